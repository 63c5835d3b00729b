"""The field of moduli that explains a session's displacements, and its evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from jaxtyping import Float, Int

from palpate.errors import NotConvergedError
from palpate.estimation import (
    Evaluation,
    FitSettings,
    MeasuredComponents,
    ProbeObservations,
    UnknownRows,
    gauss_newton,
    information_of_common,
    joint_minimum,
    observed_rows_of,
    with_noise,
)
from palpate.field.elements import ELEMENTS
from palpate.field.field_map import FieldPosterior
from palpate.field.field_prior import FieldPrior
from palpate.field.field_responses import (
    CoefficientPrior,
    FieldExpansion,
    FieldModel,
    make_field_model,
    smooth_prior,
)
from palpate.field.poke_responses import make_poke_model
from palpate.progress import Progress, silent
from palpate.records import FieldEstimate, Session, without_pictures

_MOST_ROUNDS = 10
# In the first of these the prior of most evidence is looked for.
_CHOOSING = 5
# Change of log G anywhere that ends the rounds: of second order in what it leaves.
_TOLERANCE = 0.03
# Change of Poisson's ratio for which the finite elements are solved anew: what a field changes
# hardly depends on it.
SAME_RATIO = 0.02
# Longest step of log G: derivatives are those of the body as it is.
_LONGEST = 1.5
# Evidence over that of a body that is the same everywhere from which it is not: exp(10).
DECISIVE = 10.0

Prior = TypeVar("Prior", bound=FieldPrior | CoefficientPrior)


@dataclass(frozen=True, slots=True, eq=False)
class FieldFit:
    """A field of moduli with what the data say about it.

    Attributes
    ----------
    expansion : FieldExpansion      about the field that fits best
    prior : FieldPrior              of most evidence
    log_evidence : float            over that of a body that is the same everywhere
    observations : list of ProbeObservations    with the field's response, its coefficients as
                                    errors that all probings share
    """

    expansion: FieldExpansion
    prior: FieldPrior
    log_evidence: float
    observations: list[ProbeObservations]

    def with_field(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> list[ProbeObservations]:
        """As of every `UnevenBody`."""
        prior = smooth_prior(self.expansion.model.modes.mixing_of(self.prior))
        return self.expansion.under(session, observations).observations(prior)

    def posterior(self, minimum: Evaluation) -> FieldPosterior:
        """What a fit of `observations` says of the field.

        Parameters
        ----------
        minimum : Evaluation
        """
        where, model = modes_in(minimum), self.expansion.model
        modes = model.modes
        fields = np.column_stack([modes.modes @ modes.mixing_of(self.prior), modes.depth])
        means = model.body.means(fields)
        return FieldPosterior(
            model.body.solid,
            model.body.volume,
            means[:, :-1],
            minimum.theta[where],
            minimum.normal.covariance[np.ix_(where, where)],
            modes.layers if self.prior.layer_std else 0,
            means[:, -1],
        )

    def estimate(self, posterior: FieldPosterior) -> FieldEstimate:
        """The field as it is reported.

        Parameters
        ----------
        posterior : FieldPosterior
        """
        prior, known = self.prior, posterior.known_share
        return FieldEstimate(prior.std, prior.length, self.log_evidence, known, posterior.parts())


def fit_field(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    progress: Progress = silent,
) -> FieldFit:
    """Expand about the field that fits best, under the prior of most evidence.

    Parameters
    ----------
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    settings : FitSettings
    progress : callable

    Returns
    -------
    FieldFit

    Raises
    ------
    InputError, MeshError           as `make_field_model`
    NotConvergedError               the field does not settle
    """
    progress("finite elements", 0.0)
    model = make_model(session, observations)
    plain, modes = joint_minimum(observations, settings), model.modes

    def fitted(
        expansion: FieldExpansion, last: Fitted[FieldPrior], iteration: int
    ) -> Fitted[FieldPrior]:
        prior = last.prior
        # Two priors of nearly the same evidence must not take turns.
        if iteration < _CHOOSING:
            prior = modes.best_prior(*information_about(expansion, last.minimum, last.coefficients))
        minimum = _minimum(expansion, prior, last.minimum, last.coefficients, settings)
        return Fitted(minimum, modes.mixing_of(prior) @ minimum.theta[modes_in(minimum)], prior)

    start = Fitted(plain, np.zeros(modes.modes.shape[1]), FieldPrior(0.0, 0.0))
    expansion, best = expanded_about_best(
        model, start, fitted, tolerance=_TOLERANCE, what="the field of the modulus",
        progress=progress,
    )  # fmt: skip
    evidence = log_bayes_factor(best.minimum, plain, settings)
    observed = expansion.observations(smooth_prior(modes.mixing_of(best.prior)))
    return FieldFit(expansion, best.prior, evidence, observed)


@dataclass(frozen=True, slots=True, eq=False)
class Fitted(Generic[Prior]):
    """What best explains the data to first order about other coefficients.

    Attributes
    ----------
    minimum : Evaluation
    coefficients : (b,) float
    prior : FieldPrior or CoefficientPrior      under which they were found
    """

    minimum: Evaluation
    coefficients: Float[np.ndarray, " b"]
    prior: Prior


def expanded_about_best(
    model: FieldModel,
    start: Fitted[Prior],
    fitted: Callable[[FieldExpansion, Fitted[Prior], int], Fitted[Prior]],
    *,
    tolerance: float,
    what: str,
    progress: Progress = silent,
) -> tuple[FieldExpansion, Fitted[Prior]]:
    """Expand about coefficients until those that fit best are the same.

    Parameters
    ----------
    model : FieldModel
    start : Fitted
    fitted : callable               an expansion, what fitted best before and the number of rounds
                                    before -> what fits best with this expansion
    tolerance : float               change of log G anywhere that ends the rounds
    what : str                      of which the modulus is looked for, for messages
    progress : callable

    Returns
    -------
    FieldExpansion, Fitted

    Raises
    ------
    NotConvergedError               the coefficients do not settle
    """
    coefficients, ratio, best = start.coefficients, start.minimum.poisson_ratio, start
    homogeneous = model.moved(np.zeros_like(coefficients), ratio)
    step = np.zeros_like(coefficients)
    for iteration in range(_MOST_ROUNDS):
        progress(what, 1.0 - 0.7**iteration)
        expansion = model.expanded(coefficients, ratio, homogeneous)
        best = fitted(expansion, best, iteration)
        change = float(np.abs(model.modes.modes @ (best.coefficients - coefficients)).max())
        if change < tolerance:
            return expansion.with_slope(), best
        # Of steps that alternate the middle is nearer.
        step, before = best.coefficients - coefficients, step
        share = 0.5 if step @ before < 0.0 else 1.0
        coefficients = coefficients + min(share, _LONGEST / change) * step
        if abs(best.minimum.poisson_ratio - ratio) > SAME_RATIO:
            ratio = best.minimum.poisson_ratio
            homogeneous = model.moved(np.zeros_like(coefficients), ratio)
    raise NotConvergedError(
        f"{what} still changes by {100.0 * change:.0f} % after {_MOST_ROUNDS} rounds: the"
        " displacements contradict each other; check units, forces and contacts"
    )


def make_model(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    elements: int = ELEMENTS,
    times: Sequence[int] = (1, 3, 9),
) -> FieldModel:
    """Finite elements of an object that is pushed in view of cameras, or poked without any.

    Parameters
    ----------
    session, observations, elements, times      as `make_field_model`, `make_poke_model`
    """
    make = make_poke_model if without_pictures(session) else make_field_model
    return make(session, observations, elements=elements, times=times)


def _minimum(
    expansion: FieldExpansion,
    prior: FieldPrior,
    start: Evaluation,
    coefficients: Float[np.ndarray, " b"],
    settings: FitSettings,
) -> Evaluation:
    """The best field under a prior, jointly with everything else, from another minimum and the
    coefficients there."""
    mixing = expansion.model.modes.mixing_of(prior)
    rows = tuple(map(observed_rows_of, expansion.observations(smooth_prior(mixing))))
    at = _with_modes(start, rows, np.linalg.lstsq(mixing, coefficients)[0])
    problem = at.problem.expanded(at.poisson_ratio)
    return with_noise(problem, at.theta, settings.poisson_range)


def information_about(
    expansion: FieldExpansion, minimum: Evaluation, start: Float[np.ndarray, " b"]
) -> tuple[Float[np.ndarray, "b b"], Float[np.ndarray, " b"]]:
    """What the data say about some coefficients, everything else marginalised: H and h of
    `field_prior`.

    Parameters
    ----------
    expansion : FieldExpansion
    minimum : Evaluation            of the observations without these coefficients, or with others
    start : (b,) float              coefficients there

    Returns
    -------
    (b, b), (b,) float              H, h
    """
    every = smooth_prior(np.eye(len(start)))
    rows = tuple(map(observed_rows_of, expansion.observations(every)))
    homogeneous = not any(each.is_material for each in minimum.problem.shared)
    if homogeneous and not start.any():
        # Displacements and the model's error are those of the body as it is.
        at = _with_modes(minimum, rows, start, minimum.problem.unknown)
        at = replace(at, known_residual=minimum.residual)
    else:
        at = _with_modes(minimum, rows, start)
    (common, gradient), where = information_of_common(at), modes_in(at)
    rest = np.setdiff1d(np.arange(len(gradient)), where)
    back = np.linalg.solve(common[np.ix_(rest, rest)], common[np.ix_(rest, where)]).T
    information = common[np.ix_(where, where)] - back @ common[np.ix_(rest, where)]
    information -= np.eye(len(start))
    score = gradient[where] + start - back @ gradient[rest]
    return information, information @ start + score


def _with_modes(
    minimum: Evaluation,
    rows: tuple[MeasuredComponents, ...],
    coefficients: Float[np.ndarray, " b"],
    unknown: tuple[UnknownRows, ...] | None = None,
) -> Evaluation:
    """The objective at the same point, with the coefficients of other modes."""
    problem, theta, first = minimum.problem, minimum.theta, minimum.problem.layout.errors.start
    common = {
        error.name: value for error, value in zip(problem.shared, theta[first:], strict=False)
    }
    modes = tuple(mode for mode in rows[0].parameters if mode.is_material)
    others = tuple(error for error in problem.shared if not error.is_material)
    unshared = theta[problem.layout.common :]
    errors = [common[error.name] for error in others]
    theta = np.concatenate([theta[:first], errors, coefficients, unshared])
    return Evaluation(problem.of(rows, (*others, *modes), theta, unknown), theta)


def modes_in(minimum: Evaluation) -> Int[np.ndarray, " j"]:
    """Where the coefficients of a field are in theta, in their order.

    Parameters
    ----------
    minimum : Evaluation
    """
    shared, first = minimum.problem.shared, minimum.problem.layout.errors.start
    modes = [k for k, parameter in enumerate(shared) if parameter.is_material]
    return first + np.array(modes, dtype=np.int64)


def log_bayes_factor(field: Evaluation, plain: Evaluation, settings: FitSettings) -> float:
    """Logarithm of the evidence with a field or another cause over that without, at the noise that
    is left over with it.

    Parameters
    ----------
    field, plain : Evaluation
    settings : FitSettings

    Source
    ------
    Laplace's approximation: MacKay, Bayesian interpolation, Neural Computation 4 (1992), eq. 4.1
    """
    problem = replace(
        plain.problem,
        level=field.problem.level,
        scale=field.problem.scale,
        information=field.problem.information,
    )
    same = gauss_newton(problem, plain.theta, poisson_range=settings.poisson_range)
    return 0.5 * (same.value - field.value) + _log_volume(field) - _log_volume(same)


def _log_volume(at: Evaluation) -> float:
    """Logarithm of the posterior's volume over the prior's, up to the constants."""
    information = (at.normal.common, *at.normal.own)
    determinants = sum(float(np.linalg.slogdet(block)[1]) for block in information)
    precision = at.problem.precision()
    return 0.5 * (float(np.log(precision[precision > 0.0]).sum()) - determinants)
