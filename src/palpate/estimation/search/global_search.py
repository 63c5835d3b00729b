"""Robust start: noise levels, weights and the global minimum over all of Poisson's ratio.

A redescending loss has local minima, so the outliers are identified first: every probing is fitted
with a free force and a convex loss at the middle of the range, since even a wrong Poisson's ratio
explains most of the field. Only then follow the noise model and the global search.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import NoiseModel, noise_levels
from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.responses import ResponseTable
from palpate.estimation.search.local_probe import SearchState
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.variable_projection import best_constants, fixed_weights

_CONVEX_ROUNDS = 6
_ROUNDS = 3


def fitted_parameters(probes: Sequence[ObservedRows]) -> int:
    """Number of fitted parameters: two constants, uncertain forces and motions.

    Parameters
    ----------
    probes : sequence of ObservedRows

    Returns
    -------
    int
    """
    motions = sum(int(np.count_nonzero(one.observations.motion_std)) for one in probes)
    return 2 + motions + sum(probe.force_components for probe in probes)


def global_start(
    probes: Sequence[ObservedRows], table: ResponseTable, noise: NoiseModel
) -> tuple[SearchState, Float[np.ndarray, " 8"]]:
    """Robust global minimum on the tabulated responses, to the accuracy of the table.

    Parameters
    ----------
    probes : sequence of ObservedRows
    table : ResponseTable               of these probings
    noise : NoiseModel

    Returns
    -------
    SearchState                         where the exact minimisation starts: without errors
    (8,) float                          noise level of each group
    """
    residuals = _convex_residuals(probes, table)
    shifts = [np.zeros(probe.load_shifts) for probe in probes]
    for _ in range(_ROUNDS):
        level = noise_levels(probes, residuals, parameters=fitted_parameters(probes))
        weights = [
            noise.weight(probe.squared_length(residual / probe.sigma(level)), probe.components)
            for probe, residual in zip(probes, residuals, strict=True)
        ]
        force_weights = noise.weight(
            np.array([shift[:3] @ shift[:3] for shift in shifts]),
            np.array([float(probe.force_components) for probe in probes]),
        )
        fixed = fixed_weights(probes, table, level, weights, force_weights)
        nu, modulus = best_constants(fixed)
        for k, (probe, response) in enumerate(zip(probes, table.at(nu), strict=True)):
            row_weight = probe.per_row(weights[k]) / probe.sigma(level) ** 2
            residuals[k], shifts[k] = _at_best_force(
                probe, response.T, modulus, row_weight, float(force_weights[k])
            )
    start = Misfit(tuple(probes), level, noise).start(nu, modulus)
    for shift, found in zip(start.shifts, shifts, strict=True):
        shift[: len(found)] = found
    return start, level


def _convex_residuals(probes: Sequence[ObservedRows], table: ResponseTable) -> list[np.ndarray]:
    """Residuals of each probing fitted with a free force and motions under a convex loss."""
    middle = table.at(float(np.mean(table.poisson_range)))
    weights = [1.0 / probe.unit**2 for probe in probes]
    residuals = [probe.measured for probe in probes]
    for _ in range(_CONVEX_ROUNDS):
        for k, probe in enumerate(probes):
            free = np.append(
                [True, True, True, np.any(middle[k][3])], probe.observations.motion_std > 0
            )
            columns = middle[k][free]
            measured = probe.measured - probe.observations.motion @ middle[k][4:]
            stacked = np.vstack([columns, measured])
            products = (stacked * weights[k]) @ stacked.T
            size = np.sqrt(np.maximum(np.diag(products)[:-1], np.finfo(float).tiny))
            unit = products[:-1, :-1] / np.outer(size, size) + 1e-12 * np.eye(len(size))
            fitted = np.linalg.solve(unit, products[:-1, -1] / size) / size
            residuals[k] = measured - fitted @ columns
        motions = sum(int(np.count_nonzero(probe.observations.motion_std)) for probe in probes)
        level = noise_levels(probes, residuals, parameters=3 * len(probes) + motions)
        for k, probe in enumerate(probes):
            sigma = probe.sigma(level)
            squared = probe.squared_length(residuals[k] / sigma)
            convex = 1.0 / np.sqrt(1.0 + squared / probe.components)
            weights[k] = probe.per_row(convex) / sigma**2
    return residuals


def _at_best_force(
    probe: ObservedRows,
    response: Float[np.ndarray, "r c"],
    shear_modulus: float,
    row_weight: Float[np.ndarray, " r"],
    force_weight: float,
) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, " n"]]:
    """Residuals of a probing at its best true force and motions, and their shifts in sigmas."""
    prior = probe.prior(force_weight)
    plain = probe.measured - response @ probe.load(shear_modulus, np.zeros(len(prior)))
    per_shift = probe.per_shift(response, shear_modulus).T
    inner = (per_shift * row_weight) @ per_shift.T + np.diag(prior)
    shift = np.linalg.solve(inner, per_shift @ (row_weight * plain))
    return plain - shift @ per_shift, shift
