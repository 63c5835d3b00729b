"""Fisher scoring: the exact minimum of the misfit in (nu, G) and all true forces together.

Starts from the tabulated minimum. Inside, responses are linear in Poisson's ratio and the robust
weights are updated at every step; outside, the exact responses are taken again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import NoiseModel, score_moments
from palpate.estimation.search.misfit import LocalProbe, Misfit, ScaledRows

_MAX_LINEARISATIONS = 8
_MAX_STEPS = 12
_MAX_HALVINGS = 12
_LONGEST_STEP = 2.0
# The mean slope of the score relative to the mean weight, never below this: far from the minimum it
# may be negative, and a step against it would lead uphill.
_SMALLEST_SLOPE = 0.3
_LINEARISATION_TOLERANCE = 1e-10
_STEP_TOLERANCE = 1e-11
# A step this small against the standard error changes nothing that data could show.
_STEP_OVER_ERROR = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Minimum of the misfit with everything that intervals need.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    probes : tuple of LocalProbe    linearised at the minimum
    converged : bool
    """

    poisson_ratio: float
    shear_modulus: float
    probes: tuple[LocalProbe, ...]
    converged: bool


def scored_minimum(
    misfit: Misfit,
    poisson_ratio: float,
    shear_modulus: float,
    *,
    poisson_range: tuple[float, float],
    shifts: Sequence[Float[np.ndarray, " n"]] | None = None,
) -> Minimum:
    """Minimum of the misfit near a start.

    Parameters
    ----------
    misfit : Misfit
    poisson_ratio : float [-]       start
    shear_modulus : float [Pa]      start, > 0
    poisson_range : (float, float)  Poisson's ratio stays inside
    shifts : one (n,) float for each probing, or None   start of forces and motions, in sigmas

    Returns
    -------
    Minimum                         `converged` is false where the steps did not die out
    """
    nu, modulus = float(np.clip(poisson_ratio, *poisson_range)), shear_modulus
    shifts = shifts or [np.zeros(3 + len(probe.motion)) for probe in misfit.probes]
    for _ in range(_MAX_LINEARISATIONS):
        reference = nu
        rows = misfit.scaled(reference)
        nu, modulus, local, error = _linear_minimum(
            misfit, rows, reference, modulus, shifts, poisson_range
        )
        shifts = [probe.shift for probe in local]
        # The response is taken linear over a move; what that leaves is of the move's square.
        moved = abs(nu - reference)
        converged = moved < _LINEARISATION_TOLERANCE or moved**2 < _STEP_OVER_ERROR * error
        if converged:
            break
    return Minimum(nu, modulus, local, converged)


def _linear_minimum(
    misfit: Misfit,
    rows: Sequence[ScaledRows],
    reference: float,
    modulus: float,
    shifts: Sequence[np.ndarray],
    poisson_range: tuple[float, float],
) -> tuple[float, float, tuple[LocalProbe, ...], float]:
    """Constants, linearised probings and a standard error after scoring steps with the response
    linear in Poisson's ratio about a reference."""
    nu, error = reference, np.inf
    local = misfit.linearised(rows, 0.0, modulus, shifts)
    loss = sum(probe.loss for probe in local)
    for _ in range(_MAX_STEPS):
        constants, forces, error = _step(misfit.noise, local, nu, poisson_range)
        for factor in 0.5 ** np.arange(_MAX_HALVINGS):
            new_nu = float(np.clip(nu + factor * constants[0], *poisson_range))
            new_modulus = modulus * float(np.exp(factor * constants[1]))
            new_shifts = [
                probe.shift + factor * move for probe, move in zip(local, forces, strict=True)
            ]
            trial = misfit.linearised(rows, new_nu - reference, new_modulus, new_shifts)
            new_loss = sum(probe.loss for probe in trial)
            if new_loss <= loss + 1e-12 * (1 + abs(loss)):
                break
        else:
            # No step of this direction lowers the misfit: rounding is all that is left.
            break
        moved = max(abs(new_nu - nu), abs(factor * constants[1]))
        nu, modulus, local, loss = new_nu, new_modulus, trial, new_loss
        if moved < max(_STEP_TOLERANCE, 0.1 * _STEP_OVER_ERROR * error):
            break
    return nu, modulus, local, error


def _step(
    noise: NoiseModel,
    local: Sequence[LocalProbe],
    nu: float,
    poisson_range: tuple[float, float],
) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Scoring step of (nu, log G), of forces and motions, and a standard error of nu and log G."""
    normal, gradient = np.zeros((2, 2)), np.zeros(2)
    eliminated = []
    for probe in local:
        _, slope = score_moments(noise, probe.squared, probe.rows.components)
        # Scoring, not plain reweighting: the mean slope of the score replaces the mean weight.
        factor = max(slope / float(probe.weight.mean()), _SMALLEST_SLOPE)
        products = probe.weighted_products()
        inner, pull = factor * products[:-1, :-1], products[:-1, -1]
        force = inner[2:, 2:] + np.diag(probe.prior)
        force_pull = pull[2:] - probe.prior * probe.shift
        solved = np.linalg.solve(force, np.column_stack([inner[2:, :2], force_pull]))
        normal += inner[:2, :2] - inner[:2, 2:] @ solved[:, :2]
        gradient += pull[:2] - inner[:2, 2:] @ solved[:, 2]
        eliminated.append(solved)
    step = _bounded(normal, gradient, nu, poisson_range)
    forces = [solved[:, 2] - solved[:, :2] @ step for solved in eliminated]
    return step, forces, float(1 / diagonal_root(normal).max())


def _bounded(
    normal: np.ndarray, gradient: np.ndarray, nu: float, poisson_range: tuple[float, float]
) -> np.ndarray:
    """Step of (nu, log G); at an end of the range nu is held where the step leads outwards."""
    # Scaled to a unit diagonal, least squares: nothing breaks where only one combination is
    # identifiable.
    scale = diagonal_root(normal)
    unit = normal / np.outer(scale, scale)
    step = np.linalg.lstsq(unit, gradient / scale, rcond=1e-11)[0] / scale
    low, high = poisson_range
    if not low <= nu + step[0] <= high:
        fixed = float(np.clip(nu + step[0], low, high) - nu)
        step = np.array([fixed, (gradient[1] - normal[1, 0] * fixed) / scale[1] ** 2])
    return np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)


def diagonal_root(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " n"]:
    """Root of an information matrix's diagonal, to scale it to a diagonal of ones.

    Parameters
    ----------
    matrix : (n, n) float           diagonal >= 0

    Returns
    -------
    (n,) float                      > 0, with a floor far below any information that counts
    """
    size = np.diag(matrix)
    return np.sqrt(np.maximum(size, max(1e-15 * float(size.max()), 1e-200)))
