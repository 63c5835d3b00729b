"""Binary results of image correlation programs: every layout gives the same four points."""

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
    check_four_points,
    dice_states,
    dice_values,
    multidic_states,
    write_exodus,
    write_mat,
    write_table,
)

from palpate.errors import InputError, RecordError
from palpate.records.import_displacement import read_measured
from palpate.records.programs.measured_points import measured_rows

# DICe --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", " "])
def test_dice_text(tmp_path, delimiter):
    header = "***\n*** Incremental correlation: false\n***\n" + delimiter.join(DICE_NAMES)
    path = write_table(tmp_path / "a.txt", header, dice_values(), delimiter=delimiter)
    check_four_points(read_measured("dice", path))


@pytest.mark.parametrize("column", ["SIGMA", "MATCH"])
def test_dice_tells_failure_by_either_column(tmp_path, column):
    keep = [i for i, name in enumerate(DICE_NAMES) if name != column]
    header = ",".join(DICE_NAMES[i] for i in keep)
    check_four_points(
        read_measured("dice", write_table(tmp_path / "a.txt", header, dice_values()[:, keep]))
    )


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


# MultiDIC and DuoDIC -----------------------------------------------------------------------------


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


# VTU ---------------------------------------------------------------------------------------------


def _write_vtu(path, data, *, cells=(("triangle", [[0, 1, 2], [0, 2, 3]]),), points=PLACE):
    meshio.Mesh(points, list(cells), point_data=data).write(path)
    return path


@pytest.mark.parametrize("suffix", [".vtu", ".vtk"])
@pytest.mark.parametrize("name", ["displacement", "U", "Displacement"])
def test_vtu(tmp_path, suffix, name):
    move = np.where(GOOD[:, None], MOVE, np.nan)
    data = {name: move, "displacement_std": np.full((4, 3), 0.002)}
    measured = read_measured("vtu", _write_vtu(tmp_path / f"a{suffix}", data), length_unit="mm")
    check_four_points(measured)
    np.testing.assert_allclose(measured.std[GOOD], 2e-6, rtol=1e-15)


def test_vtu_components_and_one_sigma(tmp_path):
    data = {f"u{axis}": np.where(GOOD, MOVE[:, i], np.nan) for i, axis in enumerate("xyz")}
    data["sigma"] = np.array([0.001, 0.002, 0.003, np.nan])
    measured = read_measured("vtu", _write_vtu(tmp_path / "a.vtu", data), length_unit="mm")
    check_four_points(measured)
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


def test_vtu_needs_its_package(tmp_path, monkeypatch):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InputError, match=r"pip install 'palpate\[mesh\]'"):
        read_measured("vtu", path, length_unit="mm")


def test_vtu_needs_a_unit(tmp_path):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    with pytest.raises(RecordError, match="does not tell its unit of length; say it with --length"):
        read_measured("vtu", path)
