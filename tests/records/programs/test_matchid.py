"""MatchID: its columns, and its calibration of a rig judged by DICe's matches."""

import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
    dice_gold,
    gold_columns,
    write_table,
)

from palpate.errors import CalibrationError, RecordError
from palpate.records import read_rig
from palpate.records.program import rotation_from_angles
from palpate.records.programs.registry import read_measured
from palpate.vision import triangulate

MATCHID = (
    "Coordinates.Image X [Pixel];coor.X [mm];coor.Y [mm];coor.Z [mm];"
    "disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    "disp.Out-Of-Plane: W [mm];stats.Sigma [mm]"
)


def test_matchid_with_decimal_commas(tmp_path):
    rows = [
        "0;" + ";".join(repr(float(x)) for x in (*place, *move)) + ";0.001"
        for place, move in zip(PLACE, MOVE, strict=True)
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
    found = triangulate(read_rig(path), np.stack([left, right]), 0.05)
    # Any other order of the angles leaves 0.4 px or more.
    assert np.sqrt(np.mean(found.residual**2)) < 0.07


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
