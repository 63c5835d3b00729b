"""Does the model explain each probing, and does it foretell one that it has not seen?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.intervals.profile_likelihood import FixedWeights
from palpate.estimation.intervals.sandwich import Scores
from palpate.estimation.noise import Misfit, ScoredMinimum, cut_factor
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.search import best_compliance, parabola_minimum
from palpate.shapes import Points

_GRID = 49
# One scoring step is the refit itself to second order; beyond this the table is searched.
_SMALL_MOVE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class ProbeFit:
    """Measured against predicted displacement of one probing, joint constants.

    Parameters
    ----------
    name : str
    predicted : (n, 3) float [m]            under the best true force
    residual : (n, 3) float [m]             measured minus predicted, NaN where not measured
    weight : (n, 3) float                   robust weight in [0, 1], 0 where not measured
    left_out_predicted : (n, 3) float [m] or None
        from the constants of all other probings and the measured force
    """

    name: str
    predicted: Points
    residual: Points
    weight: Points
    left_out_predicted: Points | None


def left_out_constants(
    minimum: ScoredMinimum, scores: Scores, weights: FixedWeights
) -> Float[np.ndarray, "k 2"]:
    """Constants (nu, G) from all probings but one, for every probing left out in turn.

    Parameters
    ----------
    minimum : ScoredMinimum         of all probings, at least two
    scores : Scores
    weights : FixedWeights

    Returns
    -------
    (k, 2) float                    nu [-], G [Pa]
    """
    low, high = weights.poisson_range
    left = scores.curvature.sum(0) - scores.curvature
    size = np.sqrt(np.maximum(np.einsum("kii->ki", left), np.finfo(float).tiny))
    unit = left / (size[:, :, None] * size[:, None, :]) + 1e-12 * np.eye(2)
    pull = (scores.score.sum(0) - scores.score) / size
    step = np.linalg.solve(unit, pull[..., None])[..., 0] / size
    nu = minimum.poisson_ratio + step[:, 0]
    small = np.abs(step).max() < _SMALL_MOVE and nu.min() > low and nu.max() < high
    if small:
        return np.column_stack([nu, minimum.shear_modulus * np.exp(step[:, 1])])
    others = 1.0 - np.eye(len(step))
    grid = np.linspace(low, high, _GRID)
    _, height = best_compliance(weights.at(grid), others)
    nu = np.array([parabola_minimum(grid, line) for line in height])
    compliance, _ = best_compliance(weights.at(nu), others)
    return np.column_stack([nu, 1.0 / np.diag(compliance)])


def probe_fits(
    probes: Sequence[ProbeObservations],
    misfit: Misfit,
    minimum: ScoredMinimum,
    left_out: Float[np.ndarray, "k 2"] | None,
) -> tuple[ProbeFit, ...]:
    """Predictions, residuals and weights of every probing.

    Parameters
    ----------
    probes : sequence of ProbeObservations
    misfit : Misfit                 of these probings, in this order
    minimum : ScoredMinimum
    left_out : (k, 2) float or None see `left_out_constants`
    """
    fits = []
    for k, (probe, rows, one) in enumerate(zip(probes, misfit.probes, minimum.probes, strict=True)):
        n = len(probe.position)
        force = probe.force + probe.force_std * one.shift
        predicted = _predicted(probe, force, minimum.poisson_ratio, minimum.shear_modulus)
        factor = np.zeros(n + 1)
        factor[rows.point] = cut_factor(one.squared, degrees=misfit.degrees)
        weight = np.where(np.isfinite(probe.displacement), factor[:n, None], 0.0)
        left = None
        if left_out is not None:
            left = _predicted(probe, probe.force, float(left_out[k, 0]), float(left_out[k, 1]))
        fits.append(ProbeFit(probe.name, predicted, probe.displacement - predicted, weight, left))
    return tuple(fits)


def _predicted(
    probe: ProbeObservations, force: np.ndarray, poisson_ratio: float, shear_modulus: float
) -> np.ndarray:
    """Displacement of every point of the probing, measured or not."""
    response = probe.response.value(poisson_ratio)[: 3 * len(probe.position)]
    return ((response[:, :3] @ force + response[:, 3]) / shear_modulus).reshape(-1, 3)
