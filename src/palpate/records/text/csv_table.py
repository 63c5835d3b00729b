"""Tables of numbers in text files as measuring programs write them: any separator, any locale."""

import csv
import re
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError

_UNIT = re.compile(r"^(?P<name>.*?)\s*\[(?P<unit>[^\]]*)\]$")
# How programs and the number formats of .NET and of Visual C++ write "no number".
_NO_NUMBER = {
    "",
    "-",
    "na",
    "n/a",
    "#n/a",
    "null",
    "n. def.",
    "neun",
    "non num\u00e9rique",
    "non un numero reale",
    "\u975e\u6570\u5b57",
    "\u221e",
    "infinity",
}
_NO_NUMBER_START = ("nan", "inf", "1.#")
_BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff")


@dataclass(frozen=True, slots=True)
class Column:
    """One column of a table.

    Parameters
    ----------
    name : str                      without quotes and unit
    unit : str or None              what stood in brackets
    index : int                     from 0
    """

    name: str
    unit: str | None
    index: int


@dataclass(frozen=True, slots=True)
class TextTable:
    """A header and the lines below it, not yet turned into numbers.

    Parameters
    ----------
    path : Path
    delimiter : str                 one character; a blank stands for any run of blanks
    columns : tuple of Column
    numbers : tuple of int          line of each row in the file, from 1
    rows : tuple of str
    preamble : tuple of str         lines above the header
    """

    path: Path
    delimiter: str
    columns: tuple[Column, ...]
    numbers: tuple[int, ...]
    rows: tuple[str, ...]
    preamble: tuple[str, ...]

    def find(self, words: Collection[str], *, spelled: Callable[[str], str]) -> Column | None:
        """The column whose name is one of some words, or None.

        Parameters
        ----------
        words : collection of str
        spelled : callable          what of a column's name is compared with them

        Raises
        ------
        RecordError                 there are several
        """
        found = [column for column in self.columns if spelled(column.name) in words]
        if len(found) > 1:
            raise RecordError(
                f"{self.path}: the column '{found[0].name}' is there {len(found)} times; export one"
            )
        return found[0] if found else None

    def names(self) -> str:
        """The names of the first columns, for messages."""
        shown = [column.name for column in self.columns[:12]]
        return ", ".join(shown) + (", ..." if len(self.columns) > len(shown) else "")

    def unit(self, wanted: Sequence[Column]) -> str | None:
        """The one unit of some columns, or None where none is named.

        Raises
        ------
        RecordError                 they differ
        """
        units = {column.unit or None for column in wanted}
        if len(units) > 1:
            told = ", ".join(f"{column.name} [{column.unit or '?'}]" for column in wanted)
            raise RecordError(
                f"{self.path}: its columns have different units ({told}); export all in one"
            )
        return units.pop()

    def values(self, wanted: Sequence[Column]) -> Float[np.ndarray, "n k"]:
        """Numbers of some columns; NaN where a cell is empty or says that it is no number.

        Raises
        ------
        RecordError                 text in a cell, a row that is too short or too long
        """
        count = len(self.columns)
        use = [column.index for column in wanted]
        if self.delimiter != " " and all(
            row.count(self.delimiter) == count - 1 for row in self.rows
        ):
            try:
                found = np.loadtxt(
                    self.rows, delimiter=self.delimiter, usecols=use, ndmin=2, comments=None
                )
            except ValueError:
                return self._values_slowly(wanted)
            return np.where(np.isinf(found), np.nan, found)
        return self._values_slowly(wanted)

    def _values_slowly(self, wanted: Sequence[Column]) -> Float[np.ndarray, "n k"]:
        """As `values`, cell by cell: anything wrong has a line and a column."""
        count = len(self.columns)
        found = np.full((len(self.rows), len(wanted)), np.nan)
        for i, (number, row) in enumerate(zip(self.numbers, self.rows, strict=True)):
            cells = _cells(row, self.delimiter)
            if len(cells) == count + 1 and not cells[-1].strip():
                cells = cells[:-1]
            if len(cells) != count:
                raise RecordError(
                    f"{self.path}: line {number}: has {len(cells)} cells; the header has {count}"
                    " columns: was the file cut off? Export it again"
                )
            for k, column in enumerate(wanted):
                found[i, k] = self._number(cells[column.index], number, column)
        return found

    def _number(self, cell: str, line: int, column: Column) -> float:
        word = cell.strip().strip('"').strip()
        bare = word.lower().lstrip("+-")
        if word.lower() in _NO_NUMBER or bare in _NO_NUMBER or bare.startswith(_NO_NUMBER_START):
            return np.nan
        try:
            return float(word)
        except ValueError as error:
            raise RecordError(
                f"{self.path}: line {line}: column '{column.name}' holds '{word}'; must be a number"
                " (NaN or nothing where a point was not measured)"
            ) from error


def read_text_table(path: Path, *, program: str) -> TextTable:
    """Header and rows of a file, with the separator it uses; decimal commas become points.

    Lines on top that start with '*' or '#' and a line 'sep=;' are passed over, blank lines and
    repetitions of the header too.

    Parameters
    ----------
    path : Path
    program : str                   who wrote it, for messages

    Raises
    ------
    RecordError                     not there, not text, no header, no rows
    """
    lines = _text(path, program).splitlines()
    top = next((i for i, line in enumerate(lines) if _is_header(line)), None)
    if top is None:
        raise RecordError(f"{path}: is empty; export the points from {program} again")
    head = lines[top]
    delimiter = next((mark for mark in ";\t," if mark in head), " ")
    words = [word.strip().strip('"').strip() for word in _cells(head, delimiter)]
    while words and not words[-1]:
        words.pop()
    kept = [
        (number, line)
        for number, line in enumerate(lines[top + 1 :], start=top + 2)
        if line.strip() and line.strip() != head.strip()
    ]
    if not kept:
        raise RecordError(f"{path}: has a header and no rows; export the points again")
    numbers, rows = zip(*kept, strict=True)
    if delimiter != "," and any("," in row for row in rows):
        rows = tuple(row.replace(",", ".") for row in rows)
    columns = tuple(map(_column, words, range(len(words))))
    return TextTable(path, delimiter, columns, numbers, rows, tuple(lines[:top]))


def _is_header(line: str) -> bool:
    word = line.strip()
    return bool(word) and word[0] not in "*#" and not re.fullmatch(r'"?sep=.?"?', word)


def _cells(line: str, delimiter: str) -> list[str]:
    return line.split() if delimiter == " " else next(csv.reader([line], delimiter=delimiter))


def _column(word: str, index: int) -> Column:
    if match := _UNIT.match(word):
        return Column(match["name"].strip(), match["unit"].strip(), index)
    return Column(word, None, index)


def _text(path: Path, program: str) -> str:
    """Content of a text file in UTF-8, UTF-16 with a mark, or the Western code page of Windows."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error
    if content[:2] in _BYTE_ORDER_MARKS:
        return content.decode("utf-16", errors="replace")
    if b"\0" in content:
        raise RecordError(
            f"{path}: is not a text file; export the points from {program} as text, or name another"
            " KIND"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")
