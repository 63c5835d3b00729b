"""Material-free matrices of a boundary element model: every collocation point against every node.

The rows come in blocks of LANES collocation points that lie close together, so that one instruction
serves several points and one quadrature rule suits a block. A block belongs to one thread, which
adds its triangles in order: the result does not depend on the number of threads.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.integrals.element_integrals import (
    SHAPES,
    add_near,
    add_shape_moment,
    add_singular,
    fields_at_points,
    shapes_at,
)
from palpate.bem.integrals.kelvin import LANES
from palpate.bem.integrals.quadrature import (
    Quadrature,
    element_points,
    element_spheres,
    quadratic_shapes,
    triangle_rule,
    unit_gauss,
)
from palpate.geometry import QuadraticNodes, interpolation_matrix
from palpate.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class Collocation:
    """Points at which the boundary integral equation is written.

    Attributes
    ----------
    point : (r, 3) float [m]
    vertex : (r,) int             vertex at which the point lies, -1 where inside a triangle
    triangle : (r,) int           triangle in which the point lies, -1 where at a vertex
    barycentric : (r, 3) float    place in that triangle, zero where at a vertex
    """

    point: Float[np.ndarray, "r 3"]
    vertex: Int[np.ndarray, " r"]
    triangle: Int[np.ndarray, " r"]
    barycentric: Float[np.ndarray, "r 3"]


@dataclass(frozen=True, slots=True, eq=False)
class FieldBlocks:
    """Integrals of kernel fields times nodal shape functions.

    Attributes
    ----------
    values : (blocks, n_nodes, fields, LANES) float     the order of the fields is that of
                                                        `bem.kelvin`
    rows : (blocks, LANES) int                          collocation point of each lane; the last
                                                        block repeats its last
    n_rows : int                                        number of collocation points
    """

    values: Float[np.ndarray, "blocks nodes fields lanes"]
    rows: Int[np.ndarray, "blocks lanes"]
    n_rows: int


def assemble(
    collocation: Collocation,
    triangles: Int[np.ndarray, "m 3"],
    element_nodes: Float[np.ndarray, "m 6 3"],
    nodes: QuadraticNodes,
    *,
    n_fields: int,
    quadrature: Quadrature,
) -> FieldBlocks:
    """Integrate the fields over all given elements, singular and near ones included.

    Parameters
    ----------
    collocation : Collocation
    triangles : (m, 3) int                vertices of each triangle, to know the singular ones
    element_nodes : (m, 6, 3) float [m]   the surface
    nodes : QuadraticNodes                of the field that the kernel multiplies, for the same m
                                          triangles
    n_fields : int                        9 for the traction kernel, 6 for the displacement kernel
    quadrature : Quadrature

    Returns
    -------
    FieldBlocks                           the traction kernel with the value at the collocation
                                          point subtracted within the triangles that hold it;
                                          `with_rigid_body_sum` completes it
    """
    rows, lanes = _blocks_of_neighbours(collocation.point)
    rules = [triangle_rule(degree) for degree in quadrature.degrees]
    barycentric = np.concatenate([rule.barycentric for rule in rules])
    weight = np.concatenate([rule.weight for rule in rules])
    sources = element_points(element_nodes, barycentric)
    sources[:, :, 3:] *= weight[:, None]
    start = np.cumsum([0] + [rule.weight.size for rule in rules])
    centre, radius = element_spheres(element_nodes)
    values = np.zeros((rows.shape[0], nodes.n_nodes * n_fields * LANES))
    near = np.concatenate([barycentric, weight[:, None]], axis=1)
    element, weights = _numbered_midpoints(nodes)
    in_threads(
        _integrate_blocks, rows.shape[0], lanes, rows, collocation.point, collocation.vertex,
        collocation.triangle, collocation.barycentric, np.array(triangles), element_nodes, sources,
        np.ascontiguousarray(quadratic_shapes(barycentric)), start, quadrature.ratios(),
        centre, radius, near, _polar_rule(quadrature), element, nodes.n_nodes, n_fields,
        weights.indptr.astype(np.int64), weights.indices.astype(np.int64), weights.data, values,
    )  # fmt: skip
    shape = (rows.shape[0], nodes.n_nodes, n_fields, LANES)
    return FieldBlocks(values.reshape(shape), rows, collocation.point.shape[0])


def _numbered_midpoints(nodes: QuadraticNodes) -> tuple[Int[np.ndarray, "m 6"], csr_array]:
    """The elements' nodes with only the midpoints that they use, counted from n_nodes on; weights
    of these."""
    dependent = nodes.element >= nodes.n_nodes
    used, number = np.unique(nodes.element[dependent], return_inverse=True)
    element = nodes.element.copy()
    element[dependent] = nodes.n_nodes + number
    return element, csr_array(nodes.weights[used - nodes.n_nodes])


def with_rigid_body_sum(
    blocks: FieldBlocks, collocation: Collocation, nodes: QuadraticNodes
) -> FieldBlocks:
    """Complete the traction kernel so that a rigid translation gives no traction, for each field
    apart.

    Parameters
    ----------
    blocks : FieldBlocks          of the traction kernel, changed in place
    collocation : Collocation
    nodes : QuadraticNodes        of the displacement

    Returns
    -------
    FieldBlocks                   free term and Cauchy principal value included (paper, eq. 4, C for
                                  A and B apart)
    """
    total = blocks.values.sum(axis=1)
    vertex = collocation.vertex[blocks.rows]
    block, lane = np.nonzero(vertex >= 0)
    blocks.values[block, vertex[block, lane], :, lane] -= total[block, :, lane]
    inside = np.flatnonzero(collocation.vertex < 0)
    own = interpolation_matrix(nodes, collocation.triangle[inside], collocation.barycentric[inside])
    place = np.full(collocation.point.shape[0], -1)
    place[inside] = np.arange(inside.size)
    for b, i in zip(*np.nonzero(vertex < 0), strict=True):
        row = place[blocks.rows[b, i]]
        span = slice(own.indptr[row], own.indptr[row + 1])
        share = own.data[span, None] * total[b, :, i]
        blocks.values[b, own.indices[span], :, i] -= share
    return blocks


def _polar_rule(quadrature: Quadrature) -> Float[np.ndarray, "p 3"]:
    (s, w_s), (t, w_t) = (unit_gauss(n) for n in quadrature.polar_points)
    s_grid, t_grid = np.meshgrid(s, t, indexing="ij")
    weight = np.outer(w_s * s, w_t)
    return np.stack([s_grid.ravel(), t_grid.ravel(), weight.ravel()], axis=1)


def _blocks_of_neighbours(
    point: Float[np.ndarray, "r 3"],
) -> tuple[Int[np.ndarray, "b lanes"], Float[np.ndarray, "b width"]]:
    """Rows grouped along a Morton curve, padded with the last one, and their coordinates by
    lane."""
    low = point.min(axis=0)
    cell = ((point - low) / max(np.ptp(point, axis=0).max(), 1e-300) * 1023).astype(np.int64)
    code = np.zeros(point.shape[0], dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    padding = -order.size % LANES
    rows = np.concatenate([order, np.repeat(order[-1:], padding)]).reshape(-1, LANES)
    return rows, point[rows].transpose(0, 2, 1).reshape(rows.shape[0], 3 * LANES).copy()


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _integrate_blocks(
    begin, end, lanes, rows, points, row_vertex, row_triangle, row_barycentric, triangles,
    element_nodes, sources, shapes, start, ratios, centre, radius, near, polar, nodes, n_nodes,
    n_fields, indptr, indices, data, out,
):  # fmt: skip
    width = n_fields * LANES
    n_midpoints = indptr.size - 1
    for b in range(begin, end):
        buffer = np.empty((start[-1] - start[-2]) * width)
        middle = np.zeros(n_midpoints * width)
        ratio = np.empty(LANES)
        for e in range(triangles.shape[0]):
            rule = _choose_rule(lanes[b], centre[e], radius[e], ratios, ratio)
            own = ratio[0] < 0
            first, last = start[rule], start[rule + 1]
            block = buffer[: (last - first) * width]
            fields_at_points(lanes[b], sources[e, first:last], n_fields, block)
            if own:
                _clear_near_lanes(ratio, ratios[-1], last - first, n_fields, block)
            for a in range(SHAPES):
                node = nodes[e, a]
                if node < n_nodes:
                    target = out[b, node * width : (node + 1) * width]
                else:
                    target = middle[(node - n_nodes) * width : (node - n_nodes + 1) * width]
                add_shape_moment(block, shapes[a, first:last], target)
            if own:
                for i in range(LANES):
                    if -ratio[i] < ratios[-1]:
                        row = rows[b, i]
                        local = _single(
                            points[row], row_vertex[row], row_triangle[row] == e,
                            row_barycentric[row], triangles[e], element_nodes[e], near,
                            start, ratios, polar, n_fields,
                        )  # fmt: skip
                        for a in range(SHAPES):
                            node = nodes[e, a]
                            for f in range(n_fields):
                                if node < n_nodes:
                                    out[b, node * width + f * LANES + i] += local[a, f]
                                else:
                                    place = (node - n_nodes) * width + f * LANES + i
                                    middle[place] += local[a, f]
        for t in range(n_midpoints):
            source = middle[t * width : (t + 1) * width]
            for p in range(indptr[t], indptr[t + 1]):
                target = out[b, indices[p] * width : (indices[p] + 1) * width]
                weight = data[p]
                for i in range(width):
                    target[i] += weight * source[i]


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def _choose_rule(lanes, centre, radius, ratios, ratio):
    """Rule for a block of points; distance over radius of each lane, negative where any lane is
    near."""
    smallest = np.inf
    nearest = np.inf
    for i in range(LANES):
        x = lanes[i] - centre[0]
        y = lanes[LANES + i] - centre[1]
        z = lanes[2 * LANES + i] - centre[2]
        ratio[i] = np.sqrt(x * x + y * y + z * z) / radius
    for i in range(LANES):
        nearest = min(nearest, ratio[i])
        if ratio[i] >= ratios[-1]:
            smallest = min(smallest, ratio[i])
    rule = 0
    while rule < ratios.size - 1 and smallest < ratios[rule]:
        rule += 1
    if nearest < ratios[-1]:
        for i in range(LANES):
            ratio[i] = -ratio[i]
    return rule


@numba.njit(error_model="numpy", cache=True)
def _clear_near_lanes(ratio, limit, n_points, n_fields, block):
    for i in range(LANES):
        if -ratio[i] < limit:
            for k in range(n_points * n_fields):
                block[k * LANES + i] = 0.0


@numba.njit(error_model="numpy", cache=True)
def _single(
    point, vertex, inside, barycentric, triangle, nodes, near, start, ratios, polar, n_fields
):  # fmt: skip
    """Near or singular integrals of one load point over one triangle, (6, 9)."""
    out = np.zeros((SHAPES, 9))
    own = np.zeros(6)
    corners = np.zeros((3, 3))
    if inside:
        shapes_at(barycentric[0], barycentric[1], barycentric[2], own)
        for k in range(3):
            for i in range(3):
                corners[0, i] = barycentric[i]
                corners[1, i] = 1.0 if i == k else 0.0
                corners[2, i] = 1.0 if i == (k + 1) % 3 else 0.0
            add_singular(point, nodes, corners, polar, own, n_fields, out)
        return out
    for k in range(3):
        if triangle[k] == vertex:
            own[k] = 1.0
            for j in range(3):
                corners[j, (k + j) % 3] = 1.0
            add_singular(point, nodes, corners, polar, own, n_fields, out)
            return out
    add_near(point, nodes, near, start, ratios, n_fields, out)
    return out
