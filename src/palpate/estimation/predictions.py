"""Predicted displacements: of each probing at the estimate and from the constants of the others,
and of probings that were not fitted."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.measured_components import MeasuredComponents, observed_rows_of
from palpate.estimation.noise import relative_weight
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.observations import NuisanceParameter, ProbeObservations
from palpate.estimation.posterior import IntervalSet
from palpate.estimation.problem import MODEL, Problem
from palpate.records import HALF_95, ErrorEstimate, ProbeEstimate
from palpate.shapes import Points, Vertices

# A point of smaller robust weight counts as rejected: 4.9 sigma for three components.
_MIN_WEIGHT = 0.25
# Sizes of errors over those of their priors that are looked at, and how far off a prior may be:
# the standard deviation of the logarithm of the size.
_SIZES, _FACTOR = np.geomspace(0.05, 20.0, 200), float(np.log(3.0))


@dataclass(frozen=True, slots=True, eq=False)
class ProbeFit:
    """Measured and predicted displacement of one probing, at the joint constants.

    Parameters
    ----------
    name : str
    predicted : (n, 3) float [m]            under the best true force
    residual : (n, 3) float [m]             measured minus predicted, NaN where not measured
    weight : (n, 3) float                   robust weight in [0, 1], 0 where not measured
    left_out_predicted : (n, 3) float [m] or None
        from the constants of all other probings and the measured force; motions as fitted
    left_out_sigma : (n, 3) float [m] or None   of that prediction, with the noise
    motion, motion_std : (q,) float         of supports, as fitted (`ProbeObservations`)
    errors : tuple of ErrorEstimate         those that belong to this probing alone
    sigma : (n, 3) float [m]                1 sigma of noise and model at every point, NaN where not
                                            measured
    surface : (v, 3) float [m] or None      displacement of all vertices of the mesh under the best
                                            true force; None: not requested
    """

    name: str
    predicted: Points
    residual: Points
    weight: Points
    left_out_predicted: Points | None
    motion: Float[np.ndarray, " q"] = field(default_factory=lambda: np.zeros(0))
    motion_std: Float[np.ndarray, " q"] = field(default_factory=lambda: np.zeros(0))
    errors: tuple[ErrorEstimate, ...] = ()
    sigma: Points | None = None
    surface: Vertices | None = None
    left_out_sigma: Points | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Displacement of a probing that was not fitted, predicted from its force.

    Attributes
    ----------
    name : str
    position, measured : (n, 3) float [m]   its points; NaN where not measured
    predicted : (n, 3) float [m]
    std : (n, 3) float [m]                  of the prediction: constants, forces, all other errors
                                            and the model's own; without the measurement's noise
    noise : (n, 3) float [m]                standard deviation of that noise; NaN where not measured
    """

    name: str
    position: Points
    measured: Points
    predicted: Points
    std: Points
    noise: Points


def predictions_of(
    minimum: Evaluation, probes: Sequence[ProbeObservations]
) -> tuple[Prediction, ...]:
    """Displacements of probings that were not fitted, under the forces that were measured.

    Parameters
    ----------
    minimum : Evaluation            of the probings that were fitted
    probes : sequence of ProbeObservations      others

    Returns
    -------
    tuple of Prediction
    """
    measured = [observed_rows_of(probe) for probe in probes]
    rows = tuple(components.everywhere() for components in measured)
    theta, common = minimum.theta, minimum.problem.layout.common
    problem = minimum.problem.of(rows, minimum.problem.shared, theta)
    whole = np.zeros(problem.layout.size)
    whole[:common] = theta[:common]
    residuals, derivatives = problem.linearised(whole)
    sizes, predictions = sizes_of_errors(minimum), []
    for k, (probe, seen, residual, table) in enumerate(
        zip(probes, measured, residuals, derivatives, strict=True)
    ):
        variance = _variance(problem, k, table, minimum.normal.covariance, sizes)
        count = 3 * len(probe.position)
        moved, std = (values[:count].reshape(-1, 3) for values in (-residual, np.sqrt(variance)))
        noise = np.full(count + 3, np.nan)
        level = seen.sigma(minimum.problem.level) ** 2
        noise[seen.rows] = np.sqrt(seen.component_variance(level))
        here = (probe.position, probe.displacement, moved, std, noise[:count].reshape(-1, 3))
        predictions.append(Prediction(probe.name, *here))
    return tuple(predictions)


def _variance(
    problem: Problem,
    index: int,
    table: Float[np.ndarray, "s r"],
    covariance: Float[np.ndarray, "d d"],
    sizes: Mapping[str, float],
) -> Float[np.ndarray, " r"]:
    """Variance of the rows of a probing that was not fitted [m^2], without noise, from derivatives
    (`Problem.linearised`) and the covariance of the common parameters."""
    block, common = problem.layout.blocks[index], len(covariance)
    named = problem.sources[block.whole.start : block.errors.stop]
    size = np.array([sizes.get(source, 1.0) for source in named])
    variance = np.square(size) @ np.square(table[common:])
    variance += (table[:common] * (covariance @ table[:common])).sum(axis=0)
    return variance + problem.scale**2 * problem.unknown[index].total_variance()


def sizes_of_errors(minimum: Evaluation) -> dict[str, float]:
    """Size of the errors of single probings over that of their priors, by source; predictions
    assume the same of other probings. Where few points about a tool were fitted, they say little
    about the model's error there, and it stays as it is.

    Parameters
    ----------
    minimum : Evaluation            of the probings that were fitted
    """
    problem, common = minimum.problem, minimum.problem.layout.common
    source = np.array(problem.sources[common:])
    value, std = minimum.theta[common:], minimum.normal.std[common:]
    return {
        str(name): size_of_errors(value[source == name], std[source == name])
        for name in np.unique(source)
        if name != MODEL
    }


def size_of_errors(value: Float[np.ndarray, " n"], std: Float[np.ndarray, " n"]) -> float:
    """How large errors are over what their prior says, from their posteriors under it.

    Parameters
    ----------
    value, std : (n,) float         of each, in units of its prior's standard deviation

    Returns
    -------
    float                           median of the posterior, 1 where the data tell nothing; before
                                    the data, the size is 1 within a factor of 3

    Source
    ------
    Empirical Bayes: Efron and Morris, Data analysis using Stein's estimator and its
    generalizations, Journal of the American Statistical Association 70 (1975)
    """
    determined = 1.0 - np.square(std)
    known = determined > 1e-9
    determined, value = determined[known], value[known]
    # A prior of variance 1 leaves these of a likelihood with mean `value / told`.
    variance = np.square(_SIZES)[:, None] + (1.0 - determined) / determined
    log = -0.5 * (np.log(variance) + np.square(value / determined) / variance).sum(axis=1)
    log -= 0.5 * np.square(np.log(_SIZES) / _FACTOR)
    share = np.cumsum(np.exp(log - log.max()))
    return float(_SIZES[np.searchsorted(share, 0.5 * share[-1])])


def probe_fits(minimum: Evaluation, poisson_range: tuple[float, float]) -> tuple[ProbeFit, ...]:
    """Predictions, residuals and weights of every probing.

    Parameters
    ----------
    minimum : Evaluation               of all probings
    poisson_range : (float, float)

    Returns
    -------
    tuple of ProbeFit               `left_out_predicted` is None where there is one probing only
    """
    problem, theta, std = minimum.problem, minimum.theta, minimum.normal.std
    sizes, fits = sizes_of_errors(minimum), []
    for k, (probe, block, unknown, square) in enumerate(
        zip(problem.probes, problem.layout.blocks, problem.unknown, minimum.squared, strict=True)
    ):
        variance = probe.sigma(problem.level) ** 2 + problem.scale**2 * unknown.variance
        seen, n = probe.observations, len(probe.observations.position)
        predicted = problem.predicted_points(k, theta)
        factor, load = np.zeros(n + 1), problem.load(k, theta)
        factor[probe.point] = relative_weight(problem.noise, square, probe.components)
        left_out, its_sigma = _left_out(minimum, k, poisson_range, sizes) or (None, None)
        fits.append(
            ProbeFit(
                name=seen.name,
                predicted=predicted,
                residual=seen.displacement - predicted,
                weight=np.where(np.isfinite(seen.displacement), factor[:n, None], 0.0),
                left_out_predicted=left_out,
                left_out_sigma=its_sigma,
                motion=load[4:],
                motion_std=seen.motion_std * std[block.motions],
                errors=error_estimates(problem.own(k), minimum, block.errors),
                sigma=_sigma(probe, variance),
                surface=problem.predicted_surface(k, theta),
            )
        )
    return tuple(fits)


def _sigma(probe: MeasuredComponents, variance: Float[np.ndarray, " r"]) -> Points:
    """Standard deviation of every point's components from the variance of the rows."""
    count = len(probe.observations.position)
    sigma = np.full(3 * count + 3, np.nan)
    sigma[probe.rows] = np.sqrt(probe.component_variance(variance))
    return sigma[: 3 * count].reshape(-1, 3)


def _left_out(
    minimum: Evaluation,
    index: int,
    poisson_range: tuple[float, float],
    sizes: Mapping[str, float],
) -> tuple[Points, Points] | None:
    """Prediction of a probing from what all others say about the common parameters, by one step of
    theirs from the joint minimum, and its standard deviation, noise included."""
    problem, normal, layout = minimum.problem, minimum.normal, minimum.problem.layout
    if len(problem.probes) == 1:
        return None
    theta, block = minimum.theta.copy(), layout.blocks[index]
    others = replace(
        normal,
        common=normal.common - normal.parts[index],
        gradient=normal.gradient - normal.part_gradients[index],
    )
    step = others.step((), theta[0], poisson_range)
    theta[: layout.common] += step[: layout.common]
    # Others cannot predict the motions of its supports: these stay as fitted.
    for part in (block.force, block.errors, block.unknown):
        theta[part] = 0.0
    probe = problem.probes[index]
    variance = _variance(problem, index, minimum.jacobian[index], others.covariance, sizes)
    variance += probe.sigma(problem.level) ** 2
    return problem.predicted_points(index, theta), _sigma(probe, variance)


def error_estimates(
    parameters: Sequence[NuisanceParameter], minimum: Evaluation, where: slice
) -> tuple[ErrorEstimate, ...]:
    """Estimates of nuisance parameters, in their own units.

    Parameters
    ----------
    parameters : sequence of p NuisanceParameter
    minimum : Evaluation
    where : slice                   where they are in theta

    Returns
    -------
    tuple of ErrorEstimate          without parameters of the material
    """
    return tuple(
        ErrorEstimate(
            parameter.name,
            parameter.unit,
            float(parameter.std * x),
            float(parameter.std * sigma),
            parameter.std,
        )
        for parameter, x, sigma in zip(
            parameters, minimum.theta[where], minimum.normal.std[where], strict=True
        )
        if not parameter.is_material
    )


def probe_estimate(
    constants: IntervalSet, determined: Mapping[str, bool], fit: ProbeFit
) -> ProbeEstimate:
    """Constants from one probing alone, and how well the joint fit explains it.

    Parameters
    ----------
    constants : IntervalSet         from this probing alone
    determined : mapping            constant's name -> whether this probing alone determines it
    fit : ProbeFit

    Returns
    -------
    ProbeEstimate                   residuals [m] without the points that count as rejected
    """
    observed = np.isfinite(fit.residual).any(axis=1)
    accepted = observed & (fit.weight.max(axis=1, initial=0.0) >= _MIN_WEIGHT)
    error = score = within = None
    if fit.left_out_predicted is not None:
        off = fit.residual[accepted] + fit.predicted[accepted] - fit.left_out_predicted[accepted]
        error, known = _rms(off), np.isfinite(off)
        if fit.left_out_sigma is not None and known.any():
            scores = off[known] / fit.left_out_sigma[accepted][known]
            score = float(np.sqrt(np.square(scores).mean()))
            within = float((np.abs(scores) < HALF_95).mean())
    return ProbeEstimate(
        name=fit.name,
        shear_modulus=constants.shear_modulus,
        poisson_ratio=constants.poisson_ratio,
        young_modulus=constants.young_modulus,
        observed=int(observed.sum()),
        missing=int((~observed).sum()),
        rejected=int((observed & ~accepted).sum()),
        rms_residual=_rms(fit.residual[accepted]),
        prediction_error=error,
        prediction_score=score,
        prediction_within=within,
        errors=fit.errors,
        identifiable=dict(determined),
    )


def _rms(values: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square length of the vectors that are measured [m]; 0 where there is none."""
    measured = np.isfinite(values)
    points = int(measured.any(axis=1).sum())
    return float(np.sqrt((values[measured] ** 2).sum() / points)) if points else 0.0
