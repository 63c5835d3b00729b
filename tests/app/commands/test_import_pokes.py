"""`palpate import pokes`: from a table to a session that reads and checks, or one clear message."""

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import write_mesh
from palpate.records import read_session, without_pictures


def rows(start=0.0):
    """Nine pokes of a half space of 30 kPa, ten samples each [mm, N]."""
    stiffness = 4.0 / 3.0 * 30e3 / 0.75 * np.sqrt(4e-3)
    read_rows = []
    for k in range(9):
        for depth in np.linspace(0.2, 2.0, 10):
            force = stiffness * (1e-3 * max(depth - start, 0.0)) ** 1.5
            read_rows.append(
                [k, 10.0 + 10.0 * (k % 3), 10.0 + 10.0 * (k // 3), 30.0 - depth, force]
            )
    return np.array(read_rows)


@pytest.fixture
def pokes(palpate, tmp_path):
    """Function that imports some rows: (exit code, output, errors)."""

    def run(values, *options, header="poke,x,y,z,force"):
        np.savetxt(tmp_path / "t.csv", values, delimiter=",", header=header, comments="")
        words = ("--tool-radius", "4mm", *options)
        if "--surface" not in options:
            words = (*words, "--thickness", "20mm")
        return palpate("import", "pokes", "t.csv", *words)

    return run


def test_a_table_becomes_a_session(pokes, palpate, tmp_path):
    values = rows()
    values[17, 4] = np.nan
    code, out, errors = pokes(values)
    assert (code, "9 pokes, 89 samples" in out) == (0, True)
    assert "1 rows in which a number is missing" in errors
    assert "30 kPa" in errors
    session = read_session(tmp_path / "t-session")
    assert without_pictures(session)
    assert np.ptp(session.mesh.vertices, axis=0) == pytest.approx([0.06, 0.06, 0.02])
    code, out, _ = palpate("check", "t-session")
    assert code == 0
    assert "9" in out


def test_a_mesh_is_taken_for_the_body(pokes, tmp_path):
    write_mesh(tmp_path / "block.ply", box(size=(0.04, 0.04, 0.03), cells=4))
    code, _, errors = pokes(rows(), "--surface", "block.ply", "--surface-unit", "m")
    assert code == 0, errors
    assert np.ptp(read_session(tmp_path / "t-session").mesh.vertices[:, 2]) == pytest.approx(0.03)


def test_what_is_wrong_is_said(pokes, tmp_path):
    values = rows()
    write_mesh(tmp_path / "block.ply", box(size=(0.04, 0.04, 0.02), cells=4))
    off = ("--surface", "block.ply", "--surface-unit", "m")
    inward = np.column_stack([values, np.tile([0.0, 0.0, -1.0], (len(values), 1))])
    cases = [
        (values, (), "poke,x,y,z,load", ("no column of the force", "--force-columns")),
        (values * [1, 1, 1, 1, 0], (), "poke,x,y,z,force", ("0 of 9 pokes have contact", "unit")),
        (inward, (), "poke,x,y,z,force,nx,ny,nz", ("normals point inward", "out of the body")),
        (values, off, "poke,x,y,z,force", ("9 of 9 pokes are off the surface", "--surface-unit")),
        (values[::5], (), "poke,x,y,z,force", ("has 2 samples", "at least 3")),
        (values, ("--force-unit", "g"), "poke,x,y,z,force", ("gf",)),
    ]
    for given, options, header, phrases in cases:
        code, _, errors = pokes(given, *options, header=header)
        assert code == 2
        for phrase in phrases:
            assert phrase in " ".join(errors.split()), (phrase, errors)
        assert not (tmp_path / "t-session").exists()


def test_grams_taken_for_newtons_are_said(pokes):
    values = rows()
    values[:, 4] /= 9.80665e-3
    _, _, errors = pokes(values)
    text = " ".join(errors.split())
    assert "is the force in newtons?" in text
    assert "it would be 30 kPa" in text
    code, _, errors = pokes(values, "--force-unit", "gf", "--force")
    assert code == 0
    assert "newtons" not in errors
