"""Stereo results of MatchID from CSV files."""

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
from palpate.records.text import Column, TextTable, read_text_table

_PROGRAM = "MatchID"
# Long names without their category and unit, and the short ones of version 2023.
_NAMES = {
    "X": ("x",),
    "Y": ("y",),
    "Z": ("z",),
    "U": ("horizontal displacement u", "u"),
    "V": ("vertical displacement v", "v"),
    "W": ("out-of-plane: w", "out-of-plane w", "out-of-plane displacement w", "w"),
}


def read_matchid(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of one time step that MatchID exported as CSV, one row per point.

    Read are coor.X [mm], coor.Y, coor.Z, disp.Horizontal Displacement U [mm], disp.Vertical
    Displacement V and disp.Out-Of-Plane: W, with or without category and unit, or the short names
    x, y, z, u, v, w; separated by commas, semicolons or tabs; decimal commas too. A cell without a
    number is a point that was not measured. stats.Sigma is not used.

    Parameters
    ----------
    path : Path
    length_unit : str or None       where the header names none; mm is usual
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a column is missing (2-D results have no Z and W), lengths in
                                    pixels, text, no rows

    Source
    ------
    The names of MatchID 2023 ("x", "u", ...) and 2024.1 ("coor.X [mm]", ...) as the readers of
    DuoDIC (lib_DuoDIC/ReadMatchIDFile.m: header "[Category].[Long variable name].[units]") and of
    pyvale's forerunner mt2py list them. That coor.X is the place at rest is taken from their use.
    """
    chosen_frame(path, frame, 1)
    table = read_text_table(path, program=_PROGRAM)
    wanted = _columns(table)
    metres, notes = metres_per_unit(path, found=table.unit(wanted), given=length_unit, usual="mm")
    values = table.values(wanted)
    if table.find(["sigma"], spelled=_plain):
        notes += ("The column Sigma was left out: it does not say whose error it is.",)
    given = ProgramPoints(values[:, :3], values[:, 3:], np.zeros(len(values), dtype=bool))
    return from_program(given, kind="matchid", source=path, metres=metres, notes=notes)


def _columns(table: TextTable) -> list[Column]:
    """X, Y, Z, U, V, W of the table."""
    found = {name: table.find(words, spelled=_plain) for name, words in _NAMES.items()}
    if missing := [name for name, column in found.items() if column is None]:
        flat = {"Z", "W"} & set(missing) and not {"X", "Y", "U", "V"} & set(missing)
        why = (
            "it is a 2-D result, and depth is needed: export a stereo result"
            if flat
            else "export all variables of a time step in one table, header [Category].[Long"
            " variable name].[units]"
        )
        raise RecordError(
            f"{table.path}: the column '{missing[0]}' is missing; {why}; it has: {table.names()}"
        )
    return [column for column in found.values() if column]


def _plain(name: str) -> str:
    """Name without its category, in small letters: 'coor.X' is 'x'."""
    return name.rpartition(".")[2].strip().lower()
