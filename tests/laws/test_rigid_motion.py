"""Nothing depends on where the object lies, how it is turned, or in which unit it is measured."""

import numpy as np
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation
from surfaces import box, sphere
from vision_cameras import BARREL, RATIONAL, make_camera, moved

from palpate.geometry import (
    TriangleMesh,
    area_vectors,
    closest_points,
    enclosed_volume,
    mesh_quality,
    unit_normals,
    vertex_normals,
)
from palpate.records import Rig
from palpate.vision import project, project_jacobian, triangulate
from palpate.vision.projection import rays

# Deadlines are for the machine; compiling a kernel for the first time takes seconds.
quick = settings(max_examples=25, deadline=None, derandomize=True)

angles = st.floats(-3.0, 3.0)
lengths = st.floats(-0.5, 0.5)


@st.composite
def motions(draw):
    """A rigid motion, (4, 4), of up to half a metre."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([draw(angles) for _ in range(3)]).as_matrix()
    pose[:3, 3] = [draw(lengths) for _ in range(3)]
    return pose


def placed(pose, points):
    return points @ pose[:3, :3].T + pose[:3, 3]


def placed_mesh(pose, mesh):
    return TriangleMesh(placed(pose, mesh.vertices), mesh.triangles)


SHAPES = st.sampled_from([sphere(1, 0.03), box((0.04, 0.02, 0.01), 2)])


@quick
@given(SHAPES, motions())
def test_a_turned_surface_has_turned_normals_and_the_same_volume(mesh, pose):
    after, turn = placed_mesh(pose, mesh), pose[:3, :3].T
    normals = vertex_normals(mesh.vertices, mesh.triangles)
    # Rounding of coordinates of 1 m, against edges of 1 cm: 1e-14 of an area, relative 1e-11.
    np.testing.assert_allclose(area_vectors(after), area_vectors(mesh) @ turn, atol=1e-16)
    np.testing.assert_allclose(unit_normals(after), unit_normals(mesh) @ turn, atol=1e-11)
    np.testing.assert_allclose(
        vertex_normals(after.vertices, after.triangles), normals @ turn, atol=1e-11
    )
    np.testing.assert_allclose(enclosed_volume(after), enclosed_volume(mesh), rtol=1e-9)


@quick
@given(SHAPES, st.floats(1e-3, 1e3))
def test_another_unit_scales_lengths_areas_and_volume(mesh, factor):
    before = mesh_quality(mesh)
    after = mesh_quality(TriangleMesh(factor * mesh.vertices, mesh.triangles))
    # Rounding alone.
    np.testing.assert_allclose(after.area, factor**2 * before.area, rtol=1e-12)
    np.testing.assert_allclose(after.volume, factor**3 * before.volume, rtol=1e-12)
    np.testing.assert_allclose(after.edge_mean, factor * before.edge_mean, rtol=1e-12)
    np.testing.assert_allclose(after.worst_aspect, before.worst_aspect, rtol=1e-12)
    np.testing.assert_allclose(after.smallest_angle, before.smallest_angle, rtol=1e-7)


@quick
@given(SHAPES, motions(), st.integers(0, 2**31))
def test_the_closest_point_moves_with_surface_and_point(mesh, pose, seed):
    points = np.random.default_rng(seed).uniform(-0.05, 0.05, (20, 3))
    before = closest_points(mesh, points)
    after = closest_points(placed_mesh(pose, mesh), placed(pose, points))
    # The distance is settled to rounding; which of two equal triangles has it is not.
    np.testing.assert_allclose(after.distance, before.distance, atol=1e-14)


@quick
@given(st.sampled_from([(), BARREL, RATIONAL]), motions(), st.integers(0, 2**31))
def test_a_camera_that_moves_with_the_object_sees_the_same(lens, pose, seed):
    points = np.random.default_rng(seed).uniform(-0.1, 0.1, (20, 3))
    camera = make_camera(lens=lens)
    after = moved(camera, pose)
    pixel, slope = project_jacobian(camera, points)
    pixel_after, slope_after = project_jacobian(after, placed(pose, points))
    # Rounding of coordinates of 1 m at 1500 px/m; NaN where a point is not seen, both times.
    np.testing.assert_allclose(pixel_after, pixel, atol=1e-9)
    np.testing.assert_allclose(slope_after @ pose[:3, :3], slope, atol=1e-6)


@quick
@given(st.sampled_from([(), BARREL, RATIONAL]), motions(), st.integers(0, 2**31))
def test_rays_and_triangulation_undo_projection(lens, pose, seed):
    points = placed(pose, np.random.default_rng(seed).uniform(-0.08, 0.08, (20, 3)))
    cameras = [
        moved(make_camera(f"c{k}", lens=lens, turn=(0.1, 0.3 * k, 0.2)), pose) for k in range(3)
    ]
    pixels = np.stack([project(camera, points) for camera in cameras])
    for camera, seen in zip(cameras, pixels, strict=True):
        origin, direction = rays(camera, seen)
        off = points - origin
        beside = off - (off * direction).sum(axis=1)[:, None] * direction
        # Undistortion stops at 1e-12 of the picture's plane: 1e-12 m at 1 m; a wide margin.
        assert np.abs(beside).max() < 1e-10
    triangulated = triangulate(Rig(tuple(cameras), 0, "law"), pixels, 0.1)
    np.testing.assert_allclose(triangulated.point, points, atol=1e-9)
