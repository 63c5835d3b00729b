"""The integral equations of an object as a matrix-free operator.

The near field is stored as dense blocks, equal to those of the dense assembly but in single
precision; the far field is evaluated by harmonic functions of clusters. Memory and the time of a
product grow with the number of vertices, not with its square, and one operator serves all
materials.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import DTypeLike
from scipy.sparse import csr_array

from palpate.bem.compressed.clusters import (
    ChargeSphere,
    ClusterTree,
    charge_sphere,
    cluster_pairs,
    cluster_tree,
    far_clusters,
)
from palpate.bem.compressed.far_field import (
    FarField,
    KernelWeights,
    LeafMoments,
    component_product,
    leaf_moments,
    make_child_to_parent,
    make_skeletons,
)
from palpate.bem.integrals.assembly import Collocation, FieldBlocks, kernel_integrals
from palpate.bem.integrals.kelvin import DISPLACEMENT, TRACTION
from palpate.bem.integrals.surface import BoundarySurface, Quadrature, triangle_rule
from palpate.bem.system.system import Unknowns, restricted_nodes
from palpate.geometry import QuadraticNodes, element_points, element_spheres, interpolation_matrix
from palpate.progress import Progress, part_of, silent
from palpate.threads import in_threads

# Degree of the quadrature rule of the far field; pairs too close for it belong to the near field.
_DEGREE = 5
# Equivalent charges per cluster of triangles.
_CHARGES = 250
# Distance from its centre, in its radii, beyond which everything is far from a cluster of points,
# and from a cluster of triangles.
_ADMISSIBILITY = (1.5, 2.0)
# Relative error of values interpolated within a cluster of points.
_TOLERANCE = 1e-6
# Largest numbers of collocation points and of triangles in a leaf.
LEAF_SIZE = (64, 64)


@dataclass(frozen=True, slots=True, eq=False)
class NearBlock:
    """Integrals of the fields of a cluster of collocation points over the triangles near it.

    Attributes
    ----------
    points : (m,) int                     collocation points
    nodes : (n,) int                      vertices
    traction_kernel : (9, m, n) float     for their displacements, in single precision
    sides : (s,) int                      held sides
    displacement_kernel : (6, m, s) float    for their tractions, in single precision
    """

    points: Int[np.ndarray, " m"]
    nodes: Int[np.ndarray, " n"]
    traction_kernel: Float[np.ndarray, "9 m n"]
    sides: Int[np.ndarray, " s"]
    displacement_kernel: Float[np.ndarray, "6 m s"]

    def traction_matrix(
        self, weights: KernelWeights, dtype: DTypeLike = np.float64
    ) -> Float[np.ndarray, "m 3 3 n"]:
        """Coefficients of displacements, (m, 3, 3, n): [.., i, j, ..] equation i, component j."""
        count, nodes = self.traction_kernel.shape[1:]
        out = np.empty((count, 3, 3, nodes), dtype=dtype)
        _fill_traction(weights.skew, weights.rest, self.traction_kernel, out)
        return out

    def displacement_matrix(
        self, weights: KernelWeights, dtype: DTypeLike = np.float64
    ) -> Float[np.ndarray, "m 3 3 s"]:
        """Coefficients of tractions, (m, 3, 3, s): [.., i, j, ..] equation i, component j."""
        count, sides = self.displacement_kernel.shape[1:]
        out = np.empty((count, 3, 3, sides), dtype=dtype)
        trace, rest = 1.5 * weights.constant - 2.0 * weights.slope, 0.5 * weights.constant
        _fill_displacement(trace, rest, self.displacement_kernel, out)
        return out


@dataclass(frozen=True, slots=True, eq=False)
class CompressedOperator:
    """Products of the integral equations with displacements and tractions.

    Attributes
    ----------
    near : list of NearBlock      every collocation point belongs to one of them
    far : FarField
    to_points : (r, v) sparse     displacement at the collocation points from that of the vertices
    row_sums : (2, r, 3, 3) float    A and B, summed over all vertices: subtracted at the
                                  collocation point, so that a rigid translation gives no traction
    """

    near: list[NearBlock]
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
        result = _near_product(self.near, weights, displacement, traction)
        result += self.far.apply(weights, displacement, traction)
        at_points = (self.to_points @ displacement.reshape(len(displacement), -1)).reshape(
            result.shape
        )
        row_sums = weights.skew * self.row_sums[0] + weights.rest * self.row_sums[1]
        result -= row_sums.astype(result.dtype) @ at_points.astype(result.dtype)
        return result


def _near_product(
    near: list[NearBlock],
    weights: KernelWeights,
    displacement: Float[np.ndarray, "v 3 c"],
    traction: Float[np.ndarray, "h 3 c"],
) -> Float[np.ndarray, "r 3 c"]:
    """Near-field part of the equations, (r, 3, c); arguments as for `FarField.apply`."""
    count = sum(block.points.size for block in near)
    out = np.empty((count, 3, displacement.shape[2]), dtype=displacement.dtype)

    def multiply(begin: int, end: int) -> None:
        for block in near[begin:end]:
            matrix = block.traction_matrix(weights, displacement.dtype)
            result = component_product(matrix, displacement[block.nodes])
            if block.sides.size:
                matrix = block.displacement_matrix(weights, displacement.dtype)
                result += component_product(matrix, traction[block.sides])
            out[block.points] = result

    in_threads(multiply, len(near))
    return out


def compress(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    *,
    leaf_size: tuple[int, int] = LEAF_SIZE,
    quadrature: Quadrature = Quadrature(),
    progress: Progress = silent,
) -> CompressedOperator:
    """Compute the operator of an object on its support.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    leaf_size : (int, int)    largest numbers of collocation points and of triangles in a cluster
                              that is not divided
    quadrature : Quadrature
    progress : callable

    Returns
    -------
    CompressedOperator
    """
    points = cluster_tree(collocation.point, np.zeros(len(collocation.point)), leaf_size[0])
    centre, radius = element_spheres(surface.element_nodes)
    triangles = cluster_tree(centre, radius, leaf_size[1])
    gap = quadrature.ratio(_DEGREE) * _largest(triangles, radius)
    far_pairs, near_pairs = cluster_pairs(points, triangles, _ADMISSIBILITY, gap)
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    held_nodes = restricted_nodes(surface.traction, held, index)
    near = _near_field(
        surface, collocation, (points, triangles), near_pairs, held_nodes, quadrature,
        part_of(progress, 0.0, 0.6),
    )  # fmt: skip
    progress("integrals far away", 0.6)
    sphere = charge_sphere(_CHARGES, _ADMISSIBILITY[1])
    is_far, is_leaf = far_clusters(triangles, far_pairs), triangles.children[:, 0] < 0
    moments = _all_moments(surface, held_nodes, triangles, np.flatnonzero(is_far & is_leaf), sphere)
    child_to_parent = make_child_to_parent(triangles, np.flatnonzero(is_far & ~is_leaf), sphere)
    proxies = _ADMISSIBILITY[0] * sphere.check / _ADMISSIBILITY[1]
    skeletons = make_skeletons(points, collocation.point, proxies, _TOLERANCE)
    offset = np.empty_like(collocation.point)
    for leaf in points.leaves:
        members = points.members(int(leaf))
        offset[members] = collocation.point[members] - points.centre[leaf]
    far = FarField(
        triangles, moments, child_to_parent, points, *skeletons, far_pairs, sphere, offset
    )
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
            elements = np.sort(tree.members(leaf))
            held = elements[surface.held[elements]]
            moments[int(leaf)] = leaf_moments(
                sphere,
                tree.centre[leaf],
                float(tree.radius[leaf]),
                _sources(surface.displacement, elements, surface.element_nodes[elements]),
                _sources(held_nodes, held_index[held], surface.element_nodes[held]),
            )

    in_threads(gather, leaves.size)
    return moments


def _sources(
    nodes: QuadraticNodes, elements: Int[np.ndarray, " m"], corners: Float[np.ndarray, "m 6 3"]
) -> tuple[Float[np.ndarray, "q 6"], csr_array]:
    """Quadrature points of some elements with their normals times weights, and shape functions."""
    barycentric, weight = triangle_rule(_DEGREE)
    points = element_points(corners, barycentric)
    points[:, :, 3:] *= weight[:, None]
    element = np.repeat(elements, weight.size)
    shapes = interpolation_matrix(nodes, element, np.tile(barycentric, (elements.size, 1)))
    return points.reshape(-1, 6), shapes


def _own_displacement(nodes: QuadraticNodes, collocation: Collocation) -> csr_array:
    """Displacement at the collocation points from that of the vertices."""
    inside = np.flatnonzero(collocation.vertex < 0)
    at_vertex = np.flatnonzero(collocation.vertex >= 0)
    interpolation = interpolation_matrix(
        nodes, collocation.triangle[inside], collocation.barycentric[inside]
    ).tocoo()
    row = np.concatenate([at_vertex, inside[interpolation.row]])
    column = np.concatenate([collocation.vertex[at_vertex], interpolation.col])
    value = np.concatenate([np.ones(at_vertex.size), interpolation.data])
    return csr_array((value, (row, column)), shape=(len(collocation.point), nodes.n_nodes))


def _row_sums(
    near: list[NearBlock], far: FarField, surface: BoundarySurface, held_nodes: QuadraticNodes
) -> Float[np.ndarray, "2 r 3 3"]:
    """Products of A and of B with the three unit translations."""
    translations = np.tile(np.eye(3), (len(surface.mesh.vertices), 1, 1))
    no_traction = np.zeros((held_nodes.n_nodes, 3, 3))
    parts = (KernelWeights(1.0, 0.0, 0.0, 0.0), KernelWeights(0.0, 1.0, 0.0, 0.0))
    return np.stack(
        [
            _near_product(near, weights, translations, no_traction)
            + far.apply(weights, translations, no_traction)
            for weights in parts
        ]
    )


def _near_field(
    surface: BoundarySurface,
    collocation: Collocation,
    clusters: tuple[ClusterTree, ClusterTree],
    near: list[Int[np.ndarray, " _"]],
    held_nodes: QuadraticNodes,
    quadrature: Quadrature,
    progress: Progress = silent,
) -> list[NearBlock]:
    """Integrate over all triangles that are near each cluster of points.

    Parameters
    ----------
    surface : BoundarySurface
    collocation : Collocation
    clusters : ClusterTree, ClusterTree    of the points and of the triangles
    near : list of (k,) int                leaves of the second that are near each leaf of the first
    held_nodes : QuadraticNodes            of the traction, on the held triangles in their order
    quadrature : Quadrature
    progress : callable

    Returns
    -------
    list of NearBlock
    """
    points, triangles = clusters
    leaves = points.leaves
    held_index = np.cumsum(surface.held) - 1
    blocks: list[NearBlock | None] = [None] * len(leaves)

    def integrate(begin: int, end: int) -> None:
        for number in range(begin, end):
            leaf = int(leaves[number])
            nearby = np.sort(np.concatenate([triangles.members(int(k)) for k in near[leaf]]))
            held = nearby[surface.held[nearby]]
            points_here = _chosen(collocation, points.members(leaf))
            shared = surface, points_here, quadrature
            nodes, traction_fields = _fields(
                *shared, TRACTION, surface.displacement, nearby, nearby
            )
            sides, displacement_fields = _fields(
                *shared, DISPLACEMENT, held_nodes, held_index[held], held
            )
            blocks[number] = NearBlock(
                points.members(leaf), nodes, traction_fields, sides, displacement_fields
            )
            progress("integrals nearby", sum(block is not None for block in blocks) / len(blocks))

    in_threads(integrate, len(leaves))
    return [block for block in blocks if block is not None]


def _fields(
    surface: BoundarySurface,
    collocation: Collocation,
    quadrature: Quadrature,
    n_fields: int,
    nodes: QuadraticNodes,
    elements: Int[np.ndarray, " k"],
    triangles: Int[np.ndarray, " k"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "f m n"]]:
    """Nodes that determine a field on some elements, and the integrals of some points for these."""
    used, local_nodes = _own_nodes(nodes, elements)
    if not elements.size:
        return used, np.zeros((n_fields, len(collocation.point), 0), dtype=np.float32)
    integrals = kernel_integrals(
        surface, collocation, local_nodes, n_fields, triangles=triangles, quadrature=quadrature
    )
    return used, _by_point(integrals.all_blocks())


def _by_point(blocks: FieldBlocks) -> Float[np.ndarray, "f m n"]:
    """Fields in single precision, the points in their own order."""
    values = blocks.values.transpose(2, 0, 3, 1)
    values = values.reshape(len(values), -1, values.shape[3])[:, : blocks.n_rows]
    out = np.empty(values.shape, dtype=np.float32)
    out[:, blocks.rows.ravel()[: blocks.n_rows]] = values
    return out


def _chosen(collocation: Collocation, points: Int[np.ndarray, " m"]) -> Collocation:
    return Collocation(
        collocation.point[points],
        collocation.vertex[points],
        collocation.triangle[points],
        collocation.barycentric[points],
    )


def _own_nodes(
    nodes: QuadraticNodes, elements: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " n"], QuadraticNodes]:
    """Nodes that determine a field on some elements, and the elements in terms of these alone."""
    element = nodes.element[elements]
    dependent = element >= nodes.n_nodes
    middles, middle = np.unique(element[dependent], return_inverse=True)
    weights = csr_array(nodes.weights[middles - nodes.n_nodes])
    used = np.union1d(element[~dependent], weights.indices)
    number = np.empty_like(element)
    number[~dependent] = np.searchsorted(used, element[~dependent])
    number[dependent] = used.size + middle
    columns = np.searchsorted(used, weights.indices)
    local_weights = csr_array(
        (weights.data, columns, weights.indptr), shape=(middles.size, used.size)
    )
    return used, QuadraticNodes(number, used.size, local_weights)


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _fill_traction(skew, rest, fields, out):
    """skew A + rest B from the nine fields (`traction_parts`); the innermost loops run over nodes,
    so that they vectorise."""
    kind = out.dtype.type
    third, skew, rest = kind(skew / 3.0), kind(skew), kind(rest)
    for m in range(fields.shape[1]):
        turn, tensor, part = fields[:3, m], fields[3:, m], out[m]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for n in range(fields.shape[2]):
                flux = third * (kind(tensor[0, n]) + tensor[1, n] + tensor[2, n])
                part[i, i, n] = -flux - rest * tensor[i, n]
            # Entry 3 + i of the tensor is the one of yz, zx, xy without i.
            for n in range(fields.shape[2]):
                part[j, k, n] = skew * turn[i, n] - rest * tensor[3 + i, n]
            for n in range(fields.shape[2]):
                part[k, j, n] = -skew * turn[i, n] - rest * tensor[3 + i, n]


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _fill_displacement(trace, rest, fields, out):
    """trace times 1 / r in the diagonal, and rest times the six fields (`displacement_parts`)."""
    kind = out.dtype.type
    trace, rest = kind(trace), kind(rest)
    for m in range(fields.shape[1]):
        tensor, part = fields[:, m], out[m]
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            for n in range(fields.shape[2]):
                along = trace * (kind(tensor[0, n]) + tensor[1, n] + tensor[2, n])
                part[i, i, n] = along + rest * tensor[i, n]
            for n in range(fields.shape[2]):
                part[j, k, n] = rest * tensor[3 + i, n]
            for n in range(fields.shape[2]):
                part[k, j, n] = rest * tensor[3 + i, n]
