"""What `palpate lab plan` promises, against fits of the sessions that the facility then measures.

Four benches with small pictures, each measured several times. A plan is an expectation; the
standard deviation of one fit holds the scatter of its few probings too, which chance makes larger
or smaller by a quarter and more: the plan is compared with the root mean square of several fits.
"""

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.figure import FACILITY, Figure
from benchmarks.options import Options
from palpate.estimation import FitResult, fisher_information
from palpate.lab import LabConfig, choose_variant, make_sessions, read_lab_config
from palpate.pipeline import MeasurementPlan, fit_session, plan_measurement, with_pictures_measured
from palpate.records import read_session

_BENCHES = Path(__file__).parent / "benches"


# Textures, readings and noise anew; 2 in a quick run.
REPEATS = 4


@dataclass(frozen=True, slots=True)
class Kept:
    """A plan against what came of it.

    Parameters
    ----------
    plan : MeasurementPlan
    results : tuple of FitResult
    bounds : tuple of (name -> float)       what Fisher's information says of each fit's own points
    """

    plan: MeasurementPlan
    results: tuple[FitResult, ...]
    bounds: tuple[dict[str, float], ...]


def measure(options: Options) -> list[Figure]:
    """Vertices seen, and standard deviations of E and nu, planned over measured."""
    files = sorted(_BENCHES.glob("*.toml"))
    chosen, repeats = (files[:1], 2) if options.quick else (files, REPEATS)
    return [figure for file in chosen for figure in bench_figures(file, repeats)]


def bench_figures(file: Path, repeats: int) -> list[Figure]:
    """Those of one bench.

    Parameters
    ----------
    file : Path                 its configuration
    repeats : int               how often it is measured
    """
    config = read_lab_config(file)
    measurement = kept(config, repeats)
    estimates = [result.estimate for result in measurement.results]
    seen = [
        planned.seen / measured.observed
        for estimate in estimates
        for planned, measured in zip(measurement.plan.probings, estimate.probes, strict=True)
    ]
    note = f"{len(seen)} probings, {min(seen):.2f} to {max(seen):.2f}"
    ratios = {"vertices seen": (float(np.mean(seen)), note)}
    for name, short in (("young_modulus", "E"), ("poisson_ratio", "nu")):
        planned = measurement.plan.precision[name]
        fitted = np.array([getattr(estimate, name).std for estimate in estimates])
        bound = _rms(np.array([precision[name] for precision in measurement.bounds]))
        note = (
            f"planned {planned:.3g}; {len(fitted)} fits: {fitted.min():.3g} to {fitted.max():.3g};"
            f" over what Fisher's information says of their own points {planned / bound:.2f}"
        )
        ratios[f"sd of {short}"] = (planned / _rms(fitted), note)
    return [
        Figure(FACILITY, f"{what}, plan over fit, {config.name}", value, note=note)
        for what, (value, note) in ratios.items()
    ]


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def kept(config: LabConfig, repeats: int) -> Kept:
    """Plan a measurement as its true constants have it, make it several times, and fit it."""
    variant, material = choose_variant(), config.material
    constants = {"poisson_ratio": material.poisson_ratio}
    with tempfile.TemporaryDirectory() as base:
        folders = [Path(base) / str(k) for k in range(repeats)]
        for folder in folders:
            folder.mkdir()
        wanted = [
            (replace(config, seed=config.seed + k), made_in) for k, made_in in enumerate(folders)
        ]
        make_sessions(wanted, variant=variant)
        sessions = [read_session(folder) for folder in folders]
        results = [fit_session(with_pictures_measured(measured)) for measured in sessions]
        plan = plan_measurement(
            sessions[0], variant=variant, pictures=config.pictures,
            young_modulus=material.young_modulus, **constants,
        )  # fmt: skip
    models = [result.model for result in results if result.model is not None]
    bounds = [
        fisher_information(
            [probe.observations for probe in model.problem.probes],
            shear_modulus=material.shear_modulus,
            **constants,
        ).bound()
        for model in models
    ]
    return Kept(plan, tuple(results), tuple(bounds))
