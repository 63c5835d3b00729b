"""Seeded noisy repeats made by the model: do the intervals cover, is the error near its bound?"""

import os
import tomllib
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context

from benchmarks.coverage import Coverage, Disturbance, measured_coverage
from benchmarks.figure import ESTIMATION, Figure
from benchmarks.machine import CORES, SHARED
from benchmarks.options import Options
from benchmarks.session_observations import exact, session_observations, thinned
from palpate.records import EXACT, read_session

REPEATS = 500
# What is repeated says nothing about the model: `coverage_of_bodies` does.
OWN = "repeats of the model's own displacements"
STEP = 5
DISTURBANCES = {
    "Gaussian noise": Disturbance(),
    "also 3 % gross outliers, 10 % missing": Disturbance(outliers=0.03, missing=0.1),
}
SYMBOLS = {"poisson_ratio": "nu", "shear_modulus": "G", "young_modulus": "E"}


def measure(options: Options) -> list[Figure]:
    """Repeats of the 17 probings of halfball_probes, with the noise of its noisy session."""
    repeats = 20 if options.quick else REPEATS
    # The matrices of a fit are small: two processes of one thread each beat two threads.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    with ProcessPoolExecutor(CORES, mp_context=get_context("spawn")) as pool:
        outcomes = list(pool.map(partial(_outcome, repeats), DISTURBANCES.values()))
    return [
        figure
        for name, outcome in zip(DISTURBANCES, outcomes, strict=True)
        for figure in (*_covered(name, outcome), *_errors(name, outcome))
    ]


def _outcome(repeats: int, disturbance: Disturbance) -> Coverage:
    folder = SHARED / "halfball_probes"
    truth = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))
    constants = {name: truth[name] for name in ("poisson_ratio", "shear_modulus")}
    session = thinned(read_session(folder / "session_clean.toml"), STEP)
    session = replace(session, errors=EXACT)
    probes = [exact(probe, **constants) for probe in session_observations(session)]
    return measured_coverage(probes, **constants, disturbance=disturbance, repeats=repeats, seed=1)


def _covered(name: str, outcome: Coverage) -> list[Figure]:
    figures = []
    for constant, symbol in SYMBOLS.items():
        share = 100 * outcome.covered[constant]
        chance = (share * (100 - share) / outcome.repeats) ** 0.5
        figures.append(
            Figure(
                ESTIMATION,
                f"95 % interval of {symbol} covers the truth, {outcome.repeats} {OWN}, {name}",
                share,
                "%",
                note=f"+- {chance:.1f} % by chance; displacements made by the model itself",
            )
        )
    return figures


def _errors(name: str, outcome: Coverage) -> list[Figure]:
    return [
        Figure(
            ESTIMATION,
            f"rms error of {symbol} over Cramer-Rao bound, {outcome.repeats} {OWN}, {name}",
            outcome.error_over_bound[constant],
            "x",
            note=f"17 probings of halfball_probes, every {STEP}th point; bound for Gaussian noise;"
            f" mean error {outcome.bias_over_bound[constant]:+.2f} bounds",
        )
        for constant, symbol in SYMBOLS.items()
    ]
