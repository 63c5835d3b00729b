"""OpenCV's calibration files, written by OpenCV itself."""

import cv2
import numpy as np
import pytest

from palpate.errors import CalibrationError, InputError
from palpate.records.files.rig import read_rig

K1 = np.array([[1400.0, 0.0, 319.5], [0.0, 1410.0, 239.5], [0.0, 0.0, 1.0]])
K2 = np.array([[1300.0, 0.0, 310.5], [0.0, 1310.0, 229.5], [0.0, 0.0, 1.0]])
D1, D2 = np.array([[0.1, -0.2, 1e-3, 2e-3, 0.3]]), np.array([[-0.3, 0.1, 0, 0, 0, 0.1, 0.2, 0.3]])
VECTOR = np.array([0.1, -0.3, 0.05])
R, T = cv2.Rodrigues(VECTOR)[0], np.array([[-100.0], [5.0], [20.0]])
MILLIMETRES = [-0.1, 0.005, 0.02]


def _stored(path, **entries):
    """A file written by OpenCV itself."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        storage.write(name, value)
    storage.release()
    return path


def _assert_is_the_pair(rig, names=("1", "2")):
    one, two = rig.cameras
    assert (one.name, two.name) == names
    np.testing.assert_array_equal(one.matrix, K1)
    np.testing.assert_array_equal(two.matrix, K2)
    np.testing.assert_array_equal(one.distortion[:5], D1[0])
    np.testing.assert_array_equal(two.distortion, D2[0])
    np.testing.assert_array_equal(one.T_camera_object, np.eye(4))
    np.testing.assert_allclose(two.T_camera_object[:3, :3], R, atol=1e-15)
    np.testing.assert_allclose(two.T_camera_object[:3, 3], MILLIMETRES, rtol=1e-14)


@pytest.mark.parametrize("suffix", ["yml", "yaml", "xml", "json"])
def test_opencv_stereo_in_one_file(tmp_path, suffix):
    path = tmp_path / f"stereo.{suffix}"
    _stored(
        path, K1=K1, D1=D1, K2=K2, D2=D2, R=R, T=T, R1=np.eye(3), P1=np.eye(3), length_unit="mm"
    )
    _assert_is_the_pair(read_rig(path))


@pytest.mark.parametrize(
    "names", [("M", "D"), ("cameraMatrix", "distCoeffs"), ("camera_matrix_", "dist_")]
)
def test_opencv_other_names_and_a_size(tmp_path, names):
    entries = {f"{names[0]}1": K1, f"{names[0]}2": K2, f"{names[1]}1": D1, f"{names[1]}2": D2}
    path = _stored(tmp_path / "a.yml", **entries, R=R, T=T, imageSize=np.array([640, 480]))
    rig = read_rig(path, length_unit="mm")
    _assert_is_the_pair(rig)
    assert [camera.size for camera in rig.cameras] == [(640, 480)] * 2


def test_opencv_rotation_vector_and_sides(tmp_path):
    path = _stored(tmp_path / "a.yml", K_left=K1, D_left=D1, K_right=K2, D_right=D2, R=VECTOR, T=T)
    _assert_is_the_pair(read_rig(path, length_unit="mm"), ("left", "right"))


@pytest.mark.parametrize("given", ["intrinsics.yml", "extrinsics.yml"])
def test_opencv_sample_keeps_two_files(tmp_path, given):
    """As stereo_calib of OpenCV's samples writes them."""
    _stored(tmp_path / "intrinsics.yml", M1=K1, D1=D1, M2=K2, D2=D2)
    _stored(tmp_path / "extrinsics.yml", R=R, T=T, R1=np.eye(3), R2=np.eye(3), Q=np.eye(4))
    _assert_is_the_pair(read_rig(tmp_path / given, length_unit="mm"))


def test_opencv_pose_per_camera_in_one_file(tmp_path):
    turned = cv2.Rodrigues(np.array([0.0, 0.4, 0.0]))[0]
    path = _stored(
        tmp_path / "a.yml",
        K1=K1,
        D1=D1,
        rvec1=VECTOR,
        tvec1=T,
        K2=K2,
        D2=D2,
        R2=turned,
        T2=2.0 * T,
        K3=K2,
        R3=np.eye(3),
        T3=np.zeros(3),
        length_unit="mm",
    )
    one, two, three = read_rig(path).cameras
    np.testing.assert_allclose(one.T_camera_object[:3, :3], R, atol=1e-15)
    np.testing.assert_allclose(two.T_camera_object[:3, :3], turned, atol=1e-15)
    np.testing.assert_allclose(two.T_camera_object[:3, 3], 2.0 * np.array(MILLIMETRES), rtol=1e-14)
    np.testing.assert_array_equal(three.T_camera_object, np.eye(4))
    assert not three.distortion.any()


def test_opencv_folder_of_cameras(tmp_path):
    both = {"image_width": 640, "image_height": 480, "length_unit": "mm"}
    zero = np.zeros(3)
    _stored(
        tmp_path / "a.yml",
        camera_matrix=K1,
        distortion_coefficients=D1,
        rvec=zero,
        tvec=zero,
        **both,
    )
    _stored(tmp_path / "b.yml", camera_matrix=K2, distortion_coefficients=D2, R=R, T=T, **both)
    (tmp_path / "notes.yml").write_text("by: someone\n")
    rig = read_rig(tmp_path)
    _assert_is_the_pair(rig, ("a", "b"))
    assert rig.cameras[1].size == (640, 480)
    _stored(tmp_path / "b.yml", K1=K1, K2=K2)
    with pytest.raises(CalibrationError, match=r"b\.yml: has 2 camera matrices"):
        read_rig(tmp_path)


def test_opencv_needs_a_unit(tmp_path):
    path = _stored(tmp_path / "a.yml", K1=K1, K2=K2, R=R, T=T)
    with pytest.raises(CalibrationError, match="add the line 'length_unit: mm'"):
        read_rig(path)
    with pytest.raises(InputError, match="length_unit is 'inch'; did you mean 'in'"):
        read_rig(path, length_unit="inch")


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"K1": K1, "R": R, "T": T}, "ties? two cameras, but 1 camera matrices"),
        ({"K1": K1, "K2": K2}, "camera '1' has no pose"),
        (
            {"K1": K1, "K2": np.eye(2), "R": R, "T": T},
            "camera matrix 2 has 4 numbers; must have 3 x 3",
        ),
        ({"K1": K1, "K2": K2, "R": np.eye(2), "T": T}, "rotation has 4 numbers"),
        ({"K1": K1, "K2": K2, "R": 2 * R, "T": T}, "R is not a rotation"),
        ({"K1": K1, "K2": K2, "D2": np.ones((1, 12)), "R": R, "T": T}, "12 distortion terms"),
    ],
)
def test_opencv_contradictions(tmp_path, entries, message):
    with pytest.raises(CalibrationError, match=message):
        read_rig(_stored(tmp_path / "a.yml", **entries), length_unit="mm")


def test_opencv_zero_terms_beyond_the_eighth_are_no_matter(tmp_path):
    lens = np.zeros((1, 14))
    lens[0, 0] = 0.1
    path = _stored(tmp_path / "a.yml", K1=K1, D1=lens, K2=K2, R=R, T=T)
    assert read_rig(path, length_unit="mm").cameras[0].distortion[0] == 0.1


@pytest.mark.parametrize(
    ("entries", "model"),
    [
        ({"fisheye_model": 1}, "fisheye"),
        ({"distortion_model": "equidistant"}, "equidistant"),
        ({"distortion_model": "fisheye"}, "fisheye"),
    ],
)
def test_opencv_other_lens_models_are_refused(tmp_path, entries, model):
    path = tmp_path / "a.yml"
    _stored(path, K1=K1, D1=D1, K2=K2, D2=D2, R=R, T=T, length_unit="mm", **entries)
    with pytest.raises(CalibrationError, match=f"camera '1' has the lens model {model}; only"):
        read_rig(path)
    usual = {"fisheye_model": 0, "distortion_model": "plumb_bob"}
    _assert_is_the_pair(
        read_rig(_stored(path, K1=K1, D1=D1, K2=K2, D2=D2, R=R, T=T, length_unit="mm", **usual))
    )
