"""Rigs of the facility: they look at the object, and calibrations err by what was asked for."""

import cv2
import numpy as np
import pytest

from palpate.errors import InputError
from palpate.lab.config import Calibration, Head
from palpate.lab.head import make_head, miscalibrated
from palpate.lab.specimens import half_ball
from palpate.vision.projection import project

MESH = half_ball(radius=0.04, edge=0.01)
MIDDLE = 0.5 * (MESH.vertices.min(axis=0) + MESH.vertices.max(axis=0))
HEADS = [
    Head(),
    Head(toward=np.array([0.0, 0.0, 1.0])),
    Head(layout="ring", cameras=4, baseline=0.3, columns=1280, rows=1024, k1=-0.1),
]


@pytest.mark.parametrize("head", HEADS)
def test_every_camera_looks_at_the_middle_and_sees_the_whole_object(head):
    rig = make_head(head, MESH)
    for camera in rig.cameras:
        centre = project(camera, MIDDLE[None])[0]
        np.testing.assert_allclose(centre, [(head.columns - 1) / 2, (head.rows - 1) / 2], atol=1e-6)
        seen = project(camera, MESH.vertices)
        assert (seen > 0).all()
        assert (seen < [head.columns - 1, head.rows - 1]).all()
        turn = camera.T_camera_object[:3, :3]
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) == pytest.approx(1.0)
    # In one camera the object reaches out to three quarters of the way to an edge.
    half = [(head.columns - 1) / 2, (head.rows - 1) / 2]
    out = [
        np.abs(project(camera, MESH.vertices) - half).max(axis=0) / half for camera in rig.cameras
    ]
    # A lens of k1 -0.1 pulls the outline in by less than a percent.
    assert np.max(out) == pytest.approx(0.75, rel=0.01)


def test_trinocular_head_is_an_l_with_the_first_camera_in_its_corner():
    rig = make_head(Head(baseline=0.1, distance=0.8), MESH)
    eyes = [np.linalg.inv(camera.T_camera_object)[:3, 3] for camera in rig.cameras]
    assert np.linalg.norm(eyes[0] - MIDDLE) == pytest.approx(0.8)
    left, above = (rig.cameras[0].T_camera_object[:3, :3] @ (eye - eyes[0]) for eye in eyes[1:])
    np.testing.assert_allclose(left, [-0.1, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(above, [0.0, -0.1, 0.0], atol=1e-15)
    # Up in the object's frame is up in the picture.
    assert np.diff(project(rig.cameras[0], np.stack([MIDDLE, MIDDLE * [1, 1, 2]]))[:, 1]) < 0


def test_ring_stands_evenly_around_the_direction_of_view():
    rig = make_head(Head(layout="ring", cameras=3, baseline=0.2), MESH)
    eyes = np.array([np.linalg.inv(camera.T_camera_object)[:3, 3] for camera in rig.cameras])
    sides = np.linalg.norm(eyes - np.roll(eyes, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 0.1 * np.sqrt(3.0), rtol=1e-12)


def test_errors_of_a_calibration_have_the_spread_that_was_asked_for():
    rig = make_head(Head(), MESH)
    error = Calibration(focal=1e-3, centre=0.5, rotation=0.02, translation=2e-4)
    rng = np.random.default_rng(0)
    focal, centre, turn, shift = [], [], [], []
    for _ in range(400):
        for calibrated, true in zip(miscalibrated(rig, error, MESH, rng=rng).cameras, rig.cameras,
                              strict=True):  # fmt: skip
            off = calibrated.T_camera_object @ np.linalg.inv(true.T_camera_object)
            focal.append(calibrated.matrix[0, 0] / true.matrix[0, 0] - 1.0)
            centre.append(calibrated.matrix[:2, 2] - true.matrix[:2, 2])
            turn.append(np.degrees(cv2.Rodrigues(off[:3, :3])[0].ravel()))
            shift.append(off[:3, 3])
            assert calibrated.matrix[0, 0] / calibrated.matrix[1, 1] == pytest.approx(
                1.0, rel=1e-14
            )
    # 1200 to 3600 draws: 2 % of chance, five of these.
    for errors, asked in ((focal, 1e-3), (centre, 0.5), (turn, 0.02), (shift, 2e-4)):
        assert np.std(errors) == pytest.approx(asked, rel=0.1)
        assert abs(np.mean(errors)) < 0.15 * asked


def test_an_object_that_was_moved_is_moved_for_all_cameras_alike():
    rig = make_head(Head(), MESH)
    error = Calibration(object_rotation=1.0, object_translation=1e-3)
    calibrated = miscalibrated(rig, error, MESH, rng=np.random.default_rng(3))
    moves = [
        np.linalg.inv(true.T_camera_object) @ wrong.T_camera_object
        for wrong, true in zip(calibrated.cameras, rig.cameras, strict=True)
    ]
    np.testing.assert_allclose(moves[1], moves[0], atol=1e-14)
    np.testing.assert_allclose(moves[2], moves[0], atol=1e-14)
    assert 1e-4 < np.linalg.norm(moves[0][:3, :3] @ MIDDLE + moves[0][:3, 3] - MIDDLE) < 5e-3


def test_no_error_is_no_change():
    rig = make_head(Head(), MESH)
    calibrated = miscalibrated(rig, Calibration(), MESH, rng=np.random.default_rng(0))
    for camera, other in zip(calibrated.cameras, rig.cameras, strict=True):
        np.testing.assert_allclose(camera.T_camera_object, other.T_camera_object, atol=1e-14)
        np.testing.assert_array_equal(camera.matrix, other.matrix)


def test_a_head_within_the_object_is_refused():
    with pytest.raises(InputError, match=r"distance is 0.05 m, less than the object's size"):
        make_head(Head(distance=0.05), MESH)
