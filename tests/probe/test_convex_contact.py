"""Contacts of meshes against the closed forms of the shapes that have one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk
from surfaces import ball_mesh, hull_mesh

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.probe import ConvexContact, LocalSurface, contact_circle, convex_contact
from palpate.records import SPHERE, STICKS, Tool, mesh_tool

SHEAR, NU = 2e4, 0.3
MODULUS = 2.0 * SHEAR / (1.0 - NU)
UP = np.array([0.0, 0.0, 1.0])


def _bar(half: np.ndarray) -> TriangleMesh:
    """Box of these half sides, with the middle of its lower face at the origin."""
    corners = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    return hull_mesh(half * (corners + np.array([0.0, 0.0, 1.0])))


def _contact(
    mesh: TriangleMesh,
    force: float,
    *,
    turn: Rotation | None = None,
    curvature: float = 0.0,
    friction: str = "slides",
) -> ConvexContact:
    turned = np.eye(3) if turn is None else turn.as_matrix()
    tool = mesh_tool(mesh, turned, friction)
    local = LocalSurface(turned @ UP, curvature)
    return convex_contact(tool, local, force, shear_modulus=SHEAR, poisson_ratio=NU)


def _moments(found: ConvexContact) -> tuple[float, float]:
    """Root mean square extent of the pressure along its axes [m], and its sum is one."""
    pressures = found.pressure_map
    cells = len(pressures.pressure)
    x = pressures.half_side * found.radius * ((2.0 * np.arange(cells) + 1.0) / cells - 1.0)
    weight = pressures.pressure / pressures.pressure.sum()
    return (
        float(np.sqrt(weight.sum(axis=1) @ x**2)),
        float(np.sqrt(weight.sum(axis=0) @ x**2)),
    )


@pytest.mark.parametrize("curvature", [0.0, 60.0, -30.0])
@pytest.mark.parametrize("friction", ["slides", STICKS])
def test_a_ball_touches_the_circle_of_a_sphere(curvature: float, friction: str) -> None:
    """Its 8,000 vertices lie on a sphere; at this depth the sphere is a paraboloid to 1 %."""
    found = _contact(ball_mesh(np.full(3, 6e-3)), 0.05, curvature=curvature, friction=friction)
    sphere = contact_circle(
        Tool(SPHERE, 6e-3, friction), curvature, 0.05, shear_modulus=SHEAR, poisson_ratio=NU
    )
    assert found.radius == pytest.approx(sphere.radius, rel=0.01)
    # Hertz: the mean square of each coordinate is a fifth of the circle's.
    assert _moments(found) == pytest.approx([sphere.radius / np.sqrt(5.0)] * 2, rel=0.01)
    mean = found.pressure_map.mean(np.linspace(0.0, 0.9, 10) * found.radius / _reach(found))
    hertz = np.sqrt(1.0 - np.linspace(0.0, 0.9, 10) ** 2)
    # The facets are seen in the pressure: a fortieth of its mean at the centre.
    np.testing.assert_allclose(mean / mean.mean(), hertz / hertz.mean(), atol=0.04)


def _reach(found: ConvexContact) -> float:
    return found.radius * found.pressure_map.reach


def test_a_square_face_is_as_stiff_as_king_found() -> None:
    """Force over approach is 2 beta E* sqrt(A / pi), with beta 1.012 (King, Int. J. Solids Struct.
    23 (1987) 1657); cells at the singular rim are worth half a per cent."""
    half = 4e-3
    found = _contact(_bar(np.array([half, half, 0.02])), 0.3)
    beta = 0.3 / found.approach / (2.0 * MODULUS * np.sqrt(4.0 * half**2 / np.pi))
    assert beta == pytest.approx(1.012, rel=0.005)
    assert _reach(found) == pytest.approx(np.sqrt(2.0) * half, rel=0.05)
    assert not found.pressure_map.outward.any()


def test_an_ellipsoid_touches_the_ellipse_of_hertz() -> None:
    """Johnson, Contact Mechanics (1985), equations 4.26 to 4.28: the ratio of the half axes belongs
    to the ratio of the curvatures."""
    axes = np.array([8e-3, 3e-3, 5e-3])
    along, across = axes[2] / axes[0] ** 2, axes[2] / axes[1] ** 2  # curvatures at the tip
    ratio = _axis_ratio(across / along)
    extents = sorted(_moments(_contact(ball_mesh(axes), 0.01)))
    assert extents[1] / extents[0] == pytest.approx(ratio, rel=0.02)


def _axis_ratio(curvature_ratio: float) -> float:
    """Ratio of the half axes of a Hertzian ellipse, by bisection."""
    low, high = 1.0, 50.0
    for _ in range(60):
        ratio = np.sqrt(low * high)
        square = 1.0 - ratio**-2  # of the eccentricity
        e, k = ellipe(square), ellipk(square)
        found = (ratio**2 * e - k) / (k - e)
        low, high = (ratio, high) if found < curvature_ratio else (low, ratio)
    return float(ratio)


def test_pressure_turns_with_the_tool() -> None:
    mesh = _bar(np.array([5e-3, 2e-3, 0.02]))
    turn = Rotation.from_rotvec([0.3, -1.1, 0.4])
    here, there = _contact(mesh, 0.2), _contact(mesh, 0.2, turn=turn)
    # The face's edge is drawn by cells of a fiftieth of its length, in other places when turned.
    assert there.approach == pytest.approx(here.approach, rel=0.02)
    assert there.radius == pytest.approx(here.radius, rel=0.02)
    rng = np.random.default_rng(0)
    places = rng.uniform(-0.5, 0.5, (200, 3)) * np.array([1.0, 0.3, 0.0])
    inner = here.pressure_map.at(places) / here.pressure_map.pressure.max()
    turned = there.pressure_map.at(turn.apply(places) * here.radius / there.radius)
    np.testing.assert_allclose(turned / np.median(turned), inner / np.median(inner), rtol=0.05)


def test_the_outward_traction_of_a_ball_is_that_of_a_sphere() -> None:
    """p r / R on average: its integral is that of r / R over Hertz's pressure, 3 pi / 16 of a / R;
    at the rim the slope of a sphere is 3.6 % above r / R."""
    found = _contact(ball_mesh(np.full(3, 6e-3)), 0.05)
    pressures = found.pressure_map
    outward = pressures.outward.sum() / pressures.pressure.sum()
    assert outward == pytest.approx(3.0 * np.pi / 16.0 * found.radius / 6e-3, rel=0.03)
    s = np.linspace(0.2, 0.8, 7) * found.radius / _reach(found)
    slope = pressures.mean_outward(s) / pressures.mean(s)
    np.testing.assert_allclose(slope, s * _reach(found) / 6e-3, rtol=0.05)


def test_a_mesh_that_sticks_pulls_outward_as_a_sphere_does() -> None:
    found = _contact(ball_mesh(np.full(3, 6e-3)), 0.05, friction=STICKS)
    pressures = found.pressure_map
    middle = (2.0 * np.arange(len(pressures.pressure)) + 1.0) / len(pressures.pressure) - 1.0
    distance = pressures.half_side * np.hypot(*np.meshgrid(middle, middle))
    outward = (pressures.outward * distance).sum() / pressures.pressure.sum()
    sphere = contact_circle(
        Tool(SPHERE, 6e-3, STICKS), 0.0, 0.05, shear_modulus=SHEAR, poisson_ratio=NU
    )
    # At this depth the sphere is no paraboloid by 1 %.
    assert outward == pytest.approx(sphere.outward, rel=0.02)


def test_a_punch_that_leans_by_a_degree_is_not_buried() -> None:
    """Its steep side wall faces the surface then; the front edge takes more of the force. The slope
    of the whole face is no outward traction."""
    bar = _bar(np.array([3e-3, 3e-3, 0.02]))
    lean = Rotation.from_rotvec([0.0, np.radians(1.0), 0.0])
    tool = mesh_tool(bar, lean.as_matrix())
    found = convex_contact(tool, LocalSurface(UP, 0.0), 0.5, shear_modulus=SHEAR, poisson_ratio=NU)
    weight = found.pressure_map.pressure / found.pressure_map.pressure.sum()
    cells = np.arange(len(weight)) - 0.5 * (len(weight) - 1)
    middle = (weight.sum(axis=1) @ cells * found.pressure_map.axes[0]) + (
        weight.sum(axis=0) @ cells * found.pressure_map.axes[1]
    )
    # In cells of a fiftieth of the face.
    assert middle[0] > 0.5
    assert abs(middle[1]) < 0.1
    outward = found.pressure_map.outward
    assert abs(outward).max() < 0.01 * found.pressure_map.pressure.max()


def test_what_cannot_touch_is_said() -> None:
    with pytest.raises(InputError, match="would bury a mesh of 6 mm"):
        _contact(ball_mesh(np.full(3, 6e-3)), 60.0)
    with pytest.raises(InputError, match=r"the tool pulls with 0\.1 N"):
        _contact(ball_mesh(np.full(3, 6e-3)), -0.1)
    beside = ball_mesh(np.full(3, 6e-3))
    moved = TriangleMesh(beside.vertices + np.array([9e-3, 0.0, 0.0]), beside.triangles)
    with pytest.raises(InputError, match=r"touches 9\.\d+ mm beside its origin"):
        _contact(moved, 0.05)
