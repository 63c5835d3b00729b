"""The sequence of steps from probings to elastic constants."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from palpate.errors import InputError
from palpate.estimation.fitted_model import FittedModel
from palpate.estimation.intervals import (
    IntervalSet,
    LikelihoodMap,
    ProbeFit,
    Uncertainty,
    contradiction,
    error_estimates,
    identifiable_constants,
    interval_set,
    likelihood_map,
    probe_estimate,
    probe_fits,
    scores_of,
    uncertainty_of,
    with_prior_ranges,
    with_undetermined_ratio,
)
from palpate.estimation.noise import NOISE_MODELS, noise_levels
from palpate.estimation.notes import conflicting_force_notes, fit_notes, reversed_notes
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.observed_rows import ObservedRows, observed_rows_of
from palpate.estimation.responses import ResponseTable, response_table
from palpate.estimation.search import (
    FixedWeights,
    Minimum,
    Misfit,
    best_constants,
    fitted_parameters,
    fixed_weights,
    global_start,
    nelder_mead_minimum,
    scored_minimum,
    total_loss,
    without_settlement,
)
from palpate.estimation.settings import FitMethod, FitSettings
from palpate.progress import Progress, silent
from palpate.records import Estimate, Status

_LEVEL_ROUNDS = 3
# Relative change below which the noise levels count as converged.
_LEVEL_TOLERANCE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """An estimate with the data needed to plot and check it.

    Parameters
    ----------
    estimate : Estimate
    likelihood : LikelihoodMap
    probes : tuple of ProbeFit
    intervals : IntervalSet or None     of the joint constants from the data alone: without prior
                                        ranges for constants that are not identifiable
    model : FittedModel or None         can be evaluated at other constants
    """

    estimate: Estimate
    likelihood: LikelihoodMap
    probes: tuple[ProbeFit, ...]
    intervals: IntervalSet | None = None
    model: FittedModel | None = None

    def __repr__(self) -> str:
        return f"FitResult of {len(self.probes)} probings: {self.estimate!r}"


def fit(
    probes: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    progress: Progress = silent,
) -> FitResult:
    """Elastic constants from all probings together and from each alone, with intervals.

    Parameters
    ----------
    probes : sequence of ProbeObservations  at least one
    settings : FitSettings
    progress : callable                     called with the name of each step and the fraction done

    Returns
    -------
    FitResult                               constants that are not identifiable do not raise: see
                                            `Estimate.status`

    Raises
    ------
    InputError                              no probings, duplicate names, or a probing without
                                            measurements or without any load
    NotConvergedError                       the true force of a probing did not converge (only with
                                            the method nelder-mead)
    """
    start = time.perf_counter()
    progress("tabulation", 0.0)
    rows = _checked_rows(probes)
    table = response_table(rows, settings.poisson_range)
    progress("minimisation", 0.2)
    misfit, minimum = _joint_minimum(rows, table, settings)
    progress("intervals", 0.5)
    joint = uncertainty_of(misfit, minimum, _weights(rows, table, misfit, minimum))
    intervals, reported, identifiable = _intervals(joint)
    progress("single probings", 0.7)
    singles = [(reported, identifiable)]
    if len(rows) > 1:
        singles = _single_constants(misfit, joint)
    progress("validation", 0.95)
    fits = probe_fits(misfit, joint)
    contradictions = list(filter(None, map(contradiction, probes, fits)))
    std = np.sqrt(np.diag(joint.scores.covariance())[2:])
    errors = error_estimates(misfit.shared, minimum.errors, std)
    all_errors = [*errors, *(error for probe_fit in fits for error in probe_fit.errors)]
    conflicts = [*reversed_notes(misfit, joint), *conflicting_force_notes(joint)]
    status = Status.from_identifiable(identifiable)
    if not minimum.converged:
        status = Status.NOT_CONVERGED
    # Also where the search did not converge: a wrong model is the usual reason.
    if contradictions or conflicts or any(error.is_impossible for error in all_errors):
        status = Status.MODEL_CONTRADICTED
    estimate = Estimate(
        status=status,
        shear_modulus=reported.shear_modulus,
        poisson_ratio=reported.poisson_ratio,
        young_modulus=reported.young_modulus,
        identifiable=identifiable,
        probes=tuple(
            probe_estimate(*single, own) for single, own in zip(singles, fits, strict=True)
        ),
        seconds={"fit": time.perf_counter() - start},
        method=settings.method,
        settings=asdict(settings),
        notes=(*fit_notes(misfit, joint, identifiable, contradictions, all_errors), *conflicts),
        errors=errors,
        budget=joint.budget(identifiable),
    )
    model = FittedModel(misfit, total_loss(minimum.probes, minimum.errors))
    return FitResult(estimate, likelihood_map(joint, reported), fits, intervals, model)


def best_constants_of(
    probes: Sequence[ProbeObservations], *, settings: FitSettings = FitSettings()
) -> tuple[float, float]:
    """Best-fit constants from all probings together, without intervals.

    Parameters
    ----------
    probes : sequence of ProbeObservations  at least one
    settings : FitSettings

    Returns
    -------
    (float [-], float [Pa])                 Poisson's ratio and shear modulus

    Raises
    ------
    InputError, NotConvergedError           as `fit`
    """
    rows = _checked_rows(probes)
    _, minimum = _joint_minimum(rows, response_table(rows, settings.poisson_range), settings)
    return minimum.poisson_ratio, minimum.shear_modulus


def _weights(
    rows: tuple[ObservedRows, ...], table: ResponseTable, misfit: Misfit, minimum: Minimum
) -> FixedWeights:
    """The misfit with robust weights and errors held fixed at their values at the minimum."""
    separated, table = without_settlement(rows, table, minimum)
    return fixed_weights(
        separated,
        table,
        misfit.level,
        [probe.weight for probe in minimum.probes],
        np.array([probe.force_weight for probe in minimum.probes]),
        [
            probe.explained * row.sigma(misfit.level)
            for probe, row in zip(minimum.probes, rows, strict=True)
        ],
    )


def _checked_rows(probes: Sequence[ProbeObservations]) -> tuple[ObservedRows, ...]:
    if not len(probes):
        raise InputError("there are no probings; at least one is needed for an estimate")
    names = [probe.name for probe in probes]
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(f"probings have the same name: {duplicates}; names must differ")
    return tuple(observed_rows_of(probe) for probe in probes)


def _joint_minimum(
    rows: tuple[ObservedRows, ...], table: ResponseTable, settings: FitSettings
) -> tuple[Misfit, Minimum]:
    """Robust start, then the exact minimum, with noise levels consistent with its residuals."""
    noise, poisson_range = NOISE_MODELS[settings.noise], settings.poisson_range
    start, level = global_start(rows, table, noise)
    state = start
    for _ in range(_LEVEL_ROUNDS):
        misfit = Misfit(rows, level, noise)
        minimum = scored_minimum(misfit, state, poisson_range=poisson_range)
        state = minimum.state
        residuals = [probe.residual * probe.rows.sigma(level) for probe in minimum.probes]
        level = noise_levels(rows, residuals, parameters=fitted_parameters(rows))
        if np.all(np.abs(level / misfit.level - 1) < _LEVEL_TOLERANCE):
            break
    if settings.method == FitMethod.NELDER_MEAD:
        minimum = nelder_mead_minimum(misfit, start, poisson_range=poisson_range)
    return misfit, minimum


def _intervals(uncertainty: Uncertainty) -> tuple[IntervalSet, IntervalSet, dict[str, bool]]:
    """Intervals from the data alone, intervals to report (the prior range where a constant is not
    identifiable), and which constants are identifiable."""
    intervals = interval_set(uncertainty)
    ranged, weights = intervals, uncertainty.weights
    if uncertainty.is_beyond_range():
        ranged = with_undetermined_ratio(intervals, weights)
    identifiable = identifiable_constants(ranged, weights)
    return intervals, with_prior_ranges(ranged, identifiable, weights), identifiable


def _single_constants(
    misfit: Misfit, joint: Uncertainty
) -> list[tuple[IntervalSet, dict[str, bool]]]:
    """Constants from each probing alone, with noise and weights of the joint fit, and which of them
    it identifies."""
    # A force downweighted for disagreeing with the other probings is as good as claimed by itself.
    claimed = np.stack([probe.observations.force_std for probe in misfit.probes])
    as_claimed = replace(joint.weights, force_root=claimed)
    constants = []
    for k, probe in enumerate(misfit.probes):
        weights, single = as_claimed.subset(k), replace(misfit, probes=(probe,))
        start = single.start(*best_constants(weights))
        minimum = scored_minimum(single, start, poisson_range=weights.poisson_range)
        scores, _ = scores_of(single, minimum.probes, noise=joint.noise)
        alone = replace(joint, minimum=minimum, scores=scores, weights=weights)
        constants.append(_intervals(alone)[1:])
    return constants
