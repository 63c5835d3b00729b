"""Material-independent matrices of a boundary element model: collocation points by nodes.

The rows come in blocks of LANES collocation points that lie close together, so that the loops over
a block vectorise and one quadrature rule suits all of its points. A block is computed by one
thread, which adds its triangles in order, patch by patch: the result does not depend on the number
of threads.
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals.element_integrals import (
    SHAPES,
    add_near,
    add_shape_moments,
    add_singular,
    add_weighted,
    shapes_at,
)
from palpate.bem.integrals.kelvin import LANES, TRACTION, FieldLayout, lane_fields
from palpate.bem.integrals.patches import make_patches
from palpate.bem.integrals.quadrature import Quadrature, triangle_rule, unit_gauss
from palpate.bem.integrals.surface import BoundarySurface
from palpate.geometry import (
    QuadraticNodes,
    element_points,
    element_spheres,
    interpolation_matrix,
    morton_order,
    quadratic_shapes,
)
from palpate.threads import in_threads

_N_TRACTION = TRACTION.count
# Quadrature points that are evaluated before they are summed: their fields stay in the first cache.
_BATCH = 6


@dataclass(frozen=True, slots=True, eq=False)
class Collocation:
    """Points at which the boundary integral equation is written.

    Attributes
    ----------
    point : (r, 3) float [m]
    vertex : (r,) int             vertex at which the point lies, -1 where inside a triangle
    triangle : (r,) int           triangle in which the point lies, -1 where at a vertex
    barycentric : (r, 3) float    position in that triangle, zero where at a vertex
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
    values : (blocks, n_nodes, fields, LANES) float     the fields in the order of their
                                                        `FieldLayout`
    rows : (blocks, LANES) int                          collocation point of each lane; the last
                                                        block is padded with its last point
    n_rows : int                                        number of collocation points
    """

    values: Float[np.ndarray, "blocks nodes fields lanes"]
    rows: Int[np.ndarray, "blocks lanes"]
    n_rows: int

    def by_row(self, node: int) -> Float[np.ndarray, "r fields"]:
        """The integrals that belong to one node.

        Parameters
        ----------
        node : int

        Returns
        -------
        (r, fields) float           one row per collocation point, in the order of the blocks
        """
        fields = self.values[:, node].transpose(0, 2, 1)
        return fields.reshape(-1, fields.shape[2])[: self.n_rows]


class _Points(NamedTuple):
    """Collocation points in the layout of the kernels: by lane, then one by one."""

    lanes: np.ndarray
    rows: np.ndarray
    point: np.ndarray
    vertex: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray


class _Elements(NamedTuple):
    """Triangles, patch by patch, with the quadrature points of every rule (`_sources`)."""

    triangle: np.ndarray
    vertices: np.ndarray
    nodes: np.ndarray
    sources: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


class Rules(NamedTuple):
    """Concatenated quadrature rules.

    Attributes
    ----------
    points : (q, 4) float     barycentric coordinates and weight
    shapes : (6, q) float     shape functions there
    start : (k + 1,) int      where each of the k rules starts
    ratios : (k,) float       distance over radius above which each may be used
    polar : (p, 3) float      `polar_rule`
    """

    points: np.ndarray
    shapes: np.ndarray
    start: np.ndarray
    ratios: np.ndarray
    polar: np.ndarray


def assemble(
    surface: BoundarySurface,
    collocation: Collocation,
    nodes: QuadraticNodes,
    kernel: FieldLayout,
    *,
    triangles: Int[np.ndarray, " m"] | None = None,
    quadrature: Quadrature = Quadrature(),
) -> FieldBlocks:
    """Integrate a kernel's fields times shape functions over triangles of a surface.

    Near-singular and singular integrals are included.

    Parameters
    ----------
    surface : BoundarySurface
    collocation : Collocation
    nodes : QuadraticNodes                of the field that the kernel multiplies, on the same m
                                          triangles
    kernel : FieldLayout                  `TRACTION` or `DISPLACEMENT`
    triangles : (m,) int or None          the triangles to integrate over; None: all
    quadrature : Quadrature

    Returns
    -------
    FieldBlocks                           for the traction kernel without the value at the
                                          collocation point on the triangles that contain it;
                                          `with_rigid_body_sum` completes it
    """
    if triangles is None:
        triangles = np.arange(len(surface.held))
    points = _points_in_blocks(collocation)
    rules = all_rules(quadrature)
    patches = make_patches(element_spheres(surface.element_nodes[triangles])[0], nodes)
    triangles = triangles[patches.order]
    element_nodes = surface.element_nodes[triangles]
    elements = _Elements(
        triangles, surface.mesh.triangles[triangles], element_nodes,
        _sources(element_nodes, rules), *element_spheres(element_nodes),
    )  # fmt: skip
    n_blocks = points.rows.shape[0]
    values = np.empty((n_blocks, nodes.n_nodes * kernel.count * LANES))
    in_threads(_integrate_blocks, n_blocks, kernel.count, points, elements, rules, patches, values)
    shape = (n_blocks, nodes.n_nodes, kernel.count, LANES)
    return FieldBlocks(values.reshape(shape), points.rows, collocation.point.shape[0])


def with_rigid_body_sum(
    blocks: FieldBlocks, collocation: Collocation, nodes: QuadraticNodes
) -> FieldBlocks:
    """Complete the traction kernel by the rigid-body sum: each field by itself gives zero for a
    rigid translation.

    Parameters
    ----------
    blocks : FieldBlocks          of the traction kernel, changed in place
    collocation : Collocation
    nodes : QuadraticNodes        of the displacement

    Returns
    -------
    FieldBlocks                   free term and Cauchy principal value included

    Source
    ------
    Lang and Pai (2001), eq. 4: C, for A and B separately
    """
    total = blocks.values.sum(axis=1)
    vertex = collocation.vertex[blocks.rows]
    block, lane = np.nonzero(vertex >= 0)
    blocks.values[block, vertex[block, lane], :, lane] -= total[block, :, lane]
    for b, i in zip(*np.nonzero(vertex < 0), strict=True):
        row = blocks.rows[b, i, None]
        interpolation = interpolation_matrix(
            nodes, collocation.triangle[row], collocation.barycentric[row]
        )
        blocks.values[b, interpolation.indices, :, i] -= (
            interpolation.data[:, None] * total[b, :, i]
        )
    return blocks


def all_rules(quadrature: Quadrature) -> Rules:
    """The rules of a quadrature in the layout of the kernels.

    Parameters
    ----------
    quadrature : Quadrature

    Returns
    -------
    Rules
    """
    rules = [triangle_rule(degree) for degree in quadrature.degrees]
    points = np.concatenate([np.column_stack([rule.barycentric, rule.weight]) for rule in rules])
    shapes = np.ascontiguousarray(quadratic_shapes(points[:, :3]))
    start = np.cumsum([0] + [rule.weight.size for rule in rules])
    return Rules(points, shapes, start, quadrature.ratios(), polar_rule(quadrature))


def polar_rule(quadrature: Quadrature) -> Float[np.ndarray, "p 3"]:
    """Quadrature points of the singular integrals.

    Parameters
    ----------
    quadrature : Quadrature

    Returns
    -------
    (p, 3) float [-]          radius and angle from 0 to 1, weight times radius
    """
    (s, w_s), (t, w_t) = (unit_gauss(n) for n in quadrature.polar_points)
    s_grid, t_grid = np.meshgrid(s, t, indexing="ij")
    return np.stack([s_grid.ravel(), t_grid.ravel(), np.outer(w_s * s, w_t).ravel()], axis=1)


def lanes_of(point: Float[np.ndarray, "r 3"], rows: Int[np.ndarray, "b lanes"]) -> np.ndarray:
    """Coordinates of the points of each block, coordinate-major, (b, 3 LANES) float [m]."""
    return point[rows].transpose(0, 2, 1).reshape(rows.shape[0], 3 * LANES).copy()


def _points_in_blocks(collocation: Collocation) -> _Points:
    """Points grouped along a Morton curve, padded with the last one."""
    order = morton_order(collocation.point)
    rows = np.concatenate([order, np.repeat(order[-1:], -order.size % LANES)]).reshape(-1, LANES)
    return _Points(
        lanes_of(collocation.point, rows), rows, np.array(collocation.point), collocation.vertex,
        collocation.triangle, collocation.barycentric,
    )  # fmt: skip


def _sources(element_nodes: Float[np.ndarray, "m 6 3"], rules: Rules) -> np.ndarray:
    """Quadrature points and normals times weight, (q m, 6): by rule, then by triangle."""
    sources = np.empty((rules.start[-1] * len(element_nodes), 6))
    for first, last in itertools.pairwise(rules.start):
        part = element_points(element_nodes, rules.points[first:last, :3])
        part[:, :, 3:] *= rules.points[first:last, 3:]
        sources[first * len(element_nodes) : last * len(element_nodes)] = part.reshape(-1, 6)
    return sources


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _integrate_blocks(begin, end, n_fields, points, elements, rules, patches, out):
    """Integrals of the blocks from begin to end, patch by patch."""
    width = n_fields * LANES
    start, farthest_near = rules.start, rules.ratios[-1]
    largest = 0
    for patch in range(patches.size.size):
        largest = max(largest, patches.size[patch])
    accumulated = np.empty(largest * width)
    buffer = np.empty(_BATCH * width)
    ratio = np.empty(LANES)
    for b in range(begin, end):
        for i in range(out.shape[1]):
            out[b, i] = 0.0
        for patch in range(patches.size.size):
            for i in range(patches.size[patch] * width):
                accumulated[i] = 0.0
            for e in range(patches.triangles[patch], patches.triangles[patch + 1]):
                rule, nearest = _choose_rule(
                    points.lanes[b], elements.centre[e], elements.radius[e], rules.ratios, ratio
                )
                n_points = start[rule + 1] - start[rule]
                own = start[rule] * elements.nodes.shape[0] + e * n_points
                for first in range(0, n_points, _BATCH):
                    last = min(first + _BATCH, n_points)
                    fields = buffer[: (last - first) * width]
                    sources = elements.sources[own + first : own + last]
                    shapes = rules.shapes[:, start[rule] + first : start[rule] + last]
                    lane_fields(n_fields, points.lanes[b], sources, fields)
                    if nearest < farthest_near:
                        _clear_near_lanes(ratio, farthest_near, fields)
                    add_shape_moments(fields, shapes, patches.number[e], accumulated)
                if nearest < farthest_near:
                    for i in range(LANES):
                        if ratio[i] < farthest_near:
                            _add_near_lane(
                                n_fields, points, b, i, elements, e, rules, patches.number[e],
                                accumulated,
                            )  # fmt: skip
            for s in range(patches.sums[patch], patches.sums[patch + 1]):
                first, last = patches.terms[s], patches.terms[s + 1]
                add_weighted(
                    accumulated, patches.own[first:last], patches.weight[first:last],
                    out[b, patches.node[s] * width : (patches.node[s] + 1) * width],
                )  # fmt: skip


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def _choose_rule(lanes, centre, radius, ratios, ratio):
    """Rule for a block of points, and the smallest distance over radius; fills in that of each
    lane."""
    smallest, nearest = np.inf, np.inf
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
    return rule, nearest


@numba.njit(error_model="numpy", cache=True)
def _clear_near_lanes(ratio, limit, fields):
    for i in range(LANES):
        if ratio[i] < limit:
            for k in range(i, fields.size, LANES):
                fields[k] = 0.0


@numba.njit(error_model="numpy", cache=True)
def _add_near_lane(n_fields, points, b, i, elements, e, rules, number, accumulated):
    """Add the near or singular integrals of one load point over one triangle."""
    row = points.rows[b, i]
    point, nodes, vertices = points.point[row], elements.nodes[e], elements.vertices[e]
    local, subtracted, corners = np.zeros((SHAPES, n_fields)), np.zeros(SHAPES), np.zeros((3, 3))
    corner = -1
    for k in range(3):
        if vertices[k] == points.vertex[row]:
            corner = k
    if points.triangle[row] == elements.triangle[e]:
        b0, b1, b2 = points.barycentric[row]
        if n_fields == _N_TRACTION:
            shapes_at(b0, b1, b2, subtracted)
        for k in range(3):
            corners[:] = 0.0
            corners[0, 0], corners[0, 1], corners[0, 2] = b0, b1, b2
            corners[1, k] = corners[2, (k + 1) % 3] = 1.0
            add_singular(n_fields, point, nodes, corners, rules.polar, subtracted, local)
    elif corner >= 0:
        if n_fields == _N_TRACTION:
            subtracted[corner] = 1.0
        for j in range(3):
            corners[j, (corner + j) % 3] = 1.0
        add_singular(n_fields, point, nodes, corners, rules.polar, subtracted, local)
    else:
        add_near(n_fields, point, nodes, rules.points, rules.start, rules.ratios, local)
    for a in range(SHAPES):
        offset = number[a] * n_fields * LANES + i
        for f in range(n_fields):
            accumulated[offset + f * LANES] += local[a, f]
