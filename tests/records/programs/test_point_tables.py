"""OpenCorr's tables."""

import struct

import meshio
import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
    write_table,
)
from scipy.spatial.transform import Rotation

from palpate.errors import RecordError
from palpate.records import in_object_frame, measured_rows
from palpate.records.programs.registry import read_measured

_PLANAR = np.array(
    [[10, 20, 1, 2, 1, 2, 0.1, -0.2], [30, 40, 1, 2, 3, 4, np.nan, 0.1]], dtype=float
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
    assert measured.notes == ("It has no columns ZNCC, so failed points cannot be recognised.",)


def test_opencorr_matches_that_hardly_correlate_are_no_measurements(tmp_path):
    """A correlation of 0.07 is chance: 0.75 is asked for, or what the caller says."""
    rows = _opencorr_rows()
    rows[0, 7] = 0.07
    rows[1, 5] = 0.74
    path = write_table(tmp_path / "a.csv", OPENCORR, rows)
    for least, left in ((None, [2]), (0.5, [1, 2]), (0.0, [0, 1, 2]), (0.965, [])):
        if not left:
            with pytest.raises(RecordError, match=r"3 correlate by less than 0.965 \(--min-score"):
                read_measured("opencorr", path, min_score=least)
            continue
        measured = read_measured("opencorr", path, min_score=least)
        assert list(np.flatnonzero(measured_rows(measured.displacement))) == left
        assert measured.poorly_correlated == 3 - len(left)
    with pytest.raises(RecordError, match="--min-score is 75; must be a correlation"):
        read_measured("opencorr", path, min_score=75.0)
    bare = write_table(tmp_path / "b.csv", "u,v,w,ref_x,ref_y,ref_z", np.ones((2, 6)))
    with pytest.raises(RecordError, match="has no correlation of its points"):
        read_measured("opencorr", bare, min_score=0.5)


def _pyvale_rows(*, flag=5):
    rows = np.ones((4, 24))
    rows[:, 13:16], rows[:, 16:19] = MOVE, PLACE + MOVE
    rows[~GOOD, flag] = 0.0
    return rows


@pytest.mark.parametrize("flag", [5, 19])
def test_pyvale_text(tmp_path, flag):
    # The header ends with a separator, the rows do not.
    path = write_table(tmp_path / "a.csv", PYVALE + ",", _pyvale_rows(flag=flag))
    measured = read_measured("pyvale", path)
    # rest = loaded - displacement: 300 mm to one rounding.
    np.testing.assert_allclose(measured.points, 1e-3 * PLACE, rtol=0.0, atol=1e-16)
    assert list(measured_rows(measured.displacement)) == list(GOOD)
    np.testing.assert_array_equal(measured.displacement[GOOD], 1e-3 * MOVE[GOOD])
    assert measured.notes == ()


def test_pyvale_points_that_were_not_triangulated(tmp_path):
    rows = _pyvale_rows()
    rows[~GOOD, 5] = 1.0
    rows[~GOOD, 13:19] = 0.0
    measured = read_measured("pyvale", write_table(tmp_path / "a.csv", PYVALE, rows))
    assert list(measured_rows(measured.displacement)) == list(GOOD)
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
    assert list(measured_rows(measured.displacement)) == list(GOOD)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(RecordError, match="647 bytes, no whole number of rows of 162"):
        read_measured("pyvale", path)
    path.unlink()
    with pytest.raises(RecordError, match="cannot be read"):
        read_measured("pyvale", path)


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
    with pytest.raises(RecordError, match="No such file"):
        read_measured("vtu", path, length_unit="mm")
    with pytest.raises(RecordError, match=r"is no \.vtu file"):
        read_measured("vtu", tmp_path / "a.vtp", length_unit="mm")


def test_vtu_needs_a_unit(tmp_path):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    with pytest.raises(RecordError, match="does not say its unit of length; say it with --length"):
        read_measured("vtu", path)


def test_one_camera_leaves_the_depth_unknown(tmp_path):
    path = write_table(tmp_path / "a.csv", "x,y,u,v,X [mm],Y [mm],U [mm],V [mm]", _PLANAR)
    measured = read_measured("planar", path)
    np.testing.assert_allclose(measured.points, [[1e-3, 2e-3, 0.0], [3e-3, 4e-3, 0.0]])
    np.testing.assert_array_equal(measured.displacement, [[1e-4, -2e-4, np.nan], [np.nan] * 3])
    # Looking along y: what was y is z.
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    turned = in_object_frame(measured, turn)
    np.testing.assert_allclose(turned.displacement[0], [1e-4, np.nan, -2e-4])
    np.testing.assert_allclose(turned.points[1], [3e-3, 0.0, 4e-3])
    turn[:3, :3] = Rotation.from_rotvec([0.1, 0.0, 0.0]).as_matrix()
    # Of what lies along x everything is known still.
    assert np.isfinite(in_object_frame(measured, turn).displacement[0]).tolist() == [1, 0, 0]
    turn[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.0]).as_matrix()
    with pytest.raises(RecordError, match="in a plane alone, which lies across the axes"):
        in_object_frame(measured, turn)


def test_pixels_of_one_camera_are_no_lengths(tmp_path):
    path = write_table(tmp_path / "a.csv", "x,y,u,v", _PLANAR[:, :4])
    with pytest.raises(RecordError, match="does not say its unit"):
        read_measured("planar", path)
    path = write_table(tmp_path / "b.csv", "x,y,u", _PLANAR[:, :3])
    with pytest.raises(RecordError, match="the column 'v' is missing; export x, y, u, v"):
        read_measured("planar", path, length_unit="mm")
