"""Contacts of tools: closed forms, limits, and surfaces of known curvature."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import ellipe, ellipk
from surfaces import ball_mesh, box, hull_mesh, sphere

from palpate.bem import PressureDisc, disc_displacement, disc_potentials
from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.probe import LocalSurface, ToolContact, local_surface, tool_contact
from palpate.records import (
    SLIDES,
    SPREAD,
    STICKS,
    TOOLS,
    Cone,
    Contact,
    FlatFace,
    GridTraction,
    Ring,
    Sphere,
    Tool,
    mesh_tool,
)
from palpate.records.contact import PRESSURES, cone_pressure

SHEAR, NU = 2e4, 0.3
REDUCED = 2.0 * SHEAR / (1.0 - NU)
# Where nothing changes the volume, traction along the surface does not move it along its normal.
LEVEL_NU, LEVEL_REDUCED = 0.5, 4.0 * SHEAR
MODULUS = 2.0 * SHEAR / (1.0 - NU)
UP = np.array([0.0, 0.0, 1.0])


def _found(tool: Tool, force: float, curvature: float = 0.0, nu: float = NU) -> ToolContact:
    local = LocalSurface(UP, curvature)
    return tool_contact(tool, local, force, shear_modulus=SHEAR, poisson_ratio=nu)


def _radius(tool: Tool, curvature: float, force: float, nu: float = NU) -> float:
    return _found(tool, force, curvature, nu).radius


def _share(contact: ToolContact, s: np.ndarray) -> np.ndarray:
    """Pressure at distances over the radius, over its mean over the circle."""
    angle = np.arcsin(SPREAD)
    mean = 2.0 * np.trapezoid(contact.traction.pressure * SPREAD, angle)
    return contact.traction.mean(s) / mean


@pytest.mark.parametrize("curvature", [0.0, 20.0, -50.0])
def test_a_light_touch_is_hertzian(curvature: float) -> None:
    tool, force = Sphere(5e-3), 1e-4
    relative = 1.0 / tool.radius + curvature
    hertz = (0.75 * force / (LEVEL_REDUCED * relative)) ** (1 / 3)
    # A sphere is a paraboloid but for (a / R)^2 = 1e-3.
    assert _radius(tool, curvature, force, LEVEL_NU) == pytest.approx(hertz, rel=1e-3)


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_deep_touch_is_sneddon_s(share: float) -> None:
    """Against his integral over the sphere's own slope."""
    ball, curvature = 4e-3, 15.0
    circle = share * ball

    def integrand(angle: float) -> float:
        r = circle * np.sin(angle)
        return r**2 * (r / np.sqrt(ball**2 - r**2) + curvature * r)

    force = 2.0 * LEVEL_REDUCED * quad(integrand, 0.0, 0.5 * np.pi)[0]
    radius = _radius(Sphere(ball), curvature, force, LEVEL_NU)
    assert radius == pytest.approx(circle, rel=1e-6)


def test_a_surface_that_sticks_is_touched_less() -> None:
    """By ln 3 at nu = 0, not at all when nothing changes its volume, the limit included."""
    # On so small a circle a ball that slides hardly pulls outward.
    force, ball = 1e-12, 5e-3
    for nu, stiffer in ((0.0, np.log(3.0)), (0.4999, 1.0), (0.5, 1.0)):
        free = _radius(Sphere(ball), 0.0, force, nu)
        stuck = _radius(Sphere(ball, friction=STICKS), 0.0, force, nu)
        assert (free / stuck) ** 3 == pytest.approx(stiffer, rel=1e-3)


def test_a_flat_face_touches_all_of_itself_or_less() -> None:
    tool, s = FlatFace(4e-3), np.array([0.05, 0.5, 0.9])
    contact = _found(tool, 0.5)
    assert contact.radius == 4e-3
    np.testing.assert_allclose(_share(contact, s), 0.5 / np.sqrt(1.0 - s**2), rtol=1e-4)
    assert contact.approach == pytest.approx(0.5 / (2.0 * REDUCED * 4e-3), rel=1e-6)
    # A ball of 20 mm under a light push is not flattened as far.
    contact = _found(tool, 1e-3, curvature=50.0)
    assert contact.radius == pytest.approx((0.75 * 1e-3 / (REDUCED * 50.0)) ** (1 / 3), rel=1e-6)
    np.testing.assert_allclose(_share(contact, s), 1.5 * np.sqrt(1.0 - s**2), rtol=1e-4)


def test_a_flat_face_just_touched_whole_has_the_pressure_of_a_ball_and_of_a_punch() -> None:
    """Superposition: what flattens the surface up to the rim, and the rest (Johnson, section 3.8);
    the contact grows without a jump."""
    tool, curvature, s = FlatFace(4e-3), 50.0, np.array([0.05, 0.5, 0.9])
    whole = 4.0 / 3.0 * REDUCED * curvature * tool.radius**3
    contact = _found(tool, 1.5 * whole, curvature)
    wanted = (1.5 * np.sqrt(1.0 - s**2) + 0.5 * 0.5 / np.sqrt(1.0 - s**2)) / 1.5
    np.testing.assert_allclose(_share(contact, s), wanted, rtol=1e-4)
    before, after = (_found(tool, share * whole, curvature) for share in (0.9999, 1.0001))
    np.testing.assert_allclose(_share(before, s), _share(after, s), rtol=2e-3)
    assert after.approach == pytest.approx(before.approach, rel=1e-3)


@pytest.mark.parametrize("degrees", [45.0, 70.0, 85.0])
def test_a_cone_is_sneddon_s(degrees: float) -> None:
    """F = 2 E* tan(angle) d^2 / pi at the depth d, of a circle of 2 d tan(angle) / pi."""
    angle, depth = np.radians(degrees), 1e-4
    force = 2.0 / np.pi * LEVEL_REDUCED * np.tan(angle) * depth**2
    contact = _found(Cone(0.05, angle), force, nu=LEVEL_NU)
    assert contact.radius == pytest.approx(2.0 / np.pi * depth * np.tan(angle), rel=1e-6)
    assert contact.approach == pytest.approx(depth, rel=1e-6)
    # Beyond the first of the distances at which it is tabulated.
    s = np.array([0.05, 0.3, 0.9])
    # Over its mean: the integral of 2 s arcosh(1 / s) is 1.
    np.testing.assert_allclose(_share(contact, s), np.arccosh(1.0 / s), rtol=2e-3)


@pytest.mark.parametrize("degrees", [35.0, 60.0, 75.0])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.45])
def test_four_times_the_force_doubles_the_circle_of_a_cone(degrees: float, nu: float) -> None:
    """Nothing but the circle has a length, however the surface is drawn outward."""
    cone = Cone(0.05, np.radians(degrees))
    single, four = (_found(cone, force, nu=nu).radius for force in (0.1, 0.4))
    assert four == pytest.approx(2.0 * single, rel=1e-5)
    # What the tool draws outward raises the surface towards it: fewer points are touched.
    level = np.sqrt(0.2 * np.tan(cone.angle) / np.pi / (2.0 * SHEAR / (1.0 - nu)))
    assert single < level


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


def test_the_pressure_of_a_sphere_is_sneddon_s() -> None:
    """Against his integral, at a circle of 0.7 radii, where Hertz's is 5 % too blunt."""
    ball, share = 4e-3, 0.7
    log = np.log((1 + share) / (1 - share))
    force = LEVEL_REDUCED * ball**2 * (0.5 * (share**2 + 1.0) * log - share)
    contact = _found(Sphere(ball), force, nu=LEVEL_NU)
    assert contact.radius == pytest.approx(share * ball, rel=1e-5)
    assert contact.approach == pytest.approx(share * ball * np.arctanh(share), rel=1e-5)

    def pressure(s: float) -> float:
        def steeper(w: float) -> float:
            t = s * share * np.cosh(w)
            return float(np.arctanh(t) + t / (1.0 - t**2))

        return float(quad(steeper, 0.0, np.arccosh(1.0 / s))[0])

    s = np.array([0.1, 0.5, 0.8, 0.95])
    wanted = np.array([pressure(distance) for distance in s])
    here = contact.traction.mean(s)
    np.testing.assert_allclose(here / here[0], wanted / wanted[0], rtol=1e-4)
    hertz = PRESSURES["hertz"](s)
    assert abs(hertz[2] / hertz[0] / (wanted[2] / wanted[0]) - 1.0) > 0.05


def test_the_faces_of_a_punch_and_of_a_cylinder_are_one() -> None:
    assert TOOLS["flat"] is TOOLS["cylinder"] is FlatFace
    assert Contact.under(FlatFace(4e-3), np.zeros(3)).profile == "flat"


def _lever(tool: Tool, force: float, nu: float = NU, curvature: float = 0.0) -> float:
    return _found(tool, force, curvature, nu).traction.lever


@pytest.mark.parametrize("share", [0.01, 0.3, 0.6])
def test_a_sphere_that_slides_pulls_outward_along_its_normals(share: float) -> None:
    """Against the mean of r tan(lean) under Sneddon's pressure; 2 a / (5 R) on a small circle."""

    def total(value: Callable[[float], float]) -> float:
        def ring(t: float) -> float:
            inner = quad(lambda a: value(t * np.sin(a)) * t * np.sin(a), 0.0, 0.5 * np.pi)[0]
            return float((np.arctanh(t) + t / (1.0 - t**2)) * inner)

        return float(quad(ring, 0.0, share)[0])

    ball = 4e-3
    lever = total(lambda r: r**2 / np.sqrt(1.0 - r**2)) / total(lambda r: 1.0)
    log = np.log((1 + share) / (1 - share))
    force = LEVEL_REDUCED * ball**2 * (0.5 * (share**2 + 1.0) * log - share)
    assert _lever(Sphere(ball), force, LEVEL_NU) == pytest.approx(lever / share, rel=1e-4)
    if share < 0.1:
        assert lever / share == pytest.approx(0.4 * share, rel=1e-3)


def test_so_does_a_cone_and_no_flat_face() -> None:
    cone = Cone(0.05, np.arctan(2.0))
    assert _lever(cone, 1e-3, LEVEL_NU) == pytest.approx(np.pi / 12.0, rel=1e-4)
    assert _lever(FlatFace(4e-3), 0.5) == 0.0


def _cells(across: int, size: float) -> tuple[np.ndarray, float]:
    """Centres of hexagonal cells of a face of radius `size`, and the radius of their circles."""
    i, j = np.meshgrid(*[np.arange(-2 * across, 2 * across + 1)] * 2)
    x, y = (i + 0.5 * (j % 2)) / across, np.sqrt(0.75) * j / across
    inside = np.hypot(x, y) < 1.0
    centre = size * np.stack([x[inside], y[inside], np.zeros(inside.sum())], axis=1)
    return centre, size / across * np.sqrt(np.sqrt(0.75) / np.pi)


def _displacements(centre: np.ndarray, radius: float, nu: float) -> np.ndarray:
    """Displacement of each cell of a half space of modulus 1 under one newton on each other."""

    def profile(s: np.ndarray) -> np.ndarray:
        return (s < 1.0).astype(float)

    potentials, normal = disc_potentials(profile), np.array([0.0, 0.0, 1.0])
    matrix = np.empty((len(centre), 3, len(centre), 3))
    for k, middle in enumerate(centre):
        disc = PressureDisc(middle, radius, profile)
        constant, slope = disc_displacement(disc, potentials, normal, centre)
        matrix[:, :, k] = constant + nu * slope
    return matrix


def _no_slip_outward(nu: float, across: int) -> float:
    """Of a flat face that sticks, by uniform tractions on cells that move down by one, and not
    sideways."""
    centre, radius = _cells(across, 1.0)
    matrix = _displacements(centre, radius, nu).reshape(3 * len(centre), -1)
    force = np.linalg.solve(matrix, np.tile([0.0, 0.0, -1.0], len(centre))).reshape(-1, 3)
    face = np.sqrt(len(centre)) * radius
    return float((force * centre).sum() / -force[:, 2].sum() / face)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.45])
def test_a_flat_face_that_sticks_holds_the_surface_back(nu: float) -> None:
    coarse, fine = (_no_slip_outward(nu, across) for across in (6, 10))
    # The error is of first order in the cells, whose rim is ragged.
    extrapolated = (10.0 * fine - 6.0 * coarse) / 4.0
    assert _lever(FlatFace(4e-3, friction=STICKS), 0.5, nu) == pytest.approx(extrapolated, rel=0.01)


def test_every_newton_of_a_tool_that_sticks_is_that_of_a_flat_face() -> None:
    flat = _lever(FlatFace(4e-3, friction=STICKS), 0.5)
    # The mean circle of forces that grow with its cube and its square.
    assert _lever(Sphere(5e-3, friction=STICKS), 1e-5) == pytest.approx(0.75 * flat, rel=1e-4)
    cone = Cone(0.05, 1.0, friction=STICKS)
    assert _lever(cone, 1e-3) == pytest.approx(2.0 / 3.0 * flat, rel=1e-6)
    # A flat face that a ball does not touch whole.
    touched = _lever(FlatFace(4e-3, friction=STICKS), 1e-3, curvature=50.0)
    assert touched == pytest.approx(0.75 * flat, rel=1e-6)
    # Where nothing changes its volume, a surface does not move sideways under a tool.
    assert _lever(Sphere(5e-3, friction=STICKS), 1e-2, 0.5) == 0.0


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_a_sphere_that_slides_is_met_by_a_surface_that_it_raises(nu: float) -> None:
    """Against cells without friction under a ball of radius 1, which touch it or carry nothing: the
    mean square distance of their pressure, which 500 cells know to 0.05 %. Without the outward
    traction's part it would be larger by 2 % at a nu of 0.3, by 4 % at 0."""
    share = 0.4
    centre, radius = _cells(13, 1.3 * share)
    distance = np.hypot(*centre.T[:2])
    height = 1.0 - np.sqrt(1.0 - distance**2)
    lean = np.column_stack([centre[:, :2] / (1.0 - height)[:, None], -np.ones(len(centre))])
    down = -np.einsum("ikj,kj->ik", _displacements(centre, radius, nu)[:, 2], lean)
    depth = share * np.arctanh(share)
    touched, pressure = height < 0.6 * depth, np.zeros(len(centre))
    for _ in range(20):
        pressure[:] = 0.0
        pressure[touched] = np.linalg.solve(
            down[np.ix_(touched, touched)], (depth - height)[touched]
        )
        before, gap = touched, down @ pressure - (depth - height)
        touched = (touched & (pressure > 0.0)) | (~touched & (gap < 0.0))
        if (touched == before).all():
            break
    else:
        pytest.fail("the cells in contact do not settle")
    force = float(pressure.sum())
    contact = tool_contact(
        Sphere(1.0), LocalSurface(UP, 0.0), force, shear_modulus=1.0, poisson_ratio=nu
    )
    wanted = np.sqrt(2.5 * (pressure @ distance**2) / force)
    assert contact.radius * np.sqrt(2.5) * contact.traction.spread == pytest.approx(
        wanted, rel=1e-3
    )


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
    ball = Sphere(3e-3)
    with pytest.raises(InputError, match="pulls"):
        _found(ball, -0.1)
    with pytest.raises(InputError, match="bury a sphere of 3 mm"):
        _found(ball, 50.0)


@pytest.mark.parametrize(
    ("kind", "given", "text"),
    [
        (Sphere, {"radius": 0.0}, "positive"),
        (Sphere, {"radius": 3e-3, "friction": -1.0}, "friction is -1.0"),
        (Cone, {"radius": 3e-3, "angle": 0.2}, "11.5 degrees"),
        (Ring, {"radius": 3e-3, "inner_radius": 3e-3}, "below tool_radius, 3 mm"),
    ],
)
def test_tools_that_there_are_not(kind: type[Tool], given: dict[str, float], text: str) -> None:
    with pytest.raises(InputError, match=text):
        kind(**given)


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
    friction: float = SLIDES,
) -> ToolContact:
    turned = np.eye(3) if turn is None else turn.as_matrix()
    tool = mesh_tool(mesh, turned, friction=friction)
    local = LocalSurface(turned @ UP, curvature)
    return tool_contact(tool, local, force, shear_modulus=SHEAR, poisson_ratio=NU)


def _grid(contact: ToolContact) -> GridTraction:
    assert isinstance(contact.traction, GridTraction)
    return contact.traction


def _moments(contact: ToolContact) -> tuple[float, float]:
    """Root mean square extent of the pressure along its axes [m], and its sum is one."""
    traction = _grid(contact)
    cells = len(traction.grid)
    x = traction.half_side * contact.radius * ((2.0 * np.arange(cells) + 1.0) / cells - 1.0)
    weight = traction.grid / traction.grid.sum()
    return (
        float(np.sqrt(weight.sum(axis=1) @ x**2)),
        float(np.sqrt(weight.sum(axis=0) @ x**2)),
    )


@pytest.mark.parametrize("curvature", [0.0, 60.0, -30.0])
@pytest.mark.parametrize("friction", [SLIDES, STICKS])
def test_a_ball_touches_the_circle_of_a_sphere(curvature: float, friction: str) -> None:
    """Its 8,000 vertices lie on a sphere; at this depth the sphere is a paraboloid to 1 %."""
    contact = _contact(ball_mesh(np.full(3, 6e-3)), 0.05, curvature=curvature, friction=friction)
    sphere = _found(Sphere(6e-3, friction=friction), 0.05, curvature)
    assert contact.radius == pytest.approx(sphere.radius, rel=0.01)
    # Hertz: the mean square of each coordinate is a fifth of the circle's.
    assert _moments(contact) == pytest.approx([sphere.radius / np.sqrt(5.0)] * 2, rel=0.01)
    mean = contact.traction.mean(np.linspace(0.0, 0.9, 10) * contact.radius / _reach(contact))
    hertz = np.sqrt(1.0 - np.linspace(0.0, 0.9, 10) ** 2)
    # The facets are seen in the pressure: a fortieth of its mean at the centre.
    np.testing.assert_allclose(mean / mean.mean(), hertz / hertz.mean(), atol=0.04)


def _reach(contact: ToolContact) -> float:
    return contact.radius * contact.traction.reach


def test_a_square_face_is_as_stiff_as_king_found() -> None:
    """Force over approach is 2 beta E* sqrt(A / pi), with beta 1.012 (King, Int. J. Solids Struct.
    23 (1987) 1657); cells at the singular rim are worth half a per cent."""
    half = 4e-3
    contact = _contact(_bar(np.array([half, half, 0.02])), 0.3)
    beta = 0.3 / contact.approach / (2.0 * MODULUS * np.sqrt(4.0 * half**2 / np.pi))
    assert beta == pytest.approx(1.012, rel=0.005)
    assert _reach(contact) == pytest.approx(np.sqrt(2.0) * half, rel=0.05)
    assert not contact.traction.outward.any()


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
        value = (ratio**2 * e - k) / (k - e)
        low, high = (ratio, high) if value < curvature_ratio else (low, ratio)
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
    inner = here.traction.at(places) / _grid(here).grid.max()
    turned = there.traction.at(turn.apply(places) * here.radius / there.radius)
    np.testing.assert_allclose(turned / np.median(turned), inner / np.median(inner), rtol=0.05)


@pytest.mark.parametrize("friction", [SLIDES, STICKS])
def test_the_outward_traction_of_a_ball_is_that_of_a_sphere(friction: str) -> None:
    contact = _contact(ball_mesh(np.full(3, 6e-3)), 0.05, friction=friction)
    sphere = _found(Sphere(6e-3, friction=friction), 0.05)
    # By the facets, and by the cells at the rim.
    lever = contact.traction.lever * contact.traction.reach * contact.radius
    assert lever == pytest.approx(sphere.traction.lever * sphere.radius, rel=0.02)
    at = np.searchsorted(SPREAD, 0.6)
    slope = (
        contact.traction.outward[at]
        / contact.traction.pressure[at]
        / (SPREAD[at] * _reach(contact))
    )
    wanted = sphere.traction.outward[at] / sphere.traction.pressure[at]
    assert slope == pytest.approx(wanted / (SPREAD[at] * sphere.radius), rel=0.05)


@pytest.mark.parametrize("inner", [0.3, 0.6])
def test_a_narrow_ring_s_mean_circle_and_stiffness(inner: float) -> None:
    """Axisymmetric rings of uniform pressure between the rims, by the same displacement of discs:
    the force of a ring that dents by one, and the mean square of its distance."""
    tool = Ring(4e-3, inner * 4e-3)
    contact = _found(tool, 0.3)
    stiffness, square = _ring_by_annuli(inner, 60)
    assert 0.3 / contact.approach == pytest.approx(REDUCED * tool.radius * stiffness, rel=0.01)
    assert contact.radius == pytest.approx(tool.radius * np.sqrt(2.5 * square), rel=0.01)
    # No pressure within, and none outward.
    assert not contact.traction.at(np.zeros((1, 3))).any()
    assert not contact.traction.outward.any()


def _ring_by_annuli(inner: float, count: int) -> tuple[float, float]:
    """Force over E* and depth of a ring of outer radius 1, and mean square distance of its
    pressure, by annuli of uniform pressure, narrower toward both rims."""
    edge = 0.5 * (1.0 + inner) - 0.5 * (1.0 - inner) * np.cos(np.pi * np.arange(count + 1) / count)
    middle = 0.5 * (edge[1:] + edge[:-1])

    def disc(r: np.ndarray, radius: float) -> np.ndarray:
        """Displacement times E* under a uniform pressure of one: Johnson, equation 3.29."""
        s = r / radius
        far = 1.0 / np.maximum(s, 1.0) ** 2
        inside = 4.0 / np.pi * radius * ellipe(np.minimum(s, 1.0) ** 2)
        outside = 4.0 / np.pi * r * (ellipe(far) - (1.0 - far) * ellipk(np.minimum(far, 1 - 1e-15)))
        return np.where(s < 1.0, inside, outside)

    at = np.stack([disc(middle, edge_radius) for edge_radius in edge], axis=1)
    pressure = np.linalg.solve(np.diff(at, axis=1), np.ones(count))
    force = pressure * np.pi * np.diff(edge**2)
    return float(force.sum()), float(force @ middle**2 / force.sum())


def test_a_punch_that_leans_by_a_degree_is_not_buried() -> None:
    """Its steep side wall faces the surface then; the front edge takes more of the force. The slope
    of the whole face is no outward traction."""
    bar = _bar(np.array([3e-3, 3e-3, 0.02]))
    lean = Rotation.from_rotvec([0.0, np.radians(1.0), 0.0])
    tool = mesh_tool(bar, lean.as_matrix())
    contact = _found(tool, 0.5)
    traction = _grid(contact)
    weight = traction.grid / traction.grid.sum()
    cells = np.arange(len(weight)) - 0.5 * (len(weight) - 1)
    middle = (weight.sum(axis=1) @ cells * traction.axes[0]) + (
        weight.sum(axis=0) @ cells * traction.axes[1]
    )
    # In cells of a fiftieth of the face.
    assert middle[0] > 0.5
    assert abs(middle[1]) < 0.1
    assert traction.outward.max() < 0.01 * traction.pressure.max()


def test_what_cannot_touch_is_said() -> None:
    with pytest.raises(InputError, match="would bury a mesh of 6 mm"):
        _contact(ball_mesh(np.full(3, 6e-3)), 60.0)
    with pytest.raises(InputError, match=r"the tool pulls with 0\.1 N"):
        _contact(ball_mesh(np.full(3, 6e-3)), -0.1)
    beside = ball_mesh(np.full(3, 6e-3))
    moved = TriangleMesh(beside.vertices + np.array([9e-3, 0.0, 0.0]), beside.triangles)
    with pytest.raises(InputError, match=r"touches 9\.\d+ mm beside its origin"):
        _contact(moved, 0.05)
