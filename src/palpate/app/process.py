"""The process of a command: exit codes, versions, how its output is wanted; what its environment
may lack, such as a place for kernels; and what keeps it from ending in a traceback.

Nothing heavy is imported here: it is needed before a command is loaded.
"""

import codecs
import json
import logging
import os
import platform
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from importlib.metadata import PackageNotFoundError, distributions, version
from io import StringIO
from pathlib import Path
from typing import Any

from palpate import __version__
from palpate.errors import InputError, print_message, visible

try:
    import resource
except ModuleNotFoundError:  # Windows has no such limits
    resource = None  # type: ignore[assignment]

# An argument, a file or a disk that does not do.
BAD_INPUT = 2
# An estimate or a measurement that is not ok, or a result that has changed.
NOT_OK = 3
# Memory ran out, or an error of the program itself.
PROGRAM_ERROR = 70
# What a shell makes of signals: this and their number.
BY_SIGNAL = 128

# Without these no estimate is the same again.
_PACKAGES = ("numpy", "scipy", "numba", "opencv-python-headless", "matplotlib")
# Address space that the libraries and a small model need [bytes]; with less they end the process.
_MIN_MEMORY = 1.5 * 2**30
# Libraries that take orders from the environment, and how the names of these begin.
_VARIABLE_PREFIXES = {"numba": "NUMBA_", "matplotlib": "MPL"}
_ASCII_REPLACEMENTS = {"±": "+-", "µ": "u", "μ": "u"}
Main = Callable[[Sequence[str] | None], int]
# Fewer columns show no table at all.
_MIN_COLUMNS = 20
# How the name of a temporary folder for kernels begins.
_KERNEL_FOLDER = "palpate-kernels-"
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


@contextmanager
def usable_columns() -> Iterator[None]:
    """Ignore a width of the terminal in which nothing can be shown."""
    width = os.environ.get("COLUMNS", "")
    if not width.isdecimal() or int(width) >= _MIN_COLUMNS:
        yield
        return
    del os.environ["COLUMNS"]
    try:
        yield
    finally:
        os.environ["COLUMNS"] = width


@contextmanager
def kernel_cache() -> Iterator[None]:
    """Where neither the installation nor the user's cache can be written, compiled kernels have a
    folder that goes with the process.

    Raises
    ------
    InputError                      there is none
    """
    if "NUMBA_CACHE_DIR" in os.environ or any(map(_is_writable, _cache_places())):
        yield
        return
    try:
        folder = tempfile.mkdtemp(prefix=_KERNEL_FOLDER)
    except OSError as error:
        raise InputError(
            "compiled kernels cannot be kept anywhere: the installation, the user's cache and the"
            f" system's temporary folder cannot be written ({error.strerror}); set NUMBA_CACHE_DIR"
            " to a folder that can"
        ) from error
    os.environ["NUMBA_CACHE_DIR"] = folder
    print_message(
        "note: neither the installation nor the user's cache can be written, so kernels"
        " are compiled anew every time, for half a minute; set NUMBA_CACHE_DIR to a folder that can"
        " be written"
    )
    try:
        yield
    finally:
        del os.environ["NUMBA_CACHE_DIR"]
        shutil.rmtree(folder, ignore_errors=True)


def check_kernel_cache() -> None:
    """Refuse to compile kernels that would be lost when this process ends.

    Raises
    ------
    InputError                      see `kernel_cache`
    """
    if Path(os.environ.get("NUMBA_CACHE_DIR", "")).name.startswith(_KERNEL_FOLDER):
        raise InputError(
            "compiled kernels cannot be kept: neither the installation nor the user's cache can be"
            " written; set NUMBA_CACHE_DIR to a folder that can, for this command and the others"
        )


def check_cache(folder: Path | None) -> None:
    """Refuse a cache folder that cannot be written, before the work begins.

    Parameters
    ----------
    folder : Path or None           as `--cache` names it; maybe not there yet

    Raises
    ------
    InputError                      no folder, or one that cannot be made or written
    """
    if folder is not None and not _is_writable(folder):
        raise InputError(
            f"{folder}: the cache cannot be written; give another folder with --cache, or leave the"
            " cache out"
        )


@contextmanager
def output_as(wanted: Output, words: Sequence[str]) -> Iterator[None]:
    """Print within the block as the options ask.

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
    """Output options of the command that runs."""
    return _output.get() or Output()


def versions() -> dict[str, str]:
    """Versions by the names of what has them, the system's last."""
    numbers = {"palpate": __version__, "Python": platform.python_version()}
    for package in _PACKAGES:
        with suppress(PackageNotFoundError):
            numbers[package] = version(package)
    return numbers | {"system": platform.platform()}


def _outcome(error: Exception, words: Sequence[str], log: str) -> tuple[str, int]:
    """What to say about an error that nobody expected, and the exit code."""
    causes: list[BaseException] = [error]
    while cause := causes[-1].__cause__ or causes[-1].__context__:
        causes.append(cause)
    if any(isinstance(cause, MemoryError) for cause in causes):
        detail = " ".join(str(causes[-1]).split())
        what = "memory ran out" + (f" ({detail})" if detail else "")
        return f"{what}; use a coarser mesh or fewer points, or close other programs", PROGRAM_ERROR
    file = traceback.extract_tb(causes[-1].__traceback__)[-1].filename
    for library, prefix in _VARIABLE_PREFIXES.items():
        names = [key for key in os.environ if key.startswith(prefix)]
        if names and f"{os.sep}{library}{os.sep}" in file:
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


def _cache_places() -> list[Path]:
    """Folders in which numba keeps compiled kernels: beside the source, else the user's cache."""
    places = [Path(__file__).parents[1]]
    if sys.platform == "darwin":
        user = "~/Library/Caches"
    else:
        user = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or "~/.cache"
    # A user without a home has no cache.
    with suppress(RuntimeError):
        places.append(Path(user).expanduser())
    return places


def _is_writable(folder: Path) -> bool:
    """Whether a folder, or the nearest one above that is there, can be written."""
    # One that may not be searched is not there: a home of another user, in a container.
    while not os.path.exists(folder) and folder != folder.parent:
        folder = folder.parent
    return os.path.isdir(folder) and os.access(folder, os.W_OK | os.X_OK)
