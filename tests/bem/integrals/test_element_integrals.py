"""Integrals over one element against brute force and closed forms."""

import numpy as np
import pytest

from palpate.bem.integrals.assembly import polar_rule
from palpate.bem.integrals.element_integrals import (
    add_near,
    add_shape_moments,
    add_singular,
    add_weighted,
    surface_point,
)
from palpate.bem.integrals.kelvin import DISPLACEMENT, LANES, TRACTION, lane_fields
from palpate.bem.integrals.surface import Quadrature, triangle_rule, unit_gauss
from palpate.geometry.midside_nodes import ELEMENT_NODES, element_points, quadratic_shapes

FLAT = ELEMENT_NODES @ np.array([[0.1, 0.0, 0.2], [1.1, 0.1, 0.0], [0.4, 0.8, 0.1]])
CURVED = FLAT + 0.12 * np.outer([0.0, 0, 0, 1, 0.7, 1.2], [0.1, -0.2, 1.0])


def kernel_fields(r, area_normal, n_fields):
    """The fields as `kelvin` describes them, by plain array code, (q, n_fields)."""
    d = np.linalg.norm(r, axis=1)
    x, y, z = r.T
    pairs = np.stack([x * x, y * y, z * z, y * z, z * x, x * y], axis=1)
    if n_fields == DISPLACEMENT:
        return pairs * (np.linalg.norm(area_normal, axis=1) / d**3)[:, None]
    flux = 3 * (r * area_normal).sum(axis=1) / d**5
    return np.concatenate(
        [np.cross(r, area_normal) / d[:, None] ** 3, pairs * flux[:, None]], axis=1
    )


def integral_over(corners, nodes, point, own_shapes, n_fields):
    """One rule of degree 15 over a part of an element, (6, n_fields)."""
    barycentric, weight = triangle_rule(15)
    barycentric = barycentric @ corners
    source = element_points(nodes[None], barycentric)[0]
    weight = weight * abs(np.linalg.det(corners))
    fields = kernel_fields(source[:, :3] - point, source[:, 3:], n_fields)
    return np.einsum(
        "q,aq,qf->af", weight, quadratic_shapes(barycentric) - own_shapes[:, None], fields
    )


def quarters(corners):
    a, b, c = corners
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    return [np.stack(p) for p in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]


def brute_force(corners, nodes, point, own_shapes, n_fields, levels):
    """Many small parts."""
    if levels == 0:
        return integral_over(corners, nodes, point, own_shapes, n_fields)
    return sum(
        brute_force(part, nodes, point, own_shapes, n_fields, levels - 1)
        for part in quarters(corners)
    )


def fine_polar(corners, nodes, point, own_shapes, n_fields, strips=300):
    """Plain polar coordinates around the first corner, in very many narrow strips: slow, and sure
    to 1e-10."""
    s, w_s = unit_gauss(16)
    x, w_x = unit_gauss(4)
    t = ((np.arange(strips)[:, None] + x) / strips).ravel()
    w_t = np.tile(w_x / strips, strips)
    s, t = (grid.ravel() for grid in np.meshgrid(s, t, indexing="ij"))
    weight = np.outer(w_s, w_t).ravel() * s * abs(np.linalg.det(corners))
    barycentric = np.stack([1 - s, s * (1 - t), s * t], axis=1) @ corners
    source = element_points(nodes[None], barycentric)[0]
    fields = kernel_fields(source[:, :3] - point, source[:, 3:], n_fields)
    return np.einsum(
        "q,aq,qf->af", weight, quadratic_shapes(barycentric) - own_shapes[:, None], fields
    )


def near_rules():
    rules = [triangle_rule(degree) for degree in Quadrature().degrees]
    start = np.cumsum([0] + [weight.size for _, weight in rules])
    points = [np.column_stack(rule) for rule in rules]
    return np.concatenate(points), start, Quadrature().ratios()


@pytest.mark.parametrize("n_fields", [TRACTION, DISPLACEMENT])
@pytest.mark.parametrize("degree", [4, 5])  # 6 points, a multiple of three, and 7
def test_regular_integral_in_lanes(n_fields, degree):
    barycentric, weight = triangle_rule(degree)
    source = element_points(CURVED[None], barycentric)[0]
    source[:, 3:] *= weight[:, None]
    points = np.random.default_rng(0).normal(size=(LANES, 3)) + 4
    rows = np.empty(weight.size * n_fields * LANES)
    lane_fields(n_fields, np.ascontiguousarray(points.T).ravel(), source, rows)
    shape = quadratic_shapes(barycentric)
    number = np.array([4, 0, 6, 2, 1, 5])
    out = np.ones(7 * n_fields * LANES)
    add_shape_moments(rows, np.ascontiguousarray(shape), number, out)
    values = (out - 1).reshape(7, n_fields, LANES)
    assert not values[3].any()
    for a in range(6):
        for lane in (0, 7, LANES - 1):
            fields = kernel_fields(source[:, :3] - points[lane], source[:, 3:], n_fields)
            # Fast reciprocal root: 5e-15, times the fifth power; 1 was added and taken away.
            np.testing.assert_allclose(
                values[number[a], :, lane], shape[a] @ fields, rtol=1e-11, atol=3e-16
            )


def test_weighted_sum_of_rows():
    rows = np.random.default_rng(0).normal(size=(5, LANES))
    number, weight = np.array([4, 1, 2, 0, 3, 0]), np.array([0.5, -1.0, 2.0, 3.0, 0.25, 0.0])
    out = np.ones(LANES)
    add_weighted(rows.ravel(), number, weight, out)
    np.testing.assert_allclose(out, 1 + weight @ rows[number], rtol=1e-13, atol=1e-14)


def test_surface_point_is_that_of_the_arrays():
    b = np.array([0.2, 0.5, 0.3])
    shape, source = np.empty(6), np.empty(6)
    surface_point(CURVED, *b, shape, source)
    np.testing.assert_allclose(shape, quadratic_shapes(b[None])[:, 0], rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(source, element_points(CURVED[None], b[None])[0, 0], rtol=1e-13)


@pytest.mark.parametrize("n_fields", [TRACTION, DISPLACEMENT])
@pytest.mark.parametrize("height", [0.5, 0.06])
def test_near_integral(n_fields, height):
    point_and_normal = element_points(CURVED[None], np.array([[0.3, 0.5, 0.2]]))[0, 0]
    point = point_and_normal[:3] + height * point_and_normal[3:] / np.linalg.norm(
        point_and_normal[3:]
    )
    integral = np.zeros((6, n_fields))
    add_near(n_fields, point, CURVED, *near_rules(), integral)
    expected = brute_force(np.eye(3), CURVED, point, np.zeros(6), n_fields, 5)
    error = np.abs(integral[:, :n_fields] - expected).max() / np.abs(expected).max()
    # Parts are within the default tolerance of 1e-6 by a bound; their errors come out smaller and
    # cancel.
    assert error < 1e-8


ACCURACY = (
    # With many points nothing is left but round-off and the reference.
    ((12, 40), 1e-12),
    # The default's 4 x 12 points on an element that is bent by a tenth of its size, far more than a
    # mesh's.
    (Quadrature().polar_points, 1e-4),
)


@pytest.mark.parametrize("n_fields", [TRACTION, DISPLACEMENT])
@pytest.mark.parametrize("corner", [0, 1, 2])
@pytest.mark.parametrize("nodes", [FLAT, CURVED], ids=("flat", "curved"))
@pytest.mark.parametrize(("polar_points", "tolerance"), ACCURACY)
def test_singular_integral_at_a_corner(n_fields, corner, nodes, polar_points, tolerance):
    corners = np.roll(np.eye(3), -corner, axis=0)
    own_shapes = np.eye(6)[corner]
    integral = np.zeros((6, n_fields))
    polar = polar_rule(Quadrature(polar_points=polar_points))
    subtracted = own_shapes if n_fields == TRACTION else 0 * own_shapes
    add_singular(n_fields, nodes[corner], nodes, corners, polar, subtracted, integral)
    expected = fine_polar(corners, nodes, nodes[corner], subtracted, n_fields)
    assert np.abs(integral[:, :n_fields] - expected).max() < tolerance * np.abs(expected).max()


@pytest.mark.parametrize("n_fields", [TRACTION, DISPLACEMENT])
@pytest.mark.parametrize("inside", [(0.8, 0.1, 0.1), (0.3, 0.3, 0.4), (0.02, 0.58, 0.4)])
@pytest.mark.parametrize(("polar_points", "tolerance"), ACCURACY)
def test_singular_integral_around_a_shifted_point(n_fields, inside, polar_points, tolerance):
    inside = np.array(inside)
    point = element_points(CURVED[None], inside[None])[0, 0, :3]
    own_shapes = quadratic_shapes(inside[None])[:, 0]
    integral, expected = np.zeros((6, n_fields)), np.zeros((6, n_fields))
    polar = polar_rule(Quadrature(polar_points=polar_points))
    for k in range(3):
        corners = np.stack([inside, np.eye(3)[k], np.eye(3)[(k + 1) % 3]])
        subtracted = own_shapes if n_fields == TRACTION else 0 * own_shapes
        add_singular(n_fields, point, CURVED, corners, polar, subtracted, integral)
        expected += fine_polar(corners, CURVED, point, subtracted, n_fields)
    error = np.abs(integral[:, :n_fields] - expected).max() / np.abs(expected).max()
    assert error < tolerance


def test_potential_of_a_flat_triangle_seen_from_its_corner():
    # Closed form: int 1 / r = h (asinh(b / h) - asinh(a / h)) with the opposite edge from a to b at
    # distance h.
    integral = np.zeros((6, DISPLACEMENT))
    polar = polar_rule(Quadrature())
    add_singular(DISPLACEMENT, FLAT[0], FLAT, np.eye(3), polar, np.zeros(6), integral)
    edge = FLAT[2] - FLAT[1]
    length = np.linalg.norm(edge)
    along = (FLAT[1] - FLAT[0]) @ edge / length
    height = np.linalg.norm(FLAT[1] - FLAT[0] - along * edge / length)
    exact = height * (np.arcsinh((along + length) / height) - np.arcsinh(along / height))
    # The trace of r_i r_j / r^3 is 1 / r and the shapes sum to one; 12 Gauss points resolve the
    # smooth angle.
    np.testing.assert_allclose(integral[:, :3].sum(), exact, rtol=1e-9)


@pytest.mark.parametrize("thinness", [0.1, 0.01])
def test_potential_of_a_thin_triangle(thinness):
    # The hyperbolic angle keeps its accuracy however flat the triangle is; plain polar coordinates
    # would not.
    nodes = ELEMENT_NODES @ np.array([[0.0, 0, 0], [-1, thinness, 0], [1.5, thinness, 0]])
    integral = np.zeros((6, DISPLACEMENT))
    polar = polar_rule(Quadrature())
    add_singular(DISPLACEMENT, nodes[0], nodes, np.eye(3), polar, np.zeros(6), integral)
    exact = thinness * (np.arcsinh(1.5 / thinness) + np.arcsinh(1 / thinness))
    np.testing.assert_allclose(integral[:, :3].sum(), exact, rtol=1e-8)
