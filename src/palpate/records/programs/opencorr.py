"""Stereo results of OpenCorr from CSV files."""

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
from palpate.records.text import Column, read_text_table

_PROGRAM = "OpenCorr"
_PLACE = ("ref_x", "ref_y", "ref_z")
_MOVE = ("u", "v", "w")
_SCORES = ("r1r2 zncc", "r1t1 zncc", "r1t2 zncc")


def read_opencorr(
    path: Path, *, length_unit: str | None = None, frame: int | None = None
) -> MeasuredPoints:
    """Points of a stereo table that OpenCorr saved.

    Read are ref_x, ref_y, ref_z (at rest) and u, v, w. A point failed where one of the three
    correlation scores (r1r2, r1t1, r1t2 ZNCC) is zero or less: its codes of failure are negative.

    Parameters
    ----------
    path : Path
    length_unit : str or None       of the calibration's translation; mm is usual
    frame : int or None             a file holds one state: only 0 or None

    Raises
    ------
    RecordError                     a 2-D or volume table, or one of a reconstruction alone, whose
                                    u, v, w are places; text, no rows

    Source
    ------
    OpenCorr (github.com/vincentjzy/OpenCorr), src/oc_io.cpp, IO2D::saveTable2DS; its GUI guide,
    (ii) "u, v, w: displacements in world coordinate system", (v) "ref_x, ref_y, ref_z, tar_x,
    tar_y, tar_z: coordinates of POIs before and after deformation"; examples/3d_dic/*.csv.
    """
    chosen_frame(path, frame, 1)
    table = read_text_table(path, program=_PROGRAM)
    named = {column.name.lower(): column for column in table.columns}
    if missing := [name for name in _MOVE + _PLACE if name not in named]:
        raise RecordError(
            f"{path}: the column '{missing[0]}' is missing; {_why(named)}; it has: {table.names()}"
        )
    metres, notes = metres_per_unit(path, found=None, given=length_unit, usual="mm")
    values = table.values([named[name] for name in _PLACE + _MOVE])
    failed = np.zeros(len(values), dtype=bool)
    if scores := [named[name] for name in _SCORES if name in named]:
        failed |= ~(table.values(scores) > 0.0).all(axis=1)
    else:
        notes += ("It has no columns ZNCC, so failed points cannot be told.",)
    given = ProgramPoints(values[:, :3], values[:, 3:], failed)
    return from_program(given, kind="opencorr", source=path, metres=metres, notes=notes)


def _why(named: dict[str, Column]) -> str:
    """What the table is instead."""
    if "w" not in named:
        return "it is a 2-D table, and depth is needed: save a stereo result (saveTable2DS)"
    if "z" in named:
        return "it is a volume table; save the stereo result of a surface (saveTable2DS)"
    return (
        "it is a table of a reconstruction alone or of an old version, whose u, v, w may be places;"
        " run the stereo evaluation of the loaded state and save it (saveTable2DS)"
    )
