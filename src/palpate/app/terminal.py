"""What the terminal gives and takes: numbers with units; tables, sentences and notes, printed or
kept for a JSON document; progress."""

import math
import re
import sys
import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Annotated, Any

from cyclopts import Parameter, Token
from numba.core import event
from rich import progress as rich_progress
from rich.console import Console
from rich.table import Table

from palpate.app.process import wanted_output
from palpate.app.tables import ShownTable
from palpate.errors import InputError, print_message, visible
from palpate.progress import Progress
from palpate.records import FORCE_UNITS, LENGTH_UNITS, MODULUS_UNITS, NOT_DETERMINED, quantity

# Work of which more remains is announced; work of which more remains is refused, unless it goes on
# where it was stopped [s].
_LONG_SECONDS, _MOST_SECONDS = 90.0, 86400.0
# Up to how many seconds a duration is said in which unit [s].
_DURATIONS = ((5400.0, 60.0, "minutes"), (172800.0, 3600.0, "hours"), (math.inf, 86400.0, "days"))
# What a cell may say besides a text: nothing, a number, a number and its deviation, an interval, a
# vector.
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_WITH_DEVIATION = re.compile(rf"({_NUMBER}) ± ({_NUMBER})")
_VECTOR = re.compile(rf"{_NUMBER}(?:, {_NUMBER})+")
_INTERVAL = re.compile(rf"\(?({_NUMBER}) to ({_NUMBER})\)?")


def _convert(
    units: Mapping[str, float], _type: Any, tokens: Sequence[Token]
) -> float | tuple[float, ...]:
    """One number in SI units, or as many as there are words."""
    numbers = tuple(quantity(token.value, units, token.keyword or "the number") for token in tokens)
    return numbers if len(numbers) > 1 else numbers[0]


def _convert_places(_type: Any, tokens: Sequence[Token]) -> list[tuple[float, ...]]:
    """Places in metres; an option that is given again adds one, and takes three words each time."""
    numbers = [quantity(token.value, LENGTH_UNITS, token.keyword or "a place") for token in tokens]
    return [tuple(numbers[k : k + 3]) for k in range(0, len(numbers), 3)]


# What begins with a minus is a number for these, which they may refuse, and no option.
_IN_METRES = Parameter(converter=partial(_convert, LENGTH_UNITS), allow_leading_hyphen=True)
_IN_NEWTONS = Parameter(converter=partial(_convert, FORCE_UNITS), allow_leading_hyphen=True)
_IN_PASCALS = Parameter(converter=partial(_convert, MODULUS_UNITS), allow_leading_hyphen=True)
Length = Annotated[float, _IN_METRES]
Modulus = Annotated[float, _IN_PASCALS]
Place = Annotated[tuple[float, float, float], _IN_METRES]
Places = Annotated[
    list[tuple[float, float, float]],
    Parameter(converter=_convert_places, allow_leading_hyphen=True),
]
Force = Annotated[tuple[float, float, float], _IN_NEWTONS]


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


def print_notes(notes: Iterable[str]) -> None:
    """Print what was mended, converted or looks implausible on stderr, one line each.

    Parameters
    ----------
    notes : iterable of str
    """
    for note in notes:
        print_message(f"note: {note}")


def print_file_notes(notes: Iterable[tuple[str, str]], *, files: int) -> None:
    """Print each note once, with the file that it is about, or how many they are.

    Parameters
    ----------
    notes : iterable of two str     name of a file, note about it
    files : int                     all of them
    """
    names: dict[str, list[str]] = {}
    for name, note in notes:
        names.setdefault(note, []).append(name)
    for note, concerned in names.items():
        whose = concerned[0] if len(concerned) == 1 else f"{len(concerned)} of {files} files"
        print_text(f"Note ({whose}): {note}")


@contextmanager
def progress_bar(shorter: str = "", *, resumes: bool = False) -> Iterator[Progress]:
    """A callback `(stage, fraction)` that moves a bar on stderr; the bar vanishes at the end.

    Where stderr is not a terminal no bar is shown; where every stage is to be shown, each has a
    line with the seconds so far, on a terminal or not. Once some seconds show that there are
    minutes to go, that is said, with what would make it shorter.

    Parameters
    ----------
    shorter : str                   what the user can do about long work: "a larger --step"
    resumes : bool                  the same command goes on where it was stopped: long work is not
                                    refused

    Raises
    ------
    InputError                      within the block: there is more than a day to go
    """
    if wanted_output().verbose:
        lines = _announce_length(_line_progress(), shorter, resumes=resumes)
        with _announce_compilation(lines) as progress:
            yield progress
        return
    console = Console(file=sys.stderr)
    bar = rich_progress.Progress(
        # Moves where a stage takes long and says nothing.
        rich_progress.SpinnerColumn(),
        rich_progress.TextColumn("{task.description}", markup=False),
        rich_progress.BarColumn(),
        rich_progress.TaskProgressColumn(),
        rich_progress.TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("", total=1.0)

    def show(stage: str, fraction: float) -> None:
        bar.update(task, description=visible(stage), completed=fraction)

    announced = _announce_length(show, shorter, resumes=resumes)
    with bar, _announce_compilation(announced) as progress:
        yield progress


@dataclass(slots=True)
class StageLog:
    """When each stage of a command began, for the log that lies beside a result.

    Attributes
    ----------
    lines : list of str             seconds since the command began, and the stage
    """

    lines: list[str] = field(default_factory=list)
    _start: float = field(default_factory=lambda: wanted_output().start)

    @property
    def seconds(self) -> float:
        """Since the command began."""
        return time.perf_counter() - self._start

    def add(self, stage: str) -> None:
        """Note what begins now.

        Parameters
        ----------
        stage : str                 the same as before is not noted again
        """
        if not self.lines or not self.lines[-1].endswith(f"s  {stage}"):
            self.lines.append(f"{self.seconds:9.2f} s  {stage}")

    def logged(self, progress: Progress) -> Progress:
        """Progress that is noted on its way.

        Parameters
        ----------
        progress : callable         is called all the same
        """

        def logged_progress(stage: str, fraction: float) -> None:
            self.add(stage)
            progress(stage, fraction)

        return logged_progress


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
    if match := _WITH_DEVIATION.fullmatch(text):
        return {"value": float(match[1]), "std": float(match[2])}
    if match := _INTERVAL.fullmatch(text):
        return [float(match[1]), float(match[2])]
    if _VECTOR.fullmatch(text):
        return [_cell_value(part) for part in text.split(",")]
    return text


@contextmanager
def _announce_compilation(show: Progress) -> Iterator[Progress]:
    """Progress that says so where its stage waits for kernels: after installing they are compiled,
    which takes up to a minute in which nothing else moves."""
    last, depth = ("", 0.0), 0

    class Compilation(event.Listener):
        def on_start(self, event: event.Event) -> None:
            nonlocal depth
            depth += 1
            if depth == 1 and last[0]:
                show(f"{last[0]} (compiling, once)", last[1])

        def on_end(self, event: event.Event) -> None:
            nonlocal depth
            depth -= 1
            if depth == 0 and last[0]:
                show(*last)

    def announced(stage: str, fraction: float) -> None:
        nonlocal last
        last = stage, fraction
        show(stage, fraction)

    with event.install_listener("numba:compile", Compilation()):
        yield announced


def _announce_length(show: Progress, shorter: str, *, resumes: bool) -> Progress:
    """Progress that says how long it will take, if that is minutes, and again where it turns out to
    be twice as long: by the pace of the later half of the time so far."""
    reports = deque[tuple[float, float]]()
    begin = announced_length = 0.0
    stop = "Ctrl-C stops it" + (", and the same command goes on from there" if resumes else "")
    cure = f"; shorter: {shorter}" if shorter else ""

    def announced(stage: str, fraction: float) -> None:
        nonlocal begin, announced_length
        show(stage, fraction)
        now = time.monotonic()
        begin = begin or now
        reports.append((now, fraction))
        while len(reports) > 1 and reports[1][0] <= 0.5 * (begin + now):
            reports.popleft()
        start, before = reports[0]
        seconds, done = now - start, fraction - before
        # What is hardly begun may not go on like this.
        if done <= 0.0 or seconds < (5.0 if done > 0.01 else 30.0):
            return
        left = (1.0 - fraction) * seconds / done
        pace = f"to go, by the pace of the last {seconds:.0f} s"
        if left > _MOST_SECONDS and cure and not resumes:
            raise InputError(f"there would be {_duration(left)} {pace}{cure}")
        if left > _LONG_SECONDS and now - begin + left > 2.0 * announced_length:
            announced_length = now - begin + left
            print_message(f"note: {_duration(left)} {pace}; {stop}{cure}")

    return announced


def _duration(seconds: float) -> str:
    unit, name = next((u, n) for most, u, n in _DURATIONS if seconds < most)
    return f"some {seconds / unit:.0f} {name}"


def _line_progress() -> Progress:
    """Progress as lines on stderr."""
    start, last = wanted_output().start, [""]

    def print_stage(stage: str, fraction: float) -> None:
        if stage != last[0]:
            seconds = time.perf_counter() - start
            print_message(f"{seconds:7.1f} s  {100 * fraction:3.0f} %  {stage}")
            last[0] = stage

    return print_stage
