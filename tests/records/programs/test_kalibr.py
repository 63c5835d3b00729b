"""Kalibr's chains of cameras."""

import numpy as np
import pytest

from palpate.errors import CalibrationError
from palpate.records import read_rig

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
