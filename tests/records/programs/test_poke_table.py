"""One table in three kinds of file."""

import numpy as np
import pytest
from scipy.io import savemat

from palpate.records import read_poke_table

ROWS = np.array(
    [[0.0, 1.0, 30.0, 2.0, 7], [0.0, 1.0, 29.0, 40.0, 7], [5.0, 1.0, np.nan, 3.0, 8],
     [5.0, 1.0, 29.5, 9.0, 8]]
)  # fmt: skip
NAMES = ("x", "y", "z", "force", "poke")


@pytest.fixture(params=["csv", "npz", "mat", "vectors"])
def file(request, tmp_path):
    columns = dict(zip(NAMES, ROWS.T, strict=True))
    if request.param == "csv":
        path = tmp_path / "pokes.csv"
        np.savetxt(path, ROWS, delimiter=",", header=",".join(NAMES), comments="")
    elif request.param == "mat":
        path = tmp_path / "pokes.mat"
        savemat(path, columns)
    else:
        path = tmp_path / "pokes.npz"
        if request.param == "vectors":
            columns = {"position": ROWS[:, :3], "force": ROWS[:, 3], "poke": ROWS[:, 4]}
        np.savez(path, **columns)
    return path


def test_they_are_read_alike(file):
    table = read_poke_table(file, force_unit="mN")
    np.testing.assert_allclose(table.position, 1e-3 * ROWS[[0, 1, 3], :3])
    np.testing.assert_allclose(table.force[:, 0], 1e-3 * ROWS[[0, 1, 3], 3])
    np.testing.assert_array_equal(table.poke, [0, 0, 1])
    np.testing.assert_array_equal(table.normal, np.tile([0.0, 0.0, 1.0], (3, 1)))
    assert table.without_number == 1


def test_headings_name_units_and_columns_are_named(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "px [m],py [m],pz [m],load [gf],a,b,c\n0,0,0.03,100,0,0,2\n0,0,0.02,200,0,0,2\n"
    )
    table = read_poke_table(
        path, position=("px", "py", "pz"), force=("load",), normal=("a", "b", "c")
    )
    np.testing.assert_allclose(table.position[:, 2], [0.03, 0.02])
    np.testing.assert_allclose(table.force[:, 0], [0.980665, 1.96133])
    np.testing.assert_allclose(table.normal, np.tile([0.0, 0.0, 1.0], (2, 1)))
    assert table.poke is None
