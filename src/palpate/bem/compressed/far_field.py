"""The far field of the integral equations: harmonic functions of clusters of triangles, evaluated
at clusters of collocation points.

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

from palpate.bem.compressed.clusters import (
    ChargeSphere,
    ClusterTree,
    fill_inverse_distances,
    interpolative_decomposition,
    inverse_distances,
)
from palpate.threads import in_threads

# Moments of a node: grad h x n, n.grad h, nine of F and three of psi for B; of a side: h, and
# twelve for the second term with b = 1/2.
_TRACTION, _DISPLACEMENT = 16, 13


def make_skeletons(
    tree: ClusterTree,
    points: Float[np.ndarray, "r 3"],
    proxies: Float[np.ndarray, "p 3"],
    tolerance: float,
) -> tuple[list[Float[np.ndarray, "_ 3"]], list[Float[np.ndarray, "_ _"]]]:
    """The skeleton of every cluster: the few points from which all others interpolate.

    Parameters
    ----------
    tree : ClusterTree
    points : (r, 3) float [m]
    proxies : (p, 3) float        positions of proxy charges around the unit sphere, which stand for
                                  all far sources
    tolerance : float             relative error of interpolated values

    Returns
    -------
    list of (k, 3) float [m]      skeleton points of each cluster, chosen from the leaves up
    list of (m, k) float          weights that interpolate from these to the points of a leaf, or to
                                  the skeleton points of both children
    """
    count = len(tree.start)
    skeleton = [np.zeros((0, 3))] * count
    interpolation = [np.zeros((0, 0))] * count
    for cluster in range(count - 1, -1, -1):
        children = tree.children[cluster]
        if children[0] < 0:
            candidates = points[tree.members(cluster)]
        else:
            candidates = np.concatenate([skeleton[child] for child in children])
        around = tree.centre[cluster] + tree.radius[cluster] * proxies
        chosen, weights = interpolative_decomposition(
            inverse_distances(candidates, around), tolerance
        )
        skeleton[cluster], interpolation[cluster] = candidates[chosen], weights.astype(np.float32)
    return skeleton, interpolation


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
        out += component_product(matrix, u)

    def _add_displacement(
        self, weights: KernelWeights, q: Float[np.ndarray, "s 3 c"], out: Float[np.ndarray, "k 4 c"]
    ) -> None:
        matrix = np.empty((len(out), 4, 3, len(q)), dtype=out.dtype)
        trace = 1.5 * weights.constant - 2.0 * weights.slope
        _fill_displacement(trace, weights.constant, self.displacement_kernel, matrix)
        out += component_product(matrix, q)


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Products of the far field with vectors.

    Attributes
    ----------
    sources : ClusterTree                 of the triangles
    moments : dict of LeafMoments         of its leaves that belong to a far pair
    child_to_parent : dict of (k, 2 k) float    of its larger clusters that do: their charges from
                                          those of their children
    receivers : ClusterTree               of the collocation points
    skeleton, interpolation : lists       for each of its clusters (`make_skeletons`)
    far : list of (k,) int                clusters of triangles that are far from each cluster of
                                          points
    sphere : ChargeSphere
    offset : (r, 3) float [m]             of every point from the centre of its leaf
    """

    sources: ClusterTree
    moments: dict[int, LeafMoments]
    child_to_parent: dict[int, Float[np.ndarray, "k h"]]
    receivers: ClusterTree
    skeleton: list[Float[np.ndarray, "_ 3"]]
    interpolation: list[Float[np.ndarray, "_ _"]]
    far: list[Int[np.ndarray, " _"]]
    sphere: ChargeSphere
    offset: Float[np.ndarray, "r 3"]

    def apply(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "r 3 c"]:
        """Far-field part of the equations at every collocation point.

        Parameters
        ----------
        weights : KernelWeights           of the parts of the equations
        displacement : (v, 3, c) float [m]    of all vertices
        traction : (h, 3, c) float        of all held sides, scaled as `weights` requires

        Returns
        -------
        (r, 3, c) float
        """
        if not self.moments:
            return np.zeros((len(self.offset), 3, displacement.shape[2]), dtype=displacement.dtype)
        charges = self._cluster_charges(weights, displacement, traction)
        values = [np.zeros((0, 4, 0))] * len(self.far)
        in_threads(self._receive, len(self.far), charges, values)
        return self._interpolated(values, displacement.shape[2])

    def _cluster_charges(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "s k 4 c"]:
        """Charges of all clusters of triangles, from the leaves up."""
        tree, sphere = self.sources, self.sphere
        shape = len(tree.start), len(sphere.charge), 4, displacement.shape[2]
        charges = np.zeros(shape, dtype=displacement.dtype)
        leaves = np.array(sorted(self.moments))

        def leaf_charges(begin: int, end: int) -> None:
            for leaf in leaves[begin:end]:
                charges[leaf] = self.moments[int(leaf)].charges(weights, displacement, traction)

        in_threads(leaf_charges, leaves.size)
        parents = np.array(sorted(self.child_to_parent), dtype=np.int64)
        # Clusters of one level do not depend on each other; the deepest level is first.
        for level in _levels(tree)[::-1]:
            merged = level[np.isin(level, parents)]
            in_threads(
                lambda begin, end, merged=merged: self._merge_children(merged[begin:end], charges),
                merged.size,
            )
        return charges

    def _merge_children(
        self, parents: Int[np.ndarray, " p"], charges: Float[np.ndarray, "s k 4 c"]
    ) -> None:
        """Charges of some clusters from those of their children."""
        tree = self.sources
        for cluster in parents:
            parts = tree.children[cluster]
            shifted = [recentred(charges[k], tree.centre[cluster] - tree.centre[k]) for k in parts]
            halves = np.concatenate(shifted).reshape(-1, 4 * charges.shape[3])
            charges[cluster] = (self.child_to_parent[int(cluster)] @ halves).reshape(
                charges.shape[1:]
            )

    def _receive(
        self,
        begin: int,
        end: int,
        charges: Float[np.ndarray, "s k 4 c"],
        values: list[Float[np.ndarray, "_ 4 _"]],
    ) -> None:
        """Values at the skeleton points of some clusters, due to the sources far from each."""
        tree, sphere = self.sources, self.sphere
        for cluster in range(begin, end):
            far, skeleton = self.far[cluster], self.skeleton[cluster]
            columns = charges.shape[3]
            values[cluster] = np.zeros((len(skeleton), 4, columns), dtype=charges.dtype)
            if not far.size:
                continue
            # Relative to the centre: in single precision, absolute positions would lose digits.
            centre = self.receivers.centre[cluster]
            shift = centre - tree.centre[far]
            charge_positions = tree.radius[far, None, None] * sphere.charge - shift[:, None]
            charge_positions = np.ascontiguousarray(
                charge_positions.reshape(-1, 3).T, dtype=np.float32
            )
            skeleton = (skeleton - centre).astype(np.float32)
            # Indexing has copied it: it may be changed in place.
            shifted = charges[far]
            shifted[:, :, :3] += shift[:, None, :, None].astype(shifted.dtype) * shifted[:, :, 3:]
            kernel = np.empty((len(skeleton), charge_positions.shape[1]), dtype=np.float32)
            fill_inverse_distances(skeleton, charge_positions, kernel)
            products = kernel @ shifted.reshape(kernel.shape[1], -1)
            values[cluster] = products.reshape(values[cluster].shape)

    def _interpolated(
        self, values: list[Float[np.ndarray, "_ 4 _"]], columns: int
    ) -> Float[np.ndarray, "r 3 c"]:
        """Values at all points, interpolated from the largest clusters down."""
        tree, interpolation = self.receivers, self.interpolation
        out = np.empty((len(self.offset), 3, columns), dtype=values[0].dtype)
        for cluster, children in enumerate(tree.children):
            weights = interpolation[cluster]
            interpolated = (weights @ values[cluster].reshape(weights.shape[1], -1)).reshape(
                -1, 4, columns
            )
            values[cluster] = np.zeros((0, 4, 0))
            if children[0] < 0:
                points = tree.members(cluster)
                out[points] = (
                    interpolated[:, :3] + self.offset[points][:, :, None] * interpolated[:, 3:]
                )
                continue
            first = 0
            for child in children:
                last = first + interpolation[child].shape[1]
                shift = tree.centre[child] - tree.centre[cluster]
                values[child] = values[child] + recentred(interpolated[first:last], shift)
                first = last
        return out


def recentred(
    functions: Float[np.ndarray, "... 4 c"], shift: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 4 c"]:
    """F and psi of the same field, F + (y - c) psi, about another centre.

    Parameters
    ----------
    functions : (..., 4, c) float     three components of F, then psi [that of F / m]
    shift : (..., 3) float [m]        from the old centre to the new one

    Returns
    -------
    (..., 4, c) float                 in the units of `functions`
    """
    out = functions.copy()
    out[..., :3, :] += shift[..., :, None].astype(out.dtype) * functions[..., 3:, :]
    return out


def make_child_to_parent(
    tree: ClusterTree, parents: Int[np.ndarray, " p"], sphere: ChargeSphere
) -> dict[int, Float[np.ndarray, "k h"]]:
    """Matrices that give the charges of clusters from those of their children.

    Parameters
    ----------
    tree : ClusterTree
    parents : (p,) int            clusters that have children
    sphere : ChargeSphere

    Returns
    -------
    dict of int to (k, h) float32 [-]    parent -> matrix from the h charges of both its children to
                                      its own k charges
    """
    child_to_parent: dict[int, np.ndarray] = {}

    def match(begin: int, end: int) -> None:
        for cluster in parents[begin:end]:
            check = tree.centre[cluster] + tree.radius[cluster] * sphere.check
            halves = tree.children[cluster]
            positions = [tree.centre[k] + tree.radius[k] * sphere.charge for k in halves]
            potentials = inverse_distances(check, np.concatenate(positions))
            child_to_parent[int(cluster)] = (
                tree.radius[cluster] * sphere.check_to_charge.T @ potentials
            ).astype(np.float32)

    in_threads(match, parents.size)
    return child_to_parent


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


def _levels(tree: ClusterTree) -> list[Int[np.ndarray, " _"]]:
    """Clusters by their depth in the tree."""
    levels = [np.zeros(1, dtype=np.int64)]
    while True:
        next_level = tree.children[levels[-1]].ravel()
        next_level = next_level[next_level >= 0]
        if not next_level.size:
            return levels
        levels.append(next_level)


def component_product(
    matrix: Float[np.ndarray, "k i 3 n"], vectors: Float[np.ndarray, "n 3 c"]
) -> Float[np.ndarray, "k i c"]:
    """Products of a matrix, whose columns go by components and then nodes, with vectors.

    Parameters
    ----------
    matrix : (k, i, 3, n) float
    vectors : (n, 3, c) float

    Returns
    -------
    (k, i, c) float
    """
    rows, columns = matrix.shape[0] * matrix.shape[1], 3 * len(vectors)
    by_component = vectors.transpose(1, 0, 2).reshape(columns, -1)
    return (matrix.reshape(rows, columns) @ by_component).reshape(*matrix.shape[:2], -1)


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
    local_shapes = csr_array(
        (shapes.data, np.searchsorted(used, shapes.indices), shapes.indptr),
        shape=(len(sources), used.size),
    )
    at_check = (local_shapes.T @ values).reshape(-1, check.shape[1])
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
