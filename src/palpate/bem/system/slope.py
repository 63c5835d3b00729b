"""Derivative of the system's matrix with respect to Poisson's ratio, as an operator.

The derivative involves five scalar fields only: the three of r x n and the one of r.n from the
traction kernel, and 1 / r from the displacement kernel. They are stored as dense matrices, so that
a product with many vectors takes a few large matrix products.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg.blas import get_blas_funcs

from palpate.bem.integrals.kelvin import DISPLACEMENT, TRACTION
from palpate.bem.system.system import BlockUse, BoundarySystem, Precision, for_each_block


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


def _product(a: Float[np.ndarray, "r n"], b: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "r c"]:
    """a @ b by the library that solves the system, in turns with these products: that of numpy has
    threads of its own, and the idle ones of either take the processors from the other."""
    (gemm,) = get_blas_funcs(("gemm",), (a, b))
    return gemm(1.0, b.T, a.T).T


def system_slope(system: BoundarySystem, *, precision: Precision = np.float64) -> SystemSlope:
    """Gather the fields that depend on Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem
    precision : type          of the entries

    Returns
    -------
    SystemSlope
    """
    slope, fill = slope_to_fill(system, precision)
    for_each_block(system, fill)
    return slope


def slope_to_fill(
    system: BoundarySystem, precision: Precision = np.float64
) -> tuple[SystemSlope, BlockUse]:
    """A derivative without values, and what fills in those of each block.

    Parameters
    ----------
    system, precision         as in `system_slope`

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
        flux[rows] = 2.0 / 3 * turned[TRACTION.diagonal].sum(axis=0)
        trace[rows] = scale * displacement[:, DISPLACEMENT.diagonal].sum(axis=1).T

    return SystemSlope(skew, flux, trace), fill
