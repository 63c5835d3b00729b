"""What the environment of a process may lack: a terminal of some width, a place for kernels."""

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from palpate.errors import InputError, print_message

# Fewer columns show no table at all.
_MIN_COLUMNS = 20
# How the name of a temporary folder for kernels begins.
_KERNEL_FOLDER = "palpate-kernels-"


@contextmanager
def usable_columns() -> Iterator[None]:
    """A width of the terminal that shows nothing is as good as none."""
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
    """Refuse to compile kernels that would go with this process.

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
    """Refuse a folder that cannot keep anything, before there is something to keep.

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


def _cache_places() -> list[Path]:
    """Where numba keeps compiled kernels: beside the source, else in the user's cache."""
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
