"""Whole files, read and written with messages that name them."""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from palpate.disk import write_bytes
from palpate.errors import RecordError

# What readers of binary files run into where bytes are missing or wrong.
_DAMAGE = (
    OSError, ValueError, TypeError, LookupError, AssertionError, EOFError, RuntimeError, zlib.error
)  # fmt: skip


def read_bytes(path: Path, count: int = -1) -> bytes:
    """The first bytes of a file, or all of them.

    Parameters
    ----------
    path : Path
    count : int                     bytes to read; -1: all

    Raises
    ------
    RecordError                     not there, or not readable
    """
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError as error:
        raise RecordError(f"{path}: cannot be read ({error.strerror})") from error


def read_text(path: Path) -> str:
    """Content of a text file in UTF-8, without its byte order mark.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RecordError                     not there, not readable, not UTF-8
    """
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RecordError(f"{path}: is not a text file in UTF-8; save it as such") from error


def write_text(path: Path | str, text: str) -> None:
    """Write a text file in UTF-8.

    Parameters
    ----------
    path : path
    text : str

    Raises
    ------
    RecordError                     the file cannot be written; it is as it was
    """
    write_bytes(Path(path), text.encode("utf-8", "surrogateescape"))


@contextmanager
def damage(path: Path, cure: str) -> Iterator[None]:
    """Turn what a reader of a binary format runs into within the block into a message.

    Parameters
    ----------
    path : Path                     the file that is read
    cure : str                      what to do about a file with missing or wrong bytes

    Raises
    ------
    RecordError                     as it is, or in place of what the reader raised
    """
    try:
        yield
    except RecordError:
        raise
    except _DAMAGE as error:
        raise RecordError(f"{path}: is damaged or cut off ({error}); {cure}") from error
