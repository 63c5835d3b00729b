"""Result tables of image correlation programs: every layout gives the same four points."""

import re
import struct

import numpy as np
import pytest
from program_files import GOOD, MOVE, PLACE, check_four_points, vic3d_rows, write_table

from palpate.errors import RecordError
from palpate.records.import_displacement import IMPORT_KINDS, read_measured
from palpate.records.programs.measured_points import measured_rows

VIC3D = '"x","y","u","v","sigma","X","Y","Z","U","V","W"'
MATCHID = (
    "Coordinates.Image X [Pixel];coor.X [mm];coor.Y [mm];coor.Z [mm];"
    "disp.Horizontal Displacement U [mm];disp.Vertical Displacement V [mm];"
    "disp.Out-Of-Plane: W [mm];stats.Sigma [mm]"
)
OPENCORR = (
    "x,y,u,v,w,r1r2 ZNCC,r1t1 ZNCC,r1t2 ZNCC,r2_x,r2_y,t1_x,t1_y,t2_x,t2_y,"
    "ref_x,ref_y,ref_z,tar_x,tar_y,tar_z"
)
PYVALE = (
    '"subset_x","subset_y","disp_u","disp_v","disp_mag","converged","cost_zncc","ftol","xtol",'
    '"num_iter","stereo_disp_u_px","stereo_disp_v_px","stereo_disp_mag_px","stereo_disp_u_mm",'
    '"stereo_disp_v_mm","stereo_disp_w_mm","stereo_x_mm","stereo_y_mm","stereo_z_mm",'
    '"stereo_converged","stereo_cost_zncc","stereo_ftol","stereo_xtol","stereo_num_iter"'
)


def _opencorr_rows():
    score = np.where(GOOD, 0.97, -3.0)
    scores = np.column_stack([np.full(4, 0.98), score, np.full(4, 0.96)])
    return np.column_stack([np.zeros((4, 2)), MOVE, scores, np.zeros((4, 6)), PLACE, PLACE + MOVE])


def _pyvale_rows(*, flag=5):
    rows = np.ones((4, 24))
    rows[:, 13:16], rows[:, 16:19] = MOVE, PLACE + MOVE
    rows[~GOOD, flag] = 0.0
    return rows


def test_kinds_are_those_of_the_command():
    assert list(IMPORT_KINDS) == [
        "dice",
        "vic3d",
        "matchid",
        "pyvale",
        "opencorr",
        "multidic",
        "duodic",
        "vtu",
    ]


def test_unknown_kind():
    with pytest.raises(RecordError, match="kind is 'gom'; must be one of dice, vic3d"):
        read_measured("gom", "a.csv")


# VIC-3D ------------------------------------------------------------------------------------------


def test_vic3d(tmp_path):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    measured = read_measured("vic3d", path)
    check_four_points(measured, nowhere=True)
    assert (measured.kind, measured.source, measured.std) == ("vic3d", str(path), None)
    assert measured.notes == ("It does not tell its unit of length; mm was taken (--length-unit).",)


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
    assert measured_rows(measured).all()
    assert measured.notes == ("It has no column sigma, so failed points cannot be told.",)


def test_vic3d_planar_result(tmp_path):
    path = write_table(tmp_path / "a.csv", '"x","y","X","Y","U","V","sigma"', np.ones((2, 7)))
    with pytest.raises(RecordError, match="'Z' is missing; it is a 2-D result, and depth"):
        read_measured("vic3d", path)


def test_vic3d_pixels_only(tmp_path):
    path = write_table(tmp_path / "a.csv", "x,y,z,u,v,w,sigma", np.ones((2, 7)))
    with pytest.raises(RecordError, match=r"'X' is missing; export X, Y, Z.*it has: x, y, z, u"):
        read_measured("vic3d", path)


def test_columns_in_different_units(tmp_path):
    path = write_table(tmp_path / "a.csv", "X [mm],Y [mm],Z [mm],U [m],V [m],W [m]", np.eye(6))
    with pytest.raises(RecordError, match=r"different units \(X \[mm\].*U \[m\]"):
        read_measured("vic3d", path)


# MatchID -----------------------------------------------------------------------------------------


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


# OpenCorr ----------------------------------------------------------------------------------------


def test_opencorr_with_and_without_trailing_commas(tmp_path):
    for header, end in ((OPENCORR, ""), (OPENCORR + ",", ",")):
        path = write_table(tmp_path / "a.csv", header, _opencorr_rows(), end=end)
        check_four_points(read_measured("opencorr", path))


@pytest.mark.parametrize("column", [5, 6, 7])
def test_opencorr_any_score_of_zero_is_a_failure(tmp_path, column):
    rows = _opencorr_rows()
    rows[~GOOD, 5:8] = 0.9
    rows[~GOOD, column] = 0.0
    check_four_points(read_measured("opencorr", write_table(tmp_path / "a.csv", OPENCORR, rows)))


def test_opencorr_without_scores_says_so(tmp_path):
    rows = np.column_stack([MOVE, PLACE])[GOOD]
    path = write_table(tmp_path / "a.csv", "u,v,w,ref_x,ref_y,ref_z", rows)
    measured = read_measured("opencorr", path, length_unit="mm")
    assert measured.notes == ("It has no columns ZNCC, so failed points cannot be told.",)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("x,y,u0,v0,u,v,exx,eyy,exy,zncc", "'w' is missing; it is a 2-D table"),
        ("x,y,z,u,v,w,u0,v0,w0,ZNCC", "'ref_x' is missing; it is a volume table"),
        ("x,y,u,v,w,r1r2 ZNCC,r2_x,r2_y", "table of a reconstruction alone or of an old version"),
    ],
)
def test_opencorr_other_tables(tmp_path, header, message):
    path = write_table(tmp_path / "a.csv", header, np.ones((2, len(header.split(",")))))
    with pytest.raises(RecordError, match=message):
        read_measured("opencorr", path)


# pyvale ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flag", [5, 19])
def test_pyvale_text(tmp_path, flag):
    # The header ends with a separator, the rows do not.
    path = write_table(tmp_path / "a.csv", PYVALE + ",", _pyvale_rows(flag=flag))
    measured = read_measured("pyvale", path)
    # rest = loaded - displacement: 300 mm to one rounding.
    np.testing.assert_allclose(measured.points, 1e-3 * PLACE, rtol=0.0, atol=1e-16)
    assert list(measured_rows(measured)) == list(GOOD)
    np.testing.assert_array_equal(measured.displacement[GOOD], 1e-3 * MOVE[GOOD])
    assert measured.notes == ()


def test_pyvale_points_that_were_not_triangulated(tmp_path):
    rows = _pyvale_rows()
    rows[~GOOD, 5] = 1.0
    rows[~GOOD, 13:19] = 0.0
    measured = read_measured("pyvale", write_table(tmp_path / "a.csv", PYVALE, rows))
    assert list(measured_rows(measured)) == list(GOOD)
    assert np.isnan(measured.points[~GOOD]).all()


@pytest.mark.parametrize("flag", [5, 19])
def test_pyvale_binary(tmp_path, flag):
    path = tmp_path / "a.dic3d"
    path.write_bytes(
        b"".join(
            # Field by field as ResultArrays::write_to_disk_stereo writes them.
            struct.pack("<2i3dB3di", 7, 8, *row[2:5], int(row[5]), *row[6:9], 9)
            + struct.pack("<9dB3di", *row[10:19], int(row[19]), *row[20:23], 9)
            for row in _pyvale_rows(flag=flag)
        )
    )
    measured = read_measured("pyvale", path)
    np.testing.assert_allclose(measured.points, 1e-3 * PLACE, rtol=0.0, atol=1e-16)
    assert list(measured_rows(measured)) == list(GOOD)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RecordError, match="647 bytes, no whole number of rows of 162"):
        read_measured("pyvale", path)
    path.unlink()
    with pytest.raises(RecordError, match="cannot be read"):
        read_measured("pyvale", path)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("subset_x,subset_y,disp_u,disp_v", "it is a 2-D result, and depth is needed"),
        ("a,b,c,d", "give a stereo result of pyvale with its header"),
    ],
)
def test_pyvale_other_tables(tmp_path, header, message):
    path = write_table(tmp_path / "a.csv", header, np.ones((2, 4)))
    with pytest.raises(RecordError, match=message):
        read_measured("pyvale", path)


# All ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "metres"), [("um", 1e-6), ("mm", 1e-3), ("cm", 1e-2), ("m", 1.0), ("in", 0.0254)]
)
def test_units(tmp_path, unit, metres):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    measured = read_measured("vic3d", path, length_unit=unit)
    assert measured.points[1, 1] == metres * 5.0
    assert measured.displacement[1, 2] == metres * -0.06
    assert measured.notes == ()


@pytest.mark.parametrize("word", ["\u00b5m", "\u03bcm", "micron"])
def test_units_as_they_are_spelled(tmp_path, word):
    header = ",".join(f"{name} [{word}]" for name in "XYZUVW") + ",sigma"
    path = write_table(tmp_path / "a.csv", header, np.ones((2, 7)))
    assert read_measured("vic3d", path).points[0, 0] == 1e-6


@pytest.mark.parametrize(
    ("kind", "unit", "message"),
    [
        ("matchid", "m", "its header says mm, --length-unit says m; leave the option out"),
        ("matchid", "furlong", "--length-unit is 'furlong'; must be one of um mm cm m in"),
    ],
)
def test_units_that_contradict_or_are_unknown(tmp_path, kind, unit, message):
    path = write_table(tmp_path / "a.csv", MATCHID, np.ones((2, 8)), delimiter=";")
    with pytest.raises(RecordError, match=re.escape(message)):
        read_measured(kind, path, length_unit=unit)


@pytest.mark.parametrize("kind", ["vic3d", "matchid", "opencorr", "pyvale", "vtu"])
def test_files_of_one_state_have_one_frame(tmp_path, kind):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    with pytest.raises(RecordError, match="has no frame 1; it holds 1, so leave --frame out"):
        read_measured(kind, path, frame=1)


def test_nothing_measured(tmp_path):
    rows = vic3d_rows()
    rows[:, 4] = -1.0
    path = write_table(tmp_path / "a.csv", VIC3D, rows)
    with pytest.raises(RecordError, match="not one of its 4 points was measured"):
        read_measured("vic3d", path)


def test_infinity_is_no_measurement(tmp_path):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    path.write_text(path.read_text().replace("0.05", "1.#INF"))
    assert list(measured_rows(read_measured("vic3d", path))) == [True, False, True, False]
    path.write_text(path.read_text().replace("1.#INF", "inf"))
    assert list(measured_rows(read_measured("vic3d", path))) == [True, False, True, False]
