"""Compiled integrals of the kernel fields over six-node triangles: regular for many load points,
near and singular for one.

Regular: Gauss points, for LANES load points at a time, so that the loops vectorise. Near: the
triangle is subdivided until every part is far enough from the load point for its rule. Singular:
polar coordinates about the load point, whose Jacobian cancels the 1 / r that remains. For the
traction kernel it remains after the shape functions' values at the load point are subtracted; the
rigid-body sum of the assembly accounts for these. `integrate_blocks` loops over blocks of load
points, triangles and quadrature points.
"""

import numba
import numpy as np

from palpate.bem.integrals.kelvin import LANES, TRACTION, add_point_fields, lane_fields

_SHAPES = 6
# Subdivision ends below this fraction of the triangle's area: after ten quarterings.
_SMALLEST_PART = 1e-6
# Size of the stack of pending parts: each of ten levels adds three.
_STACK_SIZE = 34
# Widest panel in the hyperbolic angle of the singular integrals that 12 points resolve.
_WIDEST_PANEL = 2.0
# Quadrature points that are evaluated before they are summed: their fields stay in the first cache.
_BATCH = 6
# Points of the largest rule whose quadrature points are kept for every triangle. Larger ones serve
# few pairs, close to each other, and would take nine tenths of the memory.
MOST_KEPT = 16


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def add_shape_moments(fields, shapes, number, out):
    """Add the sums over quadrature points of shape functions times fields.

    Parameters
    ----------
    fields : (q * width,) float             one row per quadrature point
    shapes : (6, q) float                   shape functions at the points
    number : (6,) int                       row of `out` that each sum is added to
    out : (n * width,) float                added to
    """
    # Three by three: a field that is loaded serves three sums, and a sum takes three fields. Points
    # beyond the last are the last with weight zero: a second loop would take longer to compile.
    n_points = shapes.shape[1]
    width = fields.size // n_points
    for a in range(0, _SHAPES, 3):
        out0 = out[number[a] * width : (number[a] + 1) * width]
        out1 = out[number[a + 1] * width : (number[a + 1] + 1) * width]
        out2 = out[number[a + 2] * width : (number[a + 2] + 1) * width]
        for q in range(0, n_points, 3):
            q1, q2 = min(q + 1, n_points - 1), min(q + 2, n_points - 1)
            s1, s2 = 1.0 * (q1 == q + 1), 1.0 * (q2 == q + 2)
            u0, u1, u2 = shapes[a, q], s1 * shapes[a, q1], s2 * shapes[a, q2]
            v0, v1, v2 = shapes[a + 1, q], s1 * shapes[a + 1, q1], s2 * shapes[a + 1, q2]
            w0, w1, w2 = shapes[a + 2, q], s1 * shapes[a + 2, q1], s2 * shapes[a + 2, q2]
            f0 = fields[q * width : (q + 1) * width]
            f1 = fields[q1 * width : (q1 + 1) * width]
            f2 = fields[q2 * width : (q2 + 1) * width]
            for i in range(width):
                out0[i] += u0 * f0[i] + u1 * f1[i] + u2 * f2[i]
                out1[i] += v0 * f0[i] + v1 * f1[i] + v2 * f2[i]
                out2[i] += w0 * f0[i] + w1 * f1[i] + w2 * f2[i]


@numba.njit(fastmath=True, error_model="numpy", cache=True)
def add_weighted(rows, number, weight, out):
    """Add a weighted sum of rows.

    Parameters
    ----------
    rows : (n * width,) float
    number : (k,) int                       of the rows that are summed, k a multiple of 3
    weight : (k,) float                     their weights
    out : (width,) float                    added to
    """
    width = out.size
    for k in range(0, number.size, 3):
        w0, w1, w2 = weight[k], weight[k + 1], weight[k + 2]
        f0 = rows[number[k] * width : (number[k] + 1) * width]
        f1 = rows[number[k + 1] * width : (number[k + 1] + 1) * width]
        f2 = rows[number[k + 2] * width : (number[k + 2] + 1) * width]
        for i in range(width):
            out[i] += w0 * f0[i] + w1 * f1[i] + w2 * f2[i]


@numba.njit(error_model="numpy", cache=True)
def surface_point(nodes, b0, b1, b2, shape, source):
    """Shape functions, position and area normal at one point of a six-node triangle.

    Parameters
    ----------
    nodes : (6, 3) float [m]
    b0, b1, b2 : float                      barycentric coordinates
    shape : (6,) float                      overwritten
    source : (6,) float                     overwritten: position [m], normal times area per
                                            reference area [m^2]
    """
    _shapes_at(b0, b1, b2, shape)
    u0 = u1 = u2 = v0 = v1 = v2 = 0.0
    for k in range(3):
        source[k] = 0.0
    for a in range(_SHAPES):
        slope_b, slope_c = _slopes_at(a, b0, b1, b2)
        x, y, z = nodes[a, 0], nodes[a, 1], nodes[a, 2]
        source[0] += shape[a] * x
        source[1] += shape[a] * y
        source[2] += shape[a] * z
        u0 += slope_b * x
        u1 += slope_b * y
        u2 += slope_b * z
        v0 += slope_c * x
        v1 += slope_c * y
        v2 += slope_c * z
    source[3] = u1 * v2 - u2 * v1
    source[4] = u2 * v0 - u0 * v2
    source[5] = u0 * v1 - u1 * v0


@numba.njit(error_model="numpy", cache=True)
def add_singular(n_fields, point, nodes, corners, polar, subtracted, out):
    """Add the integrals over a subtriangle that has the load point as its first corner.

    Parameters
    ----------
    n_fields : int                          which kernel (`kelvin.add_point_fields`)
    point : (3,) float [m]                  load point
    nodes : (6, 3) float [m]                six-node triangle
    corners : (3, 3) float                  barycentric coordinates of the subtriangle's corners,
                                            the load point first
    polar : (p, 3) float                    radius and hyperbolic angle, from 0 to 1, and weight
                                            times radius; the hyperbolic angle keeps the integrand
                                            smooth for subtriangles of any aspect ratio
    subtracted : (6,) float                 from the shape functions: their values at the load point
                                            for the strongly singular traction kernel, else zero
    out : (6, n_fields) float               added to
    """
    shape, source = np.empty(_SHAPES), np.empty(6)
    b = np.empty(3)
    scale = abs(
        corners[0, 0] * (corners[1, 1] * corners[2, 2] - corners[1, 2] * corners[2, 1])
        - corners[0, 1] * (corners[1, 0] * corners[2, 2] - corners[1, 2] * corners[2, 0])
        + corners[0, 2] * (corners[1, 0] * corners[2, 1] - corners[1, 1] * corners[2, 0])
    )
    foot, height = _foot_and_height(nodes, corners)
    first = np.arcsinh(-foot / height)
    span = np.arcsinh((1 - foot) / height) - first
    panels = max(1, int(np.ceil(span / _WIDEST_PANEL)))
    span /= panels
    for panel in range(panels):
        for p in range(polar.shape[0]):
            s = polar[p, 0]
            angle = first + span * (panel + polar[p, 1])
            t = foot + height * np.sinh(angle)
            weight = polar[p, 2] * scale * span * height * np.cosh(angle)
            for k in range(3):
                b[k] = (1 - s) * corners[0, k] + s * ((1 - t) * corners[1, k] + t * corners[2, k])
            surface_point(nodes, b[0], b[1], b[2], shape, source)
            for a in range(_SHAPES):
                shape[a] -= subtracted[a]
            add_point_fields(n_fields, point, source, weight, shape, out)


@numba.njit(error_model="numpy", cache=True)
def add_near(n_fields, point, nodes, rules, start, ratios, out):
    """Add the integrals over a triangle that is close to the load point but does not contain it.

    The triangle is quartered recursively until the load point is far enough from each part for one
    of the rules.

    Parameters
    ----------
    n_fields : int                          which kernel (`kelvin.add_point_fields`)
    point : (3,) float [m]                  load point
    nodes : (6, 3) float [m]                six-node triangle
    rules : (q, 4) float                    barycentric points and weights of all rules
    start : (k + 1,) int                    where each rule starts
    ratios : (k,) float                     distance over radius above which each may be used
    out : (6, n_fields) float               added to
    """
    shape, source = np.empty(_SHAPES), np.empty(6)
    stack, part = whole_triangle(), np.empty(10)
    depth = 1
    while depth > 0:
        depth, rule, _ = next_part(point, nodes, ratios, stack, depth, part)
        for q in range(start[rule], start[rule + 1]):
            weight = part_point(nodes, rules[q], part, shape, source)
            add_point_fields(n_fields, point, source, weight, shape, out)


@numba.njit(error_model="numpy", cache=True)
def whole_triangle():
    """Stack of pending parts of a triangle for `next_part`: at first the whole triangle.

    Returns
    -------
    (34, 10) float                          barycentric coordinates of the three corners, then the
                                            fraction of the triangle's area
    """
    stack = np.zeros((_STACK_SIZE, 10))
    stack[0, 0] = stack[0, 4] = stack[0, 8] = stack[0, 9] = 1.0
    return stack


@numba.njit(error_model="numpy", cache=True)
def next_part(point, nodes, ratios, stack, depth, part):
    """Pop the last pending part, subdivided until it is far enough from a point.

    Parameters
    ----------
    point : (3,) float [m]                  finite; NaN would subdivide everything to the last level
    nodes : (6, 3) float [m]                six-node triangle
    ratios : (k,) float                     distance over radius above which each rule may be used
    stack : (34, 10) float                  changed: the pending parts (`whole_triangle`)
    depth : int                             number of pending parts, >= 1
    part : (10,) float                      overwritten: the part

    Returns
    -------
    int                                     number of pending parts now
    int                                     rule to be used on the part
    float                                   distance of the point over the part's radius
    """
    while True:
        depth -= 1
        for k in range(part.size):
            part[k] = stack[depth, k]
        ratio = _ratio(point, nodes, part)
        if ratio >= ratios[-1] or part[9] <= _SMALLEST_PART:
            break
        _divide(part, stack[depth : depth + 4])
        depth += 4
    rule = 0
    while rule < ratios.size - 1 and ratio < ratios[rule]:
        rule += 1
    return depth, rule, ratio


@numba.njit(error_model="numpy", cache=True)
def part_point(nodes, rule, part, shape, source):
    """One quadrature point of a part of a triangle.

    Parameters
    ----------
    nodes : (6, 3) float [m]                six-node triangle
    rule : (4,) float                       barycentric coordinates in the part, weight
    part : (10,) float                      from `next_part`
    shape, source : (6,) float              overwritten as by `surface_point`

    Returns
    -------
    float                                   weight of the point in the triangle
    """
    b0 = rule[0] * part[0] + rule[1] * part[3] + rule[2] * part[6]
    b1 = rule[0] * part[1] + rule[1] * part[4] + rule[2] * part[7]
    surface_point(nodes, b0, b1, 1 - b0 - b1, shape, source)
    return rule[3] * part[9]


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
                first_source = start[rule] * elements.nodes.shape[0] + e * n_points
                for first in range(0, n_points, _BATCH):
                    last = min(first + _BATCH, n_points)
                    fields = buffer[: (last - first) * width]
                    if n_points <= MOST_KEPT:
                        sources = elements.sources[first_source + first : first_source + last]
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


@numba.njit(error_model="numpy", cache=True)
def _shapes_at(b0, b1, b2, shape):
    """Six shape functions at one point (`geometry.quadratic_shapes`), written into shape (6,)."""
    shape[0] = b0 * (2 * b0 - 1)
    shape[1] = b1 * (2 * b1 - 1)
    shape[2] = b2 * (2 * b2 - 1)
    shape[3] = 4 * b0 * b1
    shape[4] = 4 * b1 * b2
    shape[5] = 4 * b2 * b0


@numba.njit(error_model="numpy", cache=True)
def _slopes_at(a, b0, b1, b2):
    """Derivatives of one shape function along edges 01 and 02."""
    if a == 0:
        return 1 - 4 * b0, 1 - 4 * b0
    if a == 1:
        return 4 * b1 - 1, 0.0
    if a == 2:
        return 0.0, 4 * b2 - 1
    if a == 3:
        return 4 * (b0 - b1), -4 * b1
    if a == 4:
        return 4 * b2, 4 * b1
    return -4 * b2, 4 * (b0 - b2)


@numba.njit(error_model="numpy", cache=True)
def _foot_and_height(nodes, corners):
    """Foot and length of the perpendicular from the first corner to the opposite edge.

    Both are relative to the length of that edge; the foot is 0 at the second corner, 1 at the
    third. Measured in the tangent plane at the first corner, where the integrand is large; the
    corners of a curved element may lie off this plane.
    """
    tangent = np.zeros((3, 3))
    b0, b1, b2 = corners[0]
    for a in range(6):
        slope = _slopes_at(a, b0, b1, b2)
        for k in range(1, 3):
            weight = slope[0] * (corners[k, 1] - b1) + slope[1] * (corners[k, 2] - b2)
            for i in range(3):
                tangent[k, i] += weight * nodes[a, i]
    edge2, along, away2 = 0.0, 0.0, 0.0
    for i in range(3):
        edge, away = tangent[2, i] - tangent[1, i], tangent[1, i] - tangent[0, i]
        edge2 += edge * edge
        along += edge * away
        away2 += away * away
    foot = -along / edge2
    return foot, np.sqrt(max(away2 / edge2 - foot * foot, 1e-12))


@numba.njit(error_model="numpy", cache=True)
def _ratio(point, nodes, part):
    """Distance of a point from the centre of a part of a triangle, over the part's radius."""
    shape, source = np.empty(6), np.empty(6)
    corner = np.empty((3, 3))
    for k in range(3):
        surface_point(nodes, part[3 * k], part[3 * k + 1], part[3 * k + 2], shape, source)
        for i in range(3):
            corner[k, i] = source[i]
    distance2 = 0.0
    for i in range(3):
        centre = (corner[0, i] + corner[1, i] + corner[2, i]) / 3
        distance2 += (point[i] - centre) ** 2
        for k in range(3):
            corner[k, i] -= centre
    radius2 = 0.0
    for k in range(3):
        radius2 = max(radius2, corner[k, 0] ** 2 + corner[k, 1] ** 2 + corner[k, 2] ** 2)
    return np.sqrt(distance2 / radius2)


@numba.njit(error_model="numpy", cache=True)
def _divide(part, children):
    """The four quarters of a part (barycentric corners, then the fraction of the area)."""
    for k in range(3):
        after, before = (k + 1) % 3, (k + 2) % 3
        for i in range(3):
            corner = part[3 * k + i]
            children[k, i] = corner
            children[k, 3 + i] = 0.5 * (corner + part[3 * after + i])
            children[k, 6 + i] = 0.5 * (corner + part[3 * before + i])
            children[3, 3 * k + i] = 0.5 * (corner + part[3 * after + i])
    for k in range(4):
        children[k, 9] = 0.25 * part[9]


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
    shape = np.empty(_SHAPES)
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
    local, subtracted, corners = np.zeros((_SHAPES, n_fields)), np.zeros(_SHAPES), np.zeros((3, 3))
    corner = -1
    for k in range(3):
        if vertices[k] == points.vertex[row]:
            corner = k
    if points.triangle[row] == elements.triangle[e]:
        b0, b1, b2 = points.barycentric[row]
        if n_fields == TRACTION:
            _shapes_at(b0, b1, b2, subtracted)
        for k in range(3):
            corners[:] = 0.0
            corners[0, 0], corners[0, 1], corners[0, 2] = b0, b1, b2
            corners[1, k] = corners[2, (k + 1) % 3] = 1.0
            add_singular(n_fields, point, nodes, corners, rules.polar, subtracted, local)
    elif corner >= 0:
        if n_fields == TRACTION:
            subtracted[corner] = 1.0
        for j in range(3):
            corners[j, (corner + j) % 3] = 1.0
        add_singular(n_fields, point, nodes, corners, rules.polar, subtracted, local)
    else:
        add_near(n_fields, point, nodes, rules.points, rules.start, rules.ratios, local)
    for a in range(_SHAPES):
        offset = number[a] * n_fields * LANES + i
        for f in range(n_fields):
            accumulated[offset + f * LANES] += local[a, f]
