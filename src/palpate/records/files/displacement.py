"""Reads and writes measured surface displacements as CSV."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points
from palpate.records.measured_points import surface_limit
from palpate.records.probing import DisplacementField, measured_rows
from palpate.records.text.csv_table import TextTable, read_text_table
from palpate.records.text.text_file import write_text
from palpate.records.text.toml_table import nearest_word

_POSITION_COLUMNS = ("x", "y", "z")
_DISPLACEMENT_COLUMNS = ("ux", "uy", "uz")
_STD_COLUMNS = ("sx", "sy", "sz")
_COLUMNS = (*_POSITION_COLUMNS, *_DISPLACEMENT_COLUMNS, *_STD_COLUMNS, "sigma", "vertex")
_HEADER = ",".join(_POSITION_COLUMNS + _DISPLACEMENT_COLUMNS)
_SEPARATORS = {";": "semicolons", "\t": "tabs"}
# Range of standard deviations over the size of the body: no instrument is more accurate, and
# larger ones carry no information.
_SMALLEST_STD, _LARGEST_STD = 1e-12, 1.0


def read_displacement(
    path: Path | str, mesh: TriangleMesh, *, metres_per_unit: float = 1.0
) -> tuple[DisplacementField, tuple[str, ...]]:
    """Read displacements of surface points from a CSV file and locate them on the surface.

    Parameters
    ----------
    path : path                     header x,y,z,ux,uy,uz and optional sx,sy,sz or sigma, vertex
    mesh : TriangleMesh             in metres
    metres_per_unit : float         unit of every length in the file

    Returns
    -------
    field : DisplacementField       in metres; rows with a NaN or empty displacement are kept
    notes : tuple of str            ignored columns, repeated rows, points off the surface

    Raises
    ------
    RecordError                     missing file, missing or duplicate column, text in a cell, no
                                    rows, only NaN, a point farther from the surface than 2 % of the
                                    bounding diagonal (or half a mean edge), an invalid standard
                                    deviation
    """
    path = Path(path)
    table = read_text_table(path, cure=f"give a header {_HEADER} and a row per observed point")
    notes = _check_header(table)
    known = [column for column in table.columns if column.heading.lower() in _COLUMNS]
    table, values, copies = _without_repeated_rows(table, table.values(known))
    notes += copies
    column = {known[i].heading.lower(): values[:, i] for i in range(len(known))}

    def vectors(names: Sequence[str]) -> np.ndarray:
        return metres_per_unit * np.stack([column[name] for name in names], axis=1)

    points = vectors(_POSITION_COLUMNS)
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise RecordError(
            f"{path}: line {table.numbers[row]}: x, y or z is not a finite number;"
            " only displacements may be NaN (not measured)"
        )
    moved = vectors(_DISPLACEMENT_COLUMNS)
    std_columns = ("sigma",) * 3 if "sigma" in column else _STD_COLUMNS
    std = vectors(std_columns) if std_columns[0] in column else None
    if std is not None:
        _check_std(table, std, moved, mesh)
    if np.isinf(moved).any():
        row, k = map(int, np.argwhere(np.isinf(moved))[0])
        raise RecordError(
            f"{path}: line {table.numbers[row]}: {_DISPLACEMENT_COLUMNS[k]} is infinite; must be a"
            " number, or NaN where it was not measured"
        )
    if not measured_rows(moved).any():
        raise RecordError(
            f"{path}: not one of its {len(moved)} rows has a displacement (all NaN);"
            " leave the probing out, or export the displacements again"
        )
    surface = closest_points(mesh, points)
    notes += _check_distance(table, mesh, surface.distance)
    vertex = _vertex(table, column, mesh, points)
    try:
        field = DisplacementField(
            points=points,
            displacement=moved,
            std=std,
            vertex=vertex,
            surface=surface,
            source=str(path),
        )
    except InputError as error:
        raise RecordError(f"{path}: {error}") from error
    return field, notes


def write_displacement(
    path: Path | str, field: DisplacementField, *, metres_per_unit: float = 1.0
) -> None:
    """Write a displacement field as CSV; see `displacement_text`.

    Parameters
    ----------
    path : path
    field : DisplacementField       in metres
    metres_per_unit : float [m]     > 0; unit of every length in the file

    Raises
    ------
    RecordError                     the file cannot be written
    """
    write_text(path, displacement_text(field, metres_per_unit=metres_per_unit))


def displacement_text(field: DisplacementField, *, metres_per_unit: float = 1.0) -> str:
    """A displacement field as CSV in full precision, including NaN rows.

    Parameters
    ----------
    field : DisplacementField       in metres
    metres_per_unit : float [m]     > 0; unit of every length in the text

    Returns
    -------
    str
    """
    names = [*_POSITION_COLUMNS, *_DISPLACEMENT_COLUMNS]
    parts = [field.points / metres_per_unit, field.displacement / metres_per_unit]
    if field.std is not None:
        names += _STD_COLUMNS
        parts.append(field.std / metres_per_unit)
    rows = [[repr(float(value)) for value in row] for row in np.concatenate(parts, axis=1)]
    if field.vertex is not None:
        names.append("vertex")
        rows = [[*row, str(index)] for row, index in zip(rows, field.vertex, strict=True)]
    return "".join(f"{','.join(row)}\n" for row in [names, *rows])


def _without_repeated_rows(
    table: TextTable, values: np.ndarray
) -> tuple[TextTable, np.ndarray, tuple[str, ...]]:
    """A table and its numbers without repeated rows, which are no independent measurements and
    would narrow the intervals; with a note."""
    _, first = np.unique(np.nan_to_num(values, nan=np.inf), axis=0, return_index=True)
    if len(first) == len(values):
        return table, values, ()
    unique = np.sort(first)
    lines, rows = ([column[i] for i in unique] for column in (table.numbers, table.rows))
    note = (
        f"{table.path}: {len(values) - len(unique)} of {len(values)} rows repeat another one,"
        " number by number, and were left out: a copy is no measurement of its own."
    )
    return replace(table, numbers=tuple(lines), rows=tuple(rows)), values[unique], (note,)


def _check_header(table: TextTable) -> tuple[str, ...]:
    """Refuse a header that lacks a column or is ambiguous; a note names ignored columns."""
    path, header = table.path, [column.heading.lower() for column in table.columns]
    if table.delimiter != ",":
        raise RecordError(
            f"{path}: its columns are separated by {_SEPARATORS.get(table.delimiter, 'blanks')};"
            f" separate them by commas, with points in the numbers, under the line {_HEADER}"
        )
    missing = [name for name in (*_POSITION_COLUMNS, *_DISPLACEMENT_COLUMNS) if name not in header]
    if missing:
        raise RecordError(
            f"{path}: the column '{missing[0]}' is missing; the first line must hold {_HEADER}"
        )
    repeated = sorted({name for name in header if header.count(name) > 1})
    if repeated:
        raise RecordError(f"{path}: the column '{repeated[0]}' is there twice; remove one")
    std_names = [name for name in _STD_COLUMNS if name in header]
    if std_names and len(std_names) < 3:
        raise RecordError(
            f"{path}: has {', '.join(std_names)} only; give sx, sy and sz, or sigma for all three"
        )
    if std_names and "sigma" in header:
        raise RecordError(f"{path}: has both sx,sy,sz and sigma; give one of the two")
    unknown = [name for name in header if name not in _COLUMNS]
    optional = [name for name in ("sigma", "vertex") if name not in header]
    for name in unknown:
        if near := nearest_word(name, optional):
            raise RecordError(f"{path}: unknown column '{name}'{near}")
    if not unknown:
        return ()
    return (f"{path}: the columns {unknown} are not of the format and were left out.",)


def _check_distance(table: TextTable, mesh: TriangleMesh, distance: np.ndarray) -> tuple[str, ...]:
    """Refuse points too far from the surface; a note mentions those slightly off it."""
    diagonal = bounding_diagonal(mesh)
    limit = surface_limit(mesh)
    far = np.flatnonzero(distance > limit)
    if len(far):
        worst = int(distance.argmax())
        raise RecordError(
            f"{table.path}: line {table.numbers[int(far[0])]}: the point is"
            f" {distance[far[0]]:.4g} m off the surface, farther than {limit:.3g} m;"
            f" {len(far)} of {len(distance)} points are, the worst by {distance[worst]:.4g} m"
            f" (line {table.numbers[worst]}); check length_unit and that the points are in the"
            f" object's frame (the mesh is {diagonal:.3g} m across)"
        )
    if distance.max() <= 0.005 * diagonal:
        return ()
    note = (
        f"{table.path}: observed points lie up to {distance.max():.3g} m off the surface; they are"
        " taken to be at its closest points."
    )
    return (note,)


def _check_std(table: TextTable, std: np.ndarray, moved: np.ndarray, mesh: TriangleMesh) -> None:
    """Refuse impossible standard deviations of measured points."""
    size = bounding_diagonal(mesh)
    possible = (std >= _SMALLEST_STD * size) & (std <= _LARGEST_STD * size)
    bad = ~(possible | np.isnan(moved)).all(axis=1)
    bad &= measured_rows(moved)
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise RecordError(
            f"{table.path}: line {table.numbers[row]}: the standard deviation is"
            f" {', '.join(f'{x:.3g}' for x in np.unique(std[row]))} m, of {int(bad.sum())} measured"
            f" points like this; must be from {_SMALLEST_STD * size:.1g} to"
            f" {_LARGEST_STD * size:.2g} m, the size of the body: give one standard deviation of"
            " each point, in the unit of the displacements, or leave the column out"
        )


def _vertex(
    table: TextTable, column: dict[str, np.ndarray], mesh: TriangleMesh, points: np.ndarray
) -> np.ndarray | None:
    """Vertex indices, refused if they contradict the coordinates."""
    if "vertex" not in column:
        return None
    index = column["vertex"]
    count = len(mesh.vertices)
    with np.errstate(invalid="ignore"):
        wrong = ~((index >= 0) & (index < count) & (index == np.floor(index)))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise RecordError(
            f"{table.path}: line {table.numbers[row]}: vertex is {index[row]:g}; must be a whole"
            f" number from 0 to {count - 1}"
        )
    index = index.astype(np.int64)
    gap = np.linalg.norm(mesh.vertices[index] - points, axis=1)
    row = int(gap.argmax())
    if gap[row] > 0.02 * bounding_diagonal(mesh):
        raise RecordError(
            f"{table.path}: line {table.numbers[row]}: vertex {index[row]} of the mesh is"
            f" {gap[row]:.4g} m from the row's x, y, z; is it another mesh, or one whose vertices"
            " were welded? Leave the column 'vertex' out, the coordinates suffice"
        )
    return index
