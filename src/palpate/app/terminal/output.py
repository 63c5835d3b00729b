"""How a command's output is wanted: on a terminal or as one JSON document, and how much of it."""

import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from rich.console import Console
from rich.table import Table

from palpate.records import NOT_DETERMINED, json_text

OUTPUT_FORMAT = "palpate-output/1"
# What a cell may say besides a text: nothing, a number, a number and its deviation, an interval.
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_DEVIATION = re.compile(rf"({_NUMBER}) ± ({_NUMBER})")
_INTERVAL = re.compile(rf"\(?({_NUMBER}) to ({_NUMBER})\)?")


class ShownTable(Table):
    """A table for the terminal that remembers its cells as they came, in `content`."""

    content: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Output:
    """How the output of a command is wanted.

    Attributes
    ----------
    json : bool                     all tables and sentences as one JSON document
    verbose : bool                  every stage of long work as a line of its own, with its time
    tables, sentences : list        what was printed so far, where it becomes a document
    """

    json: bool = False
    verbose: bool = False
    tables: list[dict[str, Any]] = field(default_factory=list)
    sentences: list[str] = field(default_factory=list)


# Of the command that runs; none where tables are printed by other programs.
_output: ContextVar[Output | None] = ContextVar("output", default=None)


@contextmanager
def output_as(wanted: Output, words: Sequence[str]) -> Iterator[None]:
    """Have what is printed within the block come out as wanted.

    Parameters
    ----------
    wanted : Output
    words : sequence of str         of the command line, for the document's heading
    """
    token = _output.set(wanted)
    try:
        yield
    finally:
        _output.reset(token)
    if wanted.json:
        document = {
            "format": OUTPUT_FORMAT, "command": list(words), "tables": wanted.tables,
            "sentences": wanted.sentences,
        }  # fmt: skip
        sys.stdout.write(json_text(document))


def is_verbose() -> bool:
    """Whether every stage of long work is to be told."""
    return _wanted().verbose


def _wanted() -> Output:
    return _output.get() or Output()


def print_tables(*tables: Table) -> None:
    """Print tables, or keep them for the document.

    Parameters
    ----------
    tables : Table                  of `terminal_table`
    """
    wanted = _wanted()
    if wanted.json:
        wanted.tables.extend(one.content for one in tables if isinstance(one, ShownTable))
    else:
        Console().print(*tables)


def print_text(text: str, *, wrapped: bool = True) -> None:
    """Print sentences as they are: brackets in names are no markup.

    Parameters
    ----------
    text : str
    wrapped : bool                  between words at the terminal's width; not where it is copied
    """
    wanted = _wanted()
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
            name: cell if k == 0 else _value(cell)
            for k, (name, cell) in enumerate(zip(columns, row, strict=True))
        }
        for row in rows
    ]
    return {"title": title, "rows": shown, "caption": caption}


def _value(cell: str) -> Any:
    """What a cell says: null for a dash, a number, `value` and `std`, both ends of an interval."""
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
    return text
