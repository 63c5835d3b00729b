"""Stereo results of pyvale, text and binary."""

import struct

import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    write_table,
)

from palpate.errors import RecordError
from palpate.records.probing import measured_rows
from palpate.records.programs.registry import read_measured

PYVALE = (
    '"subset_x","subset_y","disp_u","disp_v","disp_mag","converged","cost_zncc","ftol","xtol",'
    '"num_iter","stereo_disp_u_px","stereo_disp_v_px","stereo_disp_mag_px","stereo_disp_u_mm",'
    '"stereo_disp_v_mm","stereo_disp_w_mm","stereo_x_mm","stereo_y_mm","stereo_z_mm",'
    '"stereo_converged","stereo_cost_zncc","stereo_ftol","stereo_xtol","stereo_num_iter"'
)


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
