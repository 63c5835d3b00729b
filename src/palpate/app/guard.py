"""What keeps a command from ending in a traceback: plain output, quiet libraries, a report."""

import codecs
import logging
import os
import platform
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from importlib.metadata import distributions
from io import StringIO
from pathlib import Path

from palpate import __version__
from palpate.app.environment import kernel_cache, usable_columns
from palpate.app.exit_codes import BAD_INPUT, PROGRAM_ERROR
from palpate.errors import InputError, print_message

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

# Address space that the libraries and a small model need [bytes]; with less they end the process.
_MIN_MEMORY = 1.5 * 2**30
# Libraries that take orders from the environment, and how the names of these begin.
_VARIABLE_PREFIXES = {"numba": "NUMBA_", "matplotlib": "MPL"}
_ASCII_REPLACEMENTS = {"±": "+-", "µ": "u", "μ": "u"}
Main = Callable[[Sequence[str] | None], int]


def guarded(main: Main) -> Main:
    """A command line whose unexpected errors become one line and a report, and an exit code.

    Parameters
    ----------
    main : callable                 arguments -> exit code; raises what it did not expect

    Returns
    -------
    callable                        the same, and 70 where memory ran out or the program failed
    """

    @wraps(main)
    def safe(arguments: Sequence[str] | None = None) -> int:
        if _too_little_memory():
            return PROGRAM_ERROR
        with _plain_output(), usable_columns(), _quiet_libraries() as log:
            try:
                with kernel_cache():
                    return main(arguments)
            except InputError as error:
                print_message(str(error))
                return BAD_INPUT
            except Exception as error:  # noqa: BLE001 - the last guard is for all of them
                words = sys.argv[1:] if arguments is None else arguments
                text, code = _outcome(error, words, log.getvalue())
                print_message(text)
                return code

    return safe


def _outcome(error: Exception, words: Sequence[str], log: str) -> tuple[str, int]:
    """What to say about an error that nobody expected, and the exit code."""
    causes: list[BaseException] = [error]
    while cause := causes[-1].__cause__ or causes[-1].__context__:
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        detail = " ".join(str(causes[-1]).split())
        what = "memory ran out" + (f" ({detail})" if detail else "")
        return f"{what}; use a coarser mesh or fewer points, or close other programs", PROGRAM_ERROR
    place = traceback.extract_tb(causes[-1].__traceback__)[-1].filename
    for library, prefix in _VARIABLE_PREFIXES.items():
        names = [key for key in os.environ if key.startswith(prefix)]
        if names and f"{os.sep}{library}{os.sep}" in place:
            variables = ", ".join(f"{key}={os.environ[key]}" for key in names)
            text = " ".join(str(causes[-1]).split())[:200]
            return f"{text} ({library}); correct or unset {variables}", BAD_INPUT
    what = "lists in lists without end" if isinstance(error, RecursionError) else _first_line(error)
    report = _write_report(error, words, log)
    return (
        f"an error of the program, not of yours ({what}); {report or 'no report could be written'}"
        + (" says where: please send it to the developers" if report else ""),
        PROGRAM_ERROR,
    )


def _first_line(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".splitlines()[0][:200]


def _write_report(error: Exception, words: Sequence[str], log: str) -> Path | None:
    """A file with all that a developer needs, in the current folder, else in the system's own."""
    packages = sorted(f"{d.name} {d.version}" for d in distributions() if d.name)
    text = "\n".join(
        [
            f"palpate {__version__}, Python {sys.version}, {platform.platform()}",
            f"command: palpate {' '.join(words)}",
            "",
            *traceback.format_exception(error),
            *([log] if log else []),
            *packages,
            "",
        ]
    )
    name = f"palpate-error-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.txt"
    for folder in (Path(), Path(tempfile.gettempdir())):
        try:
            (folder / name).write_text(text, encoding="utf-8", errors="backslashreplace")
        except OSError:
            continue
        return folder / name
    return None


@contextmanager
def _plain_output() -> Iterator[None]:
    """Where a terminal's or a file's encoding lacks a character, another one is written for it."""
    codecs.register_error("palpate", _ascii_replacement)
    streams = [stream for stream in (sys.stdout, sys.stderr) if hasattr(stream, "reconfigure")]
    before = [stream.errors for stream in streams]
    for stream in streams:
        stream.reconfigure(errors="palpate")
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            stream.reconfigure(errors=errors)


def _ascii_replacement(error: UnicodeError) -> tuple[str, int]:
    """The characters of a text that cannot be encoded, in ASCII."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(_ASCII_REPLACEMENTS.get(letter, "?") for letter in text), error.end


@contextmanager
def _quiet_libraries() -> Iterator[StringIO]:
    """Warnings and logs of libraries go into a text, for the report; none reaches the terminal."""
    log = StringIO()
    handler = logging.StreamHandler(log)
    logging.captureWarnings(True)
    logging.getLogger().addHandler(handler)
    try:
        yield log
    finally:
        logging.getLogger().removeHandler(handler)
        logging.captureWarnings(False)


def _too_little_memory() -> bool:
    """Whether the process may have so little memory that the libraries could not even be loaded."""
    if resource is None:
        return False
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY or limit >= _MIN_MEMORY:
        return False
    print_message(
        f"may use {limit / 2**30:.2g} GiB of memory (ulimit -v), and needs"
        f" {_MIN_MEMORY / 2**30:g} GiB; raise the limit"
    )
    return True
