"""How a command's output is wanted: on a terminal or as one JSON document, and how much of it.

Nothing heavy is imported here: it is decided before a command is loaded.
"""

import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any

from palpate.errors import visible

OUTPUT_FORMAT = "palpate-output/1"


@dataclass(frozen=True, slots=True)
class Output:
    """How the output of a command is wanted.

    Attributes
    ----------
    json : bool                     all tables and sentences as one JSON document
    verbose : bool                  every stage of long work as a line of its own, with its time
    start : float [s]               of the command, as `time.perf_counter` has it: before what it
                                    needs is loaded
    tables, sentences : list        what was printed so far, where it becomes a document
    """

    json: bool = False
    verbose: bool = False
    start: float = field(default_factory=time.perf_counter)
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
    if wanted.json and (wanted.tables or wanted.sentences):
        document = {
            "format": OUTPUT_FORMAT, "command": list(map(visible, words)), "tables": wanted.tables,
            "sentences": wanted.sentences,
        }  # fmt: skip
        sys.stdout.write(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def wanted_output() -> Output:
    """How the output of the command that runs is wanted."""
    return _output.get() or Output()
