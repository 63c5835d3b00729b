"""Tables of numbers in text files of measuring programs, with any separator and locale; tables for
spreadsheets."""

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.arrays import LARGEST_NUMBER
from palpate.errors import RecordError, quoted, visible
from palpate.files import read_bytes

_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\]]*)\]$")
_WORD = re.compile(r"\S+(?:(?<!\])\s+\[[^\]]*\])?")
# Representations of "not a number" by programs, .NET and Visual C++, in several languages.
_NO_NUMBER = {
    "", "-", "na", "n/a", "#n/a", "null", "n. def.", "neun", "non num\u00e9rique",
    "non un numero reale", "\u975e\u6570\u5b57", "\u221e"
}  # fmt: skip
_NO_NUMBER_START = ("nan", "1.#")
_INFINITE = {"inf", "infinity", "infinite", "infinito", "infini"}
# Largest file [bytes]: three million rows of six numbers.
_MAX_BYTES = 2**28
# Longest line [characters]: longer than in any table, but within the limit of the csv module.
_LONGEST_LINE = 100_000
# Longest heading searched for a unit [characters], which takes quadratic time.
_LONGEST_HEADING = 200
# Beginnings of what spreadsheets compute.
_FORMULA_STARTS = ("=", "+", "-", "@")
_BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table.

    Parameters
    ----------
    heading : str                   as in the file, without quotes
    index : int                     position in the table, from 0
    """

    heading: str
    index: int

    @property
    def name(self) -> str:
        """The heading without its unit."""
        match = _UNIT.match(self.heading[:_LONGEST_HEADING])
        return match["name"].strip() if match else self.heading

    @property
    def unit(self) -> str | None:
        """The text in square brackets after the name; None if there is none."""
        match = _UNIT.match(self.heading[:_LONGEST_HEADING])
        return match["unit"].strip() if match else None


@dataclass(frozen=True, slots=True)
class TextTable:
    """A header and the rows below it, not yet converted to numbers.

    Parameters
    ----------
    path : Path
    delimiter : str                 one character; a blank stands for any run of blanks
    columns : tuple of Column
    numbers : tuple of int          line number of each row in the file, from 1
    rows : tuple of str             lines of the rows
    preamble : tuple of str         lines above the rows, including the header
    """

    path: Path
    delimiter: str
    columns: tuple[Column, ...]
    numbers: tuple[int, ...]
    rows: tuple[str, ...]
    preamble: tuple[str, ...]

    @property
    def listed(self) -> str:
        """The first headings, shortened, for messages about a column that is missing."""
        shown = ", ".join(column.heading[:40] for column in self.columns[:12])
        return shown + (", ..." if len(self.columns) > 12 else "")

    def find(self, words: Collection[str], *, normalise: Callable[[str], str]) -> Column | None:
        """The column whose name is one of some words, or None.

        Parameters
        ----------
        words : collection of str
        normalise : callable        column name -> normalised name that is compared with the words

        Raises
        ------
        RecordError                 several columns match
        """
        matching = [column for column in self.columns if normalise(column.name) in words]
        if len(matching) > 1:
            raise RecordError(
                f"{self.path}: the column '{matching[0].name}' is there {len(matching)} times;"
                " export one"
            )
        return matching[0] if matching else None

    def require(
        self,
        wanted: Mapping[str, Collection[str]],
        *,
        normalise: Callable[[str], str],
        reason: Callable[[list[str]], str],
    ) -> list[Column]:
        """Required columns, in the order of `wanted`.

        Parameters
        ----------
        wanted : mapping            name for messages -> words, as in `find`
        normalise : callable        as in `find`
        reason : callable           missing names -> likely reason or remedy, for the message

        Raises
        ------
        RecordError                 a column is missing, or occurs twice
        """
        columns = {name: self.find(words, normalise=normalise) for name, words in wanted.items()}
        if missing := [name for name, column in columns.items() if column is None]:
            raise RecordError(
                f"{self.path}: the column '{missing[0]}' is missing; {reason(missing)}; it has:"
                f" {self.listed}"
            )
        return [column for column in columns.values() if column]

    def unit(self, wanted: Sequence[Column]) -> str | None:
        """The common unit of some columns, or None if they have none.

        Parameters
        ----------
        wanted : sequence of Column     of this table, at least one

        Raises
        ------
        RecordError                 the units differ
        """
        units = {column.unit or None for column in wanted}
        if len(units) > 1:
            names = ", ".join(f"{column.name} [{column.unit or '?'}]" for column in wanted)
            raise RecordError(
                f"{self.path}: its columns have different units ({names}); export all in one"
            )
        return units.pop()

    def factor(self, wanted: Sequence[Column], known: Mapping[str, float], default: float) -> float:
        """Value of the common unit of some columns in SI units.

        Parameters
        ----------
        wanted : sequence of Column     of this table, at least one
        known : mapping                 unit -> its value in SI units
        default : float                 result if the columns have no unit

        Raises
        ------
        RecordError                     the units differ, or are none of the known ones
        """
        unit = self.unit(wanted)
        if unit is not None and unit not in known:
            raise RecordError(
                f"{self.path}: column {quoted(wanted[0].heading)} is in {quoted(unit)}; must be in"
                f" one of {', '.join(known)}: convert it"
            )
        return default if unit is None else known[unit]

    def values(self, wanted: Sequence[Column], *, finite: bool = False) -> Float[np.ndarray, "n k"]:
        """Numbers of some columns; NaN where a cell is empty or marked as not a number.

        Parameters
        ----------
        wanted : sequence of Column     of this table
        finite : bool                   refuse infinities; else they are kept: the caller decides
                                        whether they mean a failure or a mistake

        Returns
        -------
        (n, k) float                    one row per row of the table, in its units

        Raises
        ------
        RecordError                 text in a cell, a row that is too short or too long, a number
                                    beyond `LARGEST_NUMBER`
        """
        values = self._values(wanted)
        refused = np.abs(values) > LARGEST_NUMBER
        if not finite:
            refused &= np.isfinite(values)
        if refused.any():
            row, k = np.argwhere(refused)[0]
            raise self._cell_error(self.numbers[row], wanted[k], f"{values[row, k]:g}")
        # Powers of smaller numbers would underflow.
        values[np.abs(values) < 1.0 / LARGEST_NUMBER] = 0.0
        return values

    def _values(self, wanted: Sequence[Column]) -> Float[np.ndarray, "n k"]:
        """As `values`, without the check of their magnitude."""
        count = len(self.columns)
        use = [column.index for column in wanted]
        if self.delimiter != " " and all(
            row.count(self.delimiter) == count - 1 for row in self.rows
        ):
            with suppress(ValueError):
                return np.loadtxt(
                    self.rows, delimiter=self.delimiter, usecols=use, ndmin=2, comments=None
                )
        return self._values_slowly(wanted)

    def _values_slowly(self, wanted: Sequence[Column]) -> Float[np.ndarray, "n k"]:
        """As `_values`, cell by cell, so that errors name line and column."""
        count = len(self.columns)
        values = np.full((len(self.rows), len(wanted)), np.nan)
        for i, (number, row) in enumerate(zip(self.numbers, self.rows, strict=True)):
            cells = split_cells(row, self.delimiter)
            if len(cells) < count or any(cell.strip() for cell in cells[count:]):
                raise RecordError(
                    f"{self.path}: line {number}: has {len(cells)} cells; the header has {count}"
                    " columns: was the file cut off? Export it again"
                )
            for k, column in enumerate(wanted):
                values[i, k] = self._number(cells[column.index], number, column)
        return values

    def _number(self, cell: str, line: int, column: Column) -> float:
        word = cell.strip().strip('"').strip()
        bare = word.lower().lstrip("+-")
        if word.lower() in _NO_NUMBER or bare in _NO_NUMBER or bare.startswith(_NO_NUMBER_START):
            return np.nan
        if bare in _INFINITE:
            return np.inf
        try:
            # Python would accept 1_0 as ten.
            return float(word.replace("_", "?"))
        except ValueError as error:
            raise self._cell_error(line, column, word) from error

    def _cell_error(self, line: int, column: Column, word: str) -> RecordError:
        """The error about one cell."""
        return RecordError(
            f"{self.path}: line {line}: column {quoted(column.name or column.index + 1)} holds"
            f" {quoted(word)}; must be a number, {LARGEST_NUMBER:g} at most (NaN, or nothing, where"
            " it was not measured)"
        )


def missing_depth(missing: Collection[str]) -> str | None:
    """Message for a 2-D result, in which only Z or W is missing; None if any other column is.

    Parameters
    ----------
    missing : collection of str     missing names among X, Y, Z, U, V, W

    Returns
    -------
    str or None
    """
    if not {"Z", "W"} & set(missing) or {"X", "Y", "U", "V"} & set(missing):
        return None
    return "it is a 2-D result, and depth is needed: export a stereo result"


def read_text_table(path: Path, *, cure: str) -> TextTable:
    """Read header and rows of a file and detect its separator; decimal commas become points.

    Leading lines that start with '*' or '#', a line 'sep=;' and blank lines are skipped.

    Parameters
    ----------
    path : Path
    cure : str                      advice for a file without a table, for messages

    Returns
    -------
    TextTable

    Raises
    ------
    RecordError                     missing, not text, no header, no rows, a header among the rows
    """
    lines = text_lines(path, cure=cure)
    header_row = next((i for i, line in enumerate(lines) if _is_header(line)), None)
    if header_row is None:
        raise RecordError(f"{path}: is empty; {cure}")
    delimiter = next((mark for mark in ";\t," if mark in lines[header_row]), " ")
    headings = [
        word.strip().strip('"').strip() for word in split_cells(lines[header_row], delimiter)
    ]
    while headings and not headings[-1]:
        headings.pop()
    if not headings:
        raise RecordError(f"{path}: line {header_row + 1} has no headings; {cure}")
    return make_table(path, lines, headings, first=header_row + 1, delimiter=delimiter, cure=cure)


def make_table(
    path: Path,
    lines: Sequence[str],
    headings: Sequence[str],
    *,
    first: int,
    delimiter: str,
    cure: str,
) -> TextTable:
    """Table whose rows begin at a given line; blank lines and an immediately repeated header are
    skipped.

    Parameters
    ----------
    path : Path
    lines : sequence of str         of the whole file
    headings : sequence of str      one for each column; blank if it has no name
    first : int                     index of the first row's line, from 0; lines above are preamble
    delimiter : str                 one character; a blank stands for any run of blanks
    cure : str                      advice for a file without rows, for the message

    Raises
    ------
    RecordError                     no rows; the header again among the rows
    """
    head = lines[first - 1].strip() if first else ""
    numbered = []
    for number, line in enumerate(lines[first:], start=first + 1):
        if line.strip() and line.strip() != head:
            numbered.append((number, line))
        elif numbered and line.strip():
            raise RecordError(
                f"{path}: line {number}: the header again, so these are several measurements one"
                " after the other; give each a file of its own"
            )
    if not numbered:
        raise RecordError(f"{path}: has a header and no rows; {cure}")
    numbers, rows = zip(*numbered, strict=True)
    if delimiter != "," and any("," in row for row in rows):
        rows = tuple(row.replace(",", ".") for row in rows)
    columns = tuple(map(Column, headings, range(len(headings))))
    return TextTable(path, delimiter, columns, numbers, rows, tuple(lines[:first]))


def _is_header(line: str) -> bool:
    word = line.strip()
    return bool(word) and word[0] not in "*#" and not re.fullmatch(r'"?sep=.?"?', word)


def split_cells(line: str, delimiter: str) -> list[str]:
    """Cells of one line; a blank as delimiter stands for any run of blanks, and leaves a unit with
    its quantity, as in `time [ms]`.

    Parameters
    ----------
    line : str
    delimiter : str                 one character

    Returns
    -------
    list of str                     quotes removed, except with blanks as delimiter
    """
    if delimiter == " ":
        return _WORD.findall(line)
    return next(csv.reader([line], delimiter=delimiter))


def text_lines(path: Path, *, cure: str) -> list[str]:
    """Lines of a text file in UTF-8, UTF-16 with byte order mark, or Windows code page 1252.

    Parameters
    ----------
    path : Path
    cure : str                      advice for a file that is not text, for the message

    Raises
    ------
    RecordError                     missing, not readable, not text, or with an overlong line
    """
    lines = _decode(path, read_bytes(path, max_bytes=_MAX_BYTES), cure).splitlines()
    for number, line in enumerate(lines, start=1):
        if len(line) > _LONGEST_LINE:
            raise RecordError(
                f"{path}: line {number}: has {len(line)} characters, which is no row of a table;"
                f" {cure}"
            )
    return lines


def _decode(path: Path, content: bytes, cure: str) -> str:
    if content[:2] in _BYTE_ORDER_MARKS:
        return content.decode("utf-16", errors="replace")
    if b"\0" in content:
        raise RecordError(f"{path}: is not a text file; {cure}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def spreadsheet_text(rows: Iterable[Iterable[object]]) -> str:
    """Rows as comma-separated values; what a spreadsheet would compute is a text for it.

    Parameters
    ----------
    rows : iterable of iterables    cells; None: empty

    Returns
    -------
    str                             texts that begin like a formula, and are no numbers, have an
                                    apostrophe before them; a tab or line break is shown as `\\t`,
                                    `\\n`: what comes after it would begin a cell

    Source
    ------
    OWASP, CSV Injection
    """
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(_spreadsheet_cell, row) for row in rows)
    return text.getvalue()


def _spreadsheet_cell(cell: object) -> object:
    if not isinstance(cell, str):
        return cell
    shown = visible(cell)
    with suppress(ValueError):
        float(shown)
        return shown
    return f"'{shown}" if shown.startswith(_FORMULA_STARTS) else shown
