"""Compiled loop over blocks of collocation points, triangles and quadrature points."""

import numba
import numpy as np

from palpate.bem.integrals.element_integrals import (
    SHAPES,
    add_near,
    add_shape_moments,
    add_singular,
    add_weighted,
    shapes_at,
    surface_point,
)
from palpate.bem.integrals.kelvin import LANES, TRACTION, lane_fields

_N_TRACTION = TRACTION.count
# Quadrature points that are evaluated before they are summed: their fields stay in the first cache.
_BATCH = 6
# Points of the largest rule whose quadrature points are kept for every triangle. Larger ones serve
# few pairs, close to each other, and would take nine tenths of the memory.
MOST_KEPT = 16


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def integrate_blocks(begin, end, n_fields, points, elements, rules, patches, out):
    """Integrals of the blocks from begin to end, patch by patch."""
    width = n_fields * LANES
    start, farthest_near = rules.start, rules.ratios[-1]
    largest = 0
    for patch in range(patches.size.size):
        largest = max(largest, patches.size[patch])
    accumulated = np.empty(largest * width)
    buffer = np.empty(_BATCH * width)
    own_sources = np.empty((_BATCH, 6))
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
                    if n_points <= MOST_KEPT:
                        sources = elements.sources[own + first : own + last]
                    else:
                        sources = own_sources[: last - first]
                        _fill_sources(elements.nodes[e], rules.points, start[rule] + first, sources)
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
def _fill_sources(nodes, points, first, sources):
    """Quadrature points of one triangle from one of a rule on, and normals times weight."""
    shape = np.empty(SHAPES)
    for q in range(sources.shape[0]):
        b0, b1, b2, weight = points[first + q]
        surface_point(nodes, b0, b1, b2, shape, sources[q])
        for k in range(3, 6):
            sources[q, k] *= weight


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
