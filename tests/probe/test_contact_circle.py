"""Circles that tools touch: closed forms, limits, and surfaces of known curvature."""

import numpy as np
import pytest
from scipy.integrate import quad
from surfaces import box, sphere

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.probe import contact_circle, local_surface
from palpate.records import CONE, CYLINDER, FLAT, SLIDES, SPHERE, STICKS, Tool
from palpate.records.contacts import cone_pressure

SHEAR, NU = 2e4, 0.3
REDUCED = 2.0 * SHEAR / (1.0 - NU)


def _radius(tool: Tool, curvature: float, force: float, nu: float = NU) -> float:
    return contact_circle(tool, curvature, force, shear_modulus=SHEAR, poisson_ratio=nu).radius


@pytest.mark.parametrize("curvature", [0.0, 20.0, -50.0])
def test_a_light_touch_is_hertzian(curvature: float) -> None:
    tool, force = Tool(SPHERE, 5e-3), 1e-4
    relative = 1.0 / tool.radius + curvature
    hertz = (0.75 * force / (REDUCED * relative)) ** (1 / 3)
    # A sphere is a paraboloid but for (a / R)^2 = 1e-3.
    assert _radius(tool, curvature, force) == pytest.approx(hertz, rel=1e-3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_deep_touch_is_sneddon_s(share: float) -> None:
    """Against his integral over the sphere's own slope."""
    ball, curvature = 4e-3, 15.0
    circle = share * ball

    def integrand(angle: float) -> float:
        r = circle * np.sin(angle)
        return r**2 * (r / np.sqrt(ball**2 - r**2) + curvature * r)

    force = 2.0 * REDUCED * quad(integrand, 0.0, 0.5 * np.pi)[0]
    assert _radius(Tool(SPHERE, ball), curvature, force) == pytest.approx(circle, rel=1e-6)


def test_a_surface_that_sticks_is_touched_less() -> None:
    """By ln 3 at nu = 0, not at all when nothing changes its volume, the limit included."""
    force, ball = 1e-4, 5e-3
    for nu, stiffer in ((0.0, np.log(3.0)), (0.4999, 1.0), (0.5, 1.0)):
        free = _radius(Tool(SPHERE, ball), 0.0, force, nu)
        stuck = _radius(Tool(SPHERE, ball, STICKS), 0.0, force, nu)
        assert (free / stuck) ** 3 == pytest.approx(stiffer, rel=1e-3)


def test_a_flat_face_touches_all_of_itself_or_less() -> None:
    tool = Tool(FLAT, 4e-3)
    found = contact_circle(tool, 0.0, 0.5, shear_modulus=SHEAR, poisson_ratio=NU)
    assert (found.radius, found.profile) == (4e-3, "flat")
    # A ball of 20 mm under a light push is not flattened as far.
    found = contact_circle(tool, 50.0, 1e-3, shear_modulus=SHEAR, poisson_ratio=NU)
    assert found.profile == "hertz"
    assert found.radius == pytest.approx((0.75 * 1e-3 / (REDUCED * 50.0)) ** (1 / 3))


@pytest.mark.parametrize("degrees", [45.0, 70.0, 85.0])
def test_a_cone_is_sneddon_s(degrees: float) -> None:
    """F = 2 E* tan(angle) d^2 / pi at the depth d, of a circle of 2 d tan(angle) / pi."""
    angle, depth = np.radians(degrees), 1e-4
    force = 2.0 / np.pi * REDUCED * np.tan(angle) * depth**2
    found = contact_circle(
        Tool(CONE, 0.05, SLIDES, angle), 0.0, force, shear_modulus=SHEAR, poisson_ratio=NU
    )
    assert found.profile == "cone"
    # The search ends at 1e-9 of the base.
    assert found.radius == pytest.approx(2.0 / np.pi * depth * np.tan(angle), rel=1e-6)


def test_its_pressure_gives_the_depth() -> None:
    """Boussinesq: the middle of a level surface goes down by the integral of p / r over pi E*."""
    s = np.array([0.01, 0.3, 0.9, 1.0, 1.5])
    np.testing.assert_allclose(cone_pressure(s), np.arccosh(1.0 / np.minimum(s, 1.0)))
    angle, radius = np.radians(70.0), 2e-3
    total = quad(lambda s: 2.0 * np.pi * s * np.arccosh(1.0 / s), 0.0, 1.0)[0]
    force = 0.5 * np.pi * REDUCED * radius**2 / np.tan(angle)
    middle = quad(lambda s: 2.0 * np.arccosh(1.0 / s), 0.0, 1.0)[0]
    depth = force / total / radius * middle / REDUCED
    assert depth == pytest.approx(0.5 * np.pi * radius / np.tan(angle), rel=1e-6)


def test_the_faces_of_a_punch_and_of_a_cylinder_are_one() -> None:
    found = [
        contact_circle(Tool(shape, 4e-3), 0.0, 0.5, shear_modulus=SHEAR, poisson_ratio=NU)
        for shape in (FLAT, CYLINDER)
    ]
    assert found[0] == found[1]
    assert Tool(CYLINDER, 4e-3).contact(np.zeros(3)).profile == "flat"


def test_normal_and_curvature_are_those_of_the_surface() -> None:
    ball = TriangleMesh(0.03 * sphere(3).vertices, sphere(3).triangles)
    top = local_surface(ball, np.array([0.0, 0.0, 0.03]), 3e-3)
    # Heights are taken along the normal of a facet, 5 degrees off: a few per cent.
    assert top.curvature == pytest.approx(1 / 0.03, rel=0.05)
    assert top.normal @ [0.0, 0.0, 1.0] > np.cos(np.radians(1.5))
    block = box((0.05, 0.05, 0.05), 5)
    # Beside an edge the other face does not count.
    for x in (0.025, 0.048):
        flat = local_surface(block, np.array([x, 0.025, 0.05]), 5e-3)
        assert flat.curvature == pytest.approx(0.0, abs=1e-9)
        np.testing.assert_allclose(flat.normal, [0.0, 0.0, 1.0], atol=1e-12)


def test_what_cannot_be() -> None:
    ball = Tool(SPHERE, 3e-3)
    with pytest.raises(InputError, match="pulls"):
        contact_circle(ball, 0.0, -0.1, shear_modulus=SHEAR, poisson_ratio=NU)
    with pytest.raises(InputError, match="bury a sphere of 3 mm"):
        contact_circle(ball, 0.0, 50.0, shear_modulus=SHEAR, poisson_ratio=NU)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"shape": "wedge"}, "wedge"),
        ({"radius": 0.0}, "positive"),
        ({"friction": "glue"}, "glue"),
        ({"shape": CONE}, "no tool_angle"),
        ({"angle": 1.0}, "a tool_angle"),
        ({"shape": CONE, "angle": 0.2}, "11.5 degrees"),
    ],
)
def test_tools_that_there_are_not(change: dict[str, object], text: str) -> None:
    given = {"shape": SPHERE, "radius": 3e-3, "friction": STICKS} | change
    with pytest.raises(InputError, match=text):
        Tool(**given)
