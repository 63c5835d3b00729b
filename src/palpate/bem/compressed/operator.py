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
from palpate.bem.compressed.clusters import ClusterTree, cluster_pairs, cluster_tree, far_clusters
from palpate.bem.compressed.far_field import FarField, make_child_to_parent, make_receivers
from palpate.bem.compressed.moments import KernelWeights, LeafMoments, leaf_moments
from palpate.bem.compressed.near_field import NearField, near_field
from palpate.bem.integrals.assembly import Collocation
from palpate.bem.integrals.quadrature import Quadrature, triangle_rule
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.system.boundary import Unknowns
from palpate.bem.system.system import restricted_nodes
from palpate.geometry import QuadraticNodes, element_points, element_spheres, interpolation_matrix
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
    admissibility : (float, float)    distance from its centre, in its radii, beyond which
                                  everything is far from a cluster of points, and from a cluster
                                  of triangles
    tolerance : float             relative error of values interpolated within a cluster of points
    leaf_size : (int, int)        largest numbers of collocation points and of triangles in a leaf
    """

    charges: int = 250
    admissibility: tuple[float, float] = (1.5, 2.0)
    tolerance: float = 1e-6
    leaf_size: tuple[int, int] = (64, 64)


@dataclass(frozen=True, slots=True, eq=False)
class CompressedOperator:
    """Products of the integral equations with displacements and tractions.

    Attributes
    ----------
    near : NearField
    far : FarField
    to_points : (r, v) sparse     displacement at the collocation points from that of the vertices
    row_sums : (2, r, 3, 3) float    A and B, summed over all vertices: subtracted at the
                                  collocation point, so that a rigid translation gives no traction
    """

    near: NearField
    far: FarField
    to_points: csr_array
    row_sums: Float[np.ndarray, "2 r 3 3"]

    def apply(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "r 3 c"]:
        """Left-hand sides of the integral equations at every collocation point.

        Parameters
        ----------
        weights : KernelWeights           of the parts of the equations
        displacement : (v, 3, c) float [m]    of all vertices
        traction : (h, 3, c) float        of all held sides, scaled as `weights` requires

        Returns
        -------
        (r, 3, c) float
        """
        found = self.near.apply(weights, displacement, traction)
        found += self.far.apply(weights, displacement, traction)
        at_points = (self.to_points @ displacement.reshape(len(displacement), -1)).reshape(
            found.shape
        )
        row_sums = weights.skew * self.row_sums[0] + weights.rest * self.row_sums[1]
        found -= row_sums.astype(found.dtype) @ at_points.astype(found.dtype)
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
    points = cluster_tree(
        collocation.point, np.zeros(len(collocation.point)), compression.leaf_size[0]
    )
    centre, radius = element_spheres(surface.element_nodes)
    triangles = cluster_tree(centre, radius, compression.leaf_size[1])
    gap = quadrature.ratio(_DEGREE) * _largest(triangles, radius)
    pairs = cluster_pairs(points, triangles, compression.admissibility, gap)
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    held_nodes = restricted_nodes(surface.traction, held, index)
    near = near_field(
        surface, collocation, (points, triangles), pairs.near, held_nodes, quadrature,
        part_of(progress, 0.0, 0.6),
    )  # fmt: skip
    progress("integrals far away", 0.6)
    sphere = charge_sphere(compression.charges, compression.admissibility[1])
    is_far, is_leaf = far_clusters(triangles, pairs.far), triangles.children[:, 0] < 0
    moments = _all_moments(surface, held_nodes, triangles, np.flatnonzero(is_far & is_leaf), sphere)
    child_to_parent = make_child_to_parent(triangles, np.flatnonzero(is_far & ~is_leaf), sphere)
    proxies = compression.admissibility[0] * sphere.check / compression.admissibility[1]
    receivers = make_receivers(points, collocation.point, proxies, compression.tolerance)
    offset = np.empty_like(collocation.point)
    for leaf in points.leaves:
        own = points.members(int(leaf))
        offset[own] = collocation.point[own] - points.centre[leaf]
    far = FarField(triangles, moments, child_to_parent, receivers, pairs.far, sphere, offset)
    to_points = _own_displacement(surface.displacement, collocation)
    return CompressedOperator(near, far, to_points, _row_sums(near, far, surface, held_nodes))


def _largest(tree: ClusterTree, radius: Float[np.ndarray, " m"]) -> Float[np.ndarray, " c"]:
    return np.array([radius[tree.members(k)].max() for k in range(len(tree.start))])


def _all_moments(
    surface: BoundarySurface,
    held_nodes: QuadraticNodes,
    tree: ClusterTree,
    leaves: Int[np.ndarray, " l"],
    sphere: ChargeSphere,
) -> dict[int, LeafMoments]:
    """Moments of some leaf clusters of triangles."""
    held_index = np.cumsum(surface.held) - 1
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
                _sources(held_nodes, held_index[held], surface.element_nodes[held]),
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


def _row_sums(
    near: NearField, far: FarField, surface: BoundarySurface, held_nodes: QuadraticNodes
) -> Float[np.ndarray, "2 r 3 3"]:
    """Products of A and of B with the three unit translations."""
    translations = np.tile(np.eye(3), (len(surface.mesh.vertices), 1, 1))
    no_traction = np.zeros((held_nodes.n_nodes, 3, 3))
    parts = (KernelWeights(1.0, 0.0, 0.0, 0.0), KernelWeights(0.0, 1.0, 0.0, 0.0))
    return np.stack(
        [
            near.apply(weights, translations, no_traction)
            + far.apply(weights, translations, no_traction)
            for weights in parts
        ]
    )
