"""Which triangles a tool presses on, and how hard."""

import numpy as np
import pytest
from surfaces import box, joined, sphere

from palpate.errors import InputError
from palpate.geometry import triangle_areas
from palpate.probe import find_contact_patch
from palpate.records import Contact
from palpate.records.contact import PRESSURES
from palpate.solids import make_solid, pressure_load

NOBODY = np.array([], dtype=np.int64)
TOP = np.array([0.5, 0.5, 1.0])


def contact(point=TOP, radius=0.2, profile="smooth"):
    return Contact(point=np.asarray(point, float), radius=radius, profile=profile)


def patch_on_cube(held=NOBODY, **options):
    return find_contact_patch(box(cells=8), contact(**options), held, name="poke")


@pytest.mark.parametrize(
    ("profile", "expected"),
    [("smooth", 0.75**2), ("uniform", 1.0), ("hertz", np.sqrt(0.75))],
)
def test_profiles_of_the_session_format(profile, expected):
    patch = patch_on_cube(profile=profile)
    # Half a radius away, at the rim, and beyond it.
    np.testing.assert_allclose(patch.contact.pressure(np.array([0.5])), expected)
    assert patch.contact.pressure(np.array([0.0]))[0] == 1
    assert not patch.contact.pressure(np.array([1.0, 1.5])).any()
    position = TOP + np.array([[0.06, 0.08, 0.0]])
    density = patch.density(np.array([0]), np.full((1, 3), 1 / 3), position)
    np.testing.assert_allclose(density, expected)


def test_a_new_tool_shape_presses_as_registered(monkeypatch):
    monkeypatch.setitem(PRESSURES, "cone", lambda s: np.clip(1.0 - s, 0.0, None))
    patch = patch_on_cube(profile="cone")
    position = TOP + np.array([[0.06, 0.08, 0.0], [0.0, 0.0, 0.0], [0.0, 0.3, 0.0]])
    density = patch.density(np.zeros(3, dtype=int), np.full((3, 3), 1 / 3), position)
    # Half a radius away, in the middle, and beyond the rim.
    np.testing.assert_allclose(density, [0.5, 1.0, 0.0])


def test_patch_holds_every_triangle_within_its_radius_on_the_top():
    mesh = box(cells=8)
    patch = patch_on_cube(radius=0.2)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    near = np.flatnonzero(np.linalg.norm(middle - TOP, axis=1) < 0.2)
    assert np.isin(near, patch.triangles).all()
    corners = mesh.vertices[mesh.triangles[patch.triangles]]
    # No triangle whose nearest corner is farther than the radius and a triangle's size.
    assert np.linalg.norm(corners - TOP, axis=2).min(axis=1).max() < 0.2 + 0.18
    assert triangle_areas(mesh)[patch.triangles].sum() > np.pi * 0.2**2
    np.testing.assert_allclose(patch.barycentric.sum(), 1)
    position = patch.barycentric @ mesh.vertices[mesh.triangles[patch.triangle]]
    np.testing.assert_allclose(position, TOP, atol=1e-12)


def test_vertex_profile_is_the_hat_of_the_nearest_vertex():
    patch = patch_on_cube(radius=None, profile="vertex", point=[0.51, 0.49, 1.0])
    mesh = box(cells=8)
    np.testing.assert_allclose(mesh.vertices[patch.vertex], TOP)
    assert (mesh.triangles[patch.triangles] == patch.vertex).any(axis=1).all()
    assert patch.triangles.size == (mesh.triangles == patch.vertex).any(axis=1).sum()
    corner = mesh.triangles[patch.triangles[:1]]
    barycentric = np.where(corner == patch.vertex, 0.6, 0.2)
    density = patch.density(patch.triangles[:1], barycentric, mesh.vertices[corner[:, 0]])
    np.testing.assert_allclose(density, 0.6)


def test_the_other_side_of_a_thin_plate_is_not_pressed():
    plate = box(size=(1.0, 1.0, 0.05), cells=8)
    patch = find_contact_patch(plate, contact(point=[0.5, 0.5, 0.05]), NOBODY, name="poke")
    assert (plate.vertices[plate.triangles[patch.triangles]][:, :, 2] == 0.05).all()


def test_round_the_rim_of_a_thin_plate_the_patch_ends_before_the_other_side():
    plate = box(size=(1.0, 1.0, 0.05), cells=8)
    at_rim = contact(point=[0.95, 0.5, 0.05])
    patch = find_contact_patch(plate, at_rim, NOBODY, name="poke")
    heights = plate.vertices[plate.triangles[patch.triangles]][:, :, 2]
    # Triangles of the rim may be reached, of the bottom not.
    assert (heights.max(axis=1) > 0).all()


def test_beside_an_edge_a_patch_does_not_reach_round_it_nor_do_finite_elements():
    """A circle of 3 mm, 1 mm from the edge of a cube of 40 mm: all of the force is on the top."""
    mesh, point = box((0.04, 0.04, 0.04), 8), np.array([0.039, 0.0185, 0.04])
    patch = find_contact_patch(mesh, Contact(point, 0.003, "uniform"), NOBODY, name="p1")
    corner = mesh.vertices[mesh.triangles[patch.triangles]]
    np.testing.assert_allclose(corner[:, :, 2], 0.04, atol=1e-12)
    solid = make_solid(mesh, edge=0.008)
    share = pressure_load(solid, point, 0.003, PRESSURES["uniform"])
    # As the segment of a circle that lacks a cap, whose centroid is known.
    angle = np.arccos(1 / 3)
    area = np.pi - angle + np.sin(angle) * np.cos(angle)
    centroid = 2 / 3 * np.sin(angle) ** 3 / area * 0.003
    centre = share @ solid.nodes
    np.testing.assert_allclose(centre, [0.039 - centroid, 0.0185, 0.04], atol=2e-5)


def test_a_neighbouring_part_within_reach_is_not_pressed():
    two = joined(box(cells=4), box(cells=4, origin=(1.05, 0.0, 0.0)))
    at_edge = contact(point=[0.9, 0.5, 1.0], radius=0.25)
    patch = find_contact_patch(two, at_edge, NOBODY, name="poke")
    assert two.vertices[two.triangles[patch.triangles]][:, :, 0].max() <= 1.0


def test_on_a_sphere_the_patch_is_a_cap():
    ball = sphere(4)
    patch = find_contact_patch(ball, contact(point=[0, 0, 1.0], radius=0.4), NOBODY, name="poke")
    # A chord of 0.4 cuts a cap of area pi 0.16; whole triangles reach a little farther.
    area = triangle_areas(ball)[patch.triangles].sum()
    assert np.pi * 0.16 < area < 1.6 * np.pi * 0.16


def test_a_contact_beside_the_surface_is_refused():
    with pytest.raises(InputError, match=r"probe 'poke': .* 300 mm from the surface.* 200 mm"):
        patch_on_cube(point=[0.5, 0.5, 1.3])


def test_a_contact_that_reaches_the_support_is_refused():
    mesh = box(cells=8)
    corner = mesh.vertices[mesh.triangles]
    held = np.flatnonzero((corner[:, :, 2] == 1).all(axis=1) & (corner[:, :, 0] > 0.85).all(axis=1))
    with pytest.raises(
        InputError, match=r"probe 'poke': the contact patch reaches \d+ triangles of"
    ):
        patch_on_cube(held=held, point=[0.95, 0.5, 1.0])
    # Round the edge it may be held.
    beside = np.flatnonzero((corner[:, :, 0] == 1).all(axis=1))
    assert len(patch_on_cube(held=beside, point=[0.95, 0.5, 1.0]).triangles)
