"""Fisher scoring: the exact minimum of the misfit in (nu, G) and all true forces together.

Starts from the tabulated minimum. In the inner loop responses are linear in Poisson's ratio and the
robust weights are updated at every step; the outer loop evaluates the exact responses again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import NoiseModel, score_moments
from palpate.estimation.search.local_probe import LocalProbe, ScaledRows, SearchState
from palpate.estimation.search.misfit import Misfit, common_equations, total_loss

_MAX_LINEARISATIONS = 20
# Smallest relaxation factor: changes may overshoot their limit up to twentyfold.
_SMALLEST_RELAXATION = 0.05
_MAX_STEPS = 12
_MAX_HALVINGS = 12
_LONGEST_STEP = 2.0
# Lower bound of the mean slope of the score over the mean weight: far from the minimum the slope
# may be negative, and the step would lead uphill.
_SMALLEST_SLOPE = 0.3
_LINEARISATION_TOLERANCE = 1e-10
_STEP_TOLERANCE = 1e-11
# A step this small compared with the standard error is irrelevant.
_STEP_OVER_ERROR = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class Minimum:
    """Minimum of the misfit, with what the intervals need.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    probes : tuple of LocalProbe    linearised at the minimum
    errors : (m,) float             shared errors, in prior standard deviations
    converged : bool
    """

    poisson_ratio: float
    shear_modulus: float
    probes: tuple[LocalProbe, ...]
    errors: Float[np.ndarray, " m"]
    converged: bool

    @property
    def state(self) -> SearchState:
        """Values of all that was estimated."""
        shifts = tuple(probe.shift for probe in self.probes)
        return SearchState(self.poisson_ratio, self.shear_modulus, self.errors, shifts)


def scored_minimum(
    misfit: Misfit, start: SearchState, *, poisson_range: tuple[float, float]
) -> Minimum:
    """Minimum of the misfit near a starting point.

    Parameters
    ----------
    misfit : Misfit
    start : SearchState
    poisson_range : (float, float)  Poisson's ratio stays inside

    Returns
    -------
    Minimum                         `converged` is false if the iteration did not converge
    """
    state, previous, relaxation = _within(start, poisson_range), np.zeros(0), 1.0
    for _ in range(_MAX_LINEARISATIONS):
        minimum, error = _linear_minimum(misfit, misfit.scaled(state), state, poisson_range)
        change = minimum.state.vector - state.vector
        # Responses and effects are linearised over a move; the error left is of second order in it.
        moved = float(np.abs(change[:2]).max())
        if moved < _LINEARISATION_TOLERANCE or moved**2 < _STEP_OVER_ERROR * error:
            return replace(minimum, converged=True)
        relaxation, previous = aitken_relaxation(change, previous, relaxation), change
        state = state.moved(relaxation * change)
    return minimum


def _within(state: SearchState, poisson_range: tuple[float, float]) -> SearchState:
    """The state with Poisson's ratio inside its range."""
    return replace(state, poisson_ratio=float(np.clip(state.poisson_ratio, *poisson_range)))


def aitken_relaxation(
    change: Float[np.ndarray, " n"], previous: Float[np.ndarray, " b"], relaxation: float
) -> float:
    """Relaxation factor for a fixed-point change, by Aitken's method.

    Parameters
    ----------
    change, previous : (n,) float   this change and the previous one, unrelaxed; empty at first
    relaxation : float              relaxation factor of the previous change

    Returns
    -------
    float                           0.05 to 1; 1 where changes do not overshoot

    Source
    ------
    Irons and Tuck, A version of the Aitken accelerator for computer iteration, International
    Journal for Numerical Methods in Engineering 1 (1969)
    """
    if previous.shape != change.shape:
        return 1.0
    ratio = float(change @ previous) / float(previous @ previous)
    return float(np.clip(relaxation / max(1.0 - ratio, relaxation), _SMALLEST_RELAXATION, 1.0))


def _linear_minimum(
    misfit: Misfit,
    rows: Sequence[ScaledRows],
    state: SearchState,
    poisson_range: tuple[float, float],
) -> tuple[Minimum, float]:
    """Minimum, and a standard error as in `_step`, after scoring steps with the response linear in
    Poisson's ratio about the start."""
    local = misfit.linearised(rows, state)
    loss = total_loss(local, state.errors)
    for _ in range(_MAX_STEPS):
        step, error = _step(misfit.noise, local, state, poisson_range)
        for factor in 0.5 ** np.arange(_MAX_HALVINGS):
            trial = _within(state.moved(factor * step), poisson_range)
            trial_local = misfit.linearised(rows, trial)
            new_loss = total_loss(trial_local, trial.errors)
            if new_loss <= loss + 1e-12 * (1 + abs(loss)):
                break
        else:
            # No step in this direction lowers the misfit: only rounding error is left.
            break
        moved = max(abs(trial.poisson_ratio - state.poisson_ratio), abs(factor * step[1]))
        state, local, loss = trial, trial_local, new_loss
        if moved < max(_STEP_TOLERANCE, 0.1 * _STEP_OVER_ERROR * error):
            break
    return Minimum(state.poisson_ratio, state.shear_modulus, local, state.errors, False), error


def _step(
    noise: NoiseModel,
    local: Sequence[LocalProbe],
    state: SearchState,
    poisson_range: tuple[float, float],
) -> tuple[Float[np.ndarray, " p"], float]:
    """Scoring step of `SearchState.vector`, and the smaller of the conditional standard errors of
    nu and log G."""
    factors = []
    for probe in local:
        _, slope = score_moments(noise, probe.squared, probe.rows.components)
        # Scoring, not plain reweighting: the mean slope of the score replaces the mean weight.
        factors.append(max(slope / float(probe.weight.mean()), _SMALLEST_SLOPE))
    normal, gradient, solutions = common_equations(local, state.errors, factors)
    step = _bounded(normal, gradient, state.poisson_ratio, poisson_range)
    moves = [solution[:, -1] - solution[:, :-1] @ step for solution in solutions]
    return np.concatenate([step, *moves]), float(1 / diagonal_root(normal[:2, :2]).max())


def _bounded(
    normal: np.ndarray, gradient: np.ndarray, nu: float, poisson_range: tuple[float, float]
) -> np.ndarray:
    """Step of all common parameters; where it would leave the range of nu it ends at the bound, and
    the other parameters follow."""
    # Least squares on a unit diagonal: well defined even if only one combination is identifiable.
    scale = diagonal_root(normal)
    unit = normal / np.outer(scale, scale)
    step = np.linalg.lstsq(unit, gradient / scale, rcond=1e-11)[0] / scale
    low, high = poisson_range
    if not low <= nu + step[0] <= high:
        step[0] = float(np.clip(nu + step[0], low, high) - nu)
        rest = (gradient - normal[:, 0] * step[0])[1:] / scale[1:]
        step[1:] = np.linalg.lstsq(unit[1:, 1:], rest, rcond=1e-11)[0] / scale[1:]
    step[:2] = np.clip(step[:2], -_LONGEST_STEP, _LONGEST_STEP)
    return step


def diagonal_root(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, " n"]:
    """Square root of an information matrix's diagonal, to scale it to a unit diagonal.

    Parameters
    ----------
    matrix : (n, n) float           diagonal >= 0

    Returns
    -------
    (n,) float                      > 0, with a floor far below any relevant information
    """
    size = np.diag(matrix)
    return np.sqrt(np.maximum(size, max(1e-15 * float(size.max()), 1e-200)))
