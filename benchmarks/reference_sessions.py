"""Do twelve sessions of all kinds give what they gave? For changes that should change nothing.

`python -m benchmarks.reference_sessions` fits them in some five minutes and prints each constant
beside the one in data/reference_sessions.csv: the difference over its standard deviation, and by
how much the interval's width changed. With `--freeze` it writes that file.
"""

import csv
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks import tension
from benchmarks.machine import ROOT, SHARED
from palpate.geometry import closest_points
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.records import (
    FREE,
    Contact,
    DisplacementField,
    Estimate,
    Session,
    Sphere,
    read_session,
)
from palpate.records.error_priors import ErrorPriors

FROZEN = ROOT / "benchmarks" / "data" / "reference_sessions.csv"
NAMES = ("young_modulus", "poisson_ratio")
# Of a standard deviation: a larger difference needs a reason.
LARGEST = 0.1


@dataclass(frozen=True, slots=True)
class Frozen:
    """A constant of a session.

    Attributes
    ----------
    session, name, status : str
    value, std : float              standard deviation that is reported
    """

    session: str
    name: str
    status: str
    value: float
    std: float


def _half_ball() -> Session:
    return read_session(ROOT / "examples" / "half_ball")


def _one_push() -> Session:
    return replace(_half_ball(), probings=_half_ball().probings[:1])


def _under_a_ball() -> Session:
    given = _half_ball()
    ball = Sphere(0.02)
    touched = [
        replace(probing, contact=Contact.under(ball, probing.contact.point))
        for probing in given.probings
    ]
    return replace(given, probings=tuple(touched))


def _on_support(**changes: object) -> Session:
    given = _half_ball()
    return replace(given, supports=(replace(given.supports[0], **changes),))


def _of_data(*parts: str) -> Session:
    return read_session(SHARED.joinpath(*parts))


def _pictures() -> Session:
    given = _of_data("halfball_images")
    return with_pictures_measured(replace(given, probings=given.probings[:3]))


def _tension() -> Session:
    x, y = (
        np.linspace(margin, length - margin, count)
        for margin, length, count in zip((0.012, 0.001), tension.SIZE, tension.POINTS, strict=False)
    )
    points = np.stack(np.meshgrid(x, y, tension.SIZE[2]), axis=-1).reshape(-1, 3)
    given = tension.session_of(points, ErrorPriors())
    noise = tension.NOISE * np.random.default_rng(0).standard_normal(points.shape)
    (probing,) = given.probings
    moved = tension.true_displacement()(points) + noise
    std = np.full_like(moved, tension.NOISE)
    near = closest_points(given.mesh, points)
    moved = DisplacementField(points, moved, std, None, near, "tension")
    return replace(given, probings=(replace(probing, displacement=moved),))


SESSIONS: dict[str, tuple[Callable[[], Session], bool]] = {
    "half ball": (_half_ball, False),
    "half ball, one push": (_one_push, False),
    "half ball under a ball": (_under_a_ball, False),
    "half ball on springs": (partial(_on_support, stiffness=1e8), False),
    "half ball that moves on its plate": (partial(_on_support, motion=FREE), False),
    "half ball, clean probings": (
        partial(_of_data, "halfball_probes", "session_clean.toml"),
        False,
    ),
    "half ball, noisy probings": (
        partial(_of_data, "halfball_probes", "session_noisy.toml"),
        False,
    ),
    "half ball, pictures": (_pictures, False),
    "cone, exact": (partial(_of_data, "exact_cone"), False),
    "beam": (partial(read_session, ROOT / "examples" / "beam"), False),
    "beam at finite strain": (partial(read_session, ROOT / "examples" / "beam"), True),
    "sheet in tension": (_tension, False),
}


def constants(session: str, estimate: Estimate) -> Iterator[Frozen]:
    """What is kept of an estimate."""
    for name in NAMES:
        constant = getattr(estimate, name)
        yield Frozen(session, name, estimate.status.value, constant.value, constant.std)


def write(frozen_now: list[Frozen]) -> None:
    """Freeze constants."""
    with FROZEN.open("w", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["session", "constant", "status", "value", "std"])
        for frozen in frozen_now:
            rows.writerow(
                [
                    frozen.session,
                    frozen.name,
                    frozen.status,
                    f"{frozen.value:.9g}",
                    f"{frozen.std:.4g}",
                ]
            )


def read() -> dict[tuple[str, str], Frozen]:
    """The frozen constants, by session and name."""
    with FROZEN.open(newline="") as file:
        rows = csv.DictReader(file)
        every = [
            Frozen(
                row["session"],
                row["constant"],
                row["status"],
                float(row["value"]),
                float(row["std"]),
            )
            for row in rows
        ]
    return {(frozen.session, frozen.name): frozen for frozen in every}


def main() -> None:
    """Fit all sessions, then print or freeze their constants."""
    freeze = sys.argv[1:] == ["--freeze"]
    before, frozen_now = {} if freeze else read(), list[Frozen]()
    for name, (make, finite) in SESSIONS.items():
        estimate = fit_session(make(), finite_strain=finite).estimate
        for constant in constants(name, estimate):
            frozen_now.append(constant)
            line = (
                f"{name:34s} {constant.name:14s} {constant.status:18s}"
                f" {constant.value:.7g} +- {constant.std:.3g}"
            )
            if not freeze:
                was = before[name, constant.name]
                off = (constant.value - was.value) / was.std
                mark = "" if abs(off) <= LARGEST and constant.status == was.status else "  <-"
                line += f"  {off:+.3f} std, width {100 * (constant.std / was.std - 1):+.1f} %{mark}"
            print(line, flush=True)
    if freeze:
        write(frozen_now)


if __name__ == "__main__":
    main()
