"""The mesh for the pictures: fine where seen, closed, smooth, creases kept."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.errors import InputError
from palpate.geometry import enclosed_volume, vertex_normals, welded
from palpate.lab.render_mesh import make_render_mesh
from palpate.records import Camera
from palpate.vision import project

RADIUS = 0.04


def _camera(direction=(0.0, 0.0, 1.0), size=(160, 120), focal=300.0):
    """A camera 0.4 m from the origin that looks at it."""
    z = -np.array(direction) / np.linalg.norm(direction)
    x = np.cross([0.1, 1.0, 0.05], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z])
    pose[2, 3] = 0.4
    matrix = np.array([[focal, 0.0, 80.0], [0.0, focal, 60.0], [0.0, 0.0, 1.0]])
    return Camera("c0", size, matrix, np.zeros(8), pose)


def _edge_lengths(fine, camera):
    """Longest edge of each triangle in a camera's picture [px]."""
    place = project(camera, fine.vertices)[fine.triangles]
    return np.linalg.norm(place - np.roll(place, -1, axis=1), axis=2).max(axis=1)


def _facing(fine, camera):
    pose = camera.T_camera_object
    corner = fine.vertices[fine.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    toward = -pose[:3, :3].T @ pose[:3, 3] - corner.mean(axis=1)
    return np.einsum("ma,ma->m", normal, toward) > 0.0


def _is_closed(fine):
    """Every edge between two triangles, in opposite senses, once twin vertices are welded."""
    mesh = welded(fine)
    tail, head = mesh.triangles.ravel(), np.roll(mesh.triangles, -1, axis=1).ravel()
    there = set(zip(tail.tolist(), head.tolist(), strict=True))
    return len(there) == tail.size and {(b, a) for a, b in there} == there


@pytest.mark.parametrize("mesh", [sphere(2, RADIUS), box((0.04, 0.05, 0.06), 3)])
def test_edges_that_are_seen_are_short_and_the_surface_stays_closed(mesh):
    cameras = [_camera((0.3, 0.2, 1.0)), _camera((-0.6, 0.1, 1.0), focal=400.0)]
    fine = make_render_mesh(mesh, cameras, edge=1.5)
    for camera in cameras:
        length = _edge_lengths(fine, camera)[_facing(fine, camera)]
        assert length.max() <= 1.5
        # Halving leaves none far shorter than it must be; those seen at a slant are.
        assert np.median(length) > 0.5
    assert _is_closed(fine)


def test_what_no_camera_sees_stays_coarse():
    mesh = sphere(2, RADIUS)
    fine = make_render_mesh(mesh, [_camera()], edge=1.0)
    behind = fine.vertices[:, 2] < -0.6 * RADIUS
    assert behind.sum() == (mesh.vertices[:, 2] < -0.6 * RADIUS).sum()
    beside = make_render_mesh(mesh, [_camera(size=(81, 120))], edge=1.0)
    assert len(beside.vertices) < 0.7 * len(fine.vertices)


def test_vertices_lie_on_the_smooth_surface():
    """A ball of 258 vertices: 25 times nearer than its flat triangles, whose error is of second
    order."""
    error = []
    for subdivisions in (2, 3):
        mesh = sphere(subdivisions, RADIUS)
        fine = make_render_mesh(mesh, [_camera()], edge=2.0)
        error.append(np.abs(np.linalg.norm(fine.vertices, axis=1) - RADIUS).max())
    flat = RADIUS - np.linalg.norm(mesh.vertices[mesh.triangles].mean(axis=1), axis=1).min()
    assert error[1] < 0.05 * flat
    assert np.log2(error[0] / error[1]) > 3.0
    assert enclosed_volume(fine) > enclosed_volume(mesh)


def test_creases_are_kept_and_smooth_parts_are_smooth():
    cube = make_render_mesh(box((0.05, 0.05, 0.05), 2), [_camera((0.4, 0.3, 1.0))], edge=2.0)
    normals = vertex_normals(cube.vertices, cube.triangles)
    assert np.abs(np.abs(normals).max(axis=1) - 1.0).max() < 1e-12
    ball = make_render_mesh(sphere(3, RADIUS), [_camera()], edge=2.0)
    normals = vertex_normals(ball.vertices, ball.triangles)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-12
    seen = ball.vertices[:, 2] > 0.4 * RADIUS
    radial = ball.vertices / np.linalg.norm(ball.vertices, axis=1)[:, None]
    turn = np.degrees(np.arccos(np.einsum("va,va->v", normals, radial)[seen]))
    # Flat triangles of a ball of 258 vertices lean by up to 10 degrees, its quadratic pieces by up
    # to 5, where only four triangles meet, and by 1 on average.
    assert turn.max() < 6.0
    assert turn.mean() < 1.5


def test_normals_are_weighted_with_the_areas():
    vertices = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 1], [9, 9, 9]], dtype=float)
    normals = vertex_normals(vertices, np.array([[0, 1, 2], [0, 2, 3]]))
    # Areas 2 along z and 1 along x.
    assert normals[0] == pytest.approx(np.array([1.0, 0.0, 2.0]) / np.sqrt(5.0))
    assert normals[1] == pytest.approx([0.0, 0.0, 1.0])
    assert (normals[4] == 0.0).all()


def test_too_few_vertices_go_where_edges_are_longest():
    mesh = sphere(2, RADIUS)
    fine = make_render_mesh(mesh, [_camera()], edge=0.5, max_vertices=3000)
    assert 2900 <= len(fine.vertices) <= 3000
    longest = _edge_lengths(fine, _camera())[_facing(fine, _camera())].max()
    # As many vertices go where they do without a limit and with that edge.
    enough = make_render_mesh(mesh, [_camera()], edge=1.05 * longest)
    assert len(enough.vertices) <= 3000
    assert _is_closed(fine)
    # Both sides of a crease are halved or none, wherever the vertices run out.
    for limit in range(200, 208):
        cube = make_render_mesh(
            box(3 * (0.05,), 2), [_camera((0.4, 0.3, 1.0))], edge=0.5, max_vertices=limit
        )
        assert len(cube.vertices) >= limit - 1
        assert _is_closed(cube)


def test_refusals():
    mesh = box(3 * (0.05,), 1)
    with pytest.raises(InputError, match="edge is 0 px"):
        make_render_mesh(mesh, [_camera()], edge=0.0)
    with pytest.raises(InputError, match="at least the 24 of the mesh"):
        make_render_mesh(mesh, [_camera()], max_vertices=23)
    with pytest.raises(InputError, match="has no size"):
        make_render_mesh(mesh, [_camera(size=None)])
