"""Stereo results of pyvale from CSV and .dic3d files."""

from pathlib import Path

import numpy as np

from palpate.errors import RecordError
from palpate.records.programs.measured_points import (
    MeasuredPoints,
    ProgramPoints,
    chosen_frame,
    from_program,
    metres_per_unit,
)
from palpate.records.text import read_text_table
from palpate.shapes import Flags, Points

_PROGRAM = "pyvale"
_MOVE = ("stereo_disp_u_mm", "stereo_disp_v_mm", "stereo_disp_w_mm")
_LOADED_PLACE = ("stereo_x_mm", "stereo_y_mm", "stereo_z_mm")
_CONVERGED = ("converged", "stereo_converged")
# One row of ResultArrays::write_to_disk_stereo, packed.
_ROW = np.dtype(
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


def read_pyvale(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of one stereo result that pyvale wrote, as text or binary.

    pyvale writes the place under load, stereo_x_mm = rest + stereo_disp_u_mm; the place at rest is
    the difference. A point failed where a match did not converge, or where NaN was written.

    Parameters
    ----------
    path : Path                     suffix .dic3d: binary; anything else: text
    length_unit : str or None       mm, or None
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a 2-D result, a cut file, text, no rows

    Source
    ------
    pyvale (github.com/Computer-Aided-Validation-Laboratory/pyvale), src/pyvale/dic/cpp/
    dicresults.cpp, ResultArrays::write_to_disk_stereo (columns, NaN below the threshold);
    dicimport3d.py, _read_binary_3d (rows of 162 bytes); stereoutil.cpp, pixel_to_world
    (u_world = X_mm - reference).
    """
    chosen_frame(path, frame, 1)
    metres, notes = metres_per_unit(path, found="mm", given=length_unit, usual=None)
    binary = path.suffix.lower() == ".dic3d"
    loaded, moved, failed = _binary(path) if binary else _text(path)
    given = ProgramPoints(loaded - moved, moved, failed | ~loaded.any(axis=1))
    return from_program(given, kind="pyvale", source=path, metres=metres, notes=notes)


def _text(path: Path) -> tuple[Points, Points, Flags]:
    """Places under load, displacements and failures from text."""
    table = read_text_table(path, program=_PROGRAM)
    named = {column.name: column for column in table.columns}
    if missing := [name for name in _MOVE + _LOADED_PLACE if name not in named]:
        why = (
            "it is a 2-D result, and depth is needed: give the file of a stereo evaluation"
            if "disp_u" in named and not any(name.startswith("stereo_") for name in named)
            else "give a stereo result of pyvale with its header"
        )
        raise RecordError(
            f"{path}: the column '{missing[0]}' is missing; {why}; it has: {table.names()}"
        )
    values = table.values([named[name] for name in _LOADED_PLACE + _MOVE])
    failed = np.zeros(len(values), dtype=bool)
    if flags := [named[name] for name in _CONVERGED if name in named]:
        failed = (table.values(flags) == 0.0).any(axis=1)
    return values[:, :3], values[:, 3:], failed


def _binary(path: Path) -> tuple[Points, Points, Flags]:
    """The same from packed rows."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    if not content or len(content) % _ROW.itemsize:
        raise RecordError(
            f"{path}: has {len(content)} bytes, no whole number of rows of {_ROW.itemsize}; it was"
            " cut off, or is no stereo result of pyvale: write it again, as text if in doubt"
        )
    rows = np.frombuffer(content, dtype=_ROW)
    failed = (rows["converged"] == 0) | (rows["stereo_converged"] == 0)
    return (
        np.ascontiguousarray(rows["place_mm"], dtype=np.float64),
        np.ascontiguousarray(rows["disp_mm"], dtype=np.float64),
        failed,
    )
