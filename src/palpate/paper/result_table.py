"""A table of results that is written as Markdown and CSV and printed on the terminal alike."""

import csv
import io
import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

Cell = str | int | float | None
# Headings are broken between words, so that columns are as narrow as what is in them, or this.
_HEADING = 7


@dataclass(frozen=True, slots=True)
class ResultTable:
    """Named columns and rows.

    Attributes
    ----------
    title : str
    columns : tuple of str          with units
    decimals : tuple of int         shown of the numbers in each column
    rows : tuple of tuples of Cell  None and NaN: not known
    """

    title: str
    columns: tuple[str, ...]
    decimals: tuple[int, ...]
    rows: tuple[tuple[Cell, ...], ...]


def markdown_text(table: ResultTable) -> str:
    """A table in GitHub's Markdown, numbers to the right, without its title."""
    head = "| " + " | ".join(table.columns) + " |"
    rule = "|" + "|".join("---:" if _numeric(table, k) else "---" for k in _range(table)) + "|"
    lines = ["| " + " | ".join(row) + " |" for row in _texts(table)]
    return "\n".join([head, rule, *lines]) + "\n"


def csv_text(tables: Sequence[ResultTable]) -> str:
    """Tables as comma-separated values, all digits, an empty line between them.

    Unknown values are empty. Every table begins with its columns' names.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    for number, table in enumerate(tables):
        if number:
            stream.write("\n")
        writer.writerow(table.columns)
        writer.writerows([[_plain(cell) for cell in row] for row in table.rows])
    return stream.getvalue()


def terminal_table(table: ResultTable) -> Table:
    """The same for the terminal."""
    shown = Table(
        title=escape(table.title), title_justify="left", box=SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    rows = _texts(table)
    for k, name in enumerate(table.columns):
        longest = max((len(row[k]) for row in rows), default=0)
        shown.add_column(
            escape(textwrap.fill(name, max(longest, _HEADING), break_long_words=False)),
            justify="right" if _numeric(table, k) else "left",
            overflow="fold",
        )
    for row in rows:
        shown.add_row(*map(escape, row))
    return shown


def _range(table: ResultTable) -> range:
    return range(len(table.columns))


def _numeric(table: ResultTable, column: int) -> bool:
    return not any(isinstance(row[column], str) for row in table.rows)


def _texts(table: ResultTable) -> list[tuple[str, ...]]:
    """Every cell as a person reads it."""
    return [
        tuple(_text(cell, places) for cell, places in zip(row, table.decimals, strict=True))
        for row in table.rows
    ]


def _text(cell: Cell, decimals: int) -> str:
    if _unknown(cell):
        return "-"
    return f"{cell:.{decimals}f}" if isinstance(cell, float) else str(cell)


def _plain(cell: Cell) -> str:
    if _unknown(cell):
        return ""
    return repr(cell) if isinstance(cell, float) else str(cell)


def _unknown(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, float) and not math.isfinite(cell))
