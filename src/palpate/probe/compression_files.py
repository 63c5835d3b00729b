"""Read compression records: files of testing machines, and plain columns of numbers."""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError, RecordError
from palpate.shapes import PointScalars

METRES = {"um": 1e-6, "µm": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
NEWTONS = {"mN": 1e-3, "N": 1.0, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216}
DISPLACEMENT_WORDS = ("compression", "displacement", "extension", "crosshead", "stroke", "position")
FORCE_WORDS = ("load", "force")
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
SHOWN = 60  # characters of a bad line that a message quotes


@dataclass(frozen=True, slots=True, eq=False)
class CompressionRecord:
    """One loading of one cylinder as a file gives it, in SI, compression positive.

    Attributes
    ----------
    displacement : (n,) float [m]          shortening of the cylinder
    force : (n,) float [N]                 on its ends
    source : str                           the file
    diameter, height : float [m] or None   where lines above the columns tell them
    notes : tuple of str                   units assumed, signs turned, in full sentences
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
                 no specimen has: most often a unit left out
    """
    match = re.fullmatch(rf"\s*({NUMBER})\s*([A-Za-zµ]*)\s*", text)
    if not match or (match[2] and match[2] not in METRES):
        raise InputError(f'{name} is "{text}"; write a number with its unit, like 50mm, 5cm, 0.05m')
    metres = float(match[1]) * METRES[match[2] or "m"]
    if not 1e-4 <= metres <= 2.0:
        hint = f"did you mean {match[1]}mm?" if not match[2] else "check the unit"
        raise InputError(f'{name} is "{text}", that is {metres:g} m; a specimen has 0.1 mm to 2 m: '
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
    """Shortening and force from a text file, whatever stands above the columns.

    Columns are split at commas, semicolons, tabs or blanks. A line of names right above the
    numbers selects the columns (Compression, Displacement, Load, Force, ...) and tells their
    units (`Load (N)`, `Compression [mm]`); without names, the file has two columns: displacement
    and force. Lines like `Cylinder Diameter: 50mm;` are read too.

    Parameters
    ----------
    path : file
    displacement_unit : um, mm, cm, m or in   overrides the file; mm where neither says it
    force_unit : mN, N, kN, gf, kgf or lbf    overrides the file; N where neither says it
    displacement_column, force_column : str   the column's name, or a part of it

    Raises
    ------
    InputError    unit not known
    RecordError   file missing, no numbers, text among the numbers, column missing
    """
    _check_unit(displacement_unit, METRES, "displacement_unit")
    _check_unit(force_unit, NEWTONS, "force_unit")
    lines = _lines(Path(path))
    first, splitter = _first_row(lines, path)
    names = _names(lines, first, splitter)
    table = _table(lines, first, splitter, path)
    columns = (
        _column(names, displacement_column, DISPLACEMENT_WORDS, "displacement", 0, table, path),
        _column(names, force_column, FORCE_WORDS, "force", 1, table, path),
    )
    if columns[0] == columns[1]:
        raise RecordError(f"{path}: displacement and force would both be column {columns[0] + 1}; "
                          "name them with displacement_column and force_column")  # fmt: skip
    notes: list[str] = []
    scale = _unit(names, columns[0], METRES, displacement_unit, "mm", "displacement", notes)
    force_scale = _unit(names, columns[1], NEWTONS, force_unit, "N", "force", notes)
    displacement = _turned(table[:, columns[0]] * scale, "displacement", notes)
    force = _turned(table[:, columns[1]] * force_scale, "force", notes)
    return CompressionRecord(
        displacement, force, str(path), _told(lines[:first], "diameter"),
        _told(lines[:first], "height"), tuple(notes),
    )  # fmt: skip


def _check_unit(unit: str | None, known: dict[str, float], name: str) -> None:
    """Refuse a unit that is not in the table."""
    if unit is not None and unit not in known:
        raise InputError(f'{name} is "{unit}"; must be one of {", ".join(known)}')


def _lines(path: Path) -> list[str]:
    """Lines of a text file in UTF-8 or Latin-1."""
    try:
        data = path.read_bytes()
    except FileNotFoundError as e:
        raise RecordError(f"{path}: no such file; check the path") from e
    except OSError as e:
        raise RecordError(f"{path}: cannot be read ({e.strerror}); give a text file") from e
    try:
        return data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        return data.decode("latin-1").splitlines()


def _cells(line: str, splitter: str | None) -> list[str]:
    """Cells of one line; closing separators and blanks round the cells fall away."""
    line = line.strip()
    if splitter is None:
        return line.split()
    return [cell.strip().strip('"') for cell in line.rstrip(splitter).split(splitter)]


def _number(cell: str, splitter: str | None) -> float | None:
    """Number in a cell, None where it is text; a decimal comma counts where commas do not split."""
    if splitter != ",":
        cell = cell.replace(",", ".")
    try:
        return float(cell)
    except ValueError:
        return None


def _first_row(lines: list[str], path: str | Path) -> tuple[int, str | None]:
    """Line number of the first row of two or more numbers, and what splits it."""
    for i, line in enumerate(lines):
        for splitter in (";", "\t", ",", None):
            if splitter is None or splitter in line:
                cells = _cells(line, splitter)
                if len(cells) >= 2 and all(_number(c, splitter) is not None for c in cells):
                    return i, splitter
    raise RecordError(
        f"{path}: no line with two numbers in {len(lines)} lines; a record has columns of "
        "displacement and force, split by commas, semicolons, tabs or blanks"
    )


def _names(lines: list[str], first: int, splitter: str | None) -> list[str]:
    """Column names in the last line with text above the numbers; empty where it has too few."""
    width = len(_cells(lines[first], splitter))
    above = [line for line in lines[:first] if line.strip(" \t,;")]
    if not above:
        return []
    names = _cells(above[-1].lstrip("#% "), splitter)
    return names if len(names) == width else []


def _table(
    lines: list[str], first: int, splitter: str | None, path: str | Path
) -> Float[np.ndarray, "n c"]:
    """All rows of numbers from the first on; text or a missing cell is refused with its line."""
    width = len(_cells(lines[first], splitter))
    rows = []
    for i in range(first, len(lines)):
        if not lines[i].strip(" \t,;"):
            continue
        values = [_number(cell, splitter) for cell in _cells(lines[i], splitter)]
        if len(values) != width or any(v is None or not np.isfinite(v) for v in values):
            raise RecordError(
                f'{path}, line {i + 1}: "{lines[i].strip()[:SHOWN]}" is not a row of {width} '
                "numbers like the rows above it; mend or delete the line"
            )
        rows.append(values)
    return np.array(rows, dtype=float)


def _column(
    names: list[str],
    wanted: str | None,
    words: tuple[str, ...],
    what: str,
    default: int,
    table: Float[np.ndarray, "n c"],
    path: str | Path,
) -> int:
    """Index of the column asked for, or that has one of the words, or the usual one of two."""
    cure = f'name it with {what}_column (command line: --{what}-column "...")'
    if wanted is not None or names:
        keys = (wanted.lower(),) if wanted is not None else words
        for key in keys:
            found = [i for i, name in enumerate(names) if key in name.lower()]
            exact = [i for i in found if names[i].lower() == key]
            if len(found) == 1 or exact:
                return exact[0] if exact else found[0]
            if found:
                raise RecordError(f'{path}: {len(found)} columns match {what} "{key}" '
                                  f"({', '.join(names[i] for i in found)}); {cure}")  # fmt: skip
        listed = ", ".join(names) if names else "none, the columns have no names"
        raise RecordError(f'{path}: no column for the {what} ("{" / ".join(keys)}"); the file '
                          f"has: {listed}; {cure}")  # fmt: skip
    if table.shape[1] != 2:
        raise RecordError(
            f"{path}: {table.shape[1]} columns without names; a file without names has two, "
            "displacement and force: put a line of names above the numbers"
        )
    return default


def _unit(
    names: list[str],
    column: int,
    known: dict[str, float],
    wanted: str | None,
    usual: str,
    what: str,
    notes: list[str],
) -> float:
    """Factor to SI: as asked, else as the column's name says in brackets, else the usual unit."""
    if wanted is not None:
        return known[wanted]
    told = re.search(r"[\[(]\s*([^\])]+?)\s*[\])]", names[column]) if names else None
    if told and told[1] in known:
        return known[told[1]]
    if told:
        raise RecordError(
            f'column "{names[column]}": unit "{told[1]}" is not known; must be one of '
            f"{', '.join(known)}: correct it, or say {what}_unit"
        )
    notes.append(f"The file gives no unit for the {what}; {usual} is taken.")
    return known[usual]


def _turned(values: PointScalars, what: str, notes: list[str]) -> PointScalars:
    """Values with compression positive: a column that runs to the negative side is turned."""
    if len(values) and values[np.argmax(np.abs(values))] < 0 and np.median(values) < 0:
        notes.append(f"The {what} is negative in the file; its sign was turned.")
        return -values
    return values


def _told(lines: list[str], word: str) -> float | None:
    """Size [m] that a line above the columns tells, like `Cylinder Diameter: 50mm;`."""
    for line in lines:
        match = re.search(rf"{word}\s*[:=,]?\s*({NUMBER})\s*(um|mm|cm|m|in)\b", line, re.IGNORECASE)
        if match:
            return float(match[1]) * METRES[match[2].lower()]
    return None
