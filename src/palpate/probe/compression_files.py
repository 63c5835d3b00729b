"""Read compression records: files of testing machines, and plain columns of numbers."""

import re
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.errors import InputError, RecordError
from palpate.records import (
    FORCE_UNITS,
    LENGTH_UNITS,
    Column,
    TextTable,
    make_table,
    split_cells,
    text_lines,
)
from palpate.shapes import PointScalars

METRES = LENGTH_UNITS | {"µm": 1e-6}
DISPLACEMENT_WORDS = ("compression", "displacement", "extension", "crosshead", "stroke", "position")
FORCE_WORDS = ("load", "force")
_TIME = "time"
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_BLANK = " \t,;"
_CURE = (
    "a record has columns of displacement and force, split by commas, semicolons, tabs or blanks"
)


@dataclass(frozen=True, slots=True, eq=False)
class CompressionRecord:
    """One loading of one cylinder as read from a file, in SI units, compression positive.

    Attributes
    ----------
    displacement : (n,) float [m]          shortening of the cylinder
    force : (n,) float [N]                 on its ends
    source : str                           the file
    diameter, height : float [m] or None   where lines above the columns give them
    notes : tuple of str                   units assumed, signs reversed, in full sentences
    """

    displacement: PointScalars
    force: PointScalars
    source: str
    diameter: float | None = None
    height: float | None = None
    notes: tuple[str, ...] = ()


def metres_from_text(text: str, *, name: str = "length") -> float:
    """Length in metres of `50mm`, `5 cm`, `0.05m`, `2in`; a bare number is metres.

    Parameters
    ----------
    text : str   number and, optionally, one of um, mm, cm, m, in
    name : str   what is measured; goes into messages

    Returns
    -------
    float [m]    > 0

    Raises
    ------
    InputError   no number, an unknown unit, not positive, or a size (above 2 m, below 0.1 mm) that
                 no specimen has: usually because the unit is missing
    """
    match = re.fullmatch(rf"\s*({NUMBER})\s*([A-Za-zµ]*)\s*", text)
    if not match or (match[2] and match[2] not in METRES):
        raise InputError(f'{name} is "{text}"; write a number with its unit, like 50mm, 5cm, 0.05m')
    metres = float(match[1]) * METRES[match[2] or "m"]
    if not 1e-4 <= metres <= 2.0:
        hint = f"did you mean {match[1]}mm?" if not match[2] else "check the unit"
        raise InputError(f'{name} is "{text}", that is {metres:g} m; must be from 0.1 mm to 2 m: '
                         f"{hint}")  # fmt: skip
    return metres


def read_compression(
    path: str | Path,
    *,
    displacement_unit: str | None = None,
    force_unit: str | None = None,
    displacement_column: str | None = None,
    force_column: str | None = None,
) -> CompressionRecord:
    """Shortening and force from a text file, with any lines above the columns.

    Columns are separated by commas, semicolons, tabs or blanks. A line of names right above the
    numbers selects the columns (Compression, Displacement, Load, Force, ...) and gives their
    units (`Load (N)`, `Compression [mm]`); without names, the file has two columns: displacement
    and force. Lines like `Cylinder Diameter: 50mm;` are read too.

    Parameters
    ----------
    path : file
    displacement_unit : um, mm, cm, m or in   overrides the file; mm where neither states it
    force_unit : mN, N, kN, gf, kgf or lbf    overrides the file; N where neither states it
    displacement_column, force_column : str   the column's name, or a part of it

    Returns
    -------
    CompressionRecord

    Raises
    ------
    InputError    unit not known
    RecordError   file missing, no numbers, text among the numbers, column missing, times that do
                  not ascend, a size that no specimen has
    """
    _check_unit(displacement_unit, METRES, "displacement_unit")
    _check_unit(force_unit, FORCE_UNITS, "force_unit")
    table = _read_table(Path(path))
    columns = (
        _column(table, displacement_column, DISPLACEMENT_WORDS, "displacement", 0),
        _column(table, force_column, FORCE_WORDS, "force", 1),
    )
    if columns[0] == columns[1]:
        raise RecordError(
            f"{path}: displacement and force would both be column {columns[0].index + 1}; name them"
            " with displacement_column and force_column"
        )
    _check_times(table)
    values = table.values(columns)
    bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
    if len(bad):
        raise RecordError(
            f"{path}: line {table.numbers[bad[0]]}: displacement or force is not a finite number;"
            " mend or delete the line"
        )
    notes: list[str] = []
    scale = _unit(table.path, columns[0], METRES, displacement_unit, "mm", "displacement", notes)
    force_scale = _unit(table.path, columns[1], FORCE_UNITS, force_unit, "N", "force", notes)
    return CompressionRecord(
        displacement=_compression_positive(values[:, 0] * scale, "displacement", notes),
        force=_compression_positive(values[:, 1] * force_scale, "force", notes),
        source=str(path),
        diameter=_size_above(table, "diameter"),
        height=_size_above(table, "height"),
        notes=tuple(notes),
    )


def _check_unit(unit: str | None, known: dict[str, float], name: str) -> None:
    """Refuse a unit that is not in the table."""
    if unit is not None and unit not in known:
        raise InputError(f'{name} is "{unit}"; must be one of {", ".join(known)}')


def _read_table(path: Path) -> TextTable:
    """The rows of numbers; the last line with text above them names the columns where it can."""
    lines = text_lines(path, cure=_CURE)
    first, delimiter = _first_row(lines, path)
    width = len(_cells(lines[first], delimiter))
    above = [line for line in lines[:first] if line.strip(_BLANK)]
    headings = _cells(above[-1].lstrip("#% "), delimiter) if above else []
    if len(headings) != width:
        headings = [""] * width
    # Lines of separators alone are not readings.
    lines = [line if line.strip(_BLANK) else "" for line in lines]
    return make_table(path, lines, headings, first=first, delimiter=delimiter, cure=_CURE)


def _cells(line: str, delimiter: str) -> list[str]:
    """Cells of one line, without blanks around them; trailing separators are dropped."""
    return [cell.strip() for cell in split_cells(line.strip().rstrip(delimiter), delimiter)]


def _first_row(lines: list[str], path: Path) -> tuple[int, str]:
    """Index of the first line with two or more numbers, and its delimiter."""
    for i, line in enumerate(lines):
        for delimiter in (d for d in ";\t, " if d in line.strip()):
            cells = _cells(line, delimiter)
            if len(cells) >= 2 and all(_is_number(cell, delimiter) for cell in cells):
                return i, delimiter
    raise RecordError(f"{path}: no line with two numbers in {len(lines)} lines; {_CURE}")


def _is_number(cell: str, delimiter: str) -> bool:
    """True where a cell is a number; a decimal comma is accepted unless it is the delimiter."""
    try:
        float(cell if delimiter == "," else cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _column(
    table: TextTable, wanted: str | None, words: tuple[str, ...], what: str, default: int
) -> Column:
    """The requested column, else the one whose name contains one of the words, else, without names,
    the default one of two."""
    path, named = table.path, [column for column in table.columns if column.heading]
    cure = f'name it with {what}_column (command line: --{what}-column "...")'
    if wanted is None and not named:
        if len(table.columns) != 2:
            raise RecordError(
                f"{path}: {len(table.columns)} columns without names; a file without names has two,"
                " displacement and force: put a line of names above the numbers"
            )
        return table.columns[default]
    keys = (wanted.lower(),) if wanted is not None else words
    for key in keys:
        candidates = [column for column in named if key in column.heading.lower()]
        exact = [column for column in candidates if column.heading.lower() == key]
        if len(candidates) == 1 or exact:
            return (exact or candidates)[0]
        if candidates:
            raise RecordError(
                f'{path}: {len(candidates)} columns match {what} "{key}"'
                f" ({', '.join(column.heading for column in candidates)}); {cure}"
            )
    listed = ", ".join(column.heading for column in named) or "none, the columns have no names"
    raise RecordError(
        f'{path}: no column for the {what} ("{" / ".join(keys)}"); the file has: {listed}; {cure}'
    )


def _unit(
    path: Path,
    column: Column,
    known: dict[str, float],
    wanted: str | None,
    usual: str,
    what: str,
    notes: list[str],
) -> float:
    """Factor to SI units: of the requested unit, else of the one in brackets in the column's name,
    else of the usual one."""
    match = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", column.heading)
    if wanted is not None:
        if match and match[1] != wanted:
            notes.append(f"The file says {match[1]} for the {what}; {wanted} is taken, as asked.")
        return known[wanted]
    if match and match[1] in known:
        return known[match[1]]
    if match:
        raise RecordError(
            f'{path}: column "{column.heading}": unit "{match[1]}" is not known; must be one of '
            f"{', '.join(known)}: correct it, or say {what}_unit"
        )
    notes.append(f"The file gives no unit for the {what}; {usual} is taken.")
    return known[usual]


def _compression_positive(values: PointScalars, what: str, notes: list[str]) -> PointScalars:
    """Values with compression positive: the sign of a mostly negative column is reversed."""
    if len(values) and values[np.argmax(np.abs(values))] < 0 and np.median(values) < 0:
        notes.append(f"The {what} is negative in the file; its sign was turned.")
        return -values
    return values


def _check_times(table: TextTable) -> None:
    """Refuse rows that are not in the order of time, where there is a column of times."""
    for column in table.columns:
        if not column.heading.lower().startswith(_TIME):
            continue
        time = np.zeros(0)
        # Times of day are no numbers.
        with suppress(RecordError):
            time = table.values([column])[:, 0]
        back = np.flatnonzero(np.diff(time) < 0.0)
        if len(back):
            k = int(back[0])
            raise RecordError(
                f"{table.path}: line {table.numbers[k + 1]}: the times do not ascend:"
                f" '{column.heading}' goes from {time[k]:g} to {time[k + 1]:g}; sort the rows by"
                " time, and keep one loading branch in the file"
            )


def _size_above(table: TextTable, word: str) -> float | None:
    """Size [m] that a line above the columns gives, like `Cylinder Diameter: 50mm;`."""
    for line in table.preamble:
        match = re.search(rf"{word}\s*[:=,]?\s*({NUMBER})\s*(um|mm|cm|m|in)\b", line, re.IGNORECASE)
        if match:
            text = f"{match[1]}{match[2].lower()}"
            return metres_from_text(text, name=f"{table.path}: the {word}")
    return None
