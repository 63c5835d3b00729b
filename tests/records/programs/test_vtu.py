"""Displacements in VTK's unstructured grids."""

import sys

import meshio
import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
)

from palpate.errors import InputError, RecordError
from palpate.records.programs.registry import read_measured


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


def test_vtu_needs_its_package(tmp_path, monkeypatch):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(InputError, match=r"pip install 'palpate\[mesh\]'"):
        read_measured("vtu", path, length_unit="mm")


def test_vtu_needs_a_unit(tmp_path):
    path = _write_vtu(tmp_path / "a.vtu", {"u": MOVE})
    with pytest.raises(RecordError, match="does not say its unit of length; say it with --length"):
        read_measured("vtu", path)
