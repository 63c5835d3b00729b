"""Cameras and rigs refuse what cannot be one, and keep what they are given."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from palpate.errors import CalibrationError, RecordError
from palpate.records import (
    Camera,
    Rig,
    RigCovariance,
    covariance_file,
    read_rig_covariance,
    write_rig_covariance,
)
from palpate.records.rig import check_cameras

MATRIX = np.array([[900.0, 0.5, 320.0], [0.0, 910.0, 240.0], [0.0, 0.0, 1.0]])
POSE = np.array([
    [0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]
])  # fmt: skip
KNOWN = RigCovariance(("c0.fx", "c1.tx"), np.array([900.0, 0.1]), np.diag([0.25, 1e-10]), "x")


def _camera(name="c0", *, size=(640, 480), matrix=MATRIX, distortion=None, pose=POSE):
    terms = np.zeros(8) if distortion is None else np.asarray(distortion, dtype=float)
    return Camera(name, size, matrix, terms, pose)


def _changed(array, index, value):
    other = array.copy()
    other[index] = value
    return other


def test_a_camera_keeps_what_it_is_given_and_lets_nobody_change_it():
    matrix = MATRIX.copy()
    camera = _camera(matrix=matrix)
    matrix[0, 0] = 1.0
    np.testing.assert_array_equal(camera.matrix, MATRIX)
    np.testing.assert_array_equal(camera.T_camera_object, POSE)
    for array in (camera.matrix, camera.distortion, camera.T_camera_object):
        assert array.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
    assert _camera(size=None).size is None


@pytest.mark.parametrize("count", [0, 4, 5, 8])
def test_missing_terms_of_the_distortion_are_zero(count):
    terms = np.arange(1.0, count + 1.0)
    camera = _camera(distortion=terms)
    np.testing.assert_array_equal(camera.distortion, np.append(terms, np.zeros(8 - count)))


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"distortion": np.zeros(12)}, "distortion has 12 terms"),
        ({"matrix": _changed(MATRIX, (0, 0), 0.0)}, "focal lengths are 0 and 910"),
        ({"matrix": _changed(MATRIX, (1, 1), -910.0)}, "focal lengths are 900 and -910"),
        ({"matrix": _changed(MATRIX, (0, 0), np.nan)}, "matrix"),
        ({"matrix": _changed(MATRIX, (1, 0), 0.1)}, "K is"),
        ({"matrix": MATRIX.T.copy()}, "K is"),
        ({"matrix": _changed(MATRIX, (2, 2), 2.0)}, "K is"),
        ({"pose": _changed(POSE, (0, 1), -0.99)}, "R is not a rotation"),
        ({"pose": _changed(POSE, (slice(3), 0), [0.0, -1.0, 0.0])}, "R is not a rotation"),
        ({"pose": _changed(POSE, (0, 3), np.inf)}, "T_camera_object"),
        ({"pose": POSE.T.copy()}, "last row of the pose"),
        ({"size": (640, 0)}, "size is"),
    ],
)
def test_a_camera_that_is_none_is_refused(wrong, text):
    with pytest.raises(ValueError, match=text) as caught:
        _camera(**wrong)
    if "K is" in text or "R is" in text or "size" in text or "focal" in text:
        assert isinstance(caught.value, CalibrationError)
        assert "camera 'c0'" in str(caught.value)


def test_a_rotation_written_with_seven_digits_is_one():
    turn = np.array([[0.8660254, -0.5, 0.0], [0.5, 0.8660254, 0.0], [0.0, 0.0, 1.0]])
    assert _camera(pose=_changed(POSE, (slice(3), slice(3)), turn)).name == "c0"


@pytest.mark.parametrize(
    ("names", "reference", "text"),
    [
        (["left"], 0, "has 1 camera"),
        ([], 0, "has 0 camera"),
        (["left", "right", "left"], 0, "camera 'left': there are files named 'left' already"),
        (["left", "right"], 2, "reference is camera 2 of 2"),
        (["left", "right"], -1, "reference is camera -1 of 2"),
    ],
)
def test_a_rig_that_is_none_is_refused_and_its_file_named(names, reference, text):
    with pytest.raises(CalibrationError, match=text) as caught:
        Rig(tuple(_camera(name) for name in names), reference, "rig.toml")
    assert "rig.toml" in str(caught.value)


def test_a_rig_keeps_its_cameras():
    cameras = _camera("left"), _camera("right")
    rig = Rig(cameras, 1, "rig.toml")
    assert rig.cameras == cameras
    assert rig.cameras[rig.reference].name == "right"


def test_what_was_written_is_read(tmp_path: Path) -> None:
    assert covariance_file(tmp_path / "rig.toml") is None
    write_rig_covariance(tmp_path, KNOWN, np.array([0.1, 0.1]))
    for path in (tmp_path, tmp_path / "rig.toml"):
        covariance = read_rig_covariance(covariance_file(path))
        assert covariance.names == KNOWN.names
        np.testing.assert_array_equal(covariance.value, KNOWN.value)
        np.testing.assert_array_equal(covariance.covariance, KNOWN.covariance)


def test_what_is_no_covariance_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "rig_covariance.npz"
    file.write_bytes(b"PK, and then nothing")
    with pytest.raises(RecordError, match=r"cannot be read as the covariance.*calibrate again"):
        read_rig_covariance(file)
    np.savez(file, format="palpate-rig-covariance/9")
    with pytest.raises(RecordError, match="its format is 'palpate-rig-covariance/9'"):
        read_rig_covariance(file)
    with pytest.raises(CalibrationError, match="not symmetric"):
        replace(KNOWN, covariance=np.array([[1.0, 0.5], [0.0, 1.0]]))


def test_a_principal_point_that_is_hardly_off_is_nobody_s_mistake():
    # With cx and cy exchanged it would be in the middle of this picture, which is nearly square.
    matrix = np.array([[900.0, 0.0, 247.5], [0.0, 900.0, 249.5], [0.0, 0.0, 1.0]])
    cameras = (_camera(size=(500, 496), matrix=matrix), _camera("c1"))
    check_cameras(Rig(cameras, 0, "rig.toml"))


def test_a_pole_of_a_lens_s_highest_terms_is_found():
    # 1 - 1.5 (r / r0)^4 + 0.5 (r / r0)^6 is 0 at r0, a ninth of the picture's half width.
    terms = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.5 / 0.05**4, 0.5 / 0.05**6]
    rig = Rig((_camera(distortion=terms), _camera("c1")), 0, "rig.toml")
    with pytest.raises(CalibrationError, match=r"denominator .* vanishes 45 px off"):
        check_cameras(rig)
