"""A progress bar on the terminal that shows only where there is something to wait for."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

__all__ = ["ProgressCallback", "progress_bar"]

# What is being done, and which fraction of the work is behind it.
ProgressCallback = Callable[[str, float], None]


@contextmanager
def progress_bar() -> Iterator[ProgressCallback]:
    """A callback `(stage, fraction)` that moves a bar on stderr; the bar vanishes at the end.

    Where stderr is not a terminal nothing is shown.
    """
    console = Console(file=sys.stderr)
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("", total=1.0)

    def report(stage: str, fraction: float) -> None:
        bar.update(task, description=stage, completed=fraction)

    with bar:
        yield report
