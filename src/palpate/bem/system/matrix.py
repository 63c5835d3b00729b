"""Matrices of a system from its integrals: at one Poisson's ratio, and its derivative in it.

The derivative involves five scalar fields only: the three of r x n and the one of r.n from the
traction kernel, and 1 / r from the displacement kernel. They are stored as dense matrices, so that
a product with many vectors takes a few large matrix products.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg.blas import get_blas_funcs

from palpate.bem.integrals.kelvin import displacement_parts, traction_parts
from palpate.bem.integrals.surface import integral_weights
from palpate.bem.system.system import (
    BlockUse,
    BoundarySystem,
    Precision,
    for_each_block,
)
from palpate.threads import parallel_algebra


def system_matrix(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> Float[np.ndarray, "r k"]:
    """The matrix at one Poisson's ratio, multiplied by 8 pi (1 - nu).

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float
    precision : type          of its entries

    Returns
    -------
    (r, k) float              Fortran order; rows by component, then by collocation point in the
                              order of the system; the last three are the force balance
    """
    matrix, fill = _matrix_to_fill(system, poisson_ratio, precision)
    for_each_block(system, fill)
    return matrix


@dataclass(frozen=True, slots=True, eq=False)
class SystemSlope:
    """d matrix / d nu; the matrix is linear in nu, so this is matrix(nu + 1) - matrix(nu).

    Attributes
    ----------
    skew : (3, r, f) float        twice the integrals of r x n / r^3, by free vertex
    flux : (r, f) float           twice those of r.n / r^3
    trace : (r, s) float          twice those of 1 / r, by held side, over `traction_length`
    """

    skew: Float[np.ndarray, "3 r f"]
    flux: Float[np.ndarray, "r f"]
    trace: Float[np.ndarray, "r s"]

    def apply(self, unknowns: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "r c"]:
        """Product with vectors of unknowns.

        Parameters
        ----------
        unknowns : (k, c) float

        Returns
        -------
        (r, c) float              rows in the order of `system_matrix`
        """
        (n_rows, n_free), count = self.flux.shape, unknowns.shape[1]
        unknowns = unknowns.astype(self.flux.dtype, copy=False)
        u = unknowns[: 3 * n_free].reshape(n_free, 3, count)
        q = unknowns[3 * n_free : -3].reshape(self.trace.shape[1], 3 * count)
        total = _product(self.flux, u.reshape(n_free, 3 * count)) + _product(self.trace, q)
        product = total.astype(float, copy=False).reshape(n_rows, 3, count)
        for axis, part in enumerate(self.skew):
            # A cross product with the axis involves the two other components only.
            after, last = (axis + 1) % 3, (axis + 2) % 3
            others = u[:, [after, last]].reshape(n_free, 2 * count)
            turned = _product(part, others).reshape(n_rows, 2, count)
            product[:, after] -= turned[:, 1]
            product[:, last] += turned[:, 0]
        return np.concatenate([*product.transpose(1, 0, 2), np.zeros((3, count))])


def matrix_and_slope(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> tuple[Float[np.ndarray, "r k"], SystemSlope]:
    """`system_matrix` and its derivative with respect to Poisson's ratio, from the same integrals.

    Parameters
    ----------
    system, poisson_ratio, precision    as in `system_matrix`

    Returns
    -------
    (r, k) float
    SystemSlope
    """
    matrix, fill_matrix = _matrix_to_fill(system, poisson_ratio, precision)
    slope, fill_slope = _slope_to_fill(system, precision)

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        fill_matrix(rows, traction, displacement)
        fill_slope(rows, traction, displacement)

    for_each_block(system, fill)
    return matrix, slope


def _matrix_to_fill(
    system: BoundarySystem, poisson_ratio: float, precision: Precision = np.float64
) -> tuple[Float[np.ndarray, "r k"], BlockUse]:
    """A matrix that lacks its integral equations, and what fills in those of each block.

    Parameters
    ----------
    system, poisson_ratio, precision    as in `system_matrix`

    Returns
    -------
    (r, k) float              with the force balance and the slack
    callable                  for `for_each_block`
    """
    n_rows, length = system.n_points, system.traction_length
    free, held_sides = system.unknowns.free_vertices, system.unknowns.held_sides
    matrix = np.zeros((system.size, 3 * n_rows + 3), dtype=precision)
    weights = integral_weights(system.surface, np.flatnonzero(system.surface.held))
    for axis in range(3):
        balance = weights[held_sides] / length**2
        matrix[3 * free.size + axis : -3 : 3, 3 * n_rows + axis] = balance
        matrix[axis - 3, axis * n_rows : (axis + 1) * n_rows] = 8 * np.pi
    # The transpose is filled: by node and component, then by component and collocation point.
    entries = matrix[:-3, :-3].reshape(-1, 3, 3, n_rows)

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        scaled, constant = traction_parts(np.moveaxis(traction[free], 1, 0))
        from_displacement = (1 - 2 * poisson_ratio) * scaled + constant
        entries[: free.size, :, :, rows] = from_displacement.transpose(2, 1, 0, 3)
        constant, slope = displacement_parts(np.moveaxis(displacement, 1, 0))
        from_traction = -(constant + poisson_ratio * slope) / length
        entries[free.size :, :, :, rows] = from_traction.transpose(2, 1, 0, 3)

    return matrix.T, fill


def _product(a: Float[np.ndarray, "r n"], b: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "r c"]:
    """a @ b by the library that solves the system, in turns with these products: that of numpy has
    threads of its own, and the idle ones of either take the processors from the other."""
    (gemm,) = get_blas_funcs(("gemm",), (a, b))
    with parallel_algebra(3 * len(a)):
        return gemm(1.0, b.T, a.T).T


def _slope_to_fill(
    system: BoundarySystem, precision: Precision = np.float64
) -> tuple[SystemSlope, BlockUse]:
    """A derivative without values, and what fills in those of each block.

    Parameters
    ----------
    system, precision         as in `matrix_and_slope`

    Returns
    -------
    SystemSlope
    callable                  for `for_each_block`
    """
    free, n_sides = system.unknowns.free_vertices, system.unknowns.held_sides.size
    skew = np.empty((3, system.n_points, free.size), dtype=precision)
    flux = np.empty((system.n_points, free.size), dtype=precision)
    trace = np.empty((system.n_points, n_sides), dtype=precision)
    scale = 2.0 / system.traction_length

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        # By row, then by node, as they are multiplied.
        turned = np.ascontiguousarray(traction[free].transpose(1, 2, 0))
        skew[:, rows] = 2.0 * turned[:3]
        flux[rows] = 2.0 / 3 * turned[3:6].sum(axis=0)
        trace[rows] = scale * displacement[:, :3].sum(axis=1).T

    return SystemSlope(skew, flux, trace), fill
