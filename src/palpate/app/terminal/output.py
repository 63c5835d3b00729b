"""Tables and sentences of a command: printed, or kept for a JSON document."""

import re
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from palpate.app.output import wanted_output
from palpate.app.terminal.shown_table import ShownTable
from palpate.errors import visible
from palpate.records import NOT_DETERMINED

# What a cell may say besides a text: nothing, a number, a number and its deviation, an interval, a
# vector.
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_DEVIATION = re.compile(rf"({_NUMBER}) ± ({_NUMBER})")
_VECTOR = re.compile(rf"{_NUMBER}(?:, {_NUMBER})+")
_INTERVAL = re.compile(rf"\(?({_NUMBER}) to ({_NUMBER})\)?")


def print_tables(*tables: Table) -> None:
    """Print tables, or keep them for the document.

    Parameters
    ----------
    tables : Table                  of `terminal_table`
    """
    wanted = wanted_output()
    if wanted.json:
        wanted.tables.extend(
            table_content(table.heading, table.names, table.cells, table.below)
            for table in tables
            if isinstance(table, ShownTable)
        )
    else:
        Console().print(*tables)


def print_text(text: str, *, wrapped: bool = True) -> None:
    """Print sentences as they are: brackets in names are no markup, and what would command the
    terminal is escaped.

    Parameters
    ----------
    text : str
    wrapped : bool                  between words at the terminal's width; not where it is copied
    """
    wanted = wanted_output()
    text = "\n".join(map(visible, text.split("\n")))
    if wanted.json:
        wanted.sentences.extend(text.splitlines())
    else:
        Console().print(text, markup=False, highlight=False, soft_wrap=not wrapped)


def table_content(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], caption: str
) -> dict[str, Any]:
    """A table as a document has it: a mapping for each row, numbers as numbers.

    Parameters
    ----------
    title : str
    columns : sequence of str
    rows : sequence of sequences of str     the first cell of a row is a name and stays a text
    caption : str

    Returns
    -------
    dict                            `title`, `rows`, `caption`
    """
    shown = [
        {
            name: cell if k == 0 else _cell_value(cell)
            for k, (name, cell) in enumerate(zip(columns, row, strict=True))
        }
        for row in rows
    ]
    return {"title": title, "rows": shown, "caption": caption}


def _cell_value(cell: str) -> Any:
    """What a cell says: null for a dash, a number, `value` and `std`, both ends of an interval, the
    components of a vector."""
    text = cell.strip()
    if text in ("", "-", NOT_DETERMINED):
        return None
    if re.fullmatch(r"[+-]?\d+", text):
        return int(text)
    if re.fullmatch(_NUMBER, text):
        return float(text)
    if found := _WITH_DEVIATION.fullmatch(text):
        return {"value": float(found[1]), "std": float(found[2])}
    if found := _INTERVAL.fullmatch(text):
        return [float(found[1]), float(found[2])]
    if _VECTOR.fullmatch(text):
        return [_cell_value(part) for part in text.split(",")]
    return text
