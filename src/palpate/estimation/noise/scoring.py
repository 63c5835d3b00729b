"""Fisher scoring: the exact minimum of the misfit in (nu, G) and all true forces together.

Starts from the tabulated minimum. Inside, responses are linear in Poisson's ratio and the robust
weights are updated at every step; outside, the exact responses are taken again.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise.misfit import Misfit, ScaledRows, force_components, scaled_rows
from palpate.estimation.noise.student_t import loss_of, score_moments, weight_of
from palpate.estimation.observations import ObservedRows

_OUTER = 8
_INNER = 12
_HALVINGS = 12
_LONGEST_STEP = 2.0
_OUTER_STEP = 1e-10
_INNER_STEP = 1e-11
# A step this small against the standard error changes nothing that could be told.
_STEP_OVER_ERROR = 1e-7


@dataclass(frozen=True, slots=True, eq=False)
class LocalProbe:
    """One probing linearised at given constants and true force, in units of the noise.

    Parameters
    ----------
    table : (r, 6) float            slope of the prediction in nu, log G and the three force shifts,
                                    and last the residual, measured minus predicted
    squared : (p,) float            squared residual of every point
    weight : (p,) float             robust weight of every point
    shift : (3,) float              true minus measured force, in sigmas
    force_weight : float            robust weight of the measured force
    loss : float                    contribution to the misfit
    """

    table: Float[np.ndarray, "r 6"]
    squared: Float[np.ndarray, " p"]
    weight: Float[np.ndarray, " p"]
    shift: Float[np.ndarray, " 3"]
    force_weight: float
    loss: float

    @property
    def design(self) -> Float[np.ndarray, "r 5"]:
        """Slope of the prediction."""
        return self.table[:, :5]

    @property
    def residual(self) -> Float[np.ndarray, " r"]:
        """Measured minus predicted."""
        return self.table[:, 5]


@dataclass(frozen=True, slots=True, eq=False)
class ScoredMinimum:
    """Minimum of the misfit with everything that intervals need.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    probes : tuple of LocalProbe    linearised at the minimum
    converged : bool
    iterations : int
    """

    poisson_ratio: float
    shear_modulus: float
    probes: tuple[LocalProbe, ...]
    converged: bool
    iterations: int

    @property
    def loss(self) -> float:
        """Misfit at the minimum."""
        return sum(probe.loss for probe in self.probes)


def linearised(
    misfit: Misfit,
    probe: ObservedRows,
    rows: ScaledRows,
    *,
    offset: float,
    shear_modulus: float,
    shift: Float[np.ndarray, " 3"],
) -> LocalProbe:
    """One probing at nu = reference + offset, a shear modulus and a true force.

    Parameters
    ----------
    misfit : Misfit                 for its degrees of freedom
    probe : ObservedRows
    rows : ScaledRows               response and slope at the reference
    offset : float [-]              in Poisson's ratio
    shear_modulus : float [Pa]
    shift : (3,) float              true minus measured force, in sigmas
    """
    response = rows.base if offset == 0 else rows.base + offset * rows.slope
    load = np.append(probe.force + probe.force_std * shift, 1.0) / shear_modulus
    predicted = response @ load
    residual = rows.measured - predicted
    squared = np.add.reduceat(residual**2, probe.start)
    table = np.empty((len(residual), 6))
    table[:, 0] = rows.slope @ load
    np.negative(predicted, out=table[:, 1])
    np.multiply(response[:, :3], probe.force_std / shear_modulus, out=table[:, 2:5])
    table[:, 5] = residual
    count = force_components(probe)
    length = float(shift @ shift)
    force_loss = (misfit.force_degrees + count) * float(np.log1p(length / misfit.force_degrees))
    return LocalProbe(
        table=table,
        squared=squared,
        weight=weight_of(squared, probe.components, degrees=misfit.degrees),
        shift=shift,
        force_weight=(misfit.force_degrees + count) / (misfit.force_degrees + length),
        loss=loss_of(squared, probe.components, degrees=misfit.degrees) + force_loss,
    )


def scored_minimum(
    misfit: Misfit,
    poisson_ratio: float,
    shear_modulus: float,
    *,
    poisson_range: tuple[float, float],
    shift: Sequence[Float[np.ndarray, " 3"]] | None = None,
) -> ScoredMinimum:
    """Minimum of the misfit near a start.

    Parameters
    ----------
    misfit : Misfit
    poisson_ratio : float [-]       start
    shear_modulus : float [Pa]      start
    poisson_range : (float, float)  Poisson's ratio stays inside
    shift : one (3,) float for each probing, or None    start of the true forces, in sigmas

    Returns
    -------
    ScoredMinimum                   `converged` is false where the steps did not die out
    """
    nu, modulus = float(np.clip(poisson_ratio, *poisson_range)), shear_modulus
    shifts = [np.zeros(3) for _ in misfit.probes] if shift is None else list(shift)
    done, count = False, 0
    for _ in range(_OUTER):
        rows = [
            scaled_rows(probe, sigma, nu, with_slope=True)
            for probe, sigma in zip(misfit.probes, misfit.sigma, strict=True)
        ]
        reference = nu
        nu, modulus, shifts, error, steps = _inner(
            misfit, rows, reference, modulus, shifts, poisson_range
        )
        count += steps
        moved = abs(nu - reference)
        # The response is taken linear over a move; what that leaves is of the move's square.
        done = moved < _OUTER_STEP or moved**2 < _STEP_OVER_ERROR * error
        if done:
            break
    local = _all_linearised(misfit, rows, nu - reference, modulus, shifts)
    return ScoredMinimum(nu, modulus, tuple(local), done, count)


def _all_linearised(
    misfit: Misfit,
    rows: Sequence[ScaledRows],
    offset: float,
    shear_modulus: float,
    shifts: Sequence[np.ndarray],
) -> list[LocalProbe]:
    return [
        linearised(misfit, probe, row, offset=offset, shear_modulus=shear_modulus, shift=shift)
        for probe, row, shift in zip(misfit.probes, rows, shifts, strict=True)
    ]


def _inner(
    misfit: Misfit,
    rows: Sequence[ScaledRows],
    reference: float,
    modulus: float,
    shifts: list[np.ndarray],
    poisson_range: tuple[float, float],
) -> tuple[float, float, list[np.ndarray], float, int]:
    """Scoring steps with the response linear in Poisson's ratio about a reference."""
    nu, error, steps = reference, np.inf, 0
    local = _all_linearised(misfit, rows, 0.0, modulus, shifts)
    loss = sum(probe.loss for probe in local)
    while steps < _INNER:
        steps += 1
        constants, forces, error = _step(misfit, local, nu, poisson_range)
        factor = 1.0
        for _ in range(_HALVINGS):
            new_nu = float(np.clip(nu + factor * constants[0], *poisson_range))
            new_modulus = modulus * float(np.exp(factor * constants[1]))
            new_shifts = [old + factor * move for old, move in zip(shifts, forces, strict=True)]
            trial = _all_linearised(misfit, rows, new_nu - reference, new_modulus, new_shifts)
            new_loss = sum(probe.loss for probe in trial)
            if new_loss <= loss + 1e-12 * (1 + abs(loss)):
                break
            factor *= 0.5
        else:
            # No step of this direction lowers the misfit: rounding is all that is left.
            break
        moved = max(abs(new_nu - nu), abs(factor * constants[1]))
        nu, modulus, shifts, local, loss = new_nu, new_modulus, new_shifts, trial, new_loss
        if moved < max(_INNER_STEP, 0.1 * _STEP_OVER_ERROR * error):
            break
    return nu, modulus, shifts, error, steps


def _step(
    misfit: Misfit,
    local: Sequence[LocalProbe],
    nu: float,
    poisson_range: tuple[float, float],
) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Scoring step of (nu, log G) and of the forces, and a standard error of nu and log G."""
    normal, gradient = np.zeros((2, 2)), np.zeros(2)
    kept = []
    for probe, one in zip(misfit.probes, local, strict=True):
        _, slope = score_moments(one.squared, probe.components, degrees=misfit.degrees)
        # Scoring, not plain reweighting: the mean slope of the score replaces the mean weight.
        factor = max(slope / float(one.weight.mean()), 0.3)
        row_weight = np.repeat(one.weight, probe.components.astype(np.int64))
        # One small product: a product with a vector would be threaded, at ten times the cost.
        products = (one.table * row_weight[:, None]).T @ one.table
        inner, pull = factor * products[:5, :5], products[:5, 5]
        force = inner[2:, 2:] + one.force_weight * np.eye(3)
        force_pull = pull[2:] - one.force_weight * one.shift
        solved = np.linalg.solve(force, np.column_stack([inner[2:, :2], force_pull]))
        normal += inner[:2, :2] - inner[:2, 2:] @ solved[:, :2]
        gradient += pull[:2] - inner[:2, 2:] @ solved[:, 2]
        kept.append(solved)
    step = _bounded(normal, gradient, nu, poisson_range)
    forces = [solved[:, 2] - solved[:, :2] @ step for solved in kept]
    return step, forces, float(1 / _scale_of(normal).max())


def _bounded(
    normal: np.ndarray, gradient: np.ndarray, nu: float, poisson_range: tuple[float, float]
) -> np.ndarray:
    """Step of (nu, log G); at an end of the range nu is held where the step leads outwards."""
    # Scaled to a unit diagonal, least squares: nothing breaks where only one combination is told.
    scale = _scale_of(normal)
    unit = normal / np.outer(scale, scale)
    step = np.linalg.lstsq(unit, gradient / scale, rcond=1e-11)[0] / scale
    low, high = poisson_range
    if not low <= nu + step[0] <= high:
        fixed = float(np.clip(nu + step[0], low, high) - nu)
        step = np.array([fixed, (gradient[1] - normal[1, 0] * fixed) / scale[1] ** 2])
    return np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)


def _scale_of(normal: np.ndarray) -> np.ndarray:
    """Root of the diagonal, with a floor far below any information that counts."""
    size = np.diag(normal)
    return np.sqrt(np.maximum(size, max(1e-15 * float(size.max()), 1e-200)))
