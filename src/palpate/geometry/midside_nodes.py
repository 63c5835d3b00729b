"""Six-node triangles, with midside values fitted to the surrounding vertices: quadratic accuracy
without additional unknowns.

The vertices around an edge determine a local quadratic, whose value at the midpoint of the edge is
the midside value of a six-node triangle. It is a fixed weighted sum of vertex values, so no unknown
is added. The same weights, applied to the positions of the vertices, give the midside nodes of the
smooth surface that the triangles approximate, on which finer triangles can be laid.

Nodes of a triangle are the corners 0, 1, 2, then the midpoints of edges 01, 12, 20.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array, eye_array, vstack

from palpate.errors import InputError
from palpate.geometry.triangle_mesh import (
    CREASE_ANGLE,
    Sides,
    TriangleMesh,
    area_vectors,
    split_sides,
)
from palpate.shapes import Triangles, Vertices

# The curve of a crease ends where it turns by more than the crease angle.
_MIN_SMOOTH_COSINE = np.cos(CREASE_ANGLE)
# Sum of absolute weights from which the fit of a midside node is rejected as unstable.
_MAX_WEIGHT_SUM = 4.0
ELEMENT_NODES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]
)


@dataclass(frozen=True, slots=True, eq=False)
class QuadraticNodes:
    """Six-node triangles whose midside values are weighted sums of nodal values.

    Attributes
    ----------
    element : (m, 6) int      nodes at the three corners, then at the midpoints of edges 01, 12, 20;
                              midside nodes are numbered from n_nodes on
    n_nodes : int             number of nodes with values of their own
    weights : (p, n_nodes)    sparse; value at midside node n_nodes + row = weights[row] @ values
    """

    element: Int[np.ndarray, "m 6"]
    n_nodes: int
    weights: csr_array


def displacement_nodes(mesh: TriangleMesh, sides: Sides, *, rings: int = 1) -> QuadraticNodes:
    """Nodes of a continuous field: one node per vertex, one midside node per edge.

    Parameters
    ----------
    mesh : TriangleMesh
    sides : Sides             of that mesh
    rings : int               rings of neighbours of an edge's ends that a midside value is fitted
                              to: 1 or 2

    Returns
    -------
    QuadraticNodes            n_nodes = number of vertices; the midside value of a cut edge is the
                              mean of the fits on its two sides, so that the field is continuous
    """
    rows = _half_edge_weights(mesh, sides, rings)
    edge = sides.edge.ravel()
    n_edges = sides.cut.size
    mean = csr_array(
        (np.full(edge.size, 0.5), (edge, np.arange(edge.size))), shape=(n_edges, edge.size)
    )
    to_vertex = csr_array(
        (np.ones(sides.vertex.size), (np.arange(sides.vertex.size), sides.vertex)),
        shape=(sides.vertex.size, mesh.vertices.shape[0]),
    )
    element = np.concatenate([mesh.triangles, mesh.vertices.shape[0] + sides.edge], axis=1)
    return QuadraticNodes(element, mesh.vertices.shape[0], csr_array(mean @ rows @ to_vertex))


def side_nodes(mesh: TriangleMesh, sides: Sides, *, rings: int = 1) -> QuadraticNodes:
    """Nodes of a field that may jump at cut edges, as tractions do: one node per side of a vertex.

    Parameters
    ----------
    mesh : TriangleMesh
    sides : Sides             of that mesh
    rings : int               as in `displacement_nodes`

    Returns
    -------
    QuadraticNodes            n_nodes = number of sides; a cut edge has two midside nodes, any other
                              edge one
    """
    rows = _half_edge_weights(mesh, sides, rings)
    n_sides = sides.vertex.size
    half = np.arange(sides.edge.size).reshape(-1, 3)
    midside = n_sides + np.where(sides.cut[sides.edge], half, np.minimum(half, sides.twin))
    return QuadraticNodes(np.concatenate([sides.corner, midside], axis=1), n_sides, rows)


def linear_nodes(nodes: QuadraticNodes) -> QuadraticNodes:
    """Nodes with linear interpolation: the classical element of the paper.

    Parameters
    ----------
    nodes : QuadraticNodes

    Returns
    -------
    QuadraticNodes            every midside value is the mean of those at the ends of its edge
    """
    corner = nodes.element[:, :3].ravel()
    after = np.roll(nodes.element[:, :3], -1, axis=1).ravel()
    row = nodes.element[:, 3:].ravel() - nodes.n_nodes
    _, first = np.unique(row, return_index=True)
    ends = np.stack([corner[first], after[first]], axis=1).ravel()
    weights = csr_array(
        (np.full(ends.size, 0.5), (np.repeat(row[first], 2), ends)), shape=nodes.weights.shape
    )
    return QuadraticNodes(nodes.element, nodes.n_nodes, weights)


def free_nodes(nodes: QuadraticNodes) -> QuadraticNodes:
    """Elements with midside nodes that carry values of their own.

    Parameters
    ----------
    nodes : QuadraticNodes

    Returns
    -------
    QuadraticNodes            n_nodes = number of nodes and midside nodes of the given ones; no
                              weights
    """
    count = nodes.n_nodes + nodes.weights.shape[0]
    return QuadraticNodes(nodes.element, count, csr_array((0, count)))


def interpolation_matrix(
    nodes: QuadraticNodes, triangle: Int[np.ndarray, " n"], barycentric: Float[np.ndarray, "n 3"]
) -> csr_array:
    """Matrix that takes the values at the nodes to the values at points of the surface.

    Parameters
    ----------
    nodes : QuadraticNodes
    triangle : (n,) int
    barycentric : (n, 3) float [-]

    Returns
    -------
    (n, n_nodes) sparse           rows sum to 1
    """
    point = np.repeat(np.arange(triangle.size), 6)
    entries = (quadratic_shapes(barycentric).T.ravel(), (point, nodes.element[triangle].ravel()))
    at_nodes = csr_array(entries, shape=(triangle.size, nodes.n_nodes + nodes.weights.shape[0]))
    identity = eye_array(nodes.n_nodes, format="csr")
    return csr_array(at_nodes @ vstack([identity, nodes.weights], format="csr"))


def _half_edge_weights(mesh: TriangleMesh, sides: Sides, rings: int) -> csr_array:
    """Weights over the sides for the midside node of every half-edge, (3 m, n_sides)."""
    half = np.arange(sides.edge.size)
    is_cut = sides.cut[sides.edge.ravel()]
    inner = half[~is_cut & (half < sides.twin.ravel())]
    blocks = [
        _surface_stencils(mesh, sides, inner, rings),
        _curve_stencils(mesh, sides, half[is_cut]),
    ]
    row, column, weight = (np.concatenate(part) for part in zip(*blocks, strict=True))
    partner = sides.twin.ravel()[row]
    mirrored = ~is_cut[row]
    row = np.concatenate([row, partner[mirrored]])
    column = np.concatenate([column, column[mirrored]])
    weight = np.concatenate([weight, weight[mirrored]])
    return csr_array((weight, (row, column)), shape=(half.size, sides.vertex.size))


def _surface_stencils(
    mesh: TriangleMesh, sides: Sides, half: Int[np.ndarray, " h"], rings: int
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Least-squares quadratics over the neighbours of both ends of each inner edge."""
    corner = sides.corner.ravel()
    a, b = corner[half], corner[half - half % 3 + (half + 1) % 3]
    near = _neighbours(sides)
    normal = area_vectors(mesh)
    plane = normal[half // 3] + normal[sides.twin.ravel()[half] // 3]
    position = mesh.vertices[sides.vertex]
    parts, left = [], np.arange(half.size)
    nearest = near
    for _ in range(rings - 1):
        nearest = csr_array(nearest @ near)
    # One more ring where these do not determine a quadratic.
    for reach in (nearest, csr_array(nearest @ near)):
        weight, column = _quadratic_weights(position, a[left], b[left], plane[left], reach)
        good = np.abs(weight).sum(axis=1) < _MAX_WEIGHT_SUM
        row = np.broadcast_to(half[left][:, None], weight.shape)
        keep = (weight != 0) & good[:, None]
        parts.append((row[keep], column[keep], weight[keep]))
        left = left[~good]
    # Where no neighbours determine a quadratic, the midside value is the mean of its ends.
    ends = np.stack([a[left], b[left]], axis=1).ravel()
    parts.append((np.repeat(half[left], 2), ends, np.full(ends.size, 0.5)))
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    return row, column, value


def _neighbours(sides: Sides) -> csr_array:
    corner = sides.corner
    row = np.repeat(corner, 3, axis=1).ravel()
    column = np.tile(corner, (1, 3)).ravel()
    n = sides.vertex.size
    near = csr_array((np.ones(row.size), (row, column)), shape=(n, n))
    near.sum_duplicates()
    return near


def _quadratic_weights(
    position: Float[np.ndarray, "s 3"],
    a: Int[np.ndarray, " h"],
    b: Int[np.ndarray, " h"],
    plane: Float[np.ndarray, "h 3"],
    near: csr_array,
) -> tuple[Float[np.ndarray, "h k"], Int[np.ndarray, "h k"]]:
    """Moving-least-squares weights that reproduce quadratics over the tangent plane; NaN where the
    fit is singular."""
    column, present = _padded_rows(csr_array(near[a] + near[b]))
    middle = 0.5 * (position[a] + position[b])
    along = position[b] - position[a]
    length = np.linalg.norm(along, axis=1)
    e1 = along / length[:, None]
    normal = plane - np.einsum("hi,hi->h", plane, e1)[:, None] * e1
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    e2 = np.cross(normal, e1)
    offset = (position[column] - middle[:, None]) / length[:, None, None]
    x, y = np.einsum("hki,hi->hk", offset, e1), np.einsum("hki,hi->hk", offset, e2)
    distance2 = np.einsum("hki,hki->hk", offset, offset)
    omega = np.where(present, 1.0 / (distance2 + 1e-12) ** 2, 0.0)
    basis = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2)
    gram = np.einsum("hk,hkp,hkq->hpq", omega, basis, basis)
    # Collinear neighbours leave a column of zeros, which the test for singularity below detects.
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("hpp->hp", gram), 1e-30))
    gram = gram * scale[:, :, None] * scale[:, None, :]
    singular = np.linalg.eigvalsh(gram)[:, 0] < 1e-8
    gram[singular] = np.eye(6)
    unit = np.zeros((a.size, 6, 1))
    unit[:, 0, 0] = scale[:, 0]
    coefficient = np.linalg.solve(gram, unit)[:, :, 0] * scale
    weight = omega * np.einsum("hkp,hp->hk", basis, coefficient)
    weight[singular] = np.nan
    return weight, column


def _padded_rows(matrix: csr_array) -> tuple[Int[np.ndarray, "h k"], Int[np.ndarray, "h k"]]:
    count = np.diff(matrix.indptr)
    slot = np.arange(max(count.max(initial=0), 1))
    present = slot < count[:, None]
    column = np.zeros(present.shape, dtype=np.int64)
    column[present] = matrix.indices
    return column, present.astype(np.int64)


def _curve_stencils(
    mesh: TriangleMesh, sides: Sides, half: Int[np.ndarray, " h"]
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Lagrange weights along the curve of cut edges that bounds a side, up to its corners."""
    corner = sides.corner.ravel()
    start, end = corner[half], corner[half - half % 3 + (half + 1) % 3]
    before = np.full(sides.vertex.size, -1, dtype=np.int64)
    after = np.full(sides.vertex.size, -1, dtype=np.int64)
    before[end], after[start] = start, end
    chain = np.stack([before[start], start, end, after[end]], axis=1)
    p = mesh.vertices[sides.vertex[chain]]
    step = np.diff(p, axis=1)
    length = np.linalg.norm(step, axis=2)
    with np.errstate(invalid="ignore", divide="ignore"):
        turn_start = np.einsum("hi,hi->h", step[:, 0], step[:, 1]) / (length[:, 0] * length[:, 1])
        turn_end = np.einsum("hi,hi->h", step[:, 1], step[:, 2]) / (length[:, 1] * length[:, 2])
    use = np.ones(chain.shape, dtype=bool)
    use[:, 0] = (chain[:, 0] >= 0) & (turn_start > _MIN_SMOOTH_COSINE)
    use[:, 3] = (chain[:, 3] >= 0) & (turn_end > _MIN_SMOOTH_COSINE)
    s = np.stack(
        [-length[:, 0], 0 * length[:, 0], length[:, 1], length[:, 1] + length[:, 2]], axis=1
    )
    weight = _lagrange(s, 0.5 * length[:, 1], use)
    row = np.broadcast_to(half[:, None], chain.shape)
    return row[use], chain[use], weight[use]


def _lagrange(
    s: Float[np.ndarray, "h k"], at: Float[np.ndarray, " h"], use: Bool[np.ndarray, "h k"]
) -> Float[np.ndarray, "h k"]:
    weight = np.where(use, 1.0, 0.0)
    for i in range(s.shape[1]):
        for j in range(s.shape[1]):
            if i != j:
                both = use[:, i] & use[:, j]
                gap = np.where(both, s[:, i] - s[:, j], 1.0)
                weight[:, i] *= np.where(both, (at - s[:, j]) / gap, 1.0)
    return weight


def refined_surface(mesh: TriangleMesh, *, pieces: int = 4) -> tuple[Vertices, Triangles]:
    """Cut every triangle into smaller ones that lie on the smooth surface through the vertices.

    The surface is that of the quadratic elements: midside nodes fitted to the surrounding vertices,
    edges where the normals of adjacent triangles differ by more than 40 degrees. The distance from
    a curved object decreases with the square of `pieces`.

    Parameters
    ----------
    mesh : TriangleMesh
    pieces : int                    parts of an edge, at least 1; pieces^2 triangles from one

    Returns
    -------
    vertices : (m q, 3) float [m]   q = (pieces + 1)(pieces + 2) / 2 for each of the m triangles;
                                    shared corners are not merged
    triangles : (m pieces^2, 3) int those of triangle k are rows k pieces^2 and following

    Raises
    ------
    InputError                      pieces below 1
    """
    if pieces < 1:
        raise InputError(f"pieces is {pieces}; must be 1 or more")
    lattice, small = _lattice(pieces)
    count = len(mesh.triangles)
    sides = split_sides(mesh, np.zeros(count, dtype=np.int64))
    nodes = displacement_nodes(mesh, sides)
    interpolation = interpolation_matrix(
        nodes, np.repeat(np.arange(count), len(lattice)), np.tile(lattice, (count, 1))
    )
    triangles = small[None] + len(lattice) * np.arange(count)[:, None, None]
    return np.asarray(interpolation @ mesh.vertices), triangles.reshape(-1, 3)


def piece_middles(pieces: int) -> Float[np.ndarray, "s 3"]:
    """Centroids of the small triangles within the one from which they are cut.

    Parameters
    ----------
    pieces : int                    parts of an edge, at least 1

    Returns
    -------
    (pieces^2, 3) float [-]         barycentric, in the order of `refined_surface`
    """
    lattice, small = _lattice(pieces)
    return lattice[small].mean(axis=1)


def _lattice(pieces: int) -> tuple[Float[np.ndarray, "q 3"], Int[np.ndarray, "s 3"]]:
    """Barycentric coordinates of the corners of the parts, and the parts."""
    number = {}
    corners: list[tuple[float, float, float]] = []
    for i in range(pieces + 1):
        for j in range(pieces + 1 - i):
            number[i, j] = len(corners)
            corners.append(((pieces - i - j) / pieces, i / pieces, j / pieces))
    parts = []
    for i in range(pieces):
        for j in range(pieces - i):
            parts.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j < pieces - 1:
                parts.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    return np.array(corners), np.array(parts)


def quadratic_shapes(barycentric: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "6 ..."]:
    """Shape functions of the six-node triangle.

    Parameters
    ----------
    barycentric : (..., 3) float [-]

    Returns
    -------
    (6, ...) float [-]        one at its own node and zero at the others; they sum to 1
    """
    a, b, c = np.moveaxis(barycentric, -1, 0)
    return np.stack(
        [a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a]
    )


def element_points(
    nodes: Float[np.ndarray, "m 6 3"], barycentric: Float[np.ndarray, "... q 3"]
) -> Float[np.ndarray, "m q 6"]:
    """Positions and area normals at points of six-node triangles.

    Parameters
    ----------
    nodes : (m, 6, 3) float [m]
    barycentric : (q, 3) or (m, q, 3) float [-]    the same points for all triangles, or for each

    Returns
    -------
    (m, q, 6) float           position [m], then outward normal times area per reference area [m^2]
    """
    weights = np.broadcast_to(barycentric, (len(nodes), *barycentric.shape[-2:]))
    points = np.empty((*weights.shape[:2], 6))
    _fill_points(np.ascontiguousarray(nodes), np.ascontiguousarray(weights), points)
    return points


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _fill_points(nodes, barycentric, out):
    """Positions and area normals at given points of each element."""
    shape, along = np.empty(6), np.empty((2, 3))
    for e in range(nodes.shape[0]):
        for q in range(barycentric.shape[1]):
            a, b, c = barycentric[e, q]
            shape[0], shape[1], shape[2] = a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1)
            shape[3], shape[4], shape[5] = 4 * a * b, 4 * b * c, 4 * c * a
            for i in range(3):
                corner, other, last = nodes[e, 0, i], nodes[e, 1, i], nodes[e, 2, i]
                ab, bc, ca = nodes[e, 3, i], nodes[e, 4, i], nodes[e, 5, i]
                position = shape[0] * corner + shape[1] * other + shape[2] * last
                out[e, q, i] = position + shape[3] * ab + shape[4] * bc + shape[5] * ca
                start = (1 - 4 * a) * corner
                along[0, i] = start + (4 * b - 1) * other + 4 * ((a - b) * ab + c * (bc - ca))
                along[1, i] = start + (4 * c - 1) * last + 4 * (b * (bc - ab) + (a - c) * ca)
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                out[e, q, 3 + i] = along[0, j] * along[1, k] - along[0, k] * along[1, j]


def element_spheres(
    nodes: Float[np.ndarray, "m 6 3"],
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Centre and radius of a sphere around each six-node triangle.

    Parameters
    ----------
    nodes : (m, 6, 3) float [m]

    Returns
    -------
    (m, 3) float [m], (m,) float [m]
    """
    centre = nodes[:, :3].mean(axis=1)
    return centre, np.linalg.norm(nodes - centre[:, None], axis=2).max(axis=1)


def quartered(
    triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> tuple[Int[np.ndarray, " d"], Float[np.ndarray, "d 3 3"]]:
    """The four quarters of each cell of a triangle.

    Parameters
    ----------
    triangle : (c,) int               triangle of each cell
    corners : (c, 3, 3) float [-]     barycentric coordinates of the corners of each cell

    Returns
    -------
    (4 c,) int, (4 c, 3, 3) float [-]
    """
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.tile(triangle, 4), np.concatenate([np.stack(part, axis=1) for part in parts])
