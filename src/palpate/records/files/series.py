"""Reads the series of a probing: force and motion over time, as CSV."""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.errors import InputError, RecordError
from palpate.files import is_file
from palpate.geometry import bounding_diagonal
from palpate.machine import check_memory_for
from palpate.records.probing import DisplacementField
from palpate.records.quantities import FORCE_UNITS, LENGTH_UNITS, TIME_UNITS
from palpate.records.series import Series
from palpate.records.support import HeldObject
from palpate.records.text.csv_table import Column, TextTable, read_text_table, split_cells
from palpate.records.text.toml_table import TomlTable, nearest_file
from palpate.shapes import Vector3

_FORCE, _TIP = ("fx", "fy", "fz"), ("tx", "ty", "tz")
_COLUMNS = ("t", *_FORCE, *_TIP, "displacement")
_FRAME = ("x", "y", "z", "ux", "uy", "uz")
_CURE = "give a header t,fx,fy,fz,tx,ty,tz or t,fx,fy,fz,displacement and a row per instant"
# The force of the series at the instant of the probing, relative to that of the probing.
_APART = 0.2
# Most rows, so that the modulus over time takes seconds.
_MOST_ROWS = 200_000
# A point of a frame is one of the probing's own up to this share of the body's size.
_SAME = 1e-4
# Peak of the memory for a point of a frame: what is read, stacked, and checked in a copy [bytes].
_FRAME_BYTES = 3.0 * 3 * 8


def read_series(
    table: TomlTable, body: HeldObject, force: Vector3, measured: DisplacementField | None
) -> tuple[Series | None, tuple[str, ...]]:
    """The series of a probing, if its table names one, with notes.

    Parameters
    ----------
    table : TomlTable               of the probing: `series`, and `measured_at`, which is the time
                                    of its own displacement; by default the last instant
    body : HeldObject
    force : (3,) float [N]          of the probing
    measured : DisplacementField or None
                                    displacement of the probing; all frames are of its points

    Returns
    -------
    Series or None
    tuple of str

    Raises
    ------
    RecordError                     a missing column or file; other points, or another force, than
                                    the probing's own; as of `Series`
    """
    path = table.optional("series", table.existing_file)
    if path is None:
        if "measured_at" in table.values:
            table.fail("measured_at", "is given without series; give both or none")
        return None, ()
    if not force.any():
        table.fail(
            "series", "follows the force of the tool, and the probing has none; leave it out"
        )
    rows = read_text_table(path, cure=_CURE)
    if len(rows.rows) > _MOST_ROWS:
        raise RecordError(
            f"{path}: has {len(rows.rows)} rows; must have {_MOST_ROWS} at most: keep all while the"
            " force rises, and fewer and fewer of the hold"
        )
    columns = {name: _column(rows, name) for name in _COLUMNS}
    time = _values(rows, columns, ("t",), TIME_UNITS, 1.0)[:, 0]
    forces = _values(rows, columns, _FORCE, FORCE_UNITS, 1.0)
    tip = None
    if any(columns[name] for name in _TIP):
        tip = _values(rows, columns, _TIP, LENGTH_UNITS, body.metres_per_unit)
    if not np.isfinite(np.column_stack([time, forces])).all():
        line = rows.numbers[
            int((~np.isfinite(np.column_stack([time, forces]))).any(axis=1).argmax())
        ]
        raise RecordError(f"{path}: line {line}: t, fx, fy and fz must be numbers in every row")
    instant, frames = _frames(rows, columns["displacement"], body, measured)
    reference = _reference(table, time)
    length = float(np.linalg.norm(force))
    try:
        series = Series(time, forces @ force / length, reference, tip, instant, frames, str(path))
    except InputError as error:
        raise RecordError(str(error)) from error
    if not np.linalg.norm(forces[reference] - force) <= _APART * length:
        raise RecordError(
            f"{path}: the force at {time[reference]:g} s is {forces[reference].tolist()} N, that of"
            f" {table.name} {force.tolist()} N: they are the same push; check the unit, the signs,"
            " and measured_at"
        )
    return series, series.notes


def frame_files(path: Path) -> list[Path]:
    """The displacement files that a series names, whether they exist or not.

    Parameters
    ----------
    path : Path                     of the series

    Raises
    ------
    RecordError                     no table
    """
    rows = read_text_table(path, cure=_CURE)
    names = _frame_names(rows, _column(rows, "displacement"))
    return [path.parent / name for name in names if name]


def _frame_names(rows: TextTable, column: Column | None) -> list[str]:
    """What a series names in every row; empty where no displacement was measured."""
    if column is None:
        return []
    return [split_cells(row, rows.delimiter)[column.index].strip() for row in rows.rows]


def _column(rows: TextTable, name: str) -> Column | None:
    return rows.find((name,), normalise=str.lower)


def _values(
    rows: TextTable, columns: dict[str, Column | None], names: tuple[str, ...],
    units: dict[str, float], default: float,
) -> Float[np.ndarray, "n k"]:  # fmt: skip
    """Columns in SI units; an error names the first that is missing."""
    arrays = [columns[name] for name in names]
    if None in arrays:
        raise RecordError(
            f"{rows.path}: the column '{names[arrays.index(None)]}' is missing; it has"
            f" {rows.listed}: {_CURE}"
        )
    wanted = [column for column in arrays if column is not None]
    return rows.factor(wanted, units, default) * rows.values(wanted, finite=True)


def _reference(table: TomlTable, time: Float[np.ndarray, " n"]) -> int:
    """The instant closest to `measured_at`, by default the last."""
    if "measured_at" not in table.values:
        return len(time) - 1
    at = table.quantity("measured_at", TIME_UNITS, 1.0)
    if not time[0] < at <= time[-1]:
        table.fail(
            "measured_at", f"is {at:g} s; must be after {time[0]:g} s, and {time[-1]:g} s at most:"
            " the times of the series"
        )  # fmt: skip
    return int(np.abs(time - at).argmin())


def _frames(
    rows: TextTable, column: Column | None, body: HeldObject, measured: DisplacementField | None
) -> tuple[np.ndarray, np.ndarray]:
    """Instants with a displacement file, and the displacements of the probing's own points."""
    cells = _frame_names(rows, column)
    named = [k for k, cell in enumerate(cells) if cell]
    if named and measured is None:
        raise RecordError(
            f"{rows.path}: names displacement files, and the probing has no displacement of its"
            " own; name the file of the instant measured_at as its displacement"
        )
    if measured is None or not named:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 0, 3))
    check_memory_for(
        f"{rows.path}: {len(named)} frames of {len(measured.points)} points",
        len(named) * len(measured.points) * _FRAME_BYTES,
        "name fewer frames, or measure fewer points",
    )
    same = _SAME * bounding_diagonal(body.mesh)
    frames = []
    for k in named:
        path = rows.path.parent / cells[k]
        if not is_file(path):
            raise RecordError(
                f"{rows.path}: line {rows.numbers[k]}: no such file: {path}{nearest_file(path)}"
            )
        frames.append(_frame(path, body.metres_per_unit, measured, same))
    return np.array(named, dtype=np.int64), np.stack(frames)


def _frame(
    path: Path, metres: float, measured: DisplacementField, same: float
) -> Float[np.ndarray, "p 3"]:
    """Displacements of the probing's own points in one file; NaN where it has none of them."""
    table = read_text_table(path, cure=f"give a header {','.join(_FRAME)} and a row per point")
    columns = table.require(
        {name: (name,) for name in _FRAME},
        normalise=str.lower,
        reason=lambda _: f"the first line must hold {','.join(_FRAME)}",
    )
    values = metres * table.values(columns, finite=True)
    values = values[np.isfinite(values[:, :3]).all(axis=1)]
    # Of a point without a neighbour there is none in the row after the last.
    row = cKDTree(values[:, :3]).query(measured.points, distance_upper_bound=same)[1]
    frame = np.vstack([values[:, 3:], np.full((1, 3), np.nan)])[row]
    if not np.isfinite(frame).any():
        raise RecordError(
            f"{path}: none of its points is measured and one of {measured.source}; the frames of a"
            " series hold the same points of the surface at rest"
        )
    return frame
