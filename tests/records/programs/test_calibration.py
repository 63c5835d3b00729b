"""Which program wrote a calibration: Kalibr's, unknown ones, and the way into rig.toml."""

import numpy as np
import pytest

from palpate.errors import CalibrationError, RecordError
from palpate.records.files.rig import read_rig, write_rig
from palpate.vision.cameras.projection import project

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


def test_kalibr_chain(tmp_path):
    path = tmp_path / "camchain.yaml"
    path.write_text(KALIBR)
    one, two, three = read_rig(path).cameras
    assert [one.name, two.name, three.name, one.size, two.size] == [
        "cam0", "cam1", "cam2", (640, 480), None,
    ]  # fmt: skip
    np.testing.assert_array_equal(one.matrix, [[1400, 0, 319.5], [0, 1410, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(one.distortion[:5], [0.1, -0.2, 0.001, 0.002, 0.0])
    step = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(two.T_camera_object, step, atol=1e-15)
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


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.xml", b"<ParameterList></ParameterList>", "is no camera calibration"),
        ("a.xml", b"<project><b></project>", "is not valid XML"),
        ("a.yml", b"%YAML:1.0\n---\na: [1", "is not valid YAML"),
        ("a.yml", b"- 1\n- 2\n", "holds no names with values"),
        (
            "a.yml",
            b"a: 1\nb: 2\n",
            r"is no camera calibration \(it holds: a, b\); known are rig.toml",
        ),
        ("a.txt", b"hello", "is no camera calibration; known are"),
        ("a.tif", b"II*\x00\xff\xfe", "is not a text file in UTF-8; known are"),
    ],
)
def test_unknown_files_are_refused(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(RecordError, match=message):
        read_rig(path)


def test_unreadable_files_are_refused(tmp_path):
    with pytest.raises(RecordError, match="the folder holds no calibration of a camera"):
        read_rig(tmp_path)
    folder = tmp_path / "x"
    (folder / "a.yml").mkdir(parents=True)
    with pytest.raises(RecordError, match=r"a\.yml: cannot be read"):
        read_rig(folder)


def test_any_calibration_becomes_a_rig_toml(shared_data, tmp_path):
    rig = read_rig(shared_data / "real" / "gt4_dspec" / "cal_pyaldic.xml")
    write_rig(tmp_path / "rig.toml", rig)
    again = read_rig(tmp_path / "rig.toml")
    points = np.array([[0.0, 0.0, 0.38], [0.03, -0.01, 0.4]])
    for one, two in zip(rig.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(project(two, points), project(one, points), atol=1e-9)
