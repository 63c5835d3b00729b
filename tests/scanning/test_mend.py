"""Broken surfaces are mended to the volume of the sound one, or refused with place and reason."""

import numpy as np
import pytest
from broken_surfaces import Broken, ball, box, broken_surfaces, made, together, volume, without_cap

from palpate.errors import MeshError
from palpate.geometry import TriangleMesh, checked_mesh, enclosed_volume, triangle_areas
from palpate.scanning import distances, plane_from_text
from palpate.scanning.mend import mend, rims

TABLE = broken_surfaces()


@pytest.mark.parametrize("broken", TABLE, ids=[broken.name for broken in TABLE])
def test_every_kind_is_mended_or_refused(broken: Broken):
    support = plane_from_text(broken.support) if broken.support else None
    if broken.refused:
        with pytest.raises(MeshError, match=broken.refused):
            mend(broken.mesh, support)
        return
    mended, actions, _ = mend(broken.mesh, support)
    mesh, notes = checked_mesh(mended)
    assert notes == () or broken.name == "self-intersection"
    assert broken.done in [action.defect for action in actions]
    # Exact but for what a flat patch, a crack of 2 um or a grid of 1/70 of the object may take.
    assert enclosed_volume(mesh) == pytest.approx(broken.volume, rel=broken.tolerance)


def test_a_sound_surface_is_left_alone():
    sound = made(ball())
    mended, actions, _ = mend(sound)
    assert actions == ()
    np.testing.assert_array_equal(mended.vertices, sound.vertices)
    np.testing.assert_array_equal(mended.triangles, sound.triangles)


def test_places_are_those_of_the_defects():
    broken = made(without_cap(ball(), 0.029))
    _, (action,), _ = mend(broken)
    # The rim lies at 29 mm or a triangle below it.
    assert np.linalg.norm(action.place - [0.0, 0.0, 0.0295]) < 2e-3


def test_an_open_base_above_the_table_is_led_down_to_it():
    # A box without its floor, 1 mm above the plane: what no camera sees.
    v, f = box((0.04, 0.03, 0.02), (0.0, 0.0, 0.011))
    floor = (v[f][:, :, 2] < 0.0011).all(axis=1)
    mended, _, patches = mend(made((v, f[~floor])), plane_from_text("z=0"))
    assert enclosed_volume(mended) == pytest.approx(0.04 * 0.03 * 0.021, rel=1e-9)
    # Four walls of 1 mm and the floor.
    guessed = 2 * (0.04 + 0.03) * 0.001 + 0.04 * 0.03
    assert triangle_areas(patches).sum() == pytest.approx(guessed, rel=1e-9)


def test_what_lies_below_the_support_is_cut_off():
    mended, *_ = mend(made(ball(fine=4)), plane_from_text("z=-0.015"))
    height = 0.03 + 0.015
    cap = np.pi * height**2 * (3 * 0.03 - height) / 3.0
    # An inscribed surface of 5120 triangles lacks 0.3 % of a ball.
    assert enclosed_volume(mended) == pytest.approx(cap, rel=5e-3)
    assert mended.vertices[:, 2].min() == pytest.approx(-0.015, abs=1e-12)


def test_a_ring_shaped_base_keeps_its_hole():
    # A thick tube without its lower end: two rims in the plane, one inside the other.
    outer, inner = box((0.04, 0.04, 0.02)), box((0.02, 0.02, 0.02))
    flat = np.ptp(inner[0][inner[1]][:, :, 2], axis=1) < 1e-9
    walls = inner[0], inner[1][~flat][:, ::-1]
    sides = outer[0], outer[1][~(np.ptp(outer[0][outer[1]][:, :, 2], axis=1) < 1e-9)]
    lid = _ring_lid(0.01)
    mesh = _welded(together(sides, walls, lid))
    mended, *_ = mend(mesh, plane_from_text("z=-0.01"))
    expected = (0.04**2 - 0.02**2) * 0.02
    assert enclosed_volume(mended) == pytest.approx(expected, rel=1e-9)


def _ring_lid(height):
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    v = np.concatenate([0.02 * corners, 0.01 * corners])
    v = np.column_stack([v, np.full(8, height)])
    f = [t for k in range(4) for n in [(k + 1) % 4] for t in ((k, n, 4 + n), (k, 4 + n, 4 + k))]
    return v, np.array(f)


def _welded(part):
    v, inverse = np.unique(part[0].round(9), axis=0, return_inverse=True)
    return TriangleMesh(vertices=v, triangles=inverse.ravel()[part[1]])


def test_rims_that_touch_in_a_vertex_are_two():
    v, f = ball()
    # Two triangles that share one vertex only.
    a = f[0]
    other = next(t for t in f[1:] if len(set(t) & set(a)) == 1)
    open_faces = np.array([t for t in f if tuple(t) not in (tuple(a), tuple(other))])
    assert sorted(len(chain) for chain in rims(open_faces)) == [3, 3]
    assert enclosed_volume(mend(made((v, open_faces)))[0]) == pytest.approx(volume((v, f)))


def test_distances_are_those_of_concentric_balls():
    inner, outer = made(ball(0.02, fine=4)), made(ball(0.03, fine=4))
    gap = distances(inner.vertices, outer)
    # The outer triangles' middles lie 0.1 % of the radius inside.
    np.testing.assert_allclose(gap, 0.01, atol=5e-5)
