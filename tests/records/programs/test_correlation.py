"""VIC-3D: its columns, and its calibrations judged by the matches that it made."""

import re

import cv2
import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
    dice_gold,
    gold_columns,
    vic3d_rows,
    write_table,
)

from palpate.errors import CalibrationError, RecordError
from palpate.records import read_rig
from palpate.records.probing import measured_rows
from palpate.records.program import rotation_from_angles
from palpate.records.programs.registry import read_measured
from palpate.vision import triangulate

VIC3D = '"x","y","u","v","sigma","X","Y","Z","U","V","W"'
MATCHID = (
    "Coordinates.Image X [Pixel];coor.X [mm];coor.Y [mm];coor.Z [mm];"
    "disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    "disp.Out-Of-Plane: W [mm];stats.Sigma [mm]"
)


def test_vic3d(tmp_path):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    measured = read_measured("vic3d", path)
    check_four_points(measured, nowhere=True)
    assert (measured.source, measured.std) == (str(path), None)
    assert measured.notes == ("It does not say its unit of length; mm was taken (--length-unit).",)


def test_vic3d_perfect_match_is_no_failure(tmp_path):
    rows = vic3d_rows()
    rows[0, 4] = 0.0
    check_four_points(
        read_measured("vic3d", write_table(tmp_path / "a.csv", VIC3D, rows)), nowhere=True
    )


def test_vic3d_with_units_and_deviations(tmp_path):
    header = VIC3D.replace('"', "").replace("sigma", "Sigma [pixel]")
    for name in "XYZUVW":
        header = header.replace(f",{name}", f",{name} [m]")
    header += ",Sigma_X [m],Sigma_Y [m],Sigma_Z [m]"
    rows = np.column_stack([vic3d_rows(), np.tile([1e-6, 2e-6, 5e-6], (4, 1))])
    rows[:, 5:11] *= 1e-3
    measured = read_measured("vic3d", write_table(tmp_path / "a.csv", header, rows))
    # Scaled by 1e-3 here, not there: one more rounding.
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], rtol=1e-15)
    expected = np.sqrt(2.0) * np.array([1e-6, 2e-6, 5e-6])
    np.testing.assert_allclose(measured.std[GOOD], np.tile(expected, (3, 1)), rtol=1e-15)
    assert np.isnan(measured.std[~GOOD]).all()
    assert measured.notes == (
        "The sigma of a displacement is taken as sqrt(2) of Sigma_X, Sigma_Y, Sigma_Z.",
    )


def test_deviations_that_are_not_there_for_all(tmp_path):
    rows = np.column_stack([vic3d_rows(), np.tile([1e-3, 2e-3, 5e-3], (4, 1))])
    rows[1, 12] = 0.0
    header = VIC3D + ',"Sigma_X","Sigma_Y","Sigma_Z"'
    measured = read_measured("vic3d", write_table(tmp_path / "a.csv", header, rows))
    assert measured.std is None
    assert "1 measured points have no sigma; that of the others was left out." in measured.notes


def test_vic3d_without_sigma_says_so(tmp_path):
    rows = np.delete(vic3d_rows(), 4, axis=1)[:3]
    path = write_table(tmp_path / "a.csv", VIC3D.replace('"sigma",', ""), rows)
    measured = read_measured("vic3d", path, length_unit="mm")
    assert measured_rows(measured.displacement).all()
    assert measured.notes == ("It has no column sigma, so failed points cannot be recognised.",)


def test_columns_in_different_units(tmp_path):
    path = write_table(tmp_path / "a.csv", "X [mm],Y [mm],Z [mm],U [m],V [m],W [m]", np.eye(6))
    with pytest.raises(RecordError, match=r"different units \(X \[mm\].*U \[m\]"):
        read_measured("vic3d", path)


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
    first, second = read_rig(_vic(tmp_path)).cameras
    assert (first.name, first.size, second.name, second.size) == ("0", (1920, 1200), "1", None)
    np.testing.assert_array_equal(first.matrix, [[6636, 0.25, 955], [0, 6637, 645], [0, 0, 1]])
    np.testing.assert_array_equal(second.distortion, [0.02, 1.0, 0, 0, -30, 0, 0, 0])
    np.testing.assert_allclose(second.T_camera_object[:3, 3], [0.059, 0.0002, 0.021], rtol=1e-14)
    turn = cv2.Rodrigues(np.deg2rad([0.0, 0.0, 30.0]))[0]
    turn = turn @ cv2.Rodrigues(np.deg2rad([0.0, 20.0, 0.0]))[0]
    turn = turn @ cv2.Rodrigues(np.deg2rad([10.0, 0.0, 0.0]))[0]
    np.testing.assert_allclose(second.T_camera_object[:3, :3], turn, atol=1e-15)
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
        ('id="1"', 'id="0"', "camera '0': there are files named '0' already"),
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
        marks = {
            (stem, side): (kind, float(x), float(y))
            for kind, stem, side, x, y in guess.findall(block)
        }
        for (stem, side), match in marks.items():
            other = marks.get((stem, "1"))
            if side == "0" and other is not None and other[0] == "auto":
                left.append(match[1:])
                right.append(other[1:])
    return np.array([left, right])


@pytest.mark.parametrize("name", ["dice_stereo_static/cal.xml", "gt4_dspec/cal_vic3d.xml"])
def test_vic3d_calibration_fits_the_matches_in_its_own_file(shared_data, name):
    """The judge of order, signs, units, lens. (Pictures beside the first are of another rig.)"""
    path = shared_data / "real" / name
    matches = _own_matches(path)
    assert matches.shape[1] >= 1
    points = triangulate(read_rig(path), matches, 0.05)
    # Half the distance from the epipolar line per camera; VIC-3D reports 0.03 px for such rigs.
    assert points.residual.max() < 0.05


def test_vic3d_object_frame_is_dices(shared_data):
    """Right, up and towards the cameras; DICe writes its model coordinates in the same frame."""
    folder = shared_data / "real" / "dice_stereo_static"
    gold = dice_gold(folder / "gold" / "DICe_solution_auto.e")
    matches = np.stack(
        [
            gold_columns(gold, "SUBSET_COORDINATES_X", "SUBSET_COORDINATES_Y"),
            gold_columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y"),
        ]
    )
    model = 1e-3 * gold_columns(gold, *(f"MODEL_COORDINATES_{axis}" for axis in "XYZ"))
    points = triangulate(read_rig(folder / "cal.xml"), matches, 1.0)
    # These pictures are of another state of the rig: the rays pass each other by 17 px, which DICe
    # weighs otherwise and without the lens: 0.4 mm of 0.38 m.
    np.testing.assert_allclose(points.point, model, rtol=0.0, atol=1e-3)


def test_matchid_with_decimal_commas(tmp_path):
    rows = [
        "0;" + ";".join(repr(float(x)) for x in (*point, *move)) + ";0.001"
        for point, move in zip(PLACE, MOVE, strict=True)
    ]
    rows[3] = "0;3.0;3.0;299.0;NeuN;n. def.;NaN;"
    path = tmp_path / "a.csv"
    path.write_text("\n".join([MATCHID, *rows]).replace(".0", ",0"), encoding="utf-8")
    measured = read_measured("matchid", path)
    check_four_points(measured)
    assert measured.notes == ("The column Sigma was left out: it does not say whose error it is.",)


def test_matchid_short_names(tmp_path):
    header = "x_pic,y_pic,x,y,z,u,v,w,exx"
    move = np.where(GOOD[:, None], MOVE, np.nan)
    rows = np.column_stack([np.zeros((4, 2)), PLACE, move, np.zeros(4)])
    check_four_points(read_measured("matchid", write_table(tmp_path / "a.csv", header, rows)))


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (
            "coor.X [mm],coor.Y [mm],disp.Horizontal Displacement U [mm],disp.v [mm]",
            "'Z' is missing; it is a 2-D result",
        ),
        ("x,y,z,u", "'V' is missing; export all variables of a time step in one table"),
        (
            "x [Pixel],y [Pixel],z [Pixel],u [Pixel],v [Pixel],w [Pixel]",
            "lengths are in 'Pixel'; known units are um mm cm m in",
        ),
        ("x,y,z,u,v,w,x", "the column 'x' is there 2 times"),
    ],
)
def test_matchid_refusals(tmp_path, header, message):
    path = write_table(tmp_path / "a.csv", header, np.ones((2, len(header.split(",")))))
    with pytest.raises(RecordError, match=message):
        read_measured("matchid", path)


CALIBRATION = """\
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
    path.write_text(CALIBRATION)
    first, second = read_rig(path).cameras
    assert (first.name, second.name, first.size) == ("0", "1", None)
    np.testing.assert_array_equal(first.T_camera_object, np.eye(4))
    np.testing.assert_array_equal(second.matrix[0], [6607.618164, 0.5, 917.9733887])
    lens = [0.064598486, -4.531373978, 0.001, 0.002, 29.78838921, 0, 0, 0]
    np.testing.assert_array_equal(second.distortion, lens)
    turn = rotation_from_angles([0.130689541, -19.06769369, 0.281404039])
    np.testing.assert_allclose(second.T_camera_object[:3, :3], turn, atol=1e-15)
    np.testing.assert_allclose(second.T_camera_object[0, 3], 0.1222488624, rtol=1e-14)
    # pyvale writes the same keys as YAML, radians are told by their unit.
    yaml = CALIBRATION.replace(";", ": ").replace("[deg]", "[rad]")
    (tmp_path / "cal.yaml").write_text(yaml)
    other = read_rig(tmp_path / "cal.yaml").cameras[1].T_camera_object
    turn = rotation_from_angles(np.rad2deg([0.130689541, -19.06769369, 0.281404039]))
    np.testing.assert_allclose(other[:3, :3], turn, atol=1e-12)


def test_matchid_calibration_fits_dices_matches(shared_data, tmp_path):
    path = tmp_path / "cal.caldat"
    path.write_text(
        CALIBRATION.replace("Fs [pixels];0.5", "Fs [pixels];0")
        .replace("0.001", "0")
        .replace("0.002\n", "0\n")
    )
    gold = dice_gold(shared_data / "real" / "gt4_dspec" / "dice_gold" / "DICe_solution.e")
    fine = gold["SIGMA"] >= 0.0
    left = gold_columns(gold, "COORDINATE_X", "COORDINATE_Y")[fine]
    right = gold_columns(gold, "STEREO_COORDINATES_X", "STEREO_COORDINATES_Y")[fine]
    points = triangulate(read_rig(path), np.stack([left, right]), 0.05)
    # Any other order of the angles leaves 0.4 px or more.
    assert np.sqrt(np.mean(points.residual**2)) < 0.07


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Cam1_Fx", "Cam2_Fx", "the calibration has no 'cam1_fx'"),
        ("Phi [deg];-19", "Phi [deg];x", "phi of the calibration is 'x.*must be numbers"),
        ("Theta [deg]", "Other [deg]", "the calibration has no 'theta'"),
    ],
)
def test_matchid_contradictions(tmp_path, old, new, message):
    path = tmp_path / "cal.caldat"
    path.write_text(CALIBRATION.replace(old, new))
    with pytest.raises(CalibrationError, match=message):
        read_rig(path)
