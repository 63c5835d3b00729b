"""From probings to elastic constants: the order of the steps, and nothing else."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.estimation.intervals import (
    FixedWeights,
    IntervalSet,
    LikelihoodMap,
    ProbeFit,
    Scatter,
    ScoreNoise,
    Scores,
    identifiable_constants,
    interval_sets,
    left_out_constants,
    likelihood_map,
    probe_fits,
    scatters_of,
    scores_of,
    with_displacement_error,
    with_model_error,
    with_prior_ranges,
)
from palpate.estimation.noise import (
    Misfit,
    ScoredMinimum,
    noise_levels,
    scored_minimum,
    with_levels,
)
from palpate.estimation.notes import fit_notes
from palpate.estimation.observations import ObservedRows, ProbeObservations, observed_rows_of
from palpate.estimation.responses import ResponseTable, response_table
from palpate.estimation.search import (
    best_compliance,
    fitted_parameters,
    global_start,
    nelder_mead_minimum,
    parabola_minimum,
    poisson_grid,
    weighted_products,
)
from palpate.estimation.settings import FitMethod, FitSettings
from palpate.progress import Progress
from palpate.records import Estimate, ProbeEstimate, Status

# Stages and how much of the time has passed when they start.
_STAGES = {
    "tabulation": 0.0,
    "minimisation": 0.2,
    "intervals": 0.5,
    "single probings": 0.7,
    "validation": 0.95,
}
_LEVEL_ROUNDS = 3
_LEVEL_CHANGE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """An estimate with what its plots and checks need.

    Parameters
    ----------
    estimate : Estimate
    likelihood : LikelihoodMap
    probes : tuple of ProbeFit
    intervals : method -> IntervalSet       of the joint constants, before prior ranges
    """

    estimate: Estimate
    likelihood: LikelihoodMap
    probes: tuple[ProbeFit, ...]
    intervals: dict[str, IntervalSet] = field(default_factory=dict)


def fit(
    probes: Sequence[ProbeObservations],
    *,
    settings: FitSettings | None = None,
    progress: Progress | None = None,
) -> FitResult:
    """Elastic constants from all probings together and from each alone, with intervals.

    Parameters
    ----------
    probes : sequence of ProbeObservations  at least one
    settings : FitSettings or None          None = defaults
    progress : callable or None             told what starts (text) and how far it is (0 to 1)

    Returns
    -------
    FitResult                               what cannot be told is data: see `Estimate.status`

    Raises
    ------
    InputError                              no probing, a name twice, nothing measured in a probing
    """
    settings = settings or FitSettings()
    clock = _Clock(progress or (lambda _text, _share: None))
    clock.start("tabulation")
    rows = _checked_rows(probes)
    table = response_table(rows, settings.poisson_range)
    clock.start("minimisation")
    misfit, minimum = _joint_minimum(rows, table, settings)
    clock.start("intervals")
    scores, noise = scores_of(misfit, minimum.probes)
    weights = _fixed_weights(misfit, minimum, table, settings)
    scatters = scatters_of(scores, minimum.poisson_ratio)
    sets = _interval_sets(minimum, scores, noise, weights, scatters, settings)
    told = identifiable_constants(sets[settings.interval], weights)
    reported = with_prior_ranges(sets[settings.interval], told, weights)
    likelihood = _map(scores, scatters, weights, reported, minimum, settings)
    reported = _with_shared_errors(reported, settings)
    clock.start("single probings")
    singles = _single_intervals(misfit, table, weights, noise, scatters, settings, reported)
    clock.start("validation")
    several = len(rows) > 1
    left_out = left_out_constants(minimum, scores, weights) if several else None
    fits = probe_fits(probes, misfit, minimum, left_out)
    status = Status.from_identifiable(told) if minimum.converged else Status.NOT_CONVERGED
    estimate = Estimate(
        status=status,
        shear_modulus=reported.shear_modulus,
        poisson_ratio=reported.poisson_ratio,
        young_modulus=reported.young_modulus,
        identifiable=told,
        probes=tuple(
            _probe_estimate(probe, single, one, settings)
            for probe, single, one in zip(rows, singles, fits, strict=True)
        ),
        seconds=clock.stopped(),
        method=str(settings.method),
        settings=_plain(settings),
        notes=fit_notes(misfit, minimum, noise, scatters, told, weights),
    )
    return FitResult(estimate, likelihood, fits, sets)


class _Clock:
    """Wall time of each stage."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._seconds: dict[str, float] = {}
        self._stage = ""
        self._since = time.perf_counter()

    def start(self, stage: str) -> None:
        self.stopped()
        self._stage, self._since = stage, time.perf_counter()
        self._progress(stage, _STAGES[stage])

    def stopped(self) -> dict[str, float]:
        if self._stage:
            self._seconds[self._stage] = time.perf_counter() - self._since
        return dict(self._seconds)


def _checked_rows(probes: Sequence[ProbeObservations]) -> tuple[ObservedRows, ...]:
    if not len(probes):
        raise InputError("there are no probings; at least one is needed for an estimate")
    names = [probe.name for probe in probes]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"probings have the same name: {twice}; names must differ")
    return tuple(observed_rows_of(probe) for probe in probes)


def _joint_minimum(
    rows: tuple[ObservedRows, ...], table: ResponseTable, settings: FitSettings
) -> tuple[Misfit, ScoredMinimum]:
    """Robust start, exact minimum, and noise levels that agree with its residuals."""
    degrees = {"degrees": settings.degrees, "force_degrees": settings.force_degrees}
    start = global_start(rows, table, poisson_range=settings.poisson_range, **degrees)
    misfit = with_levels(rows, start.level, **degrees)
    nu, modulus, shift = start.poisson_ratio, start.shear_modulus, start.shift
    for round_number in range(_LEVEL_ROUNDS):
        minimum = scored_minimum(
            misfit, nu, modulus, poisson_range=settings.poisson_range, shift=shift
        )
        nu, modulus = minimum.poisson_ratio, minimum.shear_modulus
        shift = tuple(one.shift for one in minimum.probes)
        residuals = [
            one.residual * sigma for one, sigma in zip(minimum.probes, misfit.sigma, strict=True)
        ]
        level = noise_levels(rows, residuals, parameters=fitted_parameters(rows))
        settled = bool(np.all(np.abs(level / misfit.level - 1) < _LEVEL_CHANGE))
        if settled or round_number == _LEVEL_ROUNDS - 1:
            break
        misfit = with_levels(rows, level, **degrees)
    if settings.method == FitMethod.NELDER_MEAD:
        found = nelder_mead_minimum(
            misfit,
            start.poisson_ratio,
            start.shear_modulus,
            poisson_range=settings.poisson_range,
        )
        minimum = replace(
            minimum,
            poisson_ratio=found.poisson_ratio,
            shear_modulus=found.shear_modulus,
            converged=found.converged,
            iterations=found.evaluations,
        )
    return misfit, minimum


def _fixed_weights(
    misfit: Misfit, minimum: ScoredMinimum, table: ResponseTable, settings: FitSettings
) -> FixedWeights:
    products = weighted_products(
        misfit.probes, table, misfit.level, [one.weight for one in minimum.probes]
    )
    root = [
        probe.force_std / np.sqrt(one.force_weight)
        for probe, one in zip(misfit.probes, minimum.probes, strict=True)
    ]
    force = np.stack([probe.force for probe in misfit.probes])
    return FixedWeights(products, force, np.stack(root), settings.poisson_range)


def _interval_sets(
    minimum: ScoredMinimum,
    scores: Scores,
    noise: ScoreNoise,
    weights: FixedWeights,
    scatters: dict[str, Scatter],
    settings: FitSettings,
) -> dict[str, IntervalSet]:
    return interval_sets(
        minimum.poisson_ratio,
        minimum.shear_modulus,
        scores,
        noise,
        weights,
        scatters=scatters,
        bootstrap_count=settings.bootstrap_count,
        rng=np.random.default_rng(settings.seed),
    )


def _map(
    scores: Scores,
    scatters: dict[str, Scatter],
    weights: FixedWeights,
    reported: IntervalSet,
    minimum: ScoredMinimum,
    settings: FitSettings,
) -> LikelihoodMap:
    calibration = 1.0
    for name, turn in (("poisson_ratio", np.eye(2)[0]), ("shear_modulus", np.eye(2)[1])):
        variance = float(turn @ scores.covariance() @ turn) * scatters[name].factor
        calibration *= np.sqrt(variance / scores.curvature_variance(turn))
    return likelihood_map(weights, reported, calibration=float(calibration), size=settings.map_size)


def _single_intervals(
    misfit: Misfit,
    table: ResponseTable,
    weights: FixedWeights,
    noise: ScoreNoise,
    scatters: dict[str, Scatter],
    settings: FitSettings,
    joint: IntervalSet,
) -> list[IntervalSet]:
    """Constants of every probing alone, with the noise and weights of all."""
    if len(misfit.probes) == 1:
        return [joint]
    grid = poisson_grid(settings.poisson_range)
    claimed = np.stack([probe.force_std for probe in misfit.probes])
    alone = replace(weights, force_root=claimed)
    compliance, height = best_compliance(alone.at(grid).apart())
    found = []
    for k, probe in enumerate(misfit.probes):
        single = replace(misfit, probes=(probe,), sigma=(misfit.sigma[k],))
        nu = parabola_minimum(grid, height[k])
        modulus = 1.0 / float(np.interp(nu, grid, compliance[k]))
        minimum = scored_minimum(single, nu, modulus, poisson_range=settings.poisson_range)
        scores, _ = scores_of(single, minimum.probes, noise=noise)
        sets = _interval_sets(
            minimum, scores, noise, alone.only(k), scatters, replace(settings, bootstrap_count=0)
        )
        chosen = sets.get(settings.interval, sets["profile"])
        told = identifiable_constants(chosen, alone.only(k))
        ranged = with_prior_ranges(chosen, told, alone.only(k))
        found.append(_with_shared_errors(ranged, settings))
    return found


def _with_shared_errors(intervals: IntervalSet, settings: FitSettings) -> IntervalSet:
    """Intervals with what all probings have in common: the model's and the lengths' own error."""
    wider = with_model_error(intervals, settings.model_error)
    return with_displacement_error(wider, settings.displacement_error)


def _probe_estimate(
    rows: ObservedRows, single: IntervalSet, one: ProbeFit, settings: FitSettings
) -> ProbeEstimate:
    seen = np.isfinite(one.residual).any(axis=1)
    factor = one.weight.max(axis=1, initial=0.0)
    kept = seen & (factor >= settings.rejection_weight)
    error = None
    if one.left_out_predicted is not None:
        error = _rms(one.residual[kept] + one.predicted[kept] - one.left_out_predicted[kept])
    return ProbeEstimate(
        name=rows.name,
        shear_modulus=single.shear_modulus,
        poisson_ratio=single.poisson_ratio,
        young_modulus=single.young_modulus,
        observed=int(seen.sum()),
        missing=int((~seen).sum()),
        rejected=int((seen & ~kept).sum()),
        rms_residual=_rms(one.residual[kept]),
        prediction_error=error,
    )


def _rms(values: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square length of the vectors that are known [m]."""
    known = np.isfinite(values)
    points = int(known.any(axis=1).sum())
    return float(np.sqrt((values[known] ** 2).sum() / points)) if points else 0.0


def _plain(settings: FitSettings) -> dict[str, object]:
    """Settings as plain values for a file."""
    return {
        name: str(value) if isinstance(value, str) else value
        for name, value in asdict(settings).items()
    }
