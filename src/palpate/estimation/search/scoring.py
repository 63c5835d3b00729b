"""Fisher scoring: the exact minimum of the misfit in (nu, G) and all true forces together.

Starts from the tabulated minimum. Inside, responses are linear in Poisson's ratio and the robust
weights are updated at every step; outside, the exact responses are taken again.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import NoiseModel, score_moments
from palpate.estimation.search.local_probe import LocalProbe, ScaledRows
from palpate.estimation.search.misfit import Misfit, common_equations, total_loss

_MAX_LINEARISATIONS = 20
# Of a change, where changes swing about their end by up to twenty times the distance to it.
_SMALLEST_SHARE = 0.05
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
    errors : (m,) float             that probings share, in prior standard deviations
    converged : bool
    """

    poisson_ratio: float
    shear_modulus: float
    probes: tuple[LocalProbe, ...]
    errors: Float[np.ndarray, " m"]
    converged: bool


def scored_minimum(
    misfit: Misfit,
    poisson_ratio: float,
    shear_modulus: float,
    *,
    poisson_range: tuple[float, float],
    shifts: Sequence[Float[np.ndarray, " _"]] | None = None,
    errors: Float[np.ndarray, " m"] | None = None,
) -> Minimum:
    """Minimum of the misfit near a start.

    Parameters
    ----------
    misfit : Misfit
    poisson_ratio : float [-]       start
    shear_modulus : float [Pa]      start, > 0
    poisson_range : (float, float)  Poisson's ratio stays inside
    shifts : one (n,) float for each probing, or None   start of forces, motions and errors, in
                                    sigmas
    errors : (m,) float or None     start of what probings share, in sigmas

    Returns
    -------
    Minimum                         `converged` is false where the steps did not die out
    """
    nu, modulus = float(np.clip(poisson_ratio, *poisson_range)), shear_modulus
    shifts = list(misfit.no_shifts() if shifts is None else shifts)
    errors = np.zeros(len(misfit.shared)) if errors is None else errors
    start, before, share = Minimum(nu, modulus, (), errors, False), np.zeros(0), 1.0
    for _ in range(_MAX_LINEARISATIONS):
        rows = misfit.scaled(start.poisson_ratio, start.shear_modulus, shifts, start.errors)
        found, error = _linear_minimum(misfit, rows, start, shifts, poisson_range)
        change = _joined(found, [probe.shift for probe in found.probes]) - _joined(start, shifts)
        # Responses and effects are taken linear over a move; what that leaves is of its square.
        moved = float(np.abs(change[:2]).max())
        if moved < _LINEARISATION_TOLERANCE or moved**2 < _STEP_OVER_ERROR * error:
            return replace(found, converged=True)
        share, before = taken_share(change, before, share), change
        start, shifts = _moved(start, shifts, share * change)
    return found


def taken_share(
    change: Float[np.ndarray, " n"], before: Float[np.ndarray, " b"], share: float
) -> float:
    """How much of a change leads to where the changes end, if they go on as since the last one.

    Parameters
    ----------
    change, before : (n,) float     this change and the whole one before; empty at first
    share : float                   how much was taken of the one before

    Returns
    -------
    float                           0.05 to 1; 1 where changes do not swing

    Source
    ------
    Irons and Tuck, A version of the Aitken accelerator for computer iteration, International
    Journal for Numerical Methods in Engineering 1 (1969)
    """
    if before.shape != change.shape:
        return 1.0
    left = float(change @ before) / float(before @ before)
    return float(np.clip(share / max(1.0 - left, share), _SMALLEST_SHARE, 1.0))


def _joined(here: Minimum, shifts: Sequence[np.ndarray]) -> Float[np.ndarray, " n"]:
    """Everything that is estimated as one vector: nu, log G, shared errors, each probing's own."""
    return np.concatenate([[here.poisson_ratio, np.log(here.shear_modulus)], here.errors, *shifts])


def _moved(
    start: Minimum, shifts: Sequence[np.ndarray], change: Float[np.ndarray, " n"]
) -> tuple[Minimum, list[np.ndarray]]:
    """A start and its shifts, moved on."""
    ends = np.cumsum([2, len(start.errors), *map(len, shifts)])
    _, errors, *own, _ = np.split(change, ends)
    there = Minimum(
        start.poisson_ratio + change[0],
        start.shear_modulus * float(np.exp(change[1])),
        (),
        start.errors + errors,
        False,
    )
    return there, [shift + move for shift, move in zip(shifts, own, strict=True)]


def _linear_minimum(
    misfit: Misfit,
    rows: Sequence[ScaledRows],
    start: Minimum,
    shifts: Sequence[np.ndarray],
    poisson_range: tuple[float, float],
) -> tuple[Minimum, float]:
    """Minimum and a standard error after scoring steps with the response linear in Poisson's ratio
    about the start."""
    reference = start.poisson_ratio
    local = misfit.linearised(rows, 0.0, start.shear_modulus, shifts, start.errors)
    best, loss = replace(start, probes=local), total_loss(local, start.errors)
    for _ in range(_MAX_STEPS):
        step, moves, error = _step(misfit.noise, best, poisson_range)
        for factor in 0.5 ** np.arange(_MAX_HALVINGS):
            nu = float(np.clip(best.poisson_ratio + factor * step[0], *poisson_range))
            modulus = best.shear_modulus * float(np.exp(factor * step[1]))
            errors = best.errors + factor * step[2:]
            new_shifts = [
                probe.shift + factor * move for probe, move in zip(best.probes, moves, strict=True)
            ]
            trial = misfit.linearised(rows, nu - reference, modulus, new_shifts, errors)
            new_loss = total_loss(trial, errors)
            if new_loss <= loss + 1e-12 * (1 + abs(loss)):
                break
        else:
            # No step of this direction lowers the misfit: rounding is all that is left.
            break
        moved = max(abs(nu - best.poisson_ratio), abs(factor * step[1]))
        best, loss = Minimum(nu, modulus, trial, errors, False), new_loss
        if moved < max(_STEP_TOLERANCE, 0.1 * _STEP_OVER_ERROR * error):
            break
    return best, error


def _step(
    noise: NoiseModel, here: Minimum, poisson_range: tuple[float, float]
) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Scoring step of (nu, log G) and shared errors, of the shifts, and a standard error."""
    factors = []
    for probe in here.probes:
        _, slope = score_moments(noise, probe.squared, probe.rows.components)
        # Scoring, not plain reweighting: the mean slope of the score replaces the mean weight.
        factors.append(max(slope / float(probe.weight.mean()), _SMALLEST_SLOPE))
    normal, gradient, solved = common_equations(here.probes, here.errors, factors)
    step = _bounded(normal, gradient, here.poisson_ratio, poisson_range)
    moves = [one[:, -1] - one[:, :-1] @ step for one in solved]
    return step, moves, float(1 / diagonal_root(normal[:2, :2]).max())


def _bounded(
    normal: np.ndarray, gradient: np.ndarray, nu: float, poisson_range: tuple[float, float]
) -> np.ndarray:
    """Step of all common parameters; at an end of the range nu is held where the step leads
    outwards."""
    # Scaled to a unit diagonal, least squares: nothing breaks where only one combination is
    # identifiable.
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
