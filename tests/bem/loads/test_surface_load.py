"""Loads integrated over their own patch, against closed forms on flat ground."""

from types import SimpleNamespace

import numpy as np
import pytest
from elastic_bodies import cube_with_faces, held_part
from scipy.special import ellipe, ellipk
from surfaces import sphere

from palpate.bem import PressureDisc, SurfaceLoad, make_surface
from palpate.bem.loads.half_space import chord_integrals
from palpate.bem.loads.surface_load import LoadCells, integrate_loads, load_points
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points
from palpate.probe import find_contact_patch
from palpate.records import Contact

CENTRE = np.array([0.5, 0.5, 1.0])
RADIUS = 0.3
# Integral of the pressure over the patch, and of pressure over distance from its centre.
TOTAL = {
    "smooth": np.pi / 3,
    "uniform": np.pi,
    "hertz": 2 * np.pi / 3,
    "cone": np.pi,
    "flat": 2 * np.pi,
}
AT_CENTRE = {
    "smooth": 16 * np.pi / 15, "uniform": 2 * np.pi, "hertz": np.pi**2 / 2, "cone": np.pi**2,
    "flat": np.pi**2,
}  # fmt: skip
# Points end at the rim, where few of them see a square root (hertz), a jump, or a singularity.
TOLERANCE = {"smooth": 1e-4, "uniform": 1e-3, "hertz": 3e-4, "flat": 5e-3, "cone": 3e-3}
# A patch of many triangles; patches inside one and across two, smaller than any of their sides; and
# patches whose rims touch a vertex and a line of the mesh, to rounding.
PLACES = [
    (0.3, [0.5, 0.5]), (0.03, [0.59, 0.55]), (0.04, [0.61, 0.62]), (0.008, [0.71, 0.4]),
    (0.1, [0.65, 0.5]), (0.15, [0.6, 0.5]),
]  # fmt: skip


@pytest.fixture(scope="module")
def cube():
    mesh, face = cube_with_faces(4)
    return held_part(mesh, face == 4)


def load_of(cube, profile, point=CENTRE, radius=RADIUS):
    held = np.flatnonzero(cube.surface.held)
    contact = Contact(point=point, radius=radius, profile=profile)
    patch = find_contact_patch(cube.surface.mesh, contact, held, name="test")
    disc = None if radius is None else PressureDisc(contact.point, radius, contact.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def fields_by_point(cube, load):
    out = np.empty((cube.n_points, 6))
    fields = integrate_loads(cube.surface, [load], cube.collocation, cube.rows)
    out[cube.order] = fields[:, 0]
    return out


@pytest.mark.parametrize(("radius", "spot"), PLACES)
@pytest.mark.parametrize("profile", TOTAL)
def test_points_of_a_round_patch(cube, profile, radius, spot):
    centre, tolerance = np.array([*spot, 1.0]), TOLERANCE[profile]
    points = load_points(cube.surface, load_of(cube, profile, centre, radius))
    np.testing.assert_allclose(points.weight.sum(), 1, rtol=1e-12)
    np.testing.assert_allclose(points.total, radius**2 * TOTAL[profile], rtol=tolerance)
    shift = (points.weight @ points.position - centre) / radius
    np.testing.assert_allclose(shift, 0.0, atol=tolerance)
    assert np.linalg.norm(points.position - centre, axis=1).max() < radius
    owner = cube.surface.mesh.vertices[cube.surface.mesh.triangles[points.triangle]].mean(axis=1)
    assert np.linalg.norm(points.position - owner, axis=1).max() < 0.25


@pytest.mark.parametrize("profile", TOTAL)
def test_at_the_vertex_in_the_middle_of_a_patch(cube, profile):
    fields = fields_by_point(cube, load_of(cube, profile))
    middle = np.argmin(np.linalg.norm(cube.collocation.point - CENTRE, axis=1))
    half = 0.5 * AT_CENTRE[profile] / (RADIUS * TOTAL[profile])
    tolerance = TOLERANCE[profile] * 2 * half
    np.testing.assert_allclose(fields[middle], [half, half, 0, 0, 0, 0], atol=tolerance)


@pytest.mark.parametrize(("radius", "spot"), PLACES)
def test_uniform_patch_seen_from_every_vertex_of_its_face(cube, radius, spot):
    centre = np.array([*spot, 1.0])
    fields = fields_by_point(cube, load_of(cube, "uniform", centre, radius))
    on_top = np.flatnonzero(cube.collocation.point[:, 2] == 1)
    s = np.linalg.norm(cube.collocation.point[on_top] - centre, axis=1) / radius
    inside, far = np.minimum(s, 1) ** 2, 1 / np.maximum(s, 1) ** 2
    outer = 4 * s * (ellipe(far) - (1 - far) * ellipk(np.minimum(far, 1 - 1e-12)))
    exact = np.where(s < 1, 4 * ellipe(inside), outer) / (np.pi * radius)
    total = fields[on_top, :3].sum(axis=1)
    np.testing.assert_allclose(total, exact, rtol=5e-4)
    assert (s < 0.999).sum() == {RADIUS: 5, 0.15: 1}.get(radius, 0)


@pytest.mark.parametrize(("radius", "spot"), PLACES)
@pytest.mark.parametrize("profile", TOTAL)
def test_round_patches_seen_from_the_corners_around(cube, profile, radius, spot):
    """Potentials by integrals of one patch on flat ground, whatever triangles it lies on."""
    centre = np.array([*spot, 1.0])
    load = load_of(cube, profile, centre, radius)
    fields = fields_by_point(cube, load)
    near = np.linalg.norm(cube.collocation.point - centre, axis=1) < 0.2
    on_top = np.flatnonzero(near & (cube.collocation.point[:, 2] == 1))
    s = np.linalg.norm(cube.collocation.point[on_top] - centre, axis=1) / radius
    exact = chord_integrals(load.disc.profile, s)[:, 0] / radius
    total = fields[on_top, :3].sum(axis=1)
    np.testing.assert_allclose(total, exact, rtol=TOLERANCE[profile])


def test_vertex_load_is_the_hat_of_its_vertex(cube):
    points = load_points(cube.surface, load_of(cube, "vertex", radius=None))
    # A third of the area of the triangles around: with this mesh's diagonals, six of 1/32.
    np.testing.assert_allclose(points.total, 6 / 32 / 3, rtol=1e-12)
    np.testing.assert_allclose(points.weight @ points.position, CENTRE, atol=1e-12)


def test_vertex_load_seen_from_its_vertex(cube):
    fields = fields_by_point(cube, load_of(cube, "vertex", radius=None))
    middle = np.argmin(np.linalg.norm(cube.collocation.point - CENTRE, axis=1))
    mesh = cube.surface.mesh
    vertex = np.argmin(np.linalg.norm(mesh.vertices - CENTRE, axis=1))
    potential = 0.0
    for corner in mesh.triangles[(mesh.triangles == vertex).any(axis=1)]:
        b, c = mesh.vertices[corner[corner != vertex]] - CENTRE
        edge = np.linalg.norm(c - b)
        foot = b @ (c - b) / edge
        height = np.linalg.norm(b - foot * (c - b) / edge)
        # The hat falls linearly to the far edge: half of the integral of 1 / r.
        potential += 0.5 * height * (np.arcsinh((foot + edge) / height) - np.arcsinh(foot / height))
    # Three panels of four Gauss points each way.
    np.testing.assert_allclose(fields[middle, :3].sum(), potential / (6 / 32 / 3), rtol=1e-6)


def test_far_away_a_patch_is_a_point(cube):
    fields = fields_by_point(cube, load_of(cube, "smooth"))
    r = CENTRE - cube.collocation.point
    d = np.linalg.norm(r, axis=1)
    far = d > 4 * RADIUS
    np.testing.assert_allclose(
        fields[far, :3].sum(axis=1),
        1 / d[far],
        rtol=0.02,  # second moment over distance squared
    )
    assert far.any()


@pytest.mark.parametrize("radius", [0.1, 0.001])
def test_a_patch_acts_where_the_curved_surface_is(radius):
    """A ball of 0.3 whose elements bulge by 0.003 over the flat triangles: a patch of any size, its
    centre given on a triangle, beside it or on the ball, is the same load."""
    unit = sphere(2)
    mesh = TriangleMesh(0.3 * unit.vertices, unit.triangles)
    held = mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.1
    ball = SimpleNamespace(surface=make_surface(mesh, np.flatnonzero(held)))
    towards = np.array([0.2, 0.1, 0.97]) / np.linalg.norm([0.2, 0.1, 0.97])
    flat = closest_points(mesh, 0.3 * towards[None]).position[0]
    points = [
        load_points(ball.surface, load_of(ball, "hertz", centre, radius))
        for centre in (flat, flat + 0.5 * radius * towards, flat - 0.5 * radius * towards)
    ]
    for patch in points:
        centre = patch.weight @ patch.position
        # A cap of the ball: its centre is below the pole by less than its height.
        height = radius**2 / 0.3
        # Triangles lean by up to 8 degrees: so much of the distance is along them.
        aside = 0.5 * radius * np.sin(np.radians(8)) / 0.3
        assert np.linalg.norm(centre / np.linalg.norm(centre) - towards) < 0.003 + aside
        assert 0.2995 - height < np.linalg.norm(centre) < 0.302
        np.testing.assert_allclose(patch.total, radius**2 * TOTAL["hertz"], rtol=0.02)


def test_rows_that_do_not_resolve_a_patch_keep_the_points_of_the_load(cube):
    """A pressure along the far edge of its patch alone, in one triangle: no ray from its corners
    has points there."""
    radius, centre = 0.03, np.array([0.59, 0.55, 1.0])
    wide = load_of(cube, "uniform", centre, radius)

    def density(triangle, barycentric, position):
        return wide.density(triangle, barycentric, position) * (
            np.abs(position[:, 0] - centre[0] - 0.0123) < 2e-4
        )

    cells = LoadCells(degree=9, rim_points=4, polar_points=4, coarsest=4, finest=4)
    strip = SurfaceLoad(wide.triangles, density, wide.disc, cells)
    # Beside another load: its rows on the patch are its own.
    fields = integrate_loads(cube.surface, [wide, strip], cube.collocation, cube.rows)[:, 1]
    assert np.isfinite(fields).all()
    points = load_points(cube.surface, strip)
    offset = cube.collocation.point[cube.order][:, None] - points.position
    # All vertices are at least 0.09 away.
    potential = (points.weight / np.linalg.norm(offset, axis=2)).sum(axis=1)
    np.testing.assert_allclose(fields[:, :3].sum(axis=1), potential, rtol=0.15)


def test_a_load_beside_its_triangles_is_refused(cube):
    load = SurfaceLoad(np.array([0, 1]), lambda triangle, b, x: np.zeros(triangle.size))
    with pytest.raises(InputError, match="covers no part of the free surface"):
        load_points(cube.surface, load)
