"""Whole files, read and written with messages that name them."""

from pathlib import Path

from palpate.disk import write_bytes
from palpate.errors import RecordError
from palpate.files import read_bytes

# More than any text that a person writes or a calibration holds: its parsing would take minutes.
_MOST_BYTES = 4 * 2**20


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
        return read_bytes(path, most=_MOST_BYTES).decode("utf-8-sig")
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
