"""How far one `palpate fit` travels through the code: files entered, moves between files and rooms.

    python -m benchmarks.trace_fit SESSION PROBING

Functions of `palpate` are listed in the order in which the main thread enters them. A move is a
pair of neighbours in this list that lie in different files. The ground floor's files are one room.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from types import FrameType

import palpate
from palpate.app.cli import main as run_command

_ROOT = os.path.dirname(palpate.__file__) + os.sep


@dataclass(frozen=True, slots=True)
class Trace:
    """Counts of a list of functions entered.

    Attributes
    ----------
    files : int             entered at least once
    moves : int             from one file to another
    between_rooms : int     of these, from one room to another
    routes : int            different pairs of files among the moves: what a reader follows once
    routes_between_rooms : int      of these, from one room to another
    """

    files: int
    moves: int
    between_rooms: int
    routes: int
    routes_between_rooms: int

    @classmethod
    def of(cls, entered: Sequence[str]) -> "Trace":
        """Counts of the files of functions in the order in which they were entered."""
        moves = [(last, here) for last, here in pairwise(entered) if last != here]
        crossing = [move for move in moves if room(move[0]) != room(move[1])]
        counts = (len(set(entered)), len(moves), len(crossing))
        return cls(*counts, len(set(moves)), len(set(crossing)))


def traced(work: Callable[[], object]) -> list[str]:
    """File of each function of `palpate` that some work enters, in order, relative to the package.

    Parameters
    ----------
    work : callable         without arguments
    """
    entered: list[str] = []

    def note(frame: FrameType, event: str, _argument: object) -> None:
        code = frame.f_code
        # Bodies of modules and classes run once, when they are imported: no part of the fit.
        imported = code.co_name == "<module>" or "__qualname__" in code.co_names
        file = code.co_filename
        if event == "call" and file.startswith(_ROOT) and not imported:
            entered.append(file.removeprefix(_ROOT))

    sys.setprofile(note)
    try:
        work()
    finally:
        sys.setprofile(None)
    return entered


def room(file: str) -> str:
    """The room that a file belongs to, by its path relative to the package."""
    return Path(file).parts[0] if os.sep in file else "ground floor"


def main() -> None:
    """Trace a fit and print the counts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trace_fit", description=__doc__)
    parser.add_argument("session", help="with pictures")
    parser.add_argument("probing")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "result")
        arguments = ["fit", given.session, "--probe", given.probing, "--out", out]
        trace = Trace.of(traced(lambda: run_command(arguments)))
    print(
        f"files entered {trace.files}, moves between files {trace.moves}, between rooms"
        f" {trace.between_rooms}; different moves {trace.routes}, between rooms"
        f" {trace.routes_between_rooms}"
    )


if __name__ == "__main__":
    main()
