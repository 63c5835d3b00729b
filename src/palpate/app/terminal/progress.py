"""A progress bar on the terminal that shows only where there is something to wait for."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress as rich_progress
from rich.console import Console

from palpate.progress import Progress


@contextmanager
def progress_bar() -> Iterator[Progress]:
    """A callback `(stage, fraction)` that moves a bar on stderr; the bar vanishes at the end.

    Where stderr is not a terminal nothing is shown.
    """
    console = Console(file=sys.stderr)
    bar = rich_progress.Progress(
        rich_progress.TextColumn("{task.description}"),
        rich_progress.BarColumn(),
        rich_progress.TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    task = bar.add_task("", total=1.0)

    def report(stage: str, fraction: float) -> None:
        bar.update(task, description=stage, completed=fraction)

    with bar:
        yield report
