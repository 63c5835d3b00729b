"""Dents against the contact circle of the same tool, which is computed by another formula."""

from dataclasses import replace

import pytest

from palpate.probe import GROWTH, contact_circle, dent, on_flat
from palpate.records import STICKS, Tool

CONSTANTS = {"shear_modulus": 8e3, "poisson_ratio": 0.4}


def test_a_ball_goes_in_by_the_square_of_the_circle_over_its_radius():
    """Hertz: depth = a^2 / R; small, since the circle is that of a whole sphere."""
    tool = Tool("sphere", 5e-3)
    force = 1e-8
    radius = contact_circle(tool, 0.0, force, **CONSTANTS).radius
    assert dent(tool, force, **CONSTANTS) == pytest.approx(radius**2 / tool.radius, rel=1e-3)


def test_on_a_ball_it_goes_in_as_on_a_flat_with_both_curvatures():
    tool, curvature, force = Tool("sphere", 5e-3), 50.0, 1e-8
    radius = contact_circle(tool, curvature, force, **CONSTANTS).radius
    expected = radius**2 * (1.0 / tool.radius + curvature)
    assert dent(on_flat(tool, curvature), force, **CONSTANTS) == pytest.approx(expected, rel=1e-3)


def test_a_hollow_that_fits_the_ball_leaves_it_a_radius():
    assert on_flat(Tool("sphere", 5e-3), -1e3).radius == pytest.approx(50e-3)


@pytest.mark.parametrize("shape", GROWTH)
def test_it_grows_with_force_and_compliance_alike(shape):
    tool, q = Tool(shape, 5e-3), GROWTH[shape]
    base = dent(tool, 0.1, **CONSTANTS)
    assert dent(tool, 0.2, **CONSTANTS) / base == pytest.approx(2.0 ** (1.0 - q))
    softer = CONSTANTS | {"shear_modulus": 4e3}
    assert dent(tool, 0.1, **softer) / base == pytest.approx(2.0 ** (1.0 - q))


def test_a_flat_face_that_sticks_is_stiffer_and_not_in_an_incompressible_body():
    tool = Tool("flat", 5e-3)
    sticking = replace(tool, friction=STICKS)
    assert dent(sticking, 0.1, **CONSTANTS) < 0.999 * dent(tool, 0.1, **CONSTANTS)
    incompressible = CONSTANTS | {"poisson_ratio": 0.5}
    assert dent(sticking, 0.1, **incompressible) == dent(tool, 0.1, **incompressible)
    # Johnson, equation 3.36: F = 2 a E* d with E* = 4 G.
    assert dent(tool, 0.1, **incompressible) == pytest.approx(0.1 / (2.0 * 5e-3 * 4.0 * 8e3))
