"""Whole text files, read and written with errors that name them."""

from pathlib import Path

from palpate.disk import write_bytes
from palpate.errors import RecordError
from palpate.files import read_bytes

# Larger than any hand-written text or calibration; parsing more would take minutes.
_MAX_BYTES = 4 * 2**20


def read_text(path: Path) -> str:
    """Content of a text file in UTF-8, without its byte order mark.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str

    Raises
    ------
    RecordError                     missing, not readable, too large, not UTF-8
    """
    try:
        return read_bytes(path, max_bytes=_MAX_BYTES).decode("utf-8-sig")
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
    RecordError                     the file cannot be written; it is then unchanged
    """
    write_bytes(Path(path), text.encode("utf-8", "surrogateescape"))
