"""What errors that probings share do to the constants: known, stated, and worse than stated.

The truth is that of `coverage_of_bodies`, quadratic tetrahedra; what the session tells is wrong in
one way at a time. Run it with

    python -m benchmarks.shared_errors FOLDER [SESSIONS [BODY ...]]

FOLDER keeps the true displacements, which take minutes a body. It prints, a body a line:

- width: of the interval of E over the width that the same measurement has where nobody errs, with
  every error as uncertain as it is by default, by what measured the forces (`BENCHES`), and how
  often it holds;
- contact: errors of E and nu where the first contact lies 1.5 mm beside the stated place:
  with the default of 0.5 mm as the only uncertain thing, with all defaults, and taken as exact;
- force: where every force is read 2 % too large, stated as 1 %, no depth given;
- scatter: how often the interval of E holds for two probings whose forces are off by so much that
  their constants lie twice as far apart as each of them claims.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle
from pathlib import Path

import numpy as np

from benchmarks.bodies import BODIES
from benchmarks.coverage_of_bodies import NOISE, Measured, errors_of, held, measured_body, session
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.records import EXACT, Estimate, Session
from palpate.records.error_priors import ErrorPriors

# Beside the stated place [m], and the gain of a sensor.
BESIDE, GAIN = 1.5e-3, 1.02


@dataclass(frozen=True, slots=True)
class Sensor:
    """What measured forces: standard deviations of its gain, and of each reading over the force."""

    name: str
    gain: float
    reading: float


# A force gauge is as good as the defaults say, a kitchen scale's check of a weight far better.
GAUGE, OTHER = Sensor("gauge", 0.01, 0.01), Sensor("other gauge", 0.01, 0.01)
WEIGHTS, EXACT_SENSOR = Sensor("weights", 5e-4, 1e-3), Sensor("exact", 0.0, 1e-6)
# The sensors of the probings, in turns.
BENCHES = {
    "a gauge": (GAUGE,),
    "two gauges": (GAUGE, OTHER),
    "weights once": (WEIGHTS, GAUGE, GAUGE),
    "weights": (WEIGHTS,),
    "exact forces": (EXACT_SENSOR,),
}


class Laboratory:
    """One body and what is fitted of it; the integrals are kept in a folder."""

    def __init__(self, body: Measured, folder: Path) -> None:
        self.body, self.cache = body, folder / "integrals"

    def session(self, drawn: ErrorPriors, stated: ErrorPriors, seed: int) -> Session:
        """A session whose errors are drawn from one prior and stated as another."""
        return replace(session(self.body, drawn, NOISE, seed), errors=stated)

    def fit(self, session: Session) -> Estimate:
        """Constants."""
        return fit_session(session, cache=self.cache).estimate


def widths(laboratory: Laboratory, seed: int) -> list[tuple[float, bool]]:
    """Width of the interval of E over that without shared errors, and whether it holds the truth,
    for each of the `BENCHES`."""
    known = _width(laboratory.fit(laboratory.session(EXACT, EXACT, seed)))
    # Forces are drawn anew for every bench, all else is the same.
    drawn = replace(ErrorPriors(), force_gain=0.0, force=0.0)
    session = laboratory.session(drawn, ErrorPriors(), seed)
    estimates = [
        laboratory.fit(measured_by(session, sensors, seed)) for sensors in BENCHES.values()
    ]
    truth = laboratory.body.truth
    return [(_width(estimate) / known, bool(held(estimate, truth)[2])) for estimate in estimates]


def _width(estimate: Estimate) -> float:
    low, high = estimate.young_modulus.ci95
    return high - low


def measured_by(session: Session, sensors: Sequence[Sensor], seed: int) -> Session:
    """A session of exact forces as some sensors, in turns, read them."""
    rng = np.random.default_rng([seed, 8])
    gains = {sensor: 1.0 + sensor.gain * rng.normal() for sensor in sensors}
    probings = []
    for probing, sensor in zip(session.probings, cycle(sensors), strict=False):
        std = sensor.reading * float(np.linalg.norm(probing.force))
        force = gains[sensor] * probing.force + std * rng.normal(size=3)
        stds = np.full(3, std)
        probings.append(replace(probing, force=force, force_std=stds, force_sensor=sensor.name))
    claimed_gains = {sensor.name: sensor.gain for sensor in sensors}
    errors = replace(session.errors, force_gains=claimed_gains)
    return replace(session, probings=tuple(probings), errors=errors)


def misplaced(session: Session, laboratory: Laboratory) -> Session:
    """The session with its first contact stated beside where it is."""
    first, *others = session.probings
    pushed = first.force / np.linalg.norm(first.force)
    beside = np.cross(pushed, np.eye(3)[np.argmin(np.abs(pushed))])
    beside *= BESIDE / np.linalg.norm(beside)
    point = closest_points(laboratory.body.mesh, (first.contact.point + beside)[None]).position[0]
    moved = replace(first, contact=replace(first.contact, point=point))
    return replace(session, probings=(moved, *others))


def too_strong(session: Session) -> Session:
    """The session with every force read too large."""
    return replace(
        session,
        probings=tuple(
            replace(probing, force=GAIN * probing.force) for probing in session.probings
        ),
    )


def scattered(laboratory: Laboratory, seed: int) -> bool:
    """Whether the interval of E of two probings holds whose spread is twice their claim."""
    rng = np.random.default_rng([seed, 7])
    whole = laboratory.session(EXACT, EXACT, seed)
    two = [whole.probings[k] for k in rng.choice(len(whole.probings), 2, replace=False)]
    claims = [laboratory.fit(replace(whole, probings=(probing,))) for probing in two]
    # Claims add to what the forces do: three variances more make the spread twice as wide.
    off = [
        1.0 + np.sqrt(3.0) * claim.young_modulus.std / claim.young_modulus.value * rng.normal()
        for claim in claims
    ]
    pair = tuple(
        replace(probing, force=k * probing.force) for probing, k in zip(two, off, strict=True)
    )
    estimate = laboratory.fit(replace(whole, probings=pair))
    return bool(held(estimate, laboratory.body.truth)[2])


def main() -> None:
    """Print the figures of each body, and what they come to together."""
    folder, count = Path(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 5
    table: list[list[tuple[float, bool]]] = []
    holding: list[bool] = []
    for name in sys.argv[3:] or BODIES:
        body = measured_body(name, folder)
        laboratory = Laboratory(body, folder)
        table += _width_lines(laboratory, count)
        priors = ErrorPriors()
        clean = laboratory.session(EXACT, priors, 0)
        beside = misplaced(clean, laboratory)
        alone = replace(EXACT, contact_point=priors.contact_point)
        rows = {
            "contact alone, 0.5 mm": replace(beside, errors=alone),
            "contact, prior 0.5 mm": beside,
            "contact, taken as exact": replace(beside, errors=EXACT),
            "force 2 %, prior 1 %": too_strong(clean),
        }
        for what, session_of_row in rows.items():
            estimate = laboratory.fit(session_of_row)
            holds = held(estimate, body.truth)
            print(f"{name:10s} {what:22s}{errors_of(estimate, body.truth)}   holds {holds}")
        holding += [scattered(laboratory, seed) for seed in range(count)]
        print(f"{name:10s} scatter: {sum(holding[-count:])} of {count} hold", flush=True)
    print(f"together: width {_medians(table)}; scatter {sum(holding)} of {len(holding)} hold")


def _width_lines(laboratory: Laboratory, count: int) -> list[list[tuple[float, bool]]]:
    table = [widths(laboratory, seed) for seed in range(count)]
    print(f"{laboratory.body.name:10s} width {_medians(table)}", flush=True)
    return table


def _medians(rows: Sequence[Sequence[tuple[float, bool]]]) -> str:
    table = np.array(rows, dtype=float)
    ratios, holding = np.median(table[:, :, 0], axis=0), table[:, :, 1].sum(axis=0)
    return ", ".join(
        f"{name} {ratio:.2f} ({holds:.0f} of {len(table)} hold)"
        for name, ratio, holds in zip(BENCHES, ratios, holding, strict=True)
    )


if __name__ == "__main__":
    main()
