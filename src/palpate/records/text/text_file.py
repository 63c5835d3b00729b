"""Whole files, read and written with messages that name them."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

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
    RecordError                     the file cannot be written
    """
    try:
        Path(path).write_text(text, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{path}: cannot be written ({error.strerror})") from error


def json_text(content: Mapping[str, Any]) -> str:
    """JSON of a record, one indent a level; NaN and infinity, which JSON does not know, are null.

    Parameters
    ----------
    content : mapping               NumPy's scalars and arrays become numbers and lists, what JSON
                                    has no type for becomes text

    Returns
    -------
    str                             ends with a line break
    """
    return json.dumps(_plain(content), indent=1, allow_nan=False) + "\n"


def _plain(value: Any) -> Any:
    """The same in JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, (bool, str, int)) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return _plain(value.tolist()) if hasattr(value, "tolist") else str(value)
