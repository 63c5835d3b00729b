"""Measured surface displacements from and to CSV files."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError, RecordError
from palpate.geometry import TriangleMesh, bounding_diagonal, closest_points, mesh_quality
from palpate.records.probing import DisplacementField
from palpate.records.text import nearest_word

_PLACE = ("x", "y", "z")
_MOVE = ("ux", "uy", "uz")
_STD = ("sx", "sy", "sz")
_COLUMNS = (*_PLACE, *_MOVE, *_STD, "sigma", "vertex")
_MAY_BE_MISSING = (*_MOVE, *_STD, "sigma")


def read_displacement(
    path: Path | str, mesh: TriangleMesh, *, metres_per_unit: float = 1.0
) -> tuple[DisplacementField, tuple[str, ...]]:
    """Displacement of surface points from a CSV file, tied to the surface.

    Parameters
    ----------
    path : path                     header x,y,z,ux,uy,uz and optional sx,sy,sz or sigma, vertex
    mesh : TriangleMesh             in metres
    metres_per_unit : float         of every length in the file

    Returns
    -------
    field : DisplacementField       in metres; rows with a NaN or empty displacement are kept
    notes : tuple of str            columns left out, points that lie off the surface

    Raises
    ------
    RecordError                     not there, a column missing or twice, text, no rows, only NaN,
                                    a point farther from the surface than 2 % of the bounding
                                    diagonal (or half a mean edge), a bad standard deviation
    """
    path = Path(path)
    header, body, first_line = _split(path)
    notes = _check_header(path, header)
    values = _numbers(path, header, body, first_line)
    column = {name: values[:, i] for i, name in enumerate(header)}
    points = metres_per_unit * np.stack([column[name] for name in _PLACE], axis=1)
    if not np.isfinite(points).all():
        row = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        raise RecordError(
            f"{path}: line {first_line + row}: x, y or z is not a finite number;"
            " only displacements may be NaN (not measured)"
        )
    moved = metres_per_unit * np.stack([column[name] for name in _MOVE], axis=1)
    if np.isnan(moved).any(axis=1).all():
        raise RecordError(
            f"{path}: not one of its {len(moved)} rows has a displacement (all NaN);"
            " leave the probing out, or export the displacements again"
        )
    surface = closest_points(mesh, points)
    notes += _check_distance(path, mesh, surface.distance, first_line)
    try:
        field = DisplacementField(
            points=points,
            displacement=moved,
            std=_std(column, metres_per_unit),
            vertex=_vertex(path, column, mesh, points, first_line),
            surface=surface,
            source=str(path),
        )
    except InputError as error:
        raise RecordError(f"{path}: {error}") from error
    return field, notes


def write_displacement(
    path: Path | str, field: DisplacementField, *, metres_per_unit: float = 1.0
) -> None:
    """Write a displacement field as CSV, every digit kept; NaN rows included.

    Raises
    ------
    RecordError                     the file cannot be written
    """
    names = [*_PLACE, *_MOVE]
    parts = [field.points / metres_per_unit, field.displacement / metres_per_unit]
    if field.std is not None:
        names += _STD
        parts.append(field.std / metres_per_unit)
    rows = [[repr(float(value)) for value in row] for row in np.concatenate(parts, axis=1)]
    if field.vertex is not None:
        names.append("vertex")
        rows = [[*row, str(index)] for row, index in zip(rows, field.vertex, strict=True)]
    lines = [",".join(row) for row in [names, *rows]]
    try:
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path}: cannot be written ({error.strerror})") from error


def _split(path: Path) -> tuple[list[str], list[str], int]:
    """Header words, the lines below it, and the line number of the first of those."""
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: is not a text file in UTF-8; export it as CSV") from error
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    top = next((i for i, line in enumerate(lines) if line.strip() and line[0] != "#"), None)
    if top is None:
        raise RecordError(f"{path}: is empty; its first line must be {','.join(_PLACE + _MOVE)}")
    header = [word.strip().strip('"').lower() for word in lines[top].split(",")]
    while lines and not lines[-1].strip():
        lines.pop()
    if len(lines) <= top + 1:
        raise RecordError(f"{path}: has a header and no rows; one row per observed point is needed")
    return header, lines[top + 1 :], top + 2


def _check_header(path: Path, header: Sequence[str]) -> tuple[str, ...]:
    """Refuse a header that lacks a column or could be misread; say which columns are left out."""
    missing = [name for name in (*_PLACE, *_MOVE) if name not in header]
    if missing:
        separated = [mark for mark in (";", "\t") if mark in header[0]]
        cure = (
            f"separate the columns by ',' instead of {separated[0]!r}"
            if separated
            else f"the first line must hold {','.join(_PLACE + _MOVE)}"
        )
        raise RecordError(f"{path}: the column '{missing[0]}' is missing; {cure}")
    twins = sorted({name for name in header if header.count(name) > 1})
    if twins:
        raise RecordError(f"{path}: the column '{twins[0]}' is there twice; remove one")
    given = [name for name in _STD if name in header]
    if given and len(given) < 3:
        raise RecordError(f"{path}: has {given} only; give sx, sy and sz, or sigma for all three")
    if given and "sigma" in header:
        raise RecordError(f"{path}: has both sx,sy,sz and sigma; give one of the two")
    unknown = [name for name in header if name not in _COLUMNS]
    optional = [name for name in ("sigma", "vertex") if name not in header]
    for name in unknown:
        if near := nearest_word(name, optional):
            raise RecordError(f"{path}: unknown column '{name}'{near}")
    if not unknown:
        return ()
    return (f"{path}: the columns {unknown} are not of the format and were left out.",)


def _numbers(
    path: Path, header: Sequence[str], body: Sequence[str], first_line: int
) -> Float[np.ndarray, "n c"]:
    """All cells as numbers; columns that are not of the format become NaN."""
    known = [i for i, name in enumerate(header) if name in _COLUMNS]
    values = np.full((len(body), len(header)), np.nan)
    if any(line.count(",") != len(header) - 1 for line in body):
        return _numbers_slowly(path, header, body, first_line)
    try:
        text = io.StringIO("\n".join(body))
        rows = np.loadtxt(text, delimiter=",", usecols=known, ndmin=2, comments=None)
    except ValueError:
        return _numbers_slowly(path, header, body, first_line)
    if len(rows) != len(body):
        return _numbers_slowly(path, header, body, first_line)
    values[:, known] = rows
    return values


def _numbers_slowly(
    path: Path, header: Sequence[str], body: Sequence[str], first_line: int
) -> Float[np.ndarray, "n c"]:
    """As `_numbers`, cell by cell: empty displacements are NaN, anything else wrong has a name."""
    values = np.full((len(body), len(header)), np.nan)
    for row, cells in enumerate(csv.reader(body)):
        place = f"{path}: line {first_line + row}"
        if len(cells) != len(header):
            raise RecordError(
                f"{place}: has {len(cells)} cells; the header has {len(header)} columns"
            )
        for i, (name, cell) in enumerate(zip(header, cells, strict=True)):
            word = cell.strip()
            if name not in _COLUMNS or (not word and name in _MAY_BE_MISSING):
                continue
            try:
                values[row, i] = float(word)
            except ValueError as error:
                raise RecordError(
                    f"{place}: column '{name}' holds '{word}'; must be a number"
                    " (NaN for a displacement that was not measured)"
                ) from error
    return values


def _check_distance(
    path: Path, mesh: TriangleMesh, distance: np.ndarray, first_line: int
) -> tuple[str, ...]:
    """Refuse points that cannot belong to this surface; mention those that lie off it."""
    diagonal = bounding_diagonal(mesh)
    limit = max(0.02 * diagonal, 0.5 * mesh_quality(mesh).edge_mean)
    far = np.flatnonzero(distance > limit)
    if len(far):
        worst = int(distance.argmax())
        raise RecordError(
            f"{path}: line {first_line + int(far[0])}: the point is"
            f" {distance[far[0]]:.4g} m off the surface, farther than {limit:.3g} m;"
            f" {len(far)} of {len(distance)} points are, the worst by {distance[worst]:.4g} m"
            f" (line {first_line + worst}); check length_unit and that the points are in the"
            f" object's frame (the mesh is {diagonal:.3g} m across)"
        )
    if distance.max() <= 0.005 * diagonal:
        return ()
    note = (
        f"{path}: observed points lie up to {distance.max():.3g} m off the surface; they are taken"
        " to be at its closest points."
    )
    return (note,)


def _std(column: dict[str, np.ndarray], metres_per_unit: float) -> np.ndarray | None:
    """Standard deviation per component, where the file gives one [m]."""
    if "sigma" in column:
        return metres_per_unit * np.repeat(column["sigma"][:, None], 3, axis=1)
    if "sx" in column:
        return metres_per_unit * np.stack([column[name] for name in _STD], axis=1)
    return None


def _vertex(
    path: Path,
    column: dict[str, np.ndarray],
    mesh: TriangleMesh,
    points: np.ndarray,
    first_line: int,
) -> np.ndarray | None:
    """Vertex indices, refused where they contradict the coordinates."""
    if "vertex" not in column:
        return None
    index = column["vertex"]
    count = len(mesh.vertices)
    with np.errstate(invalid="ignore"):
        wrong = ~((index >= 0) & (index < count) & (index == np.floor(index)))
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise RecordError(
            f"{path}: line {first_line + row}: vertex is {index[row]:g}; must be a whole number"
            f" from 0 to {count - 1}"
        )
    index = index.astype(np.int64)
    gap = np.linalg.norm(mesh.vertices[index] - points, axis=1)
    row = int(gap.argmax())
    if gap[row] > 0.02 * bounding_diagonal(mesh):
        raise RecordError(
            f"{path}: line {first_line + row}: vertex {index[row]} of the mesh is {gap[row]:.4g} m"
            " from the row's x, y, z; is it another mesh, or one whose vertices were welded?"
            " Leave the column 'vertex' out, the coordinates suffice"
        )
    return index
