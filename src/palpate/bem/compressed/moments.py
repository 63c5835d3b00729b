"""Contributions of the nodes of a cluster of triangles to its four harmonic functions.

With h(x) = 1 / |x - y| for a collocation point y and r = x - y, the fields of Kelvin's solution are

    A u = (grad h x n) x u + (n.grad h) u
    B u = F + (y - c) psi,    psi = u.grad(n.grad h),  F = -(x - c) psi + (n.u) grad h
    q (a / r) + b r (r.q) / r^3 = F + (y - c) psi,    psi = b q.grad h,  F = a q h - (x - c) psi

for any centre c: three harmonic functions F and a fourth one, psi, of y, for any material.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.compressed.charges import ChargeSphere

# Moments of a node: grad h x n, n.grad h, nine of F and three of psi for B; of a side: h, and
# twelve for the second term with b = 1/2.
_TRACTION, _DISPLACEMENT = 16, 13


class KernelWeights(NamedTuple):
    """Weights of the parts of the equations, at one Poisson's ratio or for the slope in it.

    Attributes
    ----------
    skew, rest : float            of A and of B (`traction_parts`)
    constant, slope : float       of the parts of the displacement kernel (`displacement_parts`)
    """

    skew: float
    rest: float
    constant: float
    slope: float


@dataclass(frozen=True, slots=True, eq=False)
class LeafMoments:
    """Equivalent charges of the nodes of a leaf cluster of triangles.

    Attributes
    ----------
    nodes : (n,) int                          vertices
    traction_kernel : (16, k, n) float        k charges for each of their 16 moments
    sides : (s,) int                          held sides
    displacement_kernel : (13, k, s) float    k charges for each of their 13 moments
    """

    nodes: Int[np.ndarray, " n"]
    traction_kernel: Float[np.ndarray, "16 k n"]
    sides: Int[np.ndarray, " s"]
    displacement_kernel: Float[np.ndarray, "13 k s"]

    def charges(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "k 4 c"]:
        """Charges of the four harmonic functions, F and psi.

        Parameters
        ----------
        weights : KernelWeights
        displacement : (v, 3, c) float [m]    of all vertices
        traction : (h, 3, c) float        of all held sides, scaled as `weights` requires

        Returns
        -------
        (k, 4, c) float                       at the k places; three components of F, then psi
        """
        u = displacement[self.nodes]
        count, columns = self.traction_kernel.shape[1], u.shape[2]
        out = np.zeros((count, 4, columns), dtype=displacement.dtype)
        self._add_traction(weights, u, out)
        if self.sides.size:
            self._add_displacement(weights, traction[self.sides], out)
        return out

    def _add_traction(
        self, weights: KernelWeights, u: Float[np.ndarray, "n 3 c"], out: Float[np.ndarray, "k 4 c"]
    ) -> None:
        matrix = np.empty((len(out), 4, 3, len(u)), dtype=out.dtype)
        _fill_traction(weights.skew, weights.rest, self.traction_kernel, matrix)
        out += _product(matrix, u)

    def _add_displacement(
        self, weights: KernelWeights, q: Float[np.ndarray, "s 3 c"], out: Float[np.ndarray, "k 4 c"]
    ) -> None:
        matrix = np.empty((len(out), 4, 3, len(q)), dtype=out.dtype)
        trace = 1.5 * weights.constant - 2.0 * weights.slope
        _fill_displacement(trace, weights.constant, self.displacement_kernel, matrix)
        out += _product(matrix, q)


def _product(
    matrix: Float[np.ndarray, "k 4 3 n"], vectors: Float[np.ndarray, "n 3 c"]
) -> Float[np.ndarray, "k 4 c"]:
    rows, columns = 4 * len(matrix), 3 * len(vectors)
    by_component = vectors.transpose(1, 0, 2).reshape(columns, -1)
    return (matrix.reshape(rows, columns) @ by_component).reshape(len(matrix), 4, -1)


def leaf_moments(
    sphere: ChargeSphere,
    centre: Float[np.ndarray, "3"],
    radius: float,
    vertex_sources: tuple[Float[np.ndarray, "q 6"], csr_array],
    side_sources: tuple[Float[np.ndarray, "p 6"], csr_array],
) -> LeafMoments:
    """Moments of the nodes of a leaf cluster of triangles, as equivalent charges.

    Parameters
    ----------
    sphere : ChargeSphere
    centre : (3,) float [m]
    radius : float [m]
    vertex_sources : (q, 6) float, (q, v) sparse    quadrature points with normals times weights;
                                                shape functions of the vertices there
    side_sources : (p, 6) float, (p, h) sparse  the same for the held triangles and their sides

    Returns
    -------
    LeafMoments
    """
    check = np.ascontiguousarray((centre + radius * sphere.check).T)
    return LeafMoments(
        *_node_moments(_traction_values, _TRACTION, sphere, centre, radius, check, *vertex_sources),
        *_node_moments(
            _displacement_values, _DISPLACEMENT, sphere, centre, radius, check, *side_sources
        ),
    )


def _node_moments(
    kernel: Callable[..., None],
    count: int,
    sphere: ChargeSphere,
    centre: Float[np.ndarray, "3"],
    radius: float,
    check: Float[np.ndarray, "3 p"],
    sources: Float[np.ndarray, "q 6"],
    shapes: csr_array,
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "m k n"]]:
    """Nodes whose shape functions are non-zero at some points, and their moments as charges."""
    used = np.unique(shapes.indices)
    values = np.empty((len(sources), count * check.shape[1]))
    kernel(sources, centre, check, values)
    own = csr_array(
        (shapes.data, np.searchsorted(used, shapes.indices), shapes.indptr),
        shape=(len(sources), used.size),
    )
    at_check = (own.T @ values).reshape(-1, check.shape[1])
    charges = radius * (at_check @ sphere.check_to_charge)
    charges = charges.reshape(used.size, count, sphere.check_to_charge.shape[1]).transpose(1, 2, 0)
    return used, np.ascontiguousarray(charges, dtype=np.float32)


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _traction_values(sources, centre, check, out):
    """Integrands of the 16 moments of a node at every quadrature point and check point."""
    n = check.shape[1]
    for q in range(sources.shape[0]):
        px, py, pz, nx, ny, nz = sources[q]
        cx, cy, cz = px - centre[0], py - centre[1], pz - centre[2]
        row = out[q]
        for k in range(n):
            x, y, z = px - check[0, k], py - check[1, k], pz - check[2, k]
            s2 = 1.0 / (x * x + y * y + z * z)
            s3 = s2 * np.sqrt(s2)
            gx, gy, gz = -x * s3, -y * s3, -z * s3
            row[k] = gy * nz - gz * ny
            row[n + k] = gz * nx - gx * nz
            row[2 * n + k] = gx * ny - gy * nx
            row[3 * n + k] = gx * nx + gy * ny + gz * nz
            flux = 3.0 * (x * nx + y * ny + z * nz) * s3 * s2
            psi_x, psi_y, psi_z = flux * x - nx * s3, flux * y - ny * s3, flux * z - nz * s3
            row[4 * n + k] = nx * gx - cx * psi_x
            row[5 * n + k] = ny * gx - cx * psi_y
            row[6 * n + k] = nz * gx - cx * psi_z
            row[7 * n + k] = nx * gy - cy * psi_x
            row[8 * n + k] = ny * gy - cy * psi_y
            row[9 * n + k] = nz * gy - cy * psi_z
            row[10 * n + k] = nx * gz - cz * psi_x
            row[11 * n + k] = ny * gz - cz * psi_y
            row[12 * n + k] = nz * gz - cz * psi_z
            row[13 * n + k] = psi_x
            row[14 * n + k] = psi_y
            row[15 * n + k] = psi_z


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _displacement_values(sources, centre, check, out):
    """Integrands of the 13 moments of a side at every quadrature point and check point."""
    n = check.shape[1]
    for q in range(sources.shape[0]):
        px, py, pz, nx, ny, nz = sources[q]
        area = np.sqrt(nx * nx + ny * ny + nz * nz)
        cx, cy, cz = px - centre[0], py - centre[1], pz - centre[2]
        row = out[q]
        for k in range(n):
            x, y, z = px - check[0, k], py - check[1, k], pz - check[2, k]
            s2 = 1.0 / (x * x + y * y + z * z)
            s = np.sqrt(s2)
            half = -0.5 * area * s * s2
            gx, gy, gz = half * x, half * y, half * z
            row[k] = area * s
            row[n + k] = -cx * gx
            row[2 * n + k] = -cx * gy
            row[3 * n + k] = -cx * gz
            row[4 * n + k] = -cy * gx
            row[5 * n + k] = -cy * gy
            row[6 * n + k] = -cy * gz
            row[7 * n + k] = -cz * gx
            row[8 * n + k] = -cz * gy
            row[9 * n + k] = -cz * gz
            row[10 * n + k] = gx
            row[11 * n + k] = gy
            row[12 * n + k] = gz


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _fill_traction(skew, rest, moments, out):
    """F and psi of skew A + rest B from the 16 moments of a node; the innermost loops run over
    nodes, so that they vectorise."""
    skew, rest = out.dtype.type(skew), out.dtype.type(rest)
    for c in range(moments.shape[1]):
        turn, flux, part = moments[:3, c], moments[3, c], out[c]
        for i in range(4):
            for j in range(3):
                for n in range(moments.shape[2]):
                    part[i, j, n] = rest * moments[4 + 3 * i + j, c, n]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for n in range(moments.shape[2]):
                part[i, i, n] += skew * flux[n]
            for n in range(moments.shape[2]):
                part[j, k, n] -= skew * turn[i, n]
            for n in range(moments.shape[2]):
                part[k, j, n] += skew * turn[i, n]


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _fill_displacement(trace, rest, moments, out):
    """F and psi of the displacement kernel from the 13 moments of a side."""
    trace, rest = out.dtype.type(trace), out.dtype.type(rest)
    for c in range(moments.shape[1]):
        part = out[c]
        for i in range(4):
            for j in range(3):
                for n in range(moments.shape[2]):
                    part[i, j, n] = rest * moments[1 + 3 * i + j, c, n]
        for i in range(3):
            for n in range(moments.shape[2]):
                part[i, i, n] += trace * moments[0, c, n]
