"""The near field of the integral equations: dense blocks of the fields, those of the dense assembly
in single precision."""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy.typing import DTypeLike
from scipy.sparse import csr_array

from palpate.bem.compressed.clusters import ClusterTree
from palpate.bem.compressed.moments import KernelWeights
from palpate.bem.integrals.assembly import Collocation, FieldBlocks, kernel_integrals
from palpate.bem.integrals.kelvin import DISPLACEMENT, TRACTION, FieldLayout
from palpate.bem.integrals.quadrature import Quadrature
from palpate.bem.integrals.surface import BoundarySurface
from palpate.geometry import QuadraticNodes
from palpate.progress import Progress, silent
from palpate.threads import in_threads


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
class NearField:
    """Products of the near field with vectors.

    Attributes
    ----------
    blocks : list of NearBlock        every collocation point belongs to one of them
    n_points : int
    """

    blocks: list[NearBlock]
    n_points: int

    def apply(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "r 3 c"]:
        """Near-field part of the equations, (r, 3, c); arguments as for `FarField.apply`."""
        out = np.empty((self.n_points, 3, displacement.shape[2]), dtype=displacement.dtype)
        in_threads(self._multiply, len(self.blocks), weights, displacement, traction, out)
        return out

    def _multiply(
        self,
        begin: int,
        end: int,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
        out: Float[np.ndarray, "r 3 c"],
    ) -> None:
        for block in self.blocks[begin:end]:
            found = _product(
                block.traction_matrix(weights, displacement.dtype), displacement[block.nodes]
            )
            if block.sides.size:
                matrix = block.displacement_matrix(weights, displacement.dtype)
                found += _product(matrix, traction[block.sides])
            out[block.points] = found


def near_field(
    surface: BoundarySurface,
    collocation: Collocation,
    clusters: tuple[ClusterTree, ClusterTree],
    near: list[Int[np.ndarray, " _"]],
    held_nodes: QuadraticNodes,
    quadrature: Quadrature,
    progress: Progress = silent,
) -> NearField:
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
    NearField
    """
    points, triangles = clusters
    leaves = points.leaves
    held_index = np.cumsum(surface.held) - 1
    blocks: list[NearBlock | None] = [None] * len(leaves)

    def integrate(begin: int, end: int) -> None:
        for number in range(begin, end):
            leaf = int(leaves[number])
            own = np.sort(np.concatenate([triangles.members(int(k)) for k in near[leaf]]))
            held = own[surface.held[own]]
            points_here = _chosen(collocation, points.members(leaf))
            shared = surface, points_here, quadrature
            nodes, traction_fields = _fields(*shared, TRACTION, surface.displacement, own, own)
            sides, displacement_fields = _fields(
                *shared, DISPLACEMENT, held_nodes, held_index[held], held
            )
            blocks[number] = NearBlock(
                points.members(leaf), nodes, traction_fields, sides, displacement_fields
            )
            progress("integrals nearby", sum(one is not None for one in blocks) / len(blocks))

    in_threads(integrate, len(leaves))
    return NearField([block for block in blocks if block is not None], len(collocation.point))


def _fields(
    surface: BoundarySurface,
    collocation: Collocation,
    quadrature: Quadrature,
    kernel: FieldLayout,
    nodes: QuadraticNodes,
    elements: Int[np.ndarray, " k"],
    triangles: Int[np.ndarray, " k"],
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "f m n"]]:
    """Nodes that determine a field on some elements, and the integrals of some points for these."""
    used, own = _own_nodes(nodes, elements)
    if not elements.size:
        return used, np.zeros((kernel.count, len(collocation.point), 0), dtype=np.float32)
    integrals = kernel_integrals(
        surface, collocation, own, kernel, triangles=triangles, quadrature=quadrature
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
    own = csr_array((weights.data, columns, weights.indptr), shape=(middles.size, used.size))
    return used, QuadraticNodes(number, used.size, own)


def _product(
    matrix: Float[np.ndarray, "m 3 3 n"], vectors: Float[np.ndarray, "n 3 c"]
) -> Float[np.ndarray, "m 3 c"]:
    rows, columns = 3 * len(matrix), 3 * len(vectors)
    by_component = vectors.transpose(1, 0, 2).reshape(columns, -1)
    return (matrix.reshape(rows, columns) @ by_component).reshape(len(matrix), 3, -1)


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
