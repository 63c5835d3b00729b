"""JSON, read like TOML and written without what it does not know."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.errors import RecordError, quoted
from palpate.files import damage
from palpate.records.text.text_file import read_text
from palpate.records.text.toml_table import TomlTable


def read_json(path: Path) -> TomlTable:
    """Root object of a JSON file, read like a table of a TOML file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    TomlTable                       without a name

    Raises
    ------
    RecordError                     not there, not readable, not JSON, or no object
    """
    text = read_text(path)

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twin = next(name for name in names if names.count(name) > 1)
            raise RecordError(f"{path}: has {quoted(twin)} twice in one object; keep one")
        return found

    with damage(path, "write it again", what="is not valid JSON"):
        content = json.loads(text, object_pairs_hook=unique)
    if not isinstance(content, dict):
        raise RecordError(f"{path}: is {quoted(content)}; must be an object in braces")
    return TomlTable(path, "", content)


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
