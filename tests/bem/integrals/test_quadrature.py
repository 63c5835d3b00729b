"""Quadrature rules against exact integrals."""

from math import factorial

import numpy as np
import pytest

from palpate.bem.integrals.quadrature import Quadrature, triangle_rule, unit_gauss


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
