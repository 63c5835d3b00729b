"""The integral equations of an object as a matrix-free operator.

The near field is stored as dense blocks, equal to those of the dense assembly but in single
precision; the far field is evaluated by harmonic functions of clusters. Memory and the time of a
product grow with the number of vertices, not with its square, and one operator serves all
materials.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.compressed.charges import ChargeSphere, charge_sphere
from palpate.bem.compressed.clusters import (
    ClusterTree,
    cluster_pairs,
    cluster_tree,
    seen_clusters,
)
from palpate.bem.compressed.far_field import FarField, make_lifts, make_receivers
from palpate.bem.compressed.moments import LeafMoments, Mix, leaf_moments
from palpate.bem.compressed.near_field import NearField, near_field
from palpate.bem.integrals import BoundarySurface, Collocation, Quadrature, triangle_rule
from palpate.bem.system import Unknowns, restricted_nodes
from palpate.geometry import (
    QuadraticNodes,
    element_points,
    element_spheres,
    interpolation_matrix,
)
from palpate.progress import Progress, part_of, silent
from palpate.threads import in_threads

# Degree of the quadrature rule of the far field; pairs too close for it belong to the near field.
_DEGREE = 5


@dataclass(frozen=True, slots=True)
class Compression:
    """Accuracy and cluster sizes of the compressed operator.

    Attributes
    ----------
    charges : int                 equivalent charges per cluster of triangles
    apart : (float, float)        distance from its centre, in its radii, beyond which everything is
                                  far from a cluster of points, and from a cluster of triangles
    tolerance : float             relative error of values interpolated within a cluster of points
    leaf : (int, int)             most collocation points, and most triangles, in a leaf cluster
    """

    charges: int = 250
    apart: tuple[float, float] = (1.5, 2.0)
    tolerance: float = 1e-6
    leaf: tuple[int, int] = (64, 64)


@dataclass(frozen=True, slots=True, eq=False)
class CompressedOperator:
    """Products of the integral equations with displacements and tractions.

    Attributes
    ----------
    near : NearField
    far : FarField
    own : (r, v) sparse           displacement at the collocation points from that of the vertices
    total : (2, r, 3, 3) float    A and B, summed over all vertices: subtracted at the collocation
                                  point, so that a rigid translation gives no traction
    """

    near: NearField
    far: FarField
    own: csr_array
    total: Float[np.ndarray, "2 r 3 3"]

    def apply(
        self, mix: Mix, moved: Float[np.ndarray, "v 3 c"], pressed: Float[np.ndarray, "h 3 c"]
    ) -> Float[np.ndarray, "r 3 c"]:
        """Left-hand sides of the integral equations at every collocation point.

        Parameters
        ----------
        mix : Mix                         weights of their parts
        moved : (v, 3, c) float [m]       displacement of all vertices
        pressed : (h, 3, c) float         traction of all held sides, scaled as `mix` requires

        Returns
        -------
        (r, 3, c) float
        """
        found = self.near.apply(mix, moved, pressed)
        found += self.far.apply(mix, moved, pressed)
        own = (self.own @ moved.reshape(len(moved), -1)).reshape(found.shape)
        total = mix.skew * self.total[0] + mix.rest * self.total[1]
        found -= total.astype(found.dtype) @ own.astype(found.dtype)
        return found


def compress(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    *,
    compression: Compression = Compression(),
    quadrature: Quadrature = Quadrature(),
    progress: Progress = silent,
) -> CompressedOperator:
    """Compute the operator of an object on its support.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    compression : Compression
    quadrature : Quadrature
    progress : callable

    Returns
    -------
    CompressedOperator
    """
    points = cluster_tree(collocation.point, np.zeros(len(collocation.point)), compression.leaf[0])
    middle, reach = element_spheres(surface.element_nodes)
    triangles = cluster_tree(middle, reach, compression.leaf[1])
    least = quadrature.ratios()[np.searchsorted(quadrature.degrees, _DEGREE)]
    gap = least * _largest(triangles, reach)
    pairs = cluster_pairs(points, triangles, compression.apart, gap)
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    held_nodes = restricted_nodes(surface.traction, held, index)
    near = near_field(
        surface, collocation, (points, triangles), pairs.near, held_nodes, quadrature,
        part_of(progress, 0.0, 0.6),
    )  # fmt: skip
    progress("integrals far away", 0.6)
    sphere = charge_sphere(compression.charges, compression.apart[1])
    seen, whole = seen_clusters(triangles, pairs.far), triangles.children[:, 0] < 0
    moments = _all_moments(surface, held_nodes, triangles, np.flatnonzero(seen & whole), sphere)
    lifts = make_lifts(triangles, np.flatnonzero(seen & ~whole), sphere)
    proxies = compression.apart[0] * sphere.check / compression.apart[1]
    receivers = make_receivers(points, collocation.point, proxies, compression.tolerance)
    offset = np.empty_like(collocation.point)
    for leaf in points.leaves:
        own = points.members(int(leaf))
        offset[own] = collocation.point[own] - points.centre[leaf]
    far = FarField(triangles, moments, lifts, receivers, pairs.far, sphere, offset)
    at_points = _own_displacement(surface.displacement, collocation)
    return CompressedOperator(near, far, at_points, _totals(near, far, surface, held_nodes))


def _largest(tree: ClusterTree, reach: Float[np.ndarray, " m"]) -> Float[np.ndarray, " c"]:
    return np.array([reach[tree.members(k)].max() for k in range(len(tree.start))])


def _all_moments(
    surface: BoundarySurface,
    held_nodes: QuadraticNodes,
    tree: ClusterTree,
    leaves: Int[np.ndarray, " l"],
    sphere: ChargeSphere,
) -> dict[int, LeafMoments]:
    """Moments of some leaf clusters of triangles."""
    place = np.cumsum(surface.held) - 1
    moments: dict[int, LeafMoments] = {}

    def gather(begin: int, end: int) -> None:
        for leaf in leaves[begin:end]:
            own = np.sort(tree.members(leaf))
            held = own[surface.held[own]]
            moments[int(leaf)] = leaf_moments(
                sphere,
                tree.centre[leaf],
                float(tree.radius[leaf]),
                _sources(surface.displacement, own, surface.element_nodes[own]),
                _sources(held_nodes, place[held], surface.element_nodes[held]),
            )

    in_threads(gather, leaves.size)
    return moments


def _sources(
    nodes: QuadraticNodes, elements: Int[np.ndarray, " m"], corners: Float[np.ndarray, "m 6 3"]
) -> tuple[Float[np.ndarray, "q 6"], csr_array]:
    """Quadrature points of some elements with their normals times weights, and shape functions."""
    rule = triangle_rule(_DEGREE)
    points = element_points(corners, rule.barycentric)
    points[:, :, 3:] *= rule.weight[:, None]
    each = np.repeat(elements, rule.weight.size)
    shapes = interpolation_matrix(nodes, each, np.tile(rule.barycentric, (elements.size, 1)))
    return points.reshape(-1, 6), shapes


def _own_displacement(nodes: QuadraticNodes, collocation: Collocation) -> csr_array:
    """Displacement at the collocation points from that of the vertices."""
    inside = np.flatnonzero(collocation.vertex < 0)
    at_vertex = np.flatnonzero(collocation.vertex >= 0)
    found = interpolation_matrix(
        nodes, collocation.triangle[inside], collocation.barycentric[inside]
    ).tocoo()
    row = np.concatenate([at_vertex, inside[found.row]])
    column = np.concatenate([collocation.vertex[at_vertex], found.col])
    value = np.concatenate([np.ones(at_vertex.size), found.data])
    return csr_array((value, (row, column)), shape=(len(collocation.point), nodes.n_nodes))


def _totals(
    near: NearField, far: FarField, surface: BoundarySurface, held_nodes: QuadraticNodes
) -> Float[np.ndarray, "2 r 3 3"]:
    """Products of A and of B with the three unit translations."""
    shifts = np.tile(np.eye(3), (len(surface.mesh.vertices), 1, 1))
    nothing = np.zeros((held_nodes.n_nodes, 3, 3))
    parts = (Mix(1.0, 0.0, 0.0, 0.0), Mix(0.0, 1.0, 0.0, 0.0))
    return np.stack(
        [near.apply(mix, shifts, nothing) + far.apply(mix, shifts, nothing) for mix in parts]
    )
