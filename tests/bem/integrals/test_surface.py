"""The surface between the vertices, and integrals over it."""

from math import factorial

import numpy as np
import pytest
from elastic_bodies import cube_with_faces
from surfaces import sphere

from palpate.bem import make_surface
from palpate.bem.integrals.surface import Quadrature, integral_weights, triangle_rule, unit_gauss
from palpate.errors import InputError


def low_cap(mesh):
    return np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)


@pytest.mark.parametrize("held", [[], range(12)])
def test_a_support_of_nothing_or_everything_is_refused(held):
    mesh, _ = cube_with_faces(1)
    with pytest.raises(InputError, match="must hold a part of the surface and leave a part free"):
        make_surface(mesh, np.array(held, dtype=np.int64))


def test_smooth_midpoints_lie_on_the_sphere():
    mesh = sphere(3)
    smooth = make_surface(mesh, low_cap(mesh)).element_nodes[:, 3:]
    flat = make_surface(mesh, low_cap(mesh), smooth=False).element_nodes[:, 3:]
    off_smooth = np.abs(np.linalg.norm(smooth, axis=2) - 1)
    off_flat = np.abs(np.linalg.norm(flat, axis=2) - 1)
    # Chords sag by h^2 / 8; the fit is two orders better away from the cut of the support.
    assert np.median(off_smooth) < 0.1 * np.median(off_flat)


def test_weights_integrate_quadratics_over_a_held_face():
    mesh, face = cube_with_faces(3)
    held = np.flatnonzero(face == 4)
    surface = make_surface(mesh, held)
    weights = integral_weights(surface, held)
    x, y, _ = mesh.vertices[surface.sides.vertex].T
    # The midpoint fit and the rule are exact for quadratics on flat ground.
    for value, exact in ((1 + 0 * x, 1.0), (x, 0.5), (x * x, 1 / 3), (x * y, 0.25)):
        np.testing.assert_allclose(weights @ value, exact, rtol=1e-12)
    assert not weights[np.isin(surface.sides.vertex, np.flatnonzero(mesh.vertices[:, 2] > 0))].any()


def test_area_of_a_smooth_sphere():
    areas = []
    for smooth in (True, False):
        mesh = sphere(3)
        surface = make_surface(mesh, low_cap(mesh), smooth=smooth)
        areas.append(integral_weights(surface, np.arange(mesh.triangles.shape[0])).sum())
    smooth, flat = np.abs(np.array(areas) / (4 * np.pi) - 1)
    # 258 vertices: facets miss about 2 %, curved elements much less.
    assert 5e-3 < flat < 3e-2
    assert smooth < 5e-4


def test_linear_elements_do_not_follow_dips():
    mesh, face = cube_with_faces(1)
    held = np.flatnonzero(face == 4)
    assert make_surface(mesh, held).corrects_indentation
    for linear in ({"smooth": False}, {"quadratic": False}):
        assert not make_surface(mesh, held, **linear).corrects_indentation


def monomial_error(barycentric, weight, degree):
    """Largest relative error over the monomials x^i y^j of one degree on the reference triangle."""
    worst = 0.0
    for i in range(degree + 1):
        j = degree - i
        exact = factorial(i) * factorial(j) / factorial(i + j + 2)
        integral = weight @ (barycentric[:, 1] ** i * barycentric[:, 2] ** j)
        worst = max(worst, abs(integral / exact - 1))
    return worst


@pytest.mark.parametrize("degree", range(1, 16))
def test_rule_is_exact_up_to_its_degree_and_not_beyond(degree):
    rule = triangle_rule(degree)
    # A rule that can do more wastes points; there are rules of degrees 2 and 4, then of odd ones.
    reached = degree + degree % 2 if degree < 5 else degree | 1
    # Round-off of a few dozen terms.
    assert max(monomial_error(*rule, d) for d in range(reached + 1)) < 1e-12
    assert monomial_error(*rule, reached + 1) > 1e-9


@pytest.mark.parametrize("degree", [2, 4, 5, 7, 11])
def test_rule_has_positive_weights_and_inner_points(degree):
    barycentric, weight = triangle_rule(degree)
    assert (weight > 0).all()
    assert (barycentric > 0).all()
    np.testing.assert_allclose(barycentric.sum(axis=1), 1, atol=1e-15)


def test_gauss_on_the_unit_interval():
    x, w = unit_gauss(5)
    powers = np.arange(10)
    np.testing.assert_allclose(w @ x[:, None] ** powers, 1 / (powers + 1), rtol=1e-14)


def test_ratios_fall_with_the_degree_and_meet_the_tolerance():
    quadrature = Quadrature(tolerance=1e-5, degrees=(2, 5))
    np.testing.assert_allclose(quadrature.ratios() ** -np.array([3.0, 6.0]), 1e-5)
