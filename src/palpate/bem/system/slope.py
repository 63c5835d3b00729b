"""Derivative of the system's matrix with respect to Poisson's ratio, as an operator.

The derivative needs four of the fifteen fields only: r x n and r.n of the traction kernel, and 1 /
r of the displacement kernel. They are kept as plain matrices, so that its product with many vectors
is a few large matrix products.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals import FieldBlocks
from palpate.bem.system.system import BoundarySystem
from palpate.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class SystemSlope:
    """d matrix / d nu; the matrix is linear in nu, so this is matrix(nu + 1) - matrix(nu).

    Attributes
    ----------
    skew : (3, r, f) float        twice the integrals of r x n / r^3 against free displacements
    flux : (r, f) float           twice those of r.n / r^3
    trace : (r, s) float          twice those of 1 / r against the held sides, over
                                  `traction_length`
    """

    skew: Float[np.ndarray, "3 r f"]
    flux: Float[np.ndarray, "r f"]
    trace: Float[np.ndarray, "r s"]

    def apply(self, unknowns: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        """Product with vectors of unknowns.

        Parameters
        ----------
        unknowns : (k, c) float

        Returns
        -------
        (k, c) float
        """
        (n_rows, n_free), count = self.flux.shape, unknowns.shape[1]
        u = unknowns[: 3 * n_free].reshape(n_free, 3 * count)
        q = unknowns[3 * n_free : -3].reshape(self.trace.shape[1], 3 * count)
        x, y, z = ((part @ u).reshape(n_rows, 3, count) for part in self.skew)
        along = (self.flux @ u + self.trace @ q).reshape(n_rows, 3, count)
        balance = np.zeros((3, count))
        return np.concatenate(
            [
                along[:, 0] - z[:, 1] + y[:, 2],
                along[:, 1] - x[:, 2] + z[:, 0],
                along[:, 2] - y[:, 0] + x[:, 1],
                balance,
            ]
        )


def system_slope(system: BoundarySystem) -> SystemSlope:
    """Gather the fields that depend on Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem

    Returns
    -------
    SystemSlope
    """
    free = system.unknowns.free_vertices
    traction, displacement = system.traction_kernel, system.displacement_kernel
    sides = np.arange(displacement.values.shape[1])
    skew = np.stack([_rows(traction, free, (k,), 2.0) for k in range(3)])
    flux = _rows(traction, free, (3, 4, 5), 2.0 / 3)
    trace = _rows(displacement, sides, (0, 1, 2), 2.0 / system.traction_length)
    return SystemSlope(skew, flux, trace)


def _rows(
    blocks: FieldBlocks, nodes: Int[np.ndarray, " n"], fields: tuple[int, ...], scale: float
) -> Float[np.ndarray, "r n"]:
    """Scaled sum of some fields against some nodes, one row a collocation point."""
    lanes = blocks.rows.shape[1]
    out = np.empty((blocks.values.shape[0] * lanes, nodes.size))
    in_threads(_gather, blocks.values.shape[0], blocks.values, nodes, np.array(fields), scale, out)
    return out[: blocks.n_rows]


@numba.njit(nogil=True, cache=True)
def _gather(begin, end, values, nodes, fields, scale, out):
    lanes = values.shape[3]
    for b in range(begin, end):
        for i in range(lanes):
            row = out[b * lanes + i]
            for n in range(nodes.size):
                total = 0.0
                for k in fields:
                    total += values[b, nodes[n], k, i]
                row[n] = scale * total
