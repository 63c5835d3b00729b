"""Scans of a body that is known: the mesh, its standard deviations, what is guessed and refused."""

from dataclasses import replace

import numpy as np
import pytest
from broken_surfaces import ball, made
from scan_views import NOISE, toy, views_around

from palpate.errors import InputError, MeshError
from palpate.geometry import checked_mesh, mesh_quality
from palpate.scanning import distances, fusion, scan_surface
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import deviation
from palpate.scanning.scan_file import make_view

TABLE = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))


@pytest.fixture(scope="module")
def truth():
    return toy()


@pytest.fixture(scope="module")
def scanned(truth):
    return scan_surface(views_around(truth), vertices=800, support=TABLE)


def test_the_mesh_is_sound_and_near_the_truth(truth, scanned):
    assert checked_mesh(scanned.mesh)[1] == ()
    assert np.degrees(mesh_quality(scanned.mesh).smallest_angle) > 10.0
    assert len(scanned.mesh.vertices) == pytest.approx(800, rel=0.1)
    off = deviation(truth, scanned.mesh)
    # Chords of 5 mm edges on bends of 15 mm leave 0.2 mm, and 1 % of the volume.
    assert off.median < 1e-4
    assert off.percentile_95 < 5e-4
    assert abs(off.volume) < 0.015


def test_sigmas_are_those_of_the_errors(truth, scanned):
    known = np.isfinite(scanned.sigma)
    assert known.mean() > 0.6
    error = distances(scanned.mesh.vertices[known], truth)
    ratio = np.sqrt(np.mean(error**2) / np.mean(scanned.sigma[known] ** 2))
    # Errors along normals, of a surface that is itself in triangles of 2.5 mm: 0.01 mm of chords.
    assert 0.5 < ratio < 1.6
    # The mean of many points is better known than one.
    assert np.median(scanned.sigma[known]) < 0.6 * NOISE


def test_only_what_no_view_shows_is_guessed(truth, scanned):
    centre = scanned.mesh.vertices[scanned.mesh.triangles].mean(axis=1)
    assert scanned.guessed.any()
    # The base, and the hollow above it that the base hides from cameras above the table.
    assert centre[scanned.guessed, 2].max() < 0.012
    assert scanned.guessed[centre[:, 2] < 1e-5].mean() > 0.5


@pytest.mark.slow
def test_one_view_is_closed_by_the_table_and_marked(truth):
    surface = scan_surface(views_around(truth, seen=1), vertices=800, support=TABLE)
    checked_mesh(surface.mesh)
    seen = ~surface.guessed
    centre = surface.mesh.vertices[surface.mesh.triangles].mean(axis=1)
    # What the camera at x = 0.8 m saw is where it is; the back is not claimed.
    assert np.quantile(distances(centre[seen], truth), 0.9) < 1e-3
    # Ears that stand up show their tips above the rest.
    assert surface.guessed[(centre[:, 0] < -0.01) & (centre[:, 2] < 0.03)].mean() > 0.95


def test_a_side_that_nobody_saw_is_no_surface(truth, monkeypatch):
    # A grid that is coarser than usual tells as well what is closed.
    monkeypatch.setattr(fusion, "_CELLS", 80)
    with pytest.raises(MeshError, match="does not close: no view shows"):
        scan_surface(views_around(truth, seen=3), vertices=800)


@pytest.mark.slow
def test_a_ball_seen_from_all_sides_closes_without_a_table():
    # Points on the seams are in several views: they coincide.
    points = ball(0.03, fine=5)[0]
    views = [
        make_view(f"v{k}", points[points @ way > 0.01], eye=way, sigma=1e-6, pose=np.eye(4))
        for k, way in enumerate(np.concatenate([np.eye(3), -np.eye(3)]))
    ]
    surface = scan_surface(views, vertices=500)
    assert not surface.guessed.any()
    # Of 500 vertices, chords lack 1.2 % of the volume.
    assert abs(deviation(made(ball(0.03, fine=5)), surface.mesh).volume) < 0.02


def test_an_object_that_moved_is_noticed(truth):
    views = views_around(truth)
    moved = views[3].T_object_view.copy()
    moved[:3, 3] += [0.002, 0.0, 0.001]
    views[3] = replace(views[3], T_object_view=moved)
    with pytest.raises(InputError, match=r"contradicts the others: .* the object moved between"):
        scan_surface(views, vertices=500, support=TABLE)


def test_views_of_other_places_do_not_overlap(truth):
    views = views_around(truth)
    away = views[3].T_object_view.copy()
    away[:3, 3] += [0.5, 0.0, 0.0]
    views[3] = replace(views[3], T_object_view=away)
    with pytest.raises(InputError, match=r"view 'v03' shows 0 % of what others show"):
        scan_surface(views, vertices=500, support=TABLE)
