"""Stereo results of VIC-3D (Correlated Solutions) from CSV files."""

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

_PROGRAM = "VIC-3D"
_PLACE = ("X", "Y", "Z")
_MOVE = ("U", "V", "W")
_STD = ("sigma_x", "sigma_y", "sigma_z")


def read_vic3d(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of one data file that VIC-3D exported as CSV.

    Columns X, Y, Z (at rest) and U, V, W, with or without a unit ("X [mm]"); small letters are
    pixels and are passed over. A row with sigma < 0 was not correlated. Sigma itself is in pixels
    and no standard deviation of a displacement; Sigma_X, Sigma_Y, Sigma_Z are those of a position
    in this picture, and the displacement is the difference of two positions: sqrt(2) of them.

    Parameters
    ----------
    path : Path
    length_unit : str or None       where the header names none; mm is usual
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a column is missing (2-D results have no Z and W), text, no rows

    Source
    ------
    Correlated Solutions, "Output variables in Vic-2D and Vic-3D" (application note 28): names,
    units, "sigma [pixel]: the 1-standard deviation confidence in the match"; X + U is the place
    under load. Sigma_X [mm] as VicPy's SIGMA_X; that it is one standard deviation of the place
    is taken from its name and unit, no manual was found that says so.
    """
    chosen_frame(path, frame, 1)
    table = read_text_table(path, program=_PROGRAM)
    wanted = _columns(table)
    deviations = [c for name in _STD if (c := table.find([name], spelled=str.lower))]
    unit = table.unit([*wanted, *deviations])
    metres, notes = metres_per_unit(path, found=unit, given=length_unit, usual="mm")
    values = table.values(wanted)
    failed = np.zeros(len(values), dtype=bool)
    if sigma := table.find(["sigma"], spelled=str.lower):
        failed = table.values([sigma])[:, 0] < 0.0
    else:
        notes += ("It has no column sigma, so failed points cannot be told.",)
    std = None
    if len(deviations) == 3:
        std = np.sqrt(2.0) * table.values(deviations)
        notes += ("The sigma of a displacement is taken as sqrt(2) of Sigma_X, Sigma_Y, Sigma_Z.",)
    given = ProgramPoints(values[:, :3], values[:, 3:], failed, std)
    return from_program(given, kind="vic3d", source=path, metres=metres, notes=notes)


def _columns(table: TextTable) -> list[Column]:
    """X, Y, Z, U, V, W; capitals, as small letters are pixels."""
    found = {name: table.find([name], spelled=str) for name in _PLACE + _MOVE}
    if missing := [name for name, column in found.items() if column is None]:
        flat = {"Z", "W"} & set(missing) and not {"X", "Y", "U", "V"} & set(missing)
        why = (
            "it is a 2-D result, and depth is needed: export a stereo result"
            if flat
            else "export X, Y, Z, U, V, W and sigma (capitals: lengths; small letters are pixels)"
        )
        raise RecordError(
            f"{table.path}: the column '{missing[0]}' is missing; {why}; it has: {table.names()}"
        )
    return [column for column in found.values() if column]
