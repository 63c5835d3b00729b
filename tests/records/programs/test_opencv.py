"""OpenCV's calibration files, written by OpenCV itself."""

import cv2
import numpy as np
import pytest
from program_files import cv_pixels
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError, InputError
from palpate.records import read_rig
from palpate.vision import project

K1 = np.array([[1400.0, 0.0, 319.5], [0.0, 1410.0, 239.5], [0.0, 0.0, 1.0]])
K2 = np.array([[1300.0, 0.0, 310.5], [0.0, 1310.0, 229.5], [0.0, 0.0, 1.0]])
D1, D2 = np.array([[0.1, -0.2, 1e-3, 2e-3, 0.3]]), np.array([[-0.3, 0.1, 0, 0, 0, 0.1, 0.2, 0.3]])
VECTOR = np.array([0.1, -0.3, 0.05])
R, T = cv2.Rodrigues(VECTOR)[0], np.array([[-100.0], [5.0], [20.0]])
MILLIMETRES = [-0.1, 0.005, 0.02]
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
KALIBR = """\
cam0:
  camera_model: pinhole
  distortion_coeffs: [0.1, -0.2, 0.001, 0.002]
  distortion_model: radtan
  intrinsics: [1400.0, 1410.0, 319.5, 239.5]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.0, -1.0, 0.0, 0.1]
  - [1.0, 0.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [1300.0, 1310.0, 310.5, 229.5]
cam2:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.2]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.3]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [1300.0, 1310.0, 310.5, 229.5]
"""


def _stored(path, **entries):
    """A file written by OpenCV itself."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in entries.items():
        storage.write(name, value)
    storage.release()
    return path


def _assert_is_the_pair(rig, names=("1", "2")):
    first, second = rig.cameras
    assert (first.name, second.name) == names
    np.testing.assert_array_equal(first.matrix, K1)
    np.testing.assert_array_equal(second.matrix, K2)
    np.testing.assert_array_equal(first.distortion[:5], D1[0])
    np.testing.assert_array_equal(second.distortion, D2[0])
    np.testing.assert_array_equal(first.T_camera_object, np.eye(4))
    np.testing.assert_allclose(second.T_camera_object[:3, :3], R, atol=1e-15)
    np.testing.assert_allclose(second.T_camera_object[:3, 3], MILLIMETRES, rtol=1e-14)


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
    first, second, three = read_rig(path).cameras
    np.testing.assert_allclose(first.T_camera_object[:3, :3], R, atol=1e-15)
    np.testing.assert_allclose(second.T_camera_object[:3, :3], turned, atol=1e-15)
    np.testing.assert_allclose(
        second.T_camera_object[:3, 3], 2.0 * np.array(MILLIMETRES), rtol=1e-14
    )
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


def test_kalibr_chain(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    first, second, three = read_rig(path).cameras
    assert [first.name, second.name, three.name, first.size, second.size] == [
        "cam0", "cam1", "cam2", (640, 480), None,
    ]  # fmt: skip
    np.testing.assert_array_equal(first.matrix, [[1400, 0, 319.5], [0, 1410, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(first.distortion[:5], [0.1, -0.2, 0.001, 0.002, 0.0])
    step = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(second.T_camera_object, step, atol=1e-15)
    last = np.eye(4)
    last[:3, 3] = [0.2, 0.0, 0.3]
    np.testing.assert_allclose(three.T_camera_object, last @ step, atol=1e-15)
    assert read_rig(path, length_unit="mm").cameras[1].T_camera_object[0, 3] == pytest.approx(1e-4)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radtan", "equidistant", "cam0 is of the model pinhole with equidistant"),
        ("pinhole", "omni", "cam0 is of the model omni with radtan"),
        ("  T_cn_cnm1:", "  T_other:", "cam1 has no 'T_cn_cnm1'"),
        ("intrinsics: [1400.0, ", "intrinsics: [", "cam0 intrinsics has 3 numbers; must have 4"),
        ("0.0, 0.1]", "0.0]", "cam1 T_cn_cnm1 is"),
    ],
)
def test_kalibr_contradictions(tmp_path, old, new, message):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)
