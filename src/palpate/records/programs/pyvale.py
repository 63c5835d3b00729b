"""Stereo results of pyvale from CSV and .dic3d files."""

from pathlib import Path

import numpy as np

from palpate.errors import RecordError
from palpate.files import read_bytes
from palpate.records.program import Program, ProgramPoints, chosen_frame
from palpate.records.text.csv_table import TextTable, read_text_table
from palpate.shapes import Flags, Points

_NAMES = [f"stereo_{quantity}_mm" for quantity in ("disp_u", "disp_v", "disp_w", "x", "y", "z")]
_COLUMNS = {name: (name,) for name in _NAMES}
_CONVERGED = ("converged", "stereo_converged")
# One row of ResultArrays::write_to_disk_stereo, packed.
_ROW_TYPE = np.dtype(
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


def read_pyvale_points(path: Path, frame: int | None = None) -> ProgramPoints:
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
    loaded, moved, failed = _binary(path) if binary else _text(path)
    return ProgramPoints(loaded - moved, moved, failed | ~loaded.any(axis=1), unit="mm")


def _text(path: Path) -> tuple[Points, Points, Flags]:
    """Positions under load, displacements and failure flags, from text."""
    table = read_text_table(path, cure="export the points from pyvale again, as text")
    reason = _reason(table)
    values = table.values(table.require(_COLUMNS, normalise=str, reason=lambda _: reason))
    failed = np.zeros(len(values), dtype=bool)
    if flags := [column for column in table.columns if column.name in _CONVERGED]:
        failed = (table.values(flags) == 0.0).any(axis=1)
    return values[:, 3:], values[:, :3], failed


def _reason(table: TextTable) -> str:
    """Why the columns of a stereo result may be missing, for the error message."""
    names = [column.name for column in table.columns]
    if "disp_u" in names and not any(name.startswith("stereo_") for name in names):
        return "it is a 2-D result, and depth is needed: give the file of a stereo evaluation"
    return "give a stereo result of pyvale with its header"


def _binary(path: Path) -> tuple[Points, Points, Flags]:
    """Positions under load, displacements and failure flags, from packed rows."""
    content = read_bytes(path)
    if not content or len(content) % _ROW_TYPE.itemsize:
        raise RecordError(
            f"{path}: has {len(content)} bytes, no whole number of rows of {_ROW_TYPE.itemsize}; it"
            " was cut off, or is no stereo result of pyvale: write it again, as text if in doubt"
        )
    rows = np.frombuffer(content, dtype=_ROW_TYPE)
    failed = (rows["converged"] == 0) | (rows["stereo_converged"] == 0)
    return rows["place_mm"].astype(np.float64), rows["disp_mm"].astype(np.float64), failed


PYVALE = Program(kinds=("pyvale",), results=".csv, .dic3d", read_points=read_pyvale_points)
