"""Robust start: noise levels, weights and the global minimum over all of Poisson's ratio.

Redescending weights have local minima, so nothing is trusted before the outliers are known: first
every probing is fitted with a free force and a convex loss at the middle of the range, where even a
wrong Poisson's ratio explains most of the field; only then Student's t and the global search.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import force_components, noise_levels, weight_of
from palpate.estimation.observations import ObservedRows
from palpate.estimation.responses import NodeProducts, ResponseTable, node_products
from palpate.estimation.search.variable_projection import (
    best_compliance,
    parabola_minimum,
    projected,
)

_CONVEX_ROUNDS = 6
_ROUNDS = 3
_GRID = 49


@dataclass(frozen=True, slots=True, eq=False)
class GlobalStart:
    """Where the exact minimisation starts.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    level : (8,) float                  noise level of each group
    shift : tuple of (3,) float         true minus measured force of each probing, in sigmas
    """

    poisson_ratio: float
    shear_modulus: float
    level: Float[np.ndarray, " 8"]
    shift: tuple[Float[np.ndarray, " 3"], ...]


def poisson_grid(poisson_range: tuple[float, float], *, count: int = _GRID) -> np.ndarray:
    """Evenly spaced Poisson's ratios over a range, both ends included."""
    return np.linspace(poisson_range[0], poisson_range[1], count)


def fitted_parameters(probes: Sequence[ObservedRows]) -> int:
    """Numbers that the residuals were fitted with: two constants and the uncertain forces."""
    return 2 + sum(force_components(probe) for probe in probes)


def global_start(
    probes: Sequence[ObservedRows],
    table: ResponseTable,
    *,
    poisson_range: tuple[float, float],
    degrees: float,
    force_degrees: float,
) -> GlobalStart:
    """Robust global minimum on the tabulated responses, to the accuracy of the table.

    Parameters
    ----------
    probes : sequence of ObservedRows
    table : ResponseTable
    poisson_range : (float, float) [-]
    degrees, force_degrees : float      of Student's t for displacements and forces

    Returns
    -------
    GlobalStart
    """
    residuals = _convex_residuals(probes, table, poisson_range)
    shift = [np.zeros(3) for _ in probes]
    grid = poisson_grid(poisson_range)
    nu, beta = grid[len(grid) // 2], 1.0
    for _ in range(_ROUNDS):
        level = noise_levels(probes, residuals, parameters=fitted_parameters(probes))
        weights = []
        for probe, residual in zip(probes, residuals, strict=True):
            variance = (probe.unit * level[probe.group]) ** 2
            squared = np.add.reduceat(residual**2 / variance, probe.start)
            weight = weight_of(squared, probe.components, degrees=degrees)
            weights.append(np.repeat(weight, probe.components.astype(np.int64)) / variance)
        root = np.stack(
            [
                probe.force_std * np.sqrt((force_degrees + one @ one) / (force_degrees + 3))
                for probe, one in zip(probes, shift, strict=True)
            ]
        )
        products = node_products(table, [probe.measured for probe in probes], weights)
        nu, beta = _tabulated_minimum(products, probes, root, grid)
        residuals, shift = _residuals_at(probes, table, weights, root, nu, beta)
    return GlobalStart(nu, 1.0 / beta, level, tuple(shift))


def weighted_products(
    probes: Sequence[ObservedRows],
    table: ResponseTable,
    level: Float[np.ndarray, " 8"],
    point_weight: Sequence[Float[np.ndarray, " _"]],
) -> NodeProducts:
    """Products of the tabulated responses for given noise levels and weights of the points."""
    weights = [
        np.repeat(weight, probe.components.astype(np.int64))
        / (probe.unit * level[probe.group]) ** 2
        for probe, weight in zip(probes, point_weight, strict=True)
    ]
    return node_products(table, [probe.measured for probe in probes], weights)


def _convex_residuals(
    probes: Sequence[ObservedRows], table: ResponseTable, poisson_range: tuple[float, float]
) -> list[np.ndarray]:
    """Residuals of each probing fitted with a free force under a convex loss."""
    middle = table.at(0.5 * (poisson_range[0] + poisson_range[1]))
    weights = [1.0 / probe.unit**2 for probe in probes]
    residuals = [probe.measured for probe in probes]
    for _ in range(_CONVEX_ROUNDS):
        for k, probe in enumerate(probes):
            columns = middle[k] if np.any(middle[k][3]) else middle[k][:3]
            both = np.vstack([columns, probe.measured])
            products = (both * weights[k]) @ both.T
            size = np.sqrt(np.maximum(np.diag(products)[:-1], np.finfo(float).tiny))
            unit = products[:-1, :-1] / np.outer(size, size) + 1e-12 * np.eye(len(size))
            fitted = np.linalg.solve(unit, products[:-1, -1] / size) / size
            residuals[k] = probe.measured - fitted @ columns
        level = noise_levels(probes, residuals, parameters=3 * len(probes))
        for k, probe in enumerate(probes):
            variance = (probe.unit * level[probe.group]) ** 2
            squared = np.add.reduceat(residuals[k] ** 2 / variance, probe.start)
            convex = 1.0 / np.sqrt(1.0 + squared / probe.components)
            weights[k] = np.repeat(convex, probe.components.astype(np.int64)) / variance
    return residuals


def _tabulated_minimum(
    products: NodeProducts, probes: Sequence[ObservedRows], root: np.ndarray, grid: np.ndarray
) -> tuple[float, float]:
    """Poisson's ratio and 1 / G at the global minimum for fixed weights."""
    force = np.stack([probe.force for probe in probes])
    _, height = best_compliance(projected(products.at(grid), force, root))
    nu = parabola_minimum(grid, height[0])
    beta, _ = best_compliance(projected(products.at(np.array([nu])), force, root))
    return nu, float(beta[0, 0])


def _residuals_at(
    probes: Sequence[ObservedRows],
    table: ResponseTable,
    weights: Sequence[np.ndarray],
    root: np.ndarray,
    nu: float,
    beta: float,
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Residuals and best true forces of every probing at given constants."""
    residuals, shifts = [], []
    for k, (probe, response) in enumerate(zip(probes, table.at(nu), strict=True)):
        plain = probe.measured - beta * (probe.force @ response[:3] + response[3])
        push = beta * response[:3] * root[k][:, None]
        inner = (push * weights[k]) @ push.T + np.eye(3)
        move = np.linalg.solve(inner, push @ (weights[k] * plain))
        residuals.append(plain - move @ push)
        known = probe.force_std > 0
        shift = np.where(known, move * root[k] / np.where(known, probe.force_std, 1.0), 0.0)
        shifts.append(shift)
    return residuals, shifts
