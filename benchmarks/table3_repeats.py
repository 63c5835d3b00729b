"""Table 3 of the paper made again and again on the virtual bench: do its intervals hold the truth?

Every repeat has its own texture, misalignment, readings and noise; the specimen stays.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.figure import FACILITY, Figure
from benchmarks.options import Options
from palpate.lab import Material, built_in, choose_variant, make_sessions, read_lab_config
from palpate.paper import (
    CALIBRATION,
    CONSTANTS,
    REGISTRATION,
    constant_errors,
    intervals_hold,
    reduced,
    with_misjudged_rig,
)
from palpate.pipeline import fit_session, with_pictures_measured
from palpate.records import Estimate, ProbeEstimate, Session, read_session

REPEATS = 20
# As in the error budget.
_ERROR = replace(
    CALIBRATION,
    object_rotation=REGISTRATION.object_rotation,
    object_translation=REGISTRATION.object_translation,
)
_WRONG = (
    f"focal lengths {100 * _ERROR.focal:g} %, centres {_ERROR.centre:g} px, cameras"
    f" {_ERROR.rotation:g} deg and {1e3 * _ERROR.translation:g} mm, object"
    f" {_ERROR.object_rotation:g} deg and {1e3 * _ERROR.object_translation:g} mm"
)


@dataclass(frozen=True, slots=True)
class Repeats:
    """Estimates of all repeats against the truth.

    Parameters
    ----------
    error : (r, 3) float        of nu, and of G and E in per cent
    held : (r, 3) bool          the 95 % interval holds the truth
    """

    error: Float[np.ndarray, "r 3"]
    held: np.ndarray


def measure(options: Options) -> list[Figure]:
    """Twenty sessions of the built-in half ball, each with all its probings."""
    config = read_lab_config(built_in()["half-ball"])
    config = reduced(config) if options.quick else config
    seeds = range(1, (2 if options.quick else REPEATS) + 1)
    with tempfile.TemporaryDirectory() as name:
        wanted = [(replace(config, seed=seed), Path(name) / str(seed)) for seed in seeds]
        for _, folder in wanted:
            folder.mkdir()
        make_sessions(wanted, variant=choose_variant(), progress=_log_progress)
        return evaluated([read_session(folder) for _, folder in wanted], config.material)


def evaluated(sessions: Sequence[Session], material: Material) -> list[Figure]:
    """Figures of sessions that repeat each other, each in a folder named by its seed."""
    estimates = [_estimate(session) for session in sessions]
    misjudged = [_estimate(_misjudged(session)) for session in sessions]
    together, wrong = _repeats(estimates, material), _repeats(misjudged, material)
    alone = _repeats([probe for each in estimates for probe in each.probes], material)
    count, singles = len(estimates), len(alone.error)
    note = f"{count} seeds: texture, misalignment, readings and noise anew"
    return [
        *_coverage("all probings", together, note),
        *_coverage("single probings", alone, f"{singles} probings; {note}"),
        *_coverage("all probings, calibration and pose a little wrong", wrong, f"{note}; {_WRONG}"),
        *_errors("all probings", together, note),
        *_errors("all probings, calibration and pose a little wrong", wrong, f"{note}; {_WRONG}"),
        *_spread(alone, f"{singles} probings; {note}"),
    ]


def _estimate(session: Session) -> Estimate:
    """Constants by the default method, the pose as given."""
    start = time.perf_counter()
    estimate = fit_session(with_pictures_measured(session, pose="given")).estimate
    young, nu = estimate.young_modulus, estimate.poisson_ratio
    _log(
        f"{session.path.parent.name}: nu {nu.value:.4f} {np.round(nu.ci95, 4).tolist()},"
        f" E {young.value:.0f} {np.round(young.ci95).tolist()},"
        f" {time.perf_counter() - start:.0f} s"
    )
    return estimate


def _misjudged(session: Session) -> Session:
    """The same pictures with a calibration and a pose of the object that are a little wrong."""
    folder = session.path.parent
    rng = np.random.default_rng([int(folder.name), 1])
    return with_misjudged_rig(session, rng, folder / "rig_misjudged.toml", error=_ERROR)


def _repeats(estimates: Sequence[Estimate | ProbeEstimate], material: Material) -> Repeats:
    error = constant_errors(estimates, material) * [1.0, 100.0, 100.0]
    return Repeats(error, intervals_hold(estimates, material))


def _coverage(which: str, repeats: Repeats, note: str) -> list[Figure]:
    share = 100 * repeats.held.mean(axis=0)
    by_name = ", ".join(f"{s} {x:.0f} %" for s, x in zip(CONSTANTS, share, strict=True))
    # Intervals of one repeat are wrong together: chance is that of the repeats.
    chance = 100 * repeats.held.mean(axis=1).std() / np.sqrt(len(repeats.held))
    return [
        Figure(FACILITY, f"table 3, {which}: 95 % intervals that hold the truth",
               float(share.mean()), "%", must=(90.0, 100.0), reach=(94.0, 96.0),
               note=f"{by_name}; +- {chance:.1f} % by chance; {note}"),
    ]  # fmt: skip


def _errors(which: str, repeats: Repeats, note: str) -> list[Figure]:
    rms = np.sqrt((repeats.error**2).mean(axis=0))
    mean = repeats.error.mean(axis=0)
    return [
        Figure(FACILITY, f"table 3, {which}: rms error of E", float(rms[2]), "%", must=2.4,
               reach=0.5, note=f"mean error {mean[2]:+.2f} %; {note}"),
        Figure(FACILITY, f"table 3, {which}: rms error of nu", float(rms[0]), "", must=0.02,
               reach=0.005, note=f"mean error {mean[0]:+.4f}; {note}"),
    ]  # fmt: skip


def _spread(repeats: Repeats, note: str) -> list[Figure]:
    spread = repeats.error.std(axis=0, ddof=1)
    return [
        Figure(FACILITY, "table 3, single probings: sd of nu", float(spread[0]), "", must=0.03,
               reach=0.01, note=note),
        Figure(FACILITY, "table 3, single probings: sd of G", float(spread[1]), "%", must=5.0,
               reach=1.5, note=note),
    ]  # fmt: skip


def _log_progress(text: str, share: float) -> None:
    _log(f"{100 * share:3.0f} % {text}")


def _log(text: str) -> None:
    """The last line of standard output belongs to the figures."""
    print(text, file=sys.stderr, flush=True)
