"""Result files of image correlation programs: every layout gives the same four points."""

import re
import struct
import sys

import h5py
import meshio
import numpy as np
import pytest
from program_files import (
    DICE_NAMES,
    GOOD,
    MOVE,
    PLACE,
    dice_states,
    dice_values,
    multidic_states,
    vic3d_rows,
    write_exodus,
    write_mat,
    write_table,
)

from palpate.errors import InputError, RecordError
from palpate.records.import_displacement import IMPORT_KINDS, read_measured
from palpate.records.measured_points import measured_rows

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


def _check(measured, *, nowhere=False):
    """The four points in metres; the failed one as NaN, with or without its place."""
    # The largest number is 302.5 mm; one rounding of the sum of place and displacement.
    exact = {"rtol": 0.0, "atol": 1e-16}
    assert list(measured_rows(measured)) == list(GOOD)
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], **exact)
    place = np.where((GOOD | (not nowhere))[:, None], 1e-3 * PLACE, np.nan)
    np.testing.assert_allclose(measured.points, place, **exact)


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


# VIC-3D ----------------------------------------------------------------------------------------


def test_vic3d(tmp_path):
    path = write_table(tmp_path / "a.csv", VIC3D, vic3d_rows())
    measured = read_measured("vic3d", path)
    _check(measured, nowhere=True)
    assert (measured.kind, measured.source, measured.std) == ("vic3d", str(path), None)
    assert measured.notes == ("It does not tell its unit of length; mm was taken (--length-unit).",)


def test_vic3d_perfect_match_is_no_failure(tmp_path):
    rows = vic3d_rows()
    rows[0, 4] = 0.0
    _check(read_measured("vic3d", write_table(tmp_path / "a.csv", VIC3D, rows)), nowhere=True)


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


# MatchID ---------------------------------------------------------------------------------------


def test_matchid_with_decimal_commas(tmp_path):
    rows = [
        "0;" + ";".join(repr(float(x)) for x in (*place, *move)) + ";0.001"
        for place, move in zip(PLACE, MOVE, strict=True)
    ]
    rows[3] = "0;3.0;3.0;299.0;NeuN;n. def.;NaN;"
    path = tmp_path / "a.csv"
    path.write_text("\n".join([MATCHID, *rows]).replace(".0", ",0"), encoding="utf-8")
    measured = read_measured("matchid", path)
    _check(measured)
    assert measured.notes == ("The column Sigma was left out: it does not say whose error it is.",)


def test_matchid_short_names(tmp_path):
    header = "x_pic,y_pic,x,y,z,u,v,w,exx"
    move = np.where(GOOD[:, None], MOVE, np.nan)
    rows = np.column_stack([np.zeros((4, 2)), PLACE, move, np.zeros(4)])
    _check(read_measured("matchid", write_table(tmp_path / "a.csv", header, rows)))


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


# OpenCorr --------------------------------------------------------------------------------------


def test_opencorr_with_and_without_trailing_commas(tmp_path):
    for header, end in ((OPENCORR, ""), (OPENCORR + ",", ",")):
        path = write_table(tmp_path / "a.csv", header, _opencorr_rows(), end=end)
        _check(read_measured("opencorr", path))


@pytest.mark.parametrize("column", [5, 6, 7])
def test_opencorr_any_score_of_zero_is_a_failure(tmp_path, column):
    rows = _opencorr_rows()
    rows[~GOOD, 5:8] = 0.9
    rows[~GOOD, column] = 0.0
    _check(read_measured("opencorr", write_table(tmp_path / "a.csv", OPENCORR, rows)))


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


# pyvale ----------------------------------------------------------------------------------------


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


# DICe ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", " "])
def test_dice_text(tmp_path, delimiter):
    header = "***\n*** Incremental correlation: false\n***\n" + delimiter.join(DICE_NAMES)
    path = write_table(tmp_path / "a.txt", header, dice_values(), delimiter=delimiter)
    _check(read_measured("dice", path))


@pytest.mark.parametrize("column", ["SIGMA", "MATCH"])
def test_dice_tells_failure_by_either_column(tmp_path, column):
    keep = [i for i, name in enumerate(DICE_NAMES) if name != column]
    header = ",".join(DICE_NAMES[i] for i in keep)
    _check(read_measured("dice", write_table(tmp_path / "a.txt", header, dice_values()[:, keep])))


def test_dice_without_signs_of_failure_says_so(tmp_path):
    path = write_table(tmp_path / "a.txt", ",".join(DICE_NAMES[:7]), dice_values()[:, :7])
    measured = read_measured("dice", path, length_unit="cm")
    assert measured_rows(measured).all()
    assert measured.points[0, 0] == 0.01
    assert measured.notes == ("It has no MATCH and no SIGMA, so failed points cannot be told.",)


def test_dice_incremental(tmp_path):
    header = "*** Incremental correlation: true\n" + ",".join(DICE_NAMES)
    path = write_table(tmp_path / "a.txt", header, dice_values())
    with pytest.raises(RecordError, match="from picture to picture"):
        read_measured("dice", path)


@pytest.mark.parametrize("form", ["large", "small", "hdf5"])
def test_dice_exodus(tmp_path, form):
    path = write_exodus(tmp_path / "a.e", dice_states(), form=form)
    measured = read_measured("dice", path)
    # hdf5 is written in single precision, as DICe does.
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], rtol=1e-7)
    np.testing.assert_allclose(measured.points, 1e-3 * PLACE, rtol=1e-7)
    assert list(measured_rows(measured)) == list(GOOD)
    assert measured.notes[0] == "It holds 3 states; the last, frame 2, was read (--frame)."
    half = read_measured("dice", path, frame=1)
    np.testing.assert_allclose(half.displacement, 0.5 * measured.displacement, rtol=1e-7)


def test_dice_exodus_refusals(tmp_path):
    path = write_exodus(tmp_path / "a.e", dice_states(), form="large")
    with pytest.raises(RecordError, match=r"every displacement is exactly zero.*--frame"):
        read_measured("dice", path, frame=0)
    with pytest.raises(RecordError, match="has no frame 3; it holds 3, numbered 0 to 2"):
        read_measured("dice", path, frame=3)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("dice", path)
    path.write_bytes(b"CDF\x05" + whole[4:])
    with pytest.raises(RecordError, match="is not an Exodus file in NetCDF's classic"):
        read_measured("dice", path)
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(64))
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("dice", path)
    path.unlink()
    with pytest.raises(RecordError, match="cannot be read"):
        read_measured("dice", path)


def test_dice_exodus_without_states_or_depth(tmp_path):
    path = write_exodus(tmp_path / "a.e", dice_states()[:0], form="hdf5")
    with pytest.raises(RecordError, match="holds no state"):
        read_measured("dice", path)
    path = write_exodus(tmp_path / "b.e", dice_states(), form="large")
    path.write_bytes(path.read_bytes().replace(b"MODEL_DISPLACEMENT_Z", b"SOMETHING_ELSE_OF_IT"))
    with pytest.raises(RecordError, match="has no MODEL_DISPLACEMENT_Z; it is a 2-D result"):
        read_measured("dice", path)


def test_dice_real_results(shared_data):
    """The known noise of the static series, and the four subsets that failed in the other."""
    static = shared_data / "real" / "dice_stereo_static" / "gold" / "DICe_solution_auto.e"
    measured = read_measured("dice", static)
    assert measured_rows(measured).sum() == 189
    # ../shared/data/real/dice_stereo_static/README.md: 0.7 / 0.4 / 3.2 um, rounded.
    spread = 1e6 * measured.displacement.std(axis=0)
    np.testing.assert_allclose(spread, [0.7, 0.4, 3.2], atol=0.05)
    gold = shared_data / "real" / "gt4_dspec" / "dice_gold"
    tension = read_measured("dice", gold / "DICe_solution.e", frame=-1)
    assert (~measured_rows(tension)).sum() == 4
    # Its README: motion is at most 18 um; the points scatter by some um about it.
    assert 15.0 < 1e6 * np.nanmedian(np.linalg.norm(tension.displacement, axis=1)) < 21.0
    with pytest.raises(RecordError, match="has no MODEL_COORDINATES_X; it is a 2-D result"):
        read_measured("dice", gold / "DICe_solution_2.txt")


# MultiDIC and DuoDIC ---------------------------------------------------------------------------


@pytest.mark.parametrize(("kind", "name"), [("duodic", "DIC3D"), ("multidic", "DIC3Dcombined")])
@pytest.mark.parametrize("version", ["5", "7.3"])
def test_multidic(tmp_path, kind, name, version):
    path = write_mat(tmp_path / "a.mat", name, multidic_states(), version=version)
    measured = read_measured(kind, path)
    assert list(measured_rows(measured)) == list(GOOD)
    # The difference of two places of 300 mm, each rounded to 6e-14 mm.
    np.testing.assert_allclose(measured.displacement[GOOD], 1e-3 * MOVE[GOOD], atol=1e-16)
    np.testing.assert_allclose(measured.points[GOOD], 1e-3 * PLACE[GOOD], atol=1e-16)
    assert np.isnan(measured.points[~GOOD]).all()
    half = read_measured(kind, path, frame=1)
    np.testing.assert_allclose(half.displacement[GOOD], 0.5e-3 * MOVE[GOOD], atol=1e-16)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_multidic_refusals(tmp_path, version):
    states = multidic_states()
    path = tmp_path / "a.mat"
    for found, message in (
        (states[:1], "Points3D holds 1 state"),
        ([state[:, :2] for state in states], "are n x 2; must be n x 3"),
        ([states[0], states[1][:3], states[2]], "differ in size"),
    ):
        with pytest.raises(RecordError, match=message):
            read_measured("multidic", write_mat(path, "DIC3D", found, version=version))
    write_mat(path, "DIC3D", states, version=version)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordError, match="is damaged or cut off"):
        read_measured("multidic", path)
    write_mat(path, "a", states, version=version)
    if version == "7.3":
        with h5py.File(path, "r+") as file:
            file["b/Points3D"] = file["a/Points3D"]
        with pytest.raises(RecordError, match=r"several structs with Points3D \(a, b\)"):
            read_measured("multidic", path)


def test_multidic_no_matlab_file(tmp_path):
    path = tmp_path / "a.mat"
    path.write_text("x,y,z")
    with pytest.raises(RecordError, match="is not a MATLAB file of version"):
        read_measured("multidic", path)
    path.unlink()
    with pytest.raises(RecordError, match="cannot be read"):
        read_measured("multidic", path)


def test_multidic_real_files_of_earlier_steps(shared_data):
    folder = shared_data / "real" / "multidic_pair"
    file = folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat"
    with pytest.raises(RecordError, match=r"it is the 2-D result of step 2.*DIC2DpairResults"):
        read_measured("multidic", file)
    file = folder / "calibrationObjectImages" / "DLTstruct_cam_201.mat"
    with pytest.raises(RecordError, match=r"no result of step 3.*it has: DLTstructCam$"):
        read_measured("multidic", file)


# VTU -------------------------------------------------------------------------------------------


def _write_vtu(path, data, *, cells=(("triangle", [[0, 1, 2], [0, 2, 3]]),), points=PLACE):
    meshio.Mesh(points, list(cells), point_data=data).write(path)
    return path


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize("name", ["displacement", "U", "Displacement"])
def test_vtu(tmp_path, suffix, name):
    move = np.where(GOOD[:, None], MOVE, np.nan)
    data = {name: move, "displacement_std": np.full((4, 3), 0.002)}
    measured = read_measured("vtu", _write_vtu(tmp_path / f"a{suffix}", data), length_unit="mm")
    _check(measured)
    np.testing.assert_allclose(measured.std[GOOD], 2e-6, rtol=1e-15)


def test_vtu_components_and_one_sigma(tmp_path):
    data = {f"u{axis}": np.where(GOOD, MOVE[:, i], np.nan) for i, axis in enumerate("xyz")}
    data["sigma"] = np.array([0.001, 0.002, 0.003, np.nan])
    measured = read_measured("vtu", _write_vtu(tmp_path / "a.vtu", data), length_unit="mm")
    _check(measured)
    np.testing.assert_allclose(measured.std[1], 2e-6, rtol=1e-15)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({}, "has no point data 'displacement'.*it has: no point data"),
        ({"dispacement": MOVE}, "did you mean 'displacement'"),
        ({"displacement": MOVE[:, :2]}, "has 2 components; depth is needed"),
        ({"u": MOVE, "std": np.ones((4, 2))}, "'std' has 2 components; must be 1 or 3"),
    ],
)
def test_vtu_refusals(tmp_path, data, message):
    with pytest.raises(RecordError, match=message):
        read_measured("vtu", _write_vtu(tmp_path / "a.vtu", data), length_unit="mm")


def test_vtu_that_is_no_surface_or_none_at_all(tmp_path):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE}, cells=[("tetra", [[0, 1, 2, 3]])])
    with pytest.raises(RecordError, match=r"holds solid cells \(tetra\).*Extract Surface"):
        read_measured("vtu", path, length_unit="mm")
    path.write_text("<VTKFile/>")
    with pytest.raises(RecordError, match="cannot be read as VTU"):
        read_measured("vtu", path, length_unit="mm")
    path.unlink()
    with pytest.raises(RecordError, match="no such file"):
        read_measured("vtu", path, length_unit="mm")
    with pytest.raises(RecordError, match=r"is no \.vtu file"):
        read_measured("vtu", tmp_path / "a.vtp", length_unit="mm")


# All -------------------------------------------------------------------------------------------


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
        ("vtu", None, "does not tell its unit of length; say it with --length-unit"),
    ],
)
def test_units_that_contradict_or_are_missing(tmp_path, kind, unit, message):
    if kind == "vtu":
        path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    else:
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


def test_vtu_needs_its_package(tmp_path, monkeypatch):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InputError, match=r"pip install 'palpate\[mesh\]'"):
        read_measured("vtu", path, length_unit="mm")
