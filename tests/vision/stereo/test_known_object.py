"""Stereo points are registered to the mesh of the object, wherever table and background are."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from surfaces import box, hull_mesh, sphere
from vision.scenes import make_rig

from palpate.geometry import TriangleMesh
from palpate.vision.cameras.projection import project
from palpate.vision.stereo.known_object import (
    MIN_POSE_POINTS,
    near_object,
    object_frame,
    register_object,
    smooth_surface,
)
from palpate.vision.stereo.stereo import StereoPoints

POSE = np.eye(4)
POSE[:3, :3] = Rotation.from_rotvec([0.02, -0.01, 0.03]).as_matrix()
POSE[:3, 3] = [0.002, -0.001, 0.003]


def _seen(points: np.ndarray) -> StereoPoints:
    n = len(points)
    return StereoPoints(
        np.zeros((n, 2)), points, np.tile(1e-10 * np.eye(3), (n, 1, 1)), np.zeros(n),
        np.full(n, 2), np.full(n, 1e-3), np.zeros(8, dtype=np.int64), 8,
    )  # fmt: skip


def _moved_back(points: np.ndarray) -> np.ndarray:
    """Points of the mesh in the frame of the rig, with x_mesh = POSE x_rig."""
    return (points - POSE[:3, 3]) @ POSE[:3, :3]


def test_what_is_near_the_object() -> None:
    mesh = box(size=(0.02, 0.03, 0.06), cells=1)
    # The diagonal is 0.07 m; 0.6 of it is 0.042 m from the middle.
    middle, away = np.array([0.01, 0.015, 0.03]), np.array([0.0, 0.0, 1.0])
    points = middle + np.array([[0.0], [0.041], [0.043], [1.0]]) * away
    assert near_object(points, mesh).tolist() == [True, True, False, False]
    assert near_object(_moved_back(points), mesh, POSE).tolist() == [True, True, False, False]


def _in_view(mesh: TriangleMesh) -> np.ndarray:
    """Points of the surface that cameras far above it see."""
    vertices = smooth_surface(mesh).vertices
    return vertices[vertices[:, 2] > 0.01]


def _bumpy() -> TriangleMesh:
    """An ellipsoid of three different axes, which has a pose."""
    return hull_mesh(sphere(3).vertices * [0.02, 0.03, 0.04])


def test_the_pose_is_found_among_background() -> None:
    mesh = _bumpy()
    rng = np.random.default_rng(4)
    table = np.column_stack([rng.uniform(-0.2, 0.2, (400, 2)), np.full(400, -0.08)])
    surface = _in_view(mesh)
    found = register_object(make_rig(), _seen(_moved_back(np.vstack([surface, table]))),
                            smooth_surface(mesh))  # fmt: skip
    assert found is not None
    # The points are those of the surface itself, to rounding; the search ends at 1e-6 m or better.
    np.testing.assert_allclose(found.T_mesh_points, POSE, atol=2e-6)


def test_too_few_points_have_no_pose() -> None:
    smooth = smooth_surface(_bumpy())
    few = smooth.vertices[: MIN_POSE_POINTS - 1]
    assert register_object(make_rig(), _seen(few), smooth) is None


def test_the_rig_in_the_frame_of_the_mesh_sees_the_same() -> None:
    rig, mesh = make_rig(), _bumpy()
    points = _moved_back(_in_view(mesh))
    found = register_object(rig, _seen(points), smooth_surface(mesh))
    assert found is not None
    there = object_frame(rig, found)
    in_mesh = points @ found.T_mesh_points[:3, :3].T + found.T_mesh_points[:3, 3]
    for before, after in zip(rig.cameras, there.cameras, strict=True):
        assert project(after, in_mesh) == pytest.approx(project(before, points), abs=1e-7)
