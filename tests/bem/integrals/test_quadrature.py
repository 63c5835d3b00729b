"""Quadrature rules and shape functions against exact integrals and derivatives."""

from math import factorial

import numpy as np
import pytest

from palpate.bem.integrals.quadrature import Quadrature, triangle_rule, unit_gauss
from palpate.geometry.quadratic_triangle import (
    ELEMENT_NODES,
    element_points,
    element_spheres,
    quadratic_shapes,
    quadratic_slopes,
)


def monomial_error(rule, degree):
    """Largest relative error over the monomials x^i y^j of one degree on the reference triangle."""
    worst = 0.0
    for i in range(degree + 1):
        j = degree - i
        exact = factorial(i) * factorial(j) / factorial(i + j + 2)
        found = rule.weight @ (rule.barycentric[:, 1] ** i * rule.barycentric[:, 2] ** j)
        worst = max(worst, abs(found / exact - 1))
    return worst


@pytest.mark.parametrize("degree", range(1, 16))
def test_rule_is_exact_up_to_its_degree_and_not_beyond(degree):
    rule = triangle_rule(degree)
    assert rule.degree >= degree
    # Round-off of a few dozen terms.
    assert max(monomial_error(rule, d) for d in range(rule.degree + 1)) < 1e-12
    # A rule that claims less than it can wastes points.
    assert monomial_error(rule, rule.degree + 1) > 1e-9


@pytest.mark.parametrize("degree", [2, 4, 5, 7, 11])
def test_rule_has_positive_weights_and_inner_points(degree):
    rule = triangle_rule(degree)
    assert (rule.weight > 0).all()
    assert (rule.barycentric > 0).all()
    np.testing.assert_allclose(rule.barycentric.sum(axis=1), 1, atol=1e-15)


def test_gauss_on_the_unit_interval():
    x, w = unit_gauss(5)
    powers = np.arange(10)
    np.testing.assert_allclose(w @ x[:, None] ** powers, 1 / (powers + 1), rtol=1e-14)


def test_ratios_fall_with_the_degree_and_meet_the_tolerance():
    quadrature = Quadrature(tolerance=1e-5, degrees=(2, 5))
    np.testing.assert_allclose(quadrature.ratios() ** -np.array([3.0, 6.0]), 1e-5)


def some_places(count=6):
    b = np.random.default_rng(0).random((count, 3))
    return b / b.sum(axis=1)[:, None]


def test_shapes_are_one_at_their_own_node_only():
    np.testing.assert_allclose(quadratic_shapes(ELEMENT_NODES), np.eye(6), atol=1e-15)
    np.testing.assert_allclose(quadratic_shapes(some_places()).sum(axis=0), 1, rtol=1e-14)


def test_slopes_are_the_derivatives_of_the_shapes():
    places = some_places()
    along_b, along_c = quadratic_slopes(places)
    # A central difference of a quadratic has no error but round-off, 1e-16 / step.
    for slope, step in ((along_b, [-1, 1, 0]), (along_c, [-1, 0, 1])):
        move = 1e-3 * np.array(step)
        difference = quadratic_shapes(places + move) - quadratic_shapes(places - move)
        np.testing.assert_allclose(slope, difference / 2e-3, atol=1e-12)


def test_element_points_follow_a_parabolic_cap():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.9, 0]])
    flat = ELEMENT_NODES @ corners
    nodes = flat + np.outer(0.3 * flat[:, 0] ** 2 - 0.1 * flat[:, 0] * flat[:, 1], [0, 0, 1])
    places = some_places()
    x, y, z, nx, ny, nz = element_points(nodes[None], places)[0].T
    np.testing.assert_allclose(z, 0.3 * x**2 - 0.1 * x * y, atol=1e-15)
    # Normal of z = f(x, y) is (-f_x, -f_y, 1); its z part is the area of the projection, twice
    # 0.45.
    np.testing.assert_allclose(nz, 0.9, rtol=1e-14)
    np.testing.assert_allclose(nx / nz, -(0.6 * x - 0.1 * y), atol=1e-14)
    np.testing.assert_allclose(ny / nz, 0.1 * x, atol=1e-14)


def test_spheres_hold_their_elements():
    nodes = np.random.default_rng(1).normal(size=(4, 6, 3))
    centre, radius = element_spheres(nodes)
    distance = np.linalg.norm(nodes - centre[:, None], axis=2)
    assert (distance <= radius[:, None] * (1 + 1e-15)).all()
    np.testing.assert_allclose(centre, nodes[:, :3].mean(axis=1))
