"""From probings to elastic constants: the minimum of the objective, checks, intervals.

The notes for the reader of an estimate are full sentences, the most important first.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import count
from typing import Any

import numpy as np
from scipy.optimize import minimize

from palpate.errors import InputError, counted
from palpate.estimation.checks import (
    Contradiction,
    contradictions,
    with_outlying_forces_freed,
)
from palpate.estimation.gauss_newton import at_constants, fitted, gauss_newton
from palpate.estimation.measured_components import (
    FIRST_CLAIMED,
    GROUP_NAMES,
    MeasuredComponents,
    observed_rows_of,
)
from palpate.estimation.noise import NOISE_MODELS
from palpate.estimation.normal_equations import Evaluation, determined
from palpate.estimation.observations import ProbeObservations
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
    valley_text,
)
from palpate.estimation.predictions import (
    Prediction,
    ProbeFit,
    error_estimates,
    probe_estimate,
    probe_fits,
    sizes_of_errors,
)
from palpate.geometry import place_text
from palpate.progress import Progress, part_of, silent
from palpate.records import (
    SURPRISING,
    Constant,
    ErrorEstimate,
    Estimate,
    ModulusMap,
    Session,
    Status,
    error_texts,
    length_unit,
)
from palpate.relaxation import CreepFit

_MAX_EVALUATIONS = 1000
# Of nu, and of the logarithm of G.
_SIMPLEX_TOLERANCE, _SIMPLEX_SIZE = 1e-7, 0.02
# The most frequent causes, by the landmark near which the model fails.
_SUSPECTS = {
    "the contact": (
        "the contact's point, radius or profile, the direction of the force, or a mesh too coarse"
        " there"
    ),
    "the support": "a support that slips, gives, or reaches farther or less far than stated",
}
_OTHER_SUSPECTS = (
    "points that are misplaced on the mesh, or material that is not the same everywhere and in all"
    " directions; or the support"
)
# So few points leave the noise level and the shared errors undetermined.
_FEW_POINTS = 4


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


def _no_prediction(_: Session) -> tuple[Prediction, ...]:
    raise InputError("this result has no model to predict with: fit the session again")


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
    model : Evaluation or None          the objective at the estimate; None: read from files
    map : ModulusMap or None            None: one modulus everywhere
    creep : CreepFit or None            None: no probing has a series
    predict : callable                  Session of the same object on the same supports -> tuple of
                                        Prediction, from the forces of its probings
    """

    estimate: Estimate
    likelihood: LikelihoodMap
    probes: tuple[ProbeFit, ...]
    intervals: IntervalSet | None = None
    model: Evaluation | None = None
    map: ModulusMap | None = None
    creep: CreepFit | None = None
    predict: Callable[[Session], tuple[Prediction, ...]] = _no_prediction

    @property
    def minimum(self) -> Evaluation:
        """The objective at the estimate.

        Raises
        ------
        InputError                      the result was read from files
        """
        if self.model is None:
            raise InputError("this result has no model: fit the session again")
        return self.model

    @property
    def error_sizes(self) -> dict[str, float]:
        """Source of errors of single probings -> how large those of the fitted ones are over their
        priors, and are taken to be in predictions; empty where the result was read from files."""
        return {} if self.model is None else sizes_of_errors(self.model)

    def __repr__(self) -> str:
        return f"FitResult of {counted(len(self.probes), 'probing')}: {self.estimate!r}"


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
        joint_minimum(probes, settings, part_of(progress, 0.0, 0.5)), settings.poisson_range
    )
    progress("intervals", 0.5)
    posterior = _posterior(minimum, settings)
    reported, identifiable = reported_intervals(posterior)
    singles = [(reported, identifiable)]
    if len(probes) > 1:
        singles = []
        for k in range(len(probes)):
            progress("single probings", 0.7 + 0.25 * k / len(probes))
            singles.append(_single(minimum, k, settings))
    progress("validation", 0.95)
    fits = probe_fits(minimum, settings.poisson_range)
    contradicted_by = contradictions(minimum)
    errors = error_estimates(minimum.problem.shared, minimum, minimum.problem.layout.errors)
    every = [*errors, *(error for probe_fit in fits for error in probe_fit.errors)]
    status = Status.from_identifiable(identifiable)
    if not minimum.converged:
        status = Status.NOT_CONVERGED
    estimate = Estimate(
        status=status,
        shear_modulus=reported.shear_modulus,
        poisson_ratio=reported.poisson_ratio,
        young_modulus=reported.young_modulus,
        identifiable=identifiable,
        probes=tuple(
            probe_estimate(*single, probe_fit)
            for single, probe_fit in zip(singles, fits, strict=True)
        ),
        seconds={"fit": time.perf_counter() - start},
        method=settings.method,
        settings=asdict(settings),
        notes=_fit_notes(posterior, identifiable, contradicted_by, freed, every),
        errors=errors,
        budget=uncertainty_budget(posterior, identifiable),
    )
    # Also where the search did not converge: a wrong model is the usual reason.
    if contradicted_by:
        estimate = contradicted(estimate)
    likelihood, intervals = likelihood_map(posterior, reported), interval_set(posterior)
    # What has been computed at the minimum stays; of many pushes the expansions are large.
    minimum.problem = minimum.problem.unexpanded()
    return FitResult(estimate, likelihood, fits, intervals, minimum)


def joint_minimum(
    probes: Sequence[ProbeObservations], settings: FitSettings, progress: Progress = silent
) -> Evaluation:
    """The objective at its minimum over all probings together.

    Parameters
    ----------
    probes : sequence of ProbeObservations  at least one
    settings : FitSettings
    progress : callable

    Returns
    -------
    Evaluation

    Raises
    ------
    InputError                              as `fit`
    """
    minimum = fitted(_checked_rows(probes), NOISE_MODELS[settings.noise], settings.poisson_range)
    if settings.method == FitMethod.NELDER_MEAD:
        return _simplex_minimum(minimum, settings.poisson_range, progress)
    return minimum


def contradicted(estimate: Estimate) -> Estimate:
    """The estimate of a model that does not hold: the best fit without intervals, which would be
    those of a correct model; a constant that is not determined keeps the range of its values.

    Parameters
    ----------
    estimate : Estimate
    """
    bare: dict[str, Any] = {
        name: Constant(getattr(estimate, name).value, np.nan, (np.nan, np.nan))
        for name, known in estimate.identifiable.items()
        if known
    }
    return replace(estimate, status=Status.MODEL_CONTRADICTED, budget=(), **bare)


def _checked_rows(probes: Sequence[ProbeObservations]) -> tuple[MeasuredComponents, ...]:
    if not len(probes):
        raise InputError("there are no probings; at least one is needed for an estimate")
    names = [probe.name for probe in probes]
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(f"probings have the same name: {duplicates}; names must differ")
    return tuple(observed_rows_of(probe) for probe in probes)


def _simplex_minimum(
    minimum: Evaluation, poisson_range: tuple[float, float], progress: Progress
) -> Evaluation:
    """The minimum of the same objective over (nu, log G) by a simplex search, as Lang and Pai's,
    with everything else at its best for each."""

    number = count()

    def at(constants: np.ndarray) -> Evaluation:
        # How many it takes is not known: always some fifty more.
        progress("simplex search", 1.0 - 0.98 ** next(number))
        return at_constants(minimum, float(constants[0]), float(np.exp(constants[1])))

    result = minimize(
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
    best = at(result.x)
    return Evaluation(best.problem, best.theta, bool(result.success and minimum.converged))


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


def _fit_notes(
    posterior: Posterior,
    determined: Mapping[str, bool],
    contradictions: Sequence[Contradiction],
    freed: Mapping[str, float],
    errors: Sequence[ErrorEstimate],
) -> tuple[str, ...]:
    """Notes on contradictions of the model, forces set free, implausible errors, constants that are
    not determined, few points and noise levels.

    Parameters
    ----------
    posterior : Posterior           of all probings
    determined : constant's name -> bool
    contradictions : sequence of Contradiction
    freed : probing's name -> float     `with_outlying_forces_freed`
    errors : sequence of ErrorEstimate      of the session and of all its probings

    Returns
    -------
    tuple of str                    empty if there is nothing to note
    """
    notes = []
    if contradictions:
        notes.append(_contradiction_note(contradictions[0]))
    if freed:
        names = ", ".join(f"{name!r} by {sigmas:.1f}" for name, sigmas in freed.items())
        notes.append(
            "A force that disagrees with all others was left out, in standard deviations of the"
            f" difference: {names}; check that sensor reading and its unit."
        )
    surprising = sorted(
        filter(lambda error: error.is_surprising, errors), key=_sigmas, reverse=True
    )
    if surprising:
        notes.append(_error_note(surprising))
    if posterior.is_beyond_range():
        notes.append(
            "The data lead beyond the range of Poisson's ratio, whose end,"
            f" {posterior.minimum.poisson_ratio:g}, is therefore no measurement: give a wider"
            " poisson_range if the material may be there, else look for what contradicts the model."
        )
    if not determined["poisson_ratio"]:
        notes.append(
            f"What the data determine is {valley_text(posterior)}; the moduli's intervals are for"
            " all of the range of Poisson's ratio."
        )
    return (*notes, *_count_notes(posterior), *_noise_notes(posterior))


def _contradiction_note(contradiction: Contradiction) -> str:
    if contradiction.kind == "reversed":
        return (
            f"Along {contradiction.source} the residuals are {contradiction.sigmas:.1f} times what"
            " moved there: the model contradicts it. Check the signs and the order of the"
            " components of force and displacement, the rows of the file, and whether the object"
            " moved with its support."
        )
    if contradiction.kind == "errors":
        return (
            f"The {contradiction.source} would have to be off by {contradiction.sigmas:.1f} times"
            f" what the session allows: either that is wrong or the model is ({_OTHER_SUSPECTS})."
        )
    near = f"near {contradiction.landmark}, " if contradiction.landmark else ""
    position = place_text(contradiction.place, decimals=1)
    return (
        f"The model leaves {100.0 * contradiction.share:.2g} % of the motion of probing"
        f" {contradiction.source!r} unexplained, {contradiction.sigmas:.1f} times as much as its"
        f" mesh accounts for, most of it {near}around {position}. It may be"
        f" {_SUSPECTS.get(contradiction.landmark, _OTHER_SUSPECTS)}."
    )


def _sigmas(error: ErrorEstimate) -> float:
    return abs(error.value) / error.prior_std


def _error_note(errors: Sequence[ErrorEstimate]) -> str:
    """The largest of some surprising errors."""
    value, std, prior = error_texts(errors[0])
    others = f" {len(errors) - 1} more are listed in the report." if len(errors) > 1 else ""
    return (
        f"Likely fault: the {errors[0].name} is off by {value} +- {std}, more than"
        f" {SURPRISING:.0f} times the {prior} assumed (prior, 1 sigma).{others}"
    )


def _count_notes(posterior: Posterior) -> list[str]:
    """A note where so few points were measured that this alone explains wide intervals."""
    count = sum(len(probe.start) for probe in posterior.minimum.problem.probes)
    if count > _FEW_POINTS:
        return []
    points = "One point was" if count == 1 else f"{count} points were"
    note = (
        f"{points} measured in all: that few cannot tell noise from stiffness, whatever their"
        " quality, and the intervals are wide for that reason; measure ten or more, on all sides"
        " of the contact."
    )
    return [note]


def _noise_notes(posterior: Posterior) -> list[str]:
    problem = posterior.minimum.problem
    present = np.unique(np.concatenate([probe.group for probe in problem.probes]))
    level, notes = problem.level, []
    estimated = [int(g) for g in present if g < FIRST_CLAIMED]
    if estimated:
        parts = [f"{_length_text(level[g])} in {GROUP_NAMES[g]}" for g in estimated]
        notes.append(f"Noise levels were estimated from the residuals: {', '.join(parts)}.")
        model_error = np.sqrt(
            np.mean(np.concatenate([unknown.size for unknown in problem.unknown]) ** 2)
        )
        if max(level[g] for g in estimated) < model_error:
            notes[-1] = (
                "The displacements have no noise to speak of: what is left over is no more than the"
                f" model's own error, {_length_text(model_error)}."
            )
    raised = [int(g) for g in present if g >= FIRST_CLAIMED and level[g] > 1.1]
    if raised:
        parts = [f"{level[g]:.2f} in {GROUP_NAMES[g - FIRST_CLAIMED]}" for g in raised]
        notes.append(
            "Residuals exceed the given standard deviations, which were multiplied by"
            f" {', '.join(parts)}: intervals are as wide as the residuals ask. The noise is larger"
            " than it was said to be, or the model leaves something out."
        )
    return notes


def _length_text(metres: float) -> str:
    factor, unit = length_unit(float(metres))
    return f"{metres / factor:.2g} {unit}"
