"""Dents against the contact circle of the same tool, which is computed by another formula."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.probe import LocalSurface, dent, on_flat, tool_contact
from palpate.records import STICKS, FlatFace, Sphere

CONSTANTS = {"shear_modulus": 8e3, "poisson_ratio": 0.4}


@pytest.mark.parametrize(
    ("tool", "curvature"), [(Sphere(5e-3), 0.0), (Sphere(5e-3), 50.0), (FlatFace(5e-3), 0.0)]
)
def test_it_is_the_approach_of_a_light_touch(tool, curvature):
    """A sphere is a paraboloid there."""
    local = LocalSurface(np.array([0.0, 0.0, 1.0]), curvature)
    contact = tool_contact(tool, local, 1e-8, **CONSTANTS)
    assert dent(on_flat(tool, curvature), 1e-8, **CONSTANTS) == pytest.approx(
        contact.approach, rel=2e-3
    )


def test_a_hollow_that_fits_the_ball_leaves_it_a_radius():
    assert on_flat(Sphere(5e-3), -1e3).radius == pytest.approx(50e-3)


@pytest.mark.parametrize("tool", [Sphere(5e-3), FlatFace(5e-3)])
def test_it_grows_with_force_and_compliance_alike(tool):
    q = tool.growth
    base = dent(tool, 0.1, **CONSTANTS)
    assert dent(tool, 0.2, **CONSTANTS) / base == pytest.approx(2.0 ** (1.0 - q))
    softer = CONSTANTS | {"shear_modulus": 4e3}
    assert dent(tool, 0.1, **softer) / base == pytest.approx(2.0 ** (1.0 - q))


def test_a_flat_face_that_sticks_is_stiffer_and_not_in_an_incompressible_body():
    tool = FlatFace(5e-3)
    sticking = replace(tool, friction=STICKS)
    assert dent(sticking, 0.1, **CONSTANTS) < 0.999 * dent(tool, 0.1, **CONSTANTS)
    incompressible = CONSTANTS | {"poisson_ratio": 0.5}
    assert dent(sticking, 0.1, **incompressible) == dent(tool, 0.1, **incompressible)
    # Johnson, equation 3.36: F = 2 a E* d with E* = 4 G.
    assert dent(tool, 0.1, **incompressible) == pytest.approx(0.1 / (2.0 * 5e-3 * 4.0 * 8e3))
