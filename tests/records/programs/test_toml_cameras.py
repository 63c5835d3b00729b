"""Rigs of caliscope, Anipose and Pose2Sim.

The layouts are those of files in the repositories of caliscope and aniposelib; the numbers are made
up.
"""

import numpy as np
import pytest
from program_files import cv_pixels
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError
from palpate.records import read_rig
from palpate.vision import project

TURN, SHIFT = np.array([0.4, -0.2, 0.9]), np.array([0.02, -0.05, 1.3])
INNER = np.array([[1121.0, 0.0, 943.5], [0.0, 1120.0, 532.0], [0.0, 0.0, 1.0]])
LENS = [0.073, -0.102, -3.3e-4, 6.2e-6, 0.042]
CAMERA = f"""
size = [1920, 1080]
matrix = {INNER.tolist()}
distortions = {LENS}
rotation = {TURN.tolist()}
translation = {SHIFT.tolist()}
"""
BESIDE_SHIFT = np.add(SHIFT, [0.1, 0.0, 0.0])
BESIDE = CAMERA.replace(str(SHIFT.tolist()), str(BESIDE_SHIFT.tolist()))
CALISCOPE = f"""
[cameras.1]
port = 1
rotation_count = 0
error = 0.4
exposure = "null"
grid_count = 20
{CAMERA}
[cameras.10]
port = 10
ignore = false
{BESIDE}
[cameras.2]
port = 2
ignore = true
size = [1920, 1080]
matrix = {INNER.tolist()}
distortions = {LENS}
"""
ANIPOSE = f"""
[cam_0]
name = "left"
{CAMERA}
[cam_1]
name = "right"
fisheye = false
{BESIDE}
[metadata]
adjusted = false
error = 0.0
"""


def _check(camera, shift=SHIFT):
    points = np.random.default_rng(5).uniform(-0.1, 0.1, (20, 3))
    turn = Rotation.from_rotvec(TURN).as_matrix()
    wanted = cv_pixels(points @ turn.T + shift, INNER, LENS)
    np.testing.assert_allclose(project(camera, points), wanted, atol=1e-9)
    assert camera.size == (1920, 1080)


def test_caliscope(tmp_path):
    path = tmp_path / "camera_array.toml"
    path.write_text(CALISCOPE)
    rig = read_rig(path)
    assert [camera.name for camera in rig.cameras] == ["1", "10"]
    for camera, shift in zip(rig.cameras, (SHIFT, BESIDE_SHIFT), strict=True):
        _check(camera, shift)
    # Older versions: tables side by side, numbers as text, lens terms in brackets of their own.
    text = CALISCOPE.replace("[cameras.", "[cam_").replace(str(LENS), f"[{list(map(str, LENS))}]")
    path.write_text(text)
    assert [camera.name for camera in read_rig(path).cameras] == ["cam_1", "cam_10"]
    _check(read_rig(path).cameras[1], BESIDE_SHIFT)


def test_anipose(tmp_path):
    path = tmp_path / "calibration.toml"
    path.write_text(ANIPOSE)
    with pytest.raises(CalibrationError, match="does not say the unit of its translations"):
        read_rig(path)
    rig = read_rig(path, length_unit="m")
    assert [camera.name for camera in rig.cameras] == ["left", "right"]
    _check(rig.cameras[0])
    path.write_text('length_unit = "mm"\n' + ANIPOSE.replace(str(TURN.tolist()), _matrix()))
    pose = read_rig(path).cameras[1].T_camera_object
    np.testing.assert_allclose(pose[:3, 3], 1e-3 * BESIDE_SHIFT, rtol=1e-12)
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_rotvec(TURN).as_matrix(), atol=1e-12)


def _matrix():
    return str(Rotation.from_rotvec(TURN).as_matrix().tolist())


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fisheye = false", "fisheye = true", "camera 'right' has a fisheye lens"),
        (f"rotation = {TURN.tolist()}\n", "", "camera 'left' has no rotation and translation"),
        (str(TURN.tolist()), '"null"', "camera 'left' rotation is 'null'; must be numbers"),
        (str(TURN.tolist()), "[0.1, 0.2]", "camera 'left' rotation has 2 numbers; must have 3 x 3"),
        (str(INNER.tolist()), "[1.0]", "camera 'left' matrix has 1 numbers; must have 3 x 3"),
        (str(LENS), "[0.1, nan]", "camera 'left' distortions is"),
    ],
)
def test_refusals_name_the_camera(tmp_path, old, new, message):
    path = tmp_path / "calibration.toml"
    assert old in ANIPOSE
    path.write_text('length_unit = "m"\n' + ANIPOSE.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)
