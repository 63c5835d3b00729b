"""JSON: read through the same table interface as TOML, and written with null for NaN."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from palpate.errors import RecordError, quoted
from palpate.files import read_errors
from palpate.records.text.text_file import read_text
from palpate.records.text.toml_table import TomlTable


def read_json(path: Path) -> TomlTable:
    """Root object of a JSON file, with the interface of a TOML table.

    Parameters
    ----------
    path : Path

    Returns
    -------
    TomlTable                       without a name

    Raises
    ------
    RecordError                     missing, not readable, not JSON, not an object, duplicate keys
    """
    text = read_text(path)

    def unique_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            repeated = next(name for name in names if names.count(name) > 1)
            raise RecordError(f"{path}: has {quoted(repeated)} twice in one object; keep one")
        return found

    with read_errors(path, "write it again", what="is not valid JSON"):
        content = json.loads(text, object_pairs_hook=unique_keys)
    if not isinstance(content, dict):
        raise RecordError(f"{path}: is {quoted(content)}; must be an object in braces")
    return TomlTable(path, "", content)


def json_text(content: Mapping[str, Any]) -> str:
    """JSON text of a record; NaN and infinity, which JSON cannot represent, become null.

    Parameters
    ----------
    content : mapping               NumPy scalars and arrays become numbers and lists; values of
                                    other types become text

    Returns
    -------
    str                             indented by one blank a level; ends with a line break
    """
    return json.dumps(_json_value(content), indent=1, allow_nan=False) + "\n"


def _json_value(value: Any) -> Any:
    """The value in JSON's own types."""
    if isinstance(value, Mapping):
        return {str(key): _json_value(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_json_value(item) for item in value]
    if isinstance(value, (bool, str, int)) or value is None:
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return _json_value(value.tolist()) if hasattr(value, "tolist") else str(value)
