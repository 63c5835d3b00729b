"""Stereo results of OpenCorr."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.errors import RecordError
from palpate.records.program import MIN_CORRELATION, Program, ProgramPoints, chosen_frame
from palpate.records.text.csv_table import Column, TextTable, read_text_table
from palpate.shapes import PointScalars

_COLUMNS = {name: (name,) for name in ("u", "v", "w", "ref_x", "ref_y", "ref_z")}
_SCORES = ("r1r2 zncc", "r1t1 zncc", "r1t2 zncc")
# Largest correlation, with a margin for single precision.
_LARGEST_SCORE = 1.0 + 1e-3


def read_opencorr_points(path: Path, frame: int | None = None) -> ProgramPoints:
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
        _COLUMNS, normalise=str.lower, reason=lambda missing: _reason(missing, is_volume=is_volume)
    )
    values = table.values(wanted)
    if scores := [c for name in _SCORES if (c := table.find([name], normalise=str.lower))]:
        score = _lowest_score(table, scores)
        return ProgramPoints(values[:, 3:], values[:, :3], ~(score > 0.0), score=score)
    notes = ("It has no columns ZNCC, so failed points cannot be recognised.",)
    return ProgramPoints(values[:, 3:], values[:, :3], notes=notes)


def _lowest_score(table: TextTable, columns: Sequence[Column]) -> PointScalars:
    """The lowest correlation of each row."""
    found = table.values(columns)
    if len(beyond := np.argwhere(found > _LARGEST_SCORE)):
        row, k = beyond[0]
        raise RecordError(
            f"{table.path}: line {table.numbers[row]}: {columns[k].name} is {found[row, k]:g}; must"
            " be a correlation, 1 at most (0 or less: a code of failure): is it in per cent?"
        )
    return np.asarray(found.min(axis=1))


def _reason(missing: list[str], *, is_volume: bool) -> str:
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
    read_points=read_opencorr_points,
    default_unit="mm",
    min_score=MIN_CORRELATION,
)
