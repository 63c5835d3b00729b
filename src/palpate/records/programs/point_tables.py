"""Displacements of points from programs whose calibration is not read: OpenCorr, pyvale, VTK
unstructured grids of any program, and planar results of any program.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import RecordError
from palpate.files import checked_file, read_bytes, read_errors
from palpate.foreign import read_by_meshio, result_in_child
from palpate.records.program import MIN_CORRELATION, Program, ProgramPoints, chosen_frame
from palpate.records.text.csv_table import Column, TextTable, read_text_table
from palpate.records.text.toml_table import nearest_word
from palpate.shapes import Flags, Points, PointScalars

_OPENCORR_COLUMNS = {name: (name,) for name in ("u", "v", "w", "ref_x", "ref_y", "ref_z")}
_OPENCORR_SCORES = ("r1r2 zncc", "r1t1 zncc", "r1t2 zncc")
# Largest correlation, with a margin for single precision.
_LARGEST_SCORE = 1.0 + 1e-3
_PYVALE_NAMES = [
    f"stereo_{quantity}_mm" for quantity in ("disp_u", "disp_v", "disp_w", "x", "y", "z")
]
_PYVALE_COLUMNS = {name: (name,) for name in _PYVALE_NAMES}
_PYVALE_CONVERGED = ("converged", "stereo_converged")
# One row of ResultArrays::write_to_disk_stereo, packed.
_PYVALE_ROW = np.dtype(
    [
        ("subset", "<i4", 2),
        ("disp_px", "<f8", 3),
        ("converged", "u1"),
        ("quality", "<f8", 3),
        ("num_iter", "<i4"),
        ("stereo_disp_px", "<f8", 3),
        ("disp_mm", "<f8", 3),
        ("place_mm", "<f8", 3),
        ("stereo_converged", "u1"),
        ("stereo_quality", "<f8", 3),
        ("stereo_num_iter", "<i4"),
    ]
)
_VTK_SUFFIXES = (".vtu", ".vtk")
# A million points with all that a program says of them.
_MOST_VTK_BYTES = 2**30
_DISPLACEMENT_NAMES = ("displacement", "displacements", "disp", "u")
_COMPONENT_NAMES = (("ux", "uy", "uz"), ("displacement_x", "displacement_y", "displacement_z"))
_STD_NAMES = ("displacement_std", "displacement_sigma", "std", "sigma")
_SURFACE_CELLS = ("vertex", "line", "triangle", "quad", "polygon")


def _read_opencorr_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of a stereo table that OpenCorr saved as CSV.

    The columns ref_x, ref_y, ref_z (at rest) and u, v, w are read. The score is the lowest of the
    three correlations (r1r2, r1t1, r1t2 ZNCC), at most 1; zero or less is an error code.

    Parameters
    ----------
    path : Path
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a 2-D or volume table, or one of a reconstruction alone, whose
                                    u, v, w are positions; a score above 1; text in a cell, no rows

    Source
    ------
    OpenCorr (github.com/vincentjzy/OpenCorr), src/oc_io.cpp, IO2D::saveTable2DS; its GUI guide,
    (ii) "u, v, w: displacements in world coordinate system", (v) "ref_x, ref_y, ref_z, tar_x,
    tar_y, tar_z: coordinates of POIs before and after deformation"; examples/3d_dic/*.csv.
    """
    chosen_frame(path, frame)
    table = read_text_table(path, cure="export the points from OpenCorr again, as text")
    is_volume = table.find(["z"], normalise=str.lower) is not None
    wanted = table.require(
        _OPENCORR_COLUMNS,
        normalise=str.lower,
        reason=lambda missing: _opencorr_reason(missing, is_volume=is_volume),
    )
    values = table.values(wanted)
    if scores := [c for name in _OPENCORR_SCORES if (c := table.find([name], normalise=str.lower))]:
        score = _lowest_score(table, scores)
        return ProgramPoints(values[:, 3:], values[:, :3], ~(score > 0.0), score=score)
    notes = ("It has no columns ZNCC, so failed points cannot be recognised.",)
    return ProgramPoints(values[:, 3:], values[:, :3], notes=notes)


def _lowest_score(table: TextTable, columns: Sequence[Column]) -> PointScalars:
    """The lowest correlation of each row."""
    scores = table.values(columns)
    if len(beyond := np.argwhere(scores > _LARGEST_SCORE)):
        row, k = beyond[0]
        raise RecordError(
            f"{table.path}: line {table.numbers[row]}: {columns[k].name} is {scores[row, k]:g};"
            " must be a correlation, 1 at most (0 or less: a code of failure): is it in per cent?"
        )
    return np.asarray(scores.min(axis=1))


def _opencorr_reason(missing: list[str], *, is_volume: bool) -> str:
    """What kind of table it probably is instead, for the error message."""
    if "w" in missing:
        return "it is a 2-D table, and depth is needed: save a stereo result (saveTable2DS)"
    if is_volume:
        return "it is a volume table; save the stereo result of a surface (saveTable2DS)"
    return (
        "it is a table of a reconstruction alone or of an old version, whose u, v, w may be places;"
        " run the stereo evaluation of the loaded state and save it (saveTable2DS)"
    )


OPENCORR = Program(
    kinds=("opencorr",),
    results=".csv",
    read_points=_read_opencorr_points,
    default_unit="mm",
    min_score=MIN_CORRELATION,
)


def _read_planar_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of one camera that looks square at a flat face, as a table x, y, u, v of lengths.

    Where there are columns X, Y, U, V in capitals, small letters are pixels and are ignored. The
    face is the plane z = 0 of the file's frame; the displacement along z is not known.

    Parameters
    ----------
    path : Path
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a missing column, text in a cell, no rows
    """
    chosen_frame(path, frame)
    table = read_text_table(path, cure="export the points again, as text")
    capitals = all(table.find([name], normalise=str) for name in "XYUV")
    wanted = table.require(
        {name: (name.upper() if capitals else name,) for name in "xyuv"},
        normalise=str if capitals else str.lower,
        reason=lambda _: "export x, y, u, v as lengths",
    )
    values = table.values(wanted)
    points, displacement = np.zeros((2, len(values), 3))
    points[:, :2], displacement[:, :2], displacement[:, 2] = values[:, :2], values[:, 2:], np.nan
    return ProgramPoints(points, displacement, unit=table.unit(wanted))


PLANAR = Program(
    kinds=("planar",),
    results=".csv, .txt",
    read_points=_read_planar_points,
)


def _read_pyvale_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of one stereo result of pyvale, as text or binary, in mm.

    pyvale writes the position under load, stereo_x_mm = rest + stereo_disp_u_mm; the position at
    rest is the difference. A point has failed if a match did not converge, or if NaN was written.

    Parameters
    ----------
    path : Path                     suffix .dic3d: binary; anything else: text
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a 2-D result, a truncated file, text in a cell, no rows

    Source
    ------
    pyvale (github.com/Computer-Aided-Validation-Laboratory/pyvale), src/pyvale/dic/cpp/
    dicresults.cpp, ResultArrays::write_to_disk_stereo (columns, NaN below the threshold);
    dicimport3d.py, _read_binary_3d (rows of 162 bytes); stereoutil.cpp, pixel_to_world
    (u_world = X_mm - reference).
    """
    chosen_frame(path, frame)
    binary = path.suffix.lower() == ".dic3d"
    loaded, moved, failed = _pyvale_binary(path) if binary else _pyvale_text(path)
    return ProgramPoints(loaded - moved, moved, failed | ~loaded.any(axis=1), unit="mm")


def _pyvale_text(path: Path) -> tuple[Points, Points, Flags]:
    """Positions under load, displacements and failure flags, from text."""
    table = read_text_table(path, cure="export the points from pyvale again, as text")
    reason = _pyvale_reason(table)
    values = table.values(table.require(_PYVALE_COLUMNS, normalise=str, reason=lambda _: reason))
    failed = np.zeros(len(values), dtype=bool)
    if flags := [column for column in table.columns if column.name in _PYVALE_CONVERGED]:
        failed = (table.values(flags) == 0.0).any(axis=1)
    return values[:, 3:], values[:, :3], failed


def _pyvale_reason(table: TextTable) -> str:
    """Why the columns of a stereo result may be missing, for the error message."""
    names = [column.name for column in table.columns]
    if "disp_u" in names and not any(name.startswith("stereo_") for name in names):
        return "it is a 2-D result, and depth is needed: give the file of a stereo evaluation"
    return "give a stereo result of pyvale with its header"


def _pyvale_binary(path: Path) -> tuple[Points, Points, Flags]:
    """Positions under load, displacements and failure flags, from packed rows."""
    content = read_bytes(path)
    if not content or len(content) % _PYVALE_ROW.itemsize:
        raise RecordError(
            f"{path}: has {len(content)} bytes, no whole number of rows of"
            f" {_PYVALE_ROW.itemsize}; it was cut off, or is no stereo result of pyvale: write it"
            " again, as text if in doubt"
        )
    rows = np.frombuffer(content, dtype=_PYVALE_ROW)
    failed = (rows["converged"] == 0) | (rows["stereo_converged"] == 0)
    return rows["place_mm"].astype(np.float64), rows["disp_mm"].astype(np.float64), failed


PYVALE = Program(kinds=("pyvale",), results=".csv, .dic3d", read_points=_read_pyvale_points)


def _read_vtu_points(path: Path, frame: int | None) -> ProgramPoints:
    """Points of a grid with a displacement at each, through meshio.

    The points are positions at rest. The displacement is the point data `displacement`,
    `Displacement`, `U`, `u` or `disp` with three components, or `ux`, `uy`, `uz`; its standard
    deviation, if any, `displacement_std`, `std` or `sigma` with three components or one. NaN marks
    points that were not measured. The format has no unit of length.

    Parameters
    ----------
    path : Path                     suffix .vtu or .vtk
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     no such data, a 2-D vector, volume cells, unreadable

    Source
    ------
    VTK file formats, "XML file formats", https://docs.vtk.org; the names are customary (ParaView,
    FEniCS, pyvista), not a standard.
    """
    chosen_frame(path, frame)
    content = _vtk_content(path)
    data = {name.lower(): np.asarray(values) for name, values in content.point_data.items()}
    solid = [block.type for block in content.cells if not block.type.startswith(_SURFACE_CELLS)]
    if solid:
        raise RecordError(
            f"{path}: holds solid cells ({solid[0]}), whose inner points were not observed;"
            " extract the surface first (ParaView: Extract Surface, then Merge to .vtu)"
        )
    moved = _vtk_displacement(path, data)
    points = np.zeros((len(moved), 3))
    points[:, : content.points.shape[1]] = content.points
    return ProgramPoints(points, moved, std=_vtk_std(path, data))


def _vtk_content(path: Path) -> Any:
    """The grid as meshio reads it."""
    if path.suffix.lower() not in _VTK_SUFFIXES:
        raise RecordError(
            f"{path}: is no .vtu file; save it as an unstructured grid of VTK (.vtu or .vtk)"
        )
    checked_file(path, max_bytes=_MOST_VTK_BYTES)
    what = f"cannot be read as {path.suffix[1:].upper()}"
    with read_errors(path, "open it in ParaView and save it again", what=what):
        return result_in_child(read_by_meshio, path, path.suffix[1:].lower())


def _vtk_displacement(path: Path, data: Mapping[str, np.ndarray]) -> Points:
    """The displacement, as a vector or as three scalars."""
    for name in _DISPLACEMENT_NAMES:
        if name in data and data[name].ndim == 2:
            if data[name].shape[1] != 3:
                raise RecordError(
                    f"{path}: its point data '{name}' has {data[name].shape[1]} components; depth"
                    " is needed: three"
                )
            return np.array(data[name], dtype=np.float64)
    for parts in _COMPONENT_NAMES:
        if all(name in data and data[name].ndim == 1 for name in parts):
            return np.stack([data[name] for name in parts], axis=1).astype(np.float64)
    near = next(filter(None, (nearest_word(name, _DISPLACEMENT_NAMES) for name in data)), "")
    raise RecordError(
        f"{path}: has no point data 'displacement' (or U, u, disp; or ux, uy, uz){near}; it has:"
        f" {', '.join(data) or 'no point data'}"
    )


def _vtk_std(path: Path, data: Mapping[str, np.ndarray]) -> Points | None:
    """The standard deviation of the displacement, of each component or of all three."""
    for name in _STD_NAMES:
        if name in data:
            values = np.array(data[name], dtype=np.float64)
            if values.ndim == 1:
                values = values[:, None]
            if values.shape[1] not in (1, 3):
                raise RecordError(
                    f"{path}: its point data '{name}' has {values.shape[1]} components; must be 1"
                    " or 3, one standard deviation each"
                )
            return np.broadcast_to(values, (len(values), 3)).copy()
    return None


VTU = Program(kinds=("vtu",), results=".vtu, .vtk", read_points=_read_vtu_points, correlates=False)
