"""A progress bar on the terminal that shows only where there is something to wait for."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from numba.core import event
from rich import progress as rich_progress
from rich.console import Console

from palpate.app.output import wanted_output
from palpate.errors import print_message, visible
from palpate.progress import Progress


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A callback `(stage, fraction)` that moves a bar on stderr; the bar vanishes at the end.

    Where stderr is not a terminal nothing is shown; where every stage is to be shown, each has a
    line with the seconds so far, on a terminal or not.
    """
    if wanted_output().verbose:
        with _announce_compilation(_line_progress()) as report:
            yield report
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

    with bar, _announce_compilation(show) as report:
        yield report


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

    def report(stage: str, fraction: float) -> None:
        nonlocal last
        last = stage, fraction
        show(stage, fraction)

    with event.install_listener("numba:compile", Compilation()):
        yield report


def _line_progress() -> Progress:
    """Progress as lines on stderr."""
    start, last = wanted_output().start, [""]

    def report(stage: str, fraction: float) -> None:
        if stage != last[0]:
            seconds = time.perf_counter() - start
            print_message(f"{seconds:7.1f} s  {100 * fraction:3.0f} %  {stage}")
            last[0] = stage

    return report


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

        def report(stage: str, fraction: float) -> None:
            self.add(stage)
            progress(stage, fraction)

        return report
