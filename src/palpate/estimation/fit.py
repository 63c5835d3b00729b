"""From probings to elastic constants: the minimum of the objective, checks, intervals."""

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

import numpy as np
from scipy.optimize import minimize

from palpate.errors import InputError
from palpate.estimation.checks import contradictions, with_outlying_forces_freed
from palpate.estimation.gauss_newton import fitted, gauss_newton
from palpate.estimation.noise import NOISE_MODELS
from palpate.estimation.normal_equations import Evaluation, determined
from palpate.estimation.notes import fit_notes
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.observed_rows import ObservedRows, observed_rows_of
from palpate.estimation.posterior import (
    IntervalSet,
    LikelihoodMap,
    Posterior,
    degrees_of_freedom,
    interval_set,
    likelihood_map,
    posterior_of,
    reported_intervals,
    uncertainty_budget,
)
from palpate.estimation.predictions import (
    FittedModel,
    ProbeFit,
    error_estimates,
    probe_estimate,
    probe_fits,
)
from palpate.progress import Progress, silent
from palpate.records import Constant, Estimate, Status

_MAX_EVALUATIONS = 1000
# Of nu, and of the logarithm of G.
_SIMPLEX_TOLERANCE, _SIMPLEX_SIZE = 1e-7, 0.02


class FitMethod(StrEnum):
    """How the objective is minimised: Gauss-Newton on a reduced model, or a simplex on the full."""

    REDUCED = "reduced"
    NELDER_MEAD = "nelder-mead"


def _check_choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    """Refuse a name that is not among the allowed ones."""
    if value not in allowed:
        names = ", ".join(repr(str(choice)) for choice in allowed)
        raise InputError(f"{name} is {value!r}; must be one of {names}")


@dataclass(frozen=True, slots=True)
class FitSettings:
    """Settings of an estimation, stored with its result.

    Parameters
    ----------
    method : FitMethod, or its name
    noise : str                         name in `NOISE_MODELS`: "student-t" is robust to gross
                                        outliers, "gaussian" is plain least squares
    poisson_range : (float, float) [-]  prior range of Poisson's ratio, within [-0.99, 0.4999]

    Raises
    ------
    InputError                          unknown method or noise model, or range out of bounds
    """

    method: str = FitMethod.REDUCED.value
    noise: str = "student-t"
    poisson_range: tuple[float, float] = (0.0, 0.4999)

    def __post_init__(self) -> None:
        _check_choice("method", self.method, tuple(FitMethod))
        _check_choice("noise", self.noise, tuple(NOISE_MODELS))
        low, high = self.poisson_range
        if not (np.isfinite([low, high]).all() and -0.99 <= low < high <= 0.4999):
            raise InputError(
                f"poisson_range is {self.poisson_range}; both ends must be in [-0.99, 0.4999], the"
                " lower one first; use (0, 0.4999) for common solids, (-0.99, 0.4999) for auxetics"
            )


@dataclass(frozen=True, slots=True, eq=False)
class FitResult:
    """An estimate with the data needed to plot and check it.

    Parameters
    ----------
    estimate : Estimate
    likelihood : LikelihoodMap
    probes : tuple of ProbeFit
    intervals : IntervalSet or None     of the joint constants from the data alone: without prior
                                        ranges for constants that are not determined
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
    FitResult                               constants that are not determined do not raise: see
                                            `Estimate.status`

    Raises
    ------
    InputError                              no probings, duplicate names, or a probing without
                                            measurements or without any load
    """
    start = time.perf_counter()
    progress("minimisation", 0.0)
    minimum, freed = with_outlying_forces_freed(
        _joint_minimum(_checked_rows(probes), settings), settings.poisson_range
    )
    progress("intervals", 0.5)
    posterior = _posterior(minimum, settings)
    reported, identifiable = reported_intervals(posterior)
    progress("single probings", 0.7)
    singles = [(reported, identifiable)]
    if len(probes) > 1:
        singles = [_single(minimum, k, settings) for k in range(len(probes))]
    progress("validation", 0.95)
    fits = probe_fits(minimum, settings.poisson_range)
    found = contradictions(minimum)
    errors = error_estimates(minimum.problem.shared, minimum, minimum.problem.layout.errors)
    every = [*errors, *(error for probe_fit in fits for error in probe_fit.errors)]
    status = Status.from_identifiable(identifiable)
    if not minimum.converged:
        status = Status.NOT_CONVERGED
    # Also where the search did not converge: a wrong model is the usual reason.
    if found:
        status = Status.MODEL_CONTRADICTED
    # An interval is that of a right model.
    given = _without_intervals(reported, identifiable) if found else reported
    estimate = Estimate(
        status=status,
        shear_modulus=given.shear_modulus,
        poisson_ratio=given.poisson_ratio,
        young_modulus=given.young_modulus,
        identifiable=identifiable,
        probes=tuple(
            probe_estimate(*single, own) for single, own in zip(singles, fits, strict=True)
        ),
        seconds={"fit": time.perf_counter() - start},
        method=settings.method,
        settings=asdict(settings),
        notes=fit_notes(posterior, identifiable, found, freed, every),
        errors=errors,
        budget=() if found else uncertainty_budget(posterior, identifiable),
    )
    return FitResult(
        estimate,
        likelihood_map(posterior, reported),
        fits,
        interval_set(posterior),
        FittedModel(minimum, settings.poisson_range),
    )


def _without_intervals(intervals: IntervalSet, identifiable: dict[str, bool]) -> IntervalSet:
    """The values alone, the best fit of a model that does not fit; a constant that is not
    determined keeps the range of its possible values."""
    bare = {}
    for name, known in identifiable.items():
        constant = getattr(intervals, name)
        bare[name] = Constant(constant.value, np.nan, (np.nan, np.nan)) if known else constant
    return IntervalSet(**bare)


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
    InputError                              as `fit`
    """
    minimum = _joint_minimum(_checked_rows(probes), settings)
    return minimum.poisson_ratio, minimum.shear_modulus


def _checked_rows(probes: Sequence[ProbeObservations]) -> tuple[ObservedRows, ...]:
    if not len(probes):
        raise InputError("there are no probings; at least one is needed for an estimate")
    names = [probe.name for probe in probes]
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(f"probings have the same name: {duplicates}; names must differ")
    return tuple(observed_rows_of(probe) for probe in probes)


def _joint_minimum(rows: tuple[ObservedRows, ...], settings: FitSettings) -> Evaluation:
    minimum = fitted(rows, NOISE_MODELS[settings.noise], settings.poisson_range)
    if settings.method == FitMethod.NELDER_MEAD:
        return _simplex_minimum(minimum, settings.poisson_range)
    return minimum


def _simplex_minimum(minimum: Evaluation, poisson_range: tuple[float, float]) -> Evaluation:
    """The minimum of the same objective over (nu, log G) by a simplex search, as Lang and Pai's,
    with everything else at its best for each."""

    def at(constants: np.ndarray) -> Evaluation:
        theta = minimum.theta.copy()
        theta[:2] = np.clip(constants[0], *poisson_range), constants[1]
        return gauss_newton(minimum.problem, theta, fixed=(0, 1), poisson_range=poisson_range)

    found = minimize(
        lambda constants: at(constants).value,
        minimum.theta[:2] + _SIMPLEX_SIZE,
        method="Nelder-Mead",
        bounds=[poisson_range, (None, None)],
        options={
            "xatol": _SIMPLEX_TOLERANCE,
            "fatol": _SIMPLEX_TOLERANCE,
            "maxfev": _MAX_EVALUATIONS,
        },
    )
    best = at(found.x)
    return Evaluation(best.problem, best.theta, bool(found.success and minimum.converged))


def _posterior(minimum: Evaluation, settings: FitSettings) -> Posterior:
    degrees = degrees_of_freedom(minimum, determined(minimum)[0])
    return posterior_of(minimum, settings.poisson_range, degrees)


def _single(
    minimum: Evaluation, index: int, settings: FitSettings
) -> tuple[IntervalSet, dict[str, bool]]:
    """Constants from one probing alone, with the noise of the joint fit, and which of them it
    determines."""
    problem, theta = minimum.problem.subset(index, minimum.theta)
    alone = gauss_newton(problem, theta, poisson_range=settings.poisson_range)
    return reported_intervals(_posterior(alone, settings))
