"""Quality of the fit to each probing, and of its prediction from all other probings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.uncertainty import IntervalSet, Uncertainty
from palpate.estimation.noise import relative_weight
from palpate.estimation.nuisance import LoadedResponse, Nuisance, NuisanceParameter
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.search import LocalProbe, Misfit, best_constants
from palpate.records import ErrorEstimate, ProbeEstimate
from palpate.shapes import Points, Vertices

# One scoring step equals the refit to second order; beyond this step length the table is searched.
_SMALL_MOVE = 0.01
# A point of smaller robust weight counts as rejected: 4.9 sigma for three components.
_MIN_WEIGHT = 0.25


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
    motion, motion_std : (q,) float         of supports, as fitted (`ProbeObservations`)
    errors : tuple of ErrorEstimate         those that belong to this probing alone
    sigma : (n, 3) float [m]                1 sigma of the noise at the estimated levels, NaN where
                                            not measured
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


def left_out_constants(uncertainty: Uncertainty) -> Float[np.ndarray, "k 2"]:
    """Constants (nu, G) from all probings but one, for every probing left out in turn.

    Parameters
    ----------
    uncertainty : Uncertainty       of all probings, at least two

    Returns
    -------
    (k, 2) float                    nu [-], G [Pa]
    """
    minimum, scores, weights = uncertainty.minimum, uncertainty.scores, uncertainty.weights
    low, high = weights.poisson_range
    remaining = scores.curvature.sum(0) - scores.curvature
    size = np.sqrt(np.maximum(np.einsum("kii->ki", remaining), np.finfo(float).tiny))
    unit = remaining / (size[:, :, None] * size[:, None, :]) + 1e-12 * np.eye(2)
    score = scores.score[:, :2]
    gradient = (score.sum(0) - score) / size
    step = np.linalg.solve(unit, gradient[..., None])[..., 0] / size
    nu = minimum.poisson_ratio + step[:, 0]
    if np.abs(step).max() < _SMALL_MOVE and nu.min() > low and nu.max() < high:
        return np.column_stack([nu, minimum.shear_modulus * np.exp(step[:, 1])])
    every = np.arange(len(step))
    return np.array([best_constants(weights.subset(np.delete(every, k))) for k in every])


def probe_fits(misfit: Misfit, uncertainty: Uncertainty) -> tuple[ProbeFit, ...]:
    """Predictions, residuals and weights of every probing.

    Parameters
    ----------
    misfit : Misfit
    uncertainty : Uncertainty       of its probings

    Returns
    -------
    tuple of ProbeFit               `left_out_predicted` is None where there is one probing only
    """
    minimum = uncertainty.minimum
    left_out = left_out_constants(uncertainty) if len(minimum.probes) > 1 else None
    fits = []
    for k, local in enumerate(minimum.probes):
        probe = local.rows.observations
        n = len(probe.position)
        own = local.rows.load_shifts
        constants = minimum.poisson_ratio, minimum.shear_modulus
        shared, sigmas = fitted_errors(misfit, local, minimum.errors)
        predicted = predicted_points(local, constants, local.shift, sigmas)
        factor = np.zeros(n + 1)
        factor[local.rows.point] = relative_weight(
            misfit.noise, local.squared, local.rows.components
        )
        weight = np.where(np.isfinite(probe.displacement), factor[:n, None], 0.0)
        left = None
        if left_out is not None:
            # Other probings cannot predict the motions of its supports: these stay as fitted.
            shift = np.where(np.arange(len(local.shift)) < 3, 0.0, local.shift)
            nu, modulus = left_out[k].tolist()
            left = predicted_points(local, (nu, modulus), shift, shared)
        load = local.rows.load(minimum.shear_modulus, local.shift)
        std = _shift_std(local, uncertainty)
        motion_std = probe.motion_std * std[3:own]
        errors = error_estimates(misfit.own(local.rows), local.shift[own:], std[own:])
        fits.append(
            ProbeFit(
                name=probe.name,
                predicted=predicted,
                residual=probe.displacement - predicted,
                weight=weight,
                left_out_predicted=left,
                motion=load[4:],
                motion_std=motion_std,
                errors=errors,
                sigma=_sigma(local, misfit, n),
                surface=predicted_surface(probe, minimum.poisson_ratio, load),
            )
        )
    return tuple(fits)


def _sigma(local: LocalProbe, misfit: Misfit, count: int) -> Points:
    """1 sigma of every component of every point, at the estimated noise levels."""
    sigma = np.full(3 * count + 3, np.nan)
    sigma[local.rows.rows] = local.rows.component_sigma(misfit.level)
    return sigma[: 3 * count].reshape(-1, 3)


def fitted_errors(
    misfit: Misfit, local: LocalProbe, errors: Float[np.ndarray, " m"]
) -> tuple[dict[str, float], dict[str, float]]:
    """Fitted errors of a probing by name, in prior standard deviations.

    Parameters
    ----------
    misfit : Misfit
    local : LocalProbe              of this misfit
    errors : (m,) float             shared errors

    Returns
    -------
    two dict                        the shared errors; these and the probing's own
    """
    shared = dict(zip((error.name for error in misfit.shared), errors.tolist(), strict=True))
    own = [error.name for error in misfit.own(local.rows)]
    shifts = local.shift[local.rows.load_shifts :].tolist()
    return shared, shared | dict(zip(own, shifts, strict=True))


def predicted_surface(
    probe: ProbeObservations, poisson_ratio: float, load: Float[np.ndarray, " c"]
) -> Vertices | None:
    """Displacement of all vertices of the mesh, where their response is known.

    Parameters
    ----------
    probe : ProbeObservations
    poisson_ratio : float [-]
    load : (c,) float               `ObservedRows.load`

    Returns
    -------
    (v, 3) float [m] or None
    """
    if probe.vertices is None:
        return None
    response = probe.vertices.value(poisson_ratio)
    # Rows of a measured contact point follow those of the vertices.
    response = response if probe.tip_displacement is None else response[:-3]
    return np.asarray(response @ load).reshape(-1, 3)


def error_estimates(
    parameters: Sequence[NuisanceParameter],
    value: Float[np.ndarray, " p"],
    std: Float[np.ndarray, " p"],
) -> tuple[ErrorEstimate, ...]:
    """Estimates of nuisance parameters, in their own units.

    Parameters
    ----------
    parameters : sequence of p NuisanceParameter
    value, std : (p,) float         best value and standard deviation, in prior standard deviations

    Returns
    -------
    tuple of p ErrorEstimate
    """
    return tuple(
        ErrorEstimate(
            parameter.name,
            parameter.unit,
            float(parameter.std * x),
            float(parameter.std * sigma),
            parameter.std,
        )
        for parameter, x, sigma in zip(parameters, value, std, strict=True)
    )


def _shift_std(probe: LocalProbe, uncertainty: Uncertainty) -> Float[np.ndarray, " n"]:
    """Standard deviations of a probing's shifts, including that of the common parameters."""
    noise, products, d = uncertainty.noise, probe.weighted_products(), probe.common
    inverse = np.linalg.inv(products[d:-1, d:-1] + np.diag(probe.prior()))
    projection = inverse @ products[d:-1, :d]
    # As in the sandwich: the curvature contains the mean slope of the score, its noise the power.
    own = noise.power / noise.slope * noise.excess * np.diag(inverse)
    shared = np.einsum("ni,ij,nj->n", projection, uncertainty.scores.covariance(), projection)
    # Noise of the displacements cannot make it exceed the prior.
    return np.sqrt(np.minimum(own, np.maximum(np.diag(inverse), 1.0)) + shared)


def predicted_points(
    local: LocalProbe,
    constants: tuple[float, float],
    shift: Float[np.ndarray, " s"],
    errors: Mapping[str, float],
) -> Points:
    """Displacement of every point of the probing, measured or not, under some shifts and errors.

    Parameters
    ----------
    local : LocalProbe
    constants : (float [-], float [Pa])     Poisson's ratio and shear modulus
    shift : (s,) float                      `LocalProbe.shift`
    errors : name -> float                  in sigmas; one that is missing is zero

    Returns
    -------
    (n, 3) float [m]
    """
    probe, (nu, modulus) = local.rows.observations, constants
    rows = np.arange(3 * len(probe.position))
    response = probe.response_at(nu, modulus)[: len(rows)]
    at = LoadedResponse(rows, response, local.rows.load(modulus, shift), nu)
    moved = at.displacement

    def sigmas_of(nuisance: Nuisance) -> Float[np.ndarray, " p"]:
        return np.array([errors.get(error.name, 0.0) for error in nuisance.parameters])

    for nuisance in probe.nuisances:
        moved = moved + nuisance.columns(at) @ sigmas_of(nuisance)
    for curved in local.rows.curved_nuisances:
        sigmas = sigmas_of(curved)
        moved = moved + 0.5 * (curved.curvature(at) @ sigmas) @ sigmas
    return np.asarray(moved).reshape(-1, 3)


def probe_estimate(
    constants: IntervalSet, identifiable: Mapping[str, bool], fit: ProbeFit
) -> ProbeEstimate:
    """Constants from one probing alone, and how well the joint fit explains it.

    Parameters
    ----------
    constants : IntervalSet         from this probing alone
    identifiable : mapping          constant's name -> whether this probing alone determines it
    fit : ProbeFit

    Returns
    -------
    ProbeEstimate                   residuals [m] without the points that count as rejected
    """
    observed = np.isfinite(fit.residual).any(axis=1)
    kept = observed & (fit.weight.max(axis=1, initial=0.0) >= _MIN_WEIGHT)
    error = None
    if fit.left_out_predicted is not None:
        error = _rms(fit.residual[kept] + fit.predicted[kept] - fit.left_out_predicted[kept])
    return ProbeEstimate(
        name=fit.name,
        shear_modulus=constants.shear_modulus,
        poisson_ratio=constants.poisson_ratio,
        young_modulus=constants.young_modulus,
        observed=int(observed.sum()),
        missing=int((~observed).sum()),
        rejected=int((observed & ~kept).sum()),
        rms_residual=_rms(fit.residual[kept]),
        prediction_error=error,
        errors=fit.errors,
        identifiable=identifiable,
    )


def _rms(values: Float[np.ndarray, "n 3"]) -> float:
    """Root mean square length of the vectors that are measured [m]; 0 where there is none."""
    measured = np.isfinite(values)
    points = int(measured.any(axis=1).sum())
    return float(np.sqrt((values[measured] ** 2).sum() / points)) if points else 0.0
