"""How many files one `palpate fit` from pictures passes through, and how often it moves.

    python -m benchmarks.trace_fit SESSION PROBING

Runs `palpate fit SESSION --probe PROBING` under `sys.setprofile` in every thread. Only Python
functions of palpate count; kernels that numba compiled do not. A move is a call that crosses from
one file to another: each pair of a calling and a called function counts once, or every time.
"""

import argparse
import os
import sys
import tempfile
import threading
from collections import Counter
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

import palpate
from palpate.app.cli import main as run_command

ROOT = os.path.dirname(palpate.__file__) + os.sep
# File and function of a caller, file and function of what it called.
Move = tuple[str, str, str, str]


@dataclass(slots=True)
class Trace:
    """Files that were entered, and calls between files."""

    files: set[str] = field(default_factory=set)
    moves: Counter[Move] = field(default_factory=Counter)

    def profile(self, frame: FrameType, event: str, _argument: Any) -> None:
        """Note a call; the function that `sys.setprofile` takes."""
        here = _place(frame)
        if event != "call" or not here or frame.f_code.co_name == "<module>":
            return
        self.files.add(here)
        caller = frame.f_back
        while caller is not None and not _place(caller):
            caller = caller.f_back
        if caller is not None and _place(caller) != here:
            self.moves[_place(caller), caller.f_code.co_name, here, frame.f_code.co_name] += 1


def main() -> None:
    """Trace a fit and print the counts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.trace_fit", description=__doc__)
    parser.add_argument("session")
    parser.add_argument("probing")
    given = parser.parse_args()
    trace = Trace()
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["fit", given.session, "--probe", given.probing, "--out", f"{folder}/result"]
        threading.setprofile(trace.profile)
        sys.setprofile(trace.profile)
        try:
            run_command(arguments)
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    for line in summary(trace):
        print(line)


def summary(trace: Trace) -> list[str]:
    """Counts of files and moves, a line each.

    Parameters
    ----------
    trace : Trace
    """
    between = {move: n for move, n in trace.moves.items() if _room(move[0]) != _room(move[2])}
    pairs = {(caller, called) for caller, _, called, _ in trace.moves}
    crossing = sum(_room(caller) != _room(called) for caller, called in pairs)
    return [
        f"files entered: {len(trace.files)}",
        f"moves, every call: {trace.moves.total()}, between rooms {sum(between.values())}",
        f"moves, each pair of functions once: {len(trace.moves)}, between rooms {len(between)}",
        f"moves, each pair of files once: {len(pairs)}, between rooms {crossing}",
    ]


def _place(frame: FrameType) -> str:
    """File of a frame below the package; empty where it is another's."""
    name = frame.f_code.co_filename
    return name.removeprefix(ROOT) if name.startswith(ROOT) else ""


def _room(file: str) -> str:
    return file.split(os.sep)[0]


if __name__ == "__main__":
    main()
