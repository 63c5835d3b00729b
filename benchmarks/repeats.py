"""Seeded noisy repeats made by the model: do the intervals cover, is the error near its bound?"""

import tomllib

from benchmarks.coverage import Coverage, Disturbance, measured_coverage
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from benchmarks.session_observations import exact, session_observations, thinned
from palpate.estimation import FitSettings
from palpate.records import read_session

__all__ = ["measure"]

REPEATS = 500
STEP = 5
GAUSSIAN = Disturbance()
DIRTY = Disturbance(outliers=0.03, missing=0.1)


def measure(options: Options) -> list[Figure]:
    """Repeats of the 17 probings of halfball_probes, with its own noise."""
    folder = SHARED / "halfball_probes"
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))
    constants = {name: truth[name] for name in ("poisson_ratio", "shear_modulus")}
    session = thinned(read_session(folder / "session_clean.toml"), STEP)
    probes = [exact(probe, **constants) for probe in session_observations(session)]
    repeats = 20 if options.quick else REPEATS
    figures = []
    for name, disturbance in (
        ("Gaussian noise", GAUSSIAN),
        ("with 3 % gross outliers, 10 % missing", DIRTY),
    ):
        outcome = measured_coverage(
            probes, **constants, disturbance=disturbance, repeats=repeats, seed=1
        )
        how = (
            f"17 probings of halfball_probes, every {STEP}th point, exact displacements of the"
            " model plus noise of 0.03, 0.03, 0.08 mm and 1 % of the force;"
        )
        figures += _figures(outcome, f"{repeats} seeded repeats, {name}", how)
    return figures


def _figures(outcome: Coverage, name: str, how: str) -> list[Figure]:
    reported = FitSettings().interval.value
    covered = outcome.covered[reported]
    others = {method: shares for method, shares in outcome.covered.items() if method != reported}
    figures = []
    for constant, share in covered.items():
        beside = ", ".join(
            f"{method} {100 * found[constant]:.1f} %" for method, found in others.items()
        )
        figures.append(
            Figure(
                ESTIMATION,
                f"{name}: 95 % interval of {_words(constant)} covers the truth",
                100 * share,
                "%",
                must=(92.0, 98.0),
                reach=(94.0, 96.0),
                note=f"{how} the reported interval, {reported}; {beside}",
            )
        )
    for constant, ratio in outcome.error_over_bound.items():
        figures.append(
            Figure(
                ESTIMATION,
                f"{name}: rms error of {_words(constant)} over Cramer-Rao bound",
                ratio,
                "x",
                must=1.5,
                reach=1.1,
                note=f"{how} bound for Gaussian noise without outliers",
            )
        )
    return figures


def _words(constant: str) -> str:
    return {"poisson_ratio": "nu", "shear_modulus": "G", "young_modulus": "E"}[constant]
