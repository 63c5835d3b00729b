"""Remeshed surfaces: as many vertices as wanted, even, finer where asked, and on the surface."""

import signal

import numpy as np
import pytest
from broken_surfaces import ball, box, made

from palpate.errors import InputError, MeshError
from palpate.geometry import checked_mesh, enclosed_volume, half_edges, mesh_quality
from palpate.lab import SHAPES
from palpate.scanning import distances
from palpate.scanning.remesh import deviation, remeshed


@pytest.mark.parametrize("vertices", [300, 2000])
@pytest.mark.parametrize("part", [ball(fine=4), box()], ids=["ball", "box"])
def test_vertices_are_as_many_as_wanted_and_triangles_even(part, vertices):
    mesh = remeshed(made(part), vertices=vertices)
    assert len(mesh.vertices) == pytest.approx(vertices, rel=0.1)
    assert checked_mesh(mesh)[1] == ()
    # Mmg reaches 30 degrees on smooth surfaces and 20 at corners.
    assert np.degrees(mesh_quality(mesh).smallest_angle) > 15.0


def test_creases_stay_sharp():
    mesh = remeshed(made(box()), vertices=600)
    # Every vertex on the flat faces and the edges of the box: the volume is exact.
    assert enclosed_volume(mesh) == pytest.approx(0.04 * 0.03 * 0.02, rel=1e-12)
    assert deviation(made(box()), mesh).largest < 1e-12


def test_a_ball_is_followed_by_second_order():
    off = [
        deviation(made(ball(fine=5)), remeshed(made(ball(fine=5)), vertices=n)).percentile_95
        for n in (400, 1600)
    ]
    # Chords of edges half as long are a quarter as far from the arc.
    assert off[0] / off[1] == pytest.approx(4.0, rel=0.35)


def test_edges_are_a_third_near_the_given_points():
    top = np.array([[0.0, 0.0, 0.03]])
    mesh = remeshed(made(ball(fine=4)), vertices=1500, near=top)
    ends = half_edges(mesh.triangles).ends
    length = np.linalg.norm(np.diff(mesh.vertices[ends], axis=1)[:, 0], axis=1)
    gap = np.linalg.norm(mesh.vertices[ends].mean(axis=1) - top, axis=1)
    far = length[gap > 0.03].mean()
    # Edges of a third, and a quarter of the distance more: at 1 mm of 3 mm 0.42, at 2.7 mm 0.56.
    assert length[gap < 0.0015].mean() / far == pytest.approx(0.42, abs=0.1)
    assert length[gap < 0.004].mean() / far == pytest.approx(0.56, abs=0.1)


def test_vertices_lie_on_the_surface_where_sizes_change():
    body = SHAPES["toy"].make(radius=0.035, edge=2e-3)
    ear = body.vertices[[int(body.vertices[:, 2].argmax())]]
    gap = distances(remeshed(body, vertices=1000, near=ear).vertices, body)
    # But for a few that would flatten a triangle.
    assert np.quantile(gap, 0.95) < 1e-9


@pytest.mark.slow
def test_a_thin_plate_needs_more_vertices_and_says_how_many():
    plate = made(box((0.03, 0.03, 0.001)))
    with pytest.raises(MeshError, match=r"1 mm thin near .* ask for \S+ vertices"):
        remeshed(plate, vertices=300)
    assert len(remeshed(plate, vertices=3000).vertices) > 2500


def test_numbers_of_vertices_have_limits():
    with pytest.raises(InputError, match="10 vertices are asked for; must be 50 to 50000"):
        remeshed(made(box()), vertices=10)


def test_points_in_another_unit_are_noticed():
    with pytest.raises(InputError, match=r"1 of 1 points .* away from it"):
        remeshed(made(box()), vertices=300, near=np.array([[20.0, 0.0, 10.0]]))


def test_signals_are_this_process_s_own_afterwards():
    """Mmg takes those that end a process, and leaves them to the system."""
    received = []
    before = signal.signal(signal.SIGTERM, lambda number, _: received.append(number))
    try:
        remeshed(made(box()), vertices=100)
        signal.raise_signal(signal.SIGTERM)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert received == [signal.SIGTERM]
