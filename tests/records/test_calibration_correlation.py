"""Calibrations of VIC-3D, DICe and MatchID, judged by the matches these programs made."""

import re

import cv2
import numpy as np
import pytest
import scipy.io

from palpate.errors import CalibrationError
from palpate.records.files.rig import read_rig
from palpate.records.programs.calibration_parts import rotation_from_angles
from palpate.vision.cameras.triangulation import triangulate

# VIC-3D

VIC = """<?xml version="1.0" encoding="ISO-8859-1"?>
<!DOCTYPE vpml>
<project dir="C:/\xe4">
 <calibration lri="calibration">
  <camera id="0">955 645 6636 6637 0.25 0.01 0.8 -26<orientation>180 9 0 -58 0.1 20</orientation>
  </camera>
  <camera id="1">971 615 6609 6610 0.5 0.02 1.0 -30<orientation>10 20 30 59 0.2 21</orientation>
  </camera>
 </calibration>
 <projectaois><aoinode img="a-0000_0.tif"><polygonmask width="1920" height="1200"/></aoinode>
 <aoinode img="b"/></projectaois>
</project>
"""


def _vic(tmp_path, old="", new=""):
    assert old in VIC
    path = tmp_path / "cal.xml"
    path.write_bytes(VIC.replace(old, new, 1).encode("latin-1"))
    return path


def test_vic3d_order_of_the_numbers(tmp_path):
    one, two = read_rig(_vic(tmp_path)).cameras
    assert (one.name, one.size, two.name, two.size) == ("0", (1920, 1200), "1", None)
    np.testing.assert_array_equal(one.matrix, [[6636, 0.25, 955], [0, 6637, 645], [0, 0, 1]])
    np.testing.assert_array_equal(two.distortion, [0.02, 1.0, 0, 0, -30, 0, 0, 0])
    np.testing.assert_allclose(two.T_camera_object[:3, 3], [0.059, 0.0002, 0.021], rtol=1e-14)
    turn = cv2.Rodrigues(np.deg2rad([0.0, 0.0, 30.0]))[0]
    turn = turn @ cv2.Rodrigues(np.deg2rad([0.0, 20.0, 0.0]))[0]
    turn = turn @ cv2.Rodrigues(np.deg2rad([10.0, 0.0, 0.0]))[0]
    np.testing.assert_allclose(two.T_camera_object[:3, :3], turn, atol=1e-15)
    assert (
        read_rig(_vic(tmp_path), length_unit="in").cameras[1].T_camera_object[2, 3] == 21 * 0.0254
    )


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (" -26<", "<", 'id="0"> has 7 numbers; must have 8'),
        (" 21<", "<", "<orientation> of camera '1' has 5 numbers; must have 6"),
        ("<orientation>10 20 30 59 0.2 21</orientation>", "", "camera '1' has no <orientation>"),
        ("6636 6637", "six 6637", "must be numbers"),
        ('id="1"', 'id="0"', "cameras share a name"),
    ],
)
def test_vic3d_contradictions(tmp_path, old, new, message):
    with pytest.raises(CalibrationError, match=message):
        read_rig(_vic(tmp_path, old, new))


def _own_matches(path):
    """Pairs of pixels that VIC-3D itself matched (automatic start points) and put into the file."""
    text = path.read_bytes().decode("latin-1")
    guess = re.compile(r'<guess type="(\w+)" score="[^"]*" img="([^"]+)_([01])\.tif">(\S+) (\S+)')
    left, right = [], []
    for block in re.findall(r"<startpoint.*?</startpoint>", text, re.DOTALL):
        found = {
            (stem, side): (kind, float(x), float(y))
            for kind, stem, side, x, y in guess.findall(block)
        }
        for (stem, side), place in found.items():
            other = found.get((stem, "1"))
            if side == "0" and other is not None and other[0] == "auto":
                left.append(place[1:])
                right.append(other[1:])
    return np.array([left, right])


@pytest.mark.parametrize("name", ["dice_stereo_static/cal.xml", "gt4_dspec/cal_vic3d.xml"])
def test_vic3d_calibration_fits_the_matches_in_its_own_file(shared_data, name):
    """The judge of order, signs, units, lens. (Pictures beside the first are of another rig.)"""
    path = shared_data / "real" / name
    matches = _own_matches(path)
    assert matches.shape[1] >= 1
    found = triangulate(read_rig(path), matches, 0.05)
    # Half the distance from the epipolar line per camera; VIC-3D reports 0.03 px for such rigs.
    assert found.residual.max() < 0.05


def _gold(path):
    """Nodal variables of DICe's first frame."""
    with scipy.io.netcdf_file(path, mmap=False) as file:
        names = [b"".join(row).split(b"\0")[0].decode() for row in file.variables["name_nod_var"]]
        return {
            name: np.array(file.variables[f"vals_nod_var{i + 1}"][0], dtype=np.float64)
            for i, name in enumerate(names)
        }


def _columns(gold, *names):
    return np.stack([gold[name] for name in names], axis=1)


def test_two_calibrations_of_one_rig_agree_on_dices_matches(shared_data):
    folder = shared_data / "real" / "gt4_dspec"
    gold = _gold(folder / "dice_gold" / "DICe_solution.e")
    fine = gold["SIGMA"] >= 0.0
    matches = np.stack(
        [
            _columns(gold, "COORDINATE_X", "COORDINATE_Y")[fine],
            _columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y")[fine],
        ]
    )
    assert fine.sum() > 100
    depths, shapes = [], []
    for name in ("cal_vic3d.xml", "cal_pyaldic.xml"):
        rig = read_rig(folder / name)
        found = triangulate(rig, matches, 0.05)
        # Both programs report calibrations of some 0.05 px.
        assert np.sqrt(np.mean(found.residual**2)) < 0.06
        pose = rig.cameras[0].T_camera_object
        depths.append(found.point @ pose[2, :3] + pose[2, 3])
        shapes.append(found.point)
    # Two independent calibrations with a target: a fraction of a per cent.
    assert np.median(depths[0] / depths[1]) == pytest.approx(1.0, abs=0.003)
    assert np.median(depths[0]) == pytest.approx(0.383, abs=0.005)
    # DICe's points, in a frame of their own, have the shape of ours over 94 mm.
    model = 1e-3 * _columns(gold, *(f"MODEL_COORDINATES_{axis}" for axis in "XYZ"))[fine]
    a, b = shapes[0] - shapes[0].mean(axis=0), model - model.mean(axis=0)
    u, s, v = np.linalg.svd(a.T @ b)
    assert s.sum() / np.sum(a**2) == pytest.approx(1.0, abs=1e-4)
    # DICe triangulates linearly: 2 um here.
    assert (b - a @ u @ v).std(axis=0).max() < 3e-6


def test_vic3d_object_frame_is_dices(shared_data):
    """Right, up and towards the cameras; DICe writes its model coordinates in the same frame."""
    folder = shared_data / "real" / "dice_stereo_static"
    gold = _gold(folder / "gold" / "DICe_solution_auto.e")
    matches = np.stack(
        [
            _columns(gold, "SUBSET_COORDINATES_X", "SUBSET_COORDINATES_Y"),
            _columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y"),
        ]
    )
    model = 1e-3 * _columns(gold, *(f"MODEL_COORDINATES_{axis}" for axis in "XYZ"))
    found = triangulate(read_rig(folder / "cal.xml"), matches, 1.0)
    # These pictures are of another state of the rig: the rays pass each other by 17 px, which DICe
    # weighs otherwise and without the lens: 0.4 mm of 0.38 m.
    np.testing.assert_allclose(found.point, model, rtol=0.0, atol=1e-3)


# DICe

DICE = """
<ParameterList>
<!-- DICe formatted camera system file -->
<Parameter name="xml_file_format" type="string" value="DICe_xml_camera_system_file" />
<Parameter name="system_type_3D" type="string" value="OPENCV" />
<Parameter name="extrinsics_relative_camera_to_camera" type="bool" value="true" />
<ParameterList name="CAMERA 0">
<Parameter name="CAMERA_ID" type="string" value="one" />
<Parameter name="CX" type="double" value="319.5" />
<Parameter name="CY" type="double" value="239.5" />
<Parameter name="FX" type="double" value="1400" />
<Parameter name="FY" type="double" value="1.41e+003" />
<Parameter name="K1" type="double" value="0.1" />
<Parameter name="P2" type="double" value="0.002" />
<Parameter name="K3" type="double" value="0.3" />
<Parameter name="LENS_DISTORTION_MODEL" type="string" value="OPENCV_LENS_DISTORTION" />
<Parameter name="ALPHA" type="double" value="10" />
<Parameter name="TZ" type="double" value="7" />
<Parameter name="IMAGE_HEIGHT_WIDTH" type="string" value="{ 480, 640 }" />
</ParameterList>
<ParameterList name="CAMERA 1">
<Parameter name="CAMERA_ID" type="string" value="" />
<Parameter name="CX" type="double" value="310.5" />
<Parameter name="CY" type="double" value="229.5" />
<Parameter name="FX" type="double" value="1300" />
<Parameter name="FY" type="double" value="1310" />
<Parameter name="TX" type="double" value="100" />
<ParameterList name="rotation_3x3_matrix">
<Parameter name="ROW 0" type="string" value="{ 0.0, -1.0, 0.0 }" />
<Parameter name="ROW 1" type="string" value="{ 1.0, 0.0, 0.0 }" />
<Parameter name="ROW 2" type="string" value="{ 0.0, 0.0, 1.0 }" />
</ParameterList>
</ParameterList>
</ParameterList>
"""


def _dice(tmp_path, old="", new=""):
    assert old in DICE
    path = tmp_path / "cal.xml"
    path.write_text(DICE.replace(old, new, 1))
    return path


def test_dice_order_and_chain(tmp_path):
    one, two = read_rig(_dice(tmp_path)).cameras
    assert (one.name, one.size, two.name, two.size) == ("one", (640, 480), "1", None)
    np.testing.assert_array_equal(one.matrix, [[1400, 0, 319.5], [0, 1410, 239.5], [0, 0, 1]])
    np.testing.assert_array_equal(one.distortion, [0.1, 0, 0, 0.002, 0.3, 0, 0, 0])
    first = np.eye(4)
    first[:3, :3], first[2, 3] = rotation_from_angles([10.0, 0.0, 0.0]), 0.007
    np.testing.assert_allclose(one.T_camera_object, first, atol=1e-15)
    step = np.array([[0, -1, 0, 0.1], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    np.testing.assert_allclose(two.T_camera_object, step @ first, atol=1e-15)
    plain = read_rig(_dice(tmp_path, 'value="true"', 'value="false"')).cameras[1]
    np.testing.assert_allclose(plain.T_camera_object, step, atol=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name="FX"', 'name="FFX"', "camera 'one' has no FX"),
        ("OPENCV_LENS_DISTORTION", "K1R1_K2R2_K3R3", "lens model K1R1_K2R2_K3R3; known are"),
        ("OPENCV_LENS_DISTORTION", "NO_LENS_DISTORTION", "has lens terms but"),
        ('name="TX"', 'name="FS"', "has FS 100, which DICe passes over"),
        ('name="P2"', 'name="S1"', "14 distortion terms"),
        ('name="ROW 2"', 'name="ROW 3"', "CAMERA 1: rotation_3x3_matrix lacks ROW 2"),
        ("{ 480, 640 }", "{ 480 }", "has 1 numbers; must have 2"),
        ('name="system_type_3D"', 'name="user_6_param_transform"', "would move the object frame"),
        ("CAMERA 1", "CAMRA 1", "has 1 camera; depth needs"),
    ],
)
def test_dice_contradictions(tmp_path, old, new, message):
    with pytest.raises(CalibrationError, match=message):
        read_rig(_dice(tmp_path, old, new))


# MatchID. The figures are a calibration of the rig of gt4_dspec, as MatchID gives them.

MATCHID = """\
Cam0_Fx [pixels];6673.315918
Cam0_Fy [pixels];6669.302734
Cam0_Fs [pixels];0
Cam0_Kappa 1;0.032258954
Cam0_Kappa 2;-1.01141417
Cam0_Kappa 3;29.78838921
Cam0_P1;0
Cam0_P2;0
Cam0_Cx [pixels];872.1577759
Cam0_Cy [pixels];579.9553223
Cam1_Fx [pixels];6607.618164
Cam1_Fy [pixels];6602.857422
Cam1_Fs [pixels];0.5
Cam1_Kappa 1;0.064598486
Cam1_Kappa 2;-4.531373978
Cam1_Kappa 3;29.78838921
Cam1_P1;0.001
Cam1_P2;0.002
Cam1_Cx [pixels];917.9733887
Cam1_Cy [pixels];531.6352539
Tx [mm];122.2488624
Ty [mm];1.848889206
Tz [mm];17.62463774
Theta [deg];0.130689541
Phi [deg];-19.06769369
Psi [deg];0.281404039
"""


def test_matchid_numbers(tmp_path):
    path = tmp_path / "cal.caldat"
    path.write_text(MATCHID)
    one, two = read_rig(path).cameras
    assert (one.name, two.name, one.size) == ("0", "1", None)
    np.testing.assert_array_equal(one.T_camera_object, np.eye(4))
    np.testing.assert_array_equal(two.matrix[0], [6607.618164, 0.5, 917.9733887])
    lens = [0.064598486, -4.531373978, 0.001, 0.002, 29.78838921, 0, 0, 0]
    np.testing.assert_array_equal(two.distortion, lens)
    turn = rotation_from_angles([0.130689541, -19.06769369, 0.281404039])
    np.testing.assert_allclose(two.T_camera_object[:3, :3], turn, atol=1e-15)
    np.testing.assert_allclose(two.T_camera_object[0, 3], 0.1222488624, rtol=1e-14)
    # pyvale writes the same keys as YAML, radians are told by their unit.
    yaml = MATCHID.replace(";", ": ").replace("[deg]", "[rad]")
    (tmp_path / "cal.yaml").write_text(yaml)
    other = read_rig(tmp_path / "cal.yaml").cameras[1].T_camera_object
    turn = rotation_from_angles(np.rad2deg([0.130689541, -19.06769369, 0.281404039]))
    np.testing.assert_allclose(other[:3, :3], turn, atol=1e-12)


def test_matchid_calibration_fits_dices_matches(shared_data, tmp_path):
    path = tmp_path / "cal.caldat"
    path.write_text(
        MATCHID.replace("Fs [pixels];0.5", "Fs [pixels];0")
        .replace("0.001", "0")
        .replace("0.002\n", "0\n")
    )
    gold = _gold(shared_data / "real" / "gt4_dspec" / "dice_gold" / "DICe_solution.e")
    fine = gold["SIGMA"] >= 0.0
    left = _columns(gold, "COORDINATE_X", "COORDINATE_Y")[fine]
    right = _columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y")[fine]
    found = triangulate(read_rig(path), np.stack([left, right]), 0.05)
    # Any other order of the angles leaves 0.4 px or more.
    assert np.sqrt(np.mean(found.residual**2)) < 0.07


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Cam1_Fx", "Cam2_Fx", "'Cam1_Fx' is missing"),
        ("Phi [deg];-19", "Phi [deg];x", "Phi is 'x.*must be numbers"),
        ("Theta [deg]", "Other [deg]", "'Theta' is missing"),
    ],
)
def test_matchid_contradictions(tmp_path, old, new, message):
    path = tmp_path / "cal.caldat"
    path.write_text(MATCHID.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)
