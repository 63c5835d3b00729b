"""`palpate measure`: the guided measurement, in the browser or at the terminal."""

import os
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib.util import find_spec
from pathlib import Path

from rich.prompt import Prompt

from palpate.app.process import check_cache
from palpate.app.tables import constants_table
from palpate.app.terminal import print_tables, print_text, progress_bar
from palpate.bench import Page, Questions, measure as measure_live, read_bench, wanted_precision
from palpate.disk import created_folder
from palpate.errors import InputError, visible
from palpate.progress import Progress


class _Terminal(Questions):
    """A person at the terminal."""

    def tell(self, text: str) -> None:
        """Print a line."""
        print_text(text)

    def choose(self, text: str, options: list[str]) -> str:
        """One of some words; the first on Enter."""
        shown = {visible(word): word for word in options}
        return shown[_asked(text, choices=list(shown), default=visible(options[0]))]

    def ask(self, text: str, usual: str) -> str:
        """A number or a word."""
        return _asked(text, default=usual)

    def wait(self, text: str) -> None:
        """Wait until Enter is pressed."""
        _asked(f"{text}; then Enter", default="", show_default=False)

    def working(self) -> AbstractContextManager[Progress]:
        """A bar, until the block ends."""
        return progress_bar()


def _asked(text: str, **options: object) -> str:
    try:
        return str(Prompt.ask(visible(text), **options))  # type: ignore[call-overload]
    except EOFError:
        raise InputError(
            "there is nobody to answer: standard input has ended; say --until or --pushes, and all"
            " that is asked for in bench.toml; or --port, for a page in the browser"
        ) from None


def _has_browser() -> bool:
    """Whether a person sits at this computer, and can open the page."""
    shown = os.name == "nt" or sys.platform == "darwin"
    shown = shown or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return shown and sys.stdin.isatty() and find_spec("viser") is not None


@contextmanager
def _person(name: str, *, terminal: bool, port: int | None) -> Iterator[Questions]:
    """Who answers: in the browser, or at the terminal."""
    if port is None and (terminal or not _has_browser()):
        yield _Terminal()
        return
    page = Page(name, port=port, on_message=print_text)
    print_text(f"Open {page.address} in a browser", wrapped=False)
    try:
        yield page
    finally:
        page.close()


def measure(
    bench: str,
    /,
    *,
    out: Path,
    until: str | None = None,
    pushes: int | None = None,
    cache: Path | None = None,
    dry_run: bool = False,
    terminal: bool = False,
    port: int | None = None,
) -> int:
    """Measure an object live: cameras, a gauge or a scale, pushes by hand or by an arm.

    Looks at the devices, calibrates cameras without a rig with a board that is held up, asks what
    the object is, says where to press, and after each push prints the constants with their
    intervals and how many more pushes the wanted precision takes. The session is whole after each
    push; begun again with the same folder, it goes on.

    It asks and shows in the browser, on a page that this computer serves to itself only and to who
    has the address that is printed; or at the terminal, with --terminal, without a display, or
    where nobody sits at the terminal. Ctrl-C ends it.

    Parameters
    ----------
    bench
        bench.toml, or its folder; a configuration of the virtual laboratory, or the word virtual.
    out
        Folder of the session.
    until
        Stop when a constant's 95 % interval is as narrow: "E 3 %" is 3 % to either side; "nu 0.02",
        "G 2 kPa".
    pushes
        Stop after so many pushes. Without this and --until, it asks after each.
    cache
        Folder in which to keep factors and reduced models of this object, as in `palpate fit`.
        Without it, factors are kept in memory while it runs.
    dry_run
        Say and draw what the arm would do for the first push, without moving it.
    terminal
        Ask at the terminal.
    port
        Port of the page, which is then shown in any case. Default: 8080, or the next free one.

    Returns
    -------
    int
        0.
    """
    if pushes is not None and pushes < 1:
        raise InputError(f"--pushes is {pushes}; must be 1 or more")
    check_cache(cache)
    wanted = None if until is None else wanted_precision(until)
    if terminal and port is not None:
        raise InputError("--port is for the page in the browser; leave it or --terminal out")
    devices = read_bench(bench)
    with created_folder(out), _person(devices.name, terminal=terminal, port=port) as person:
        estimate = measure_live(
            devices, person, out, until=wanted, pushes=pushes, cache=cache, dry_run=dry_run
        )
        if isinstance(person, Page):
            print_text("Press Close on the page, or Ctrl-C")
            with suppress(KeyboardInterrupt):
                person.finish("Nothing was measured" if estimate is None else "That was all")
    if estimate is not None:
        print_tables(constants_table(estimate))
    return 0
