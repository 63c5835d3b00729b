"""Sessions and their truth as text: what the facility leaves is read like any other session."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np


def toml_value(value: Any) -> str:
    """A value as TOML: texts, numbers with all their digits, truth values, lists, inline tables.

    Parameters
    ----------
    value : str, bool, int, float, sequence, array or mapping of these

    Raises
    ------
    TypeError                       anything else
    """
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value))
    if isinstance(value, Mapping):
        inside = ", ".join(f"{key} = {toml_value(item)}" for key, item in value.items())
        return f"{{ {inside} }}"
    if isinstance(value, Sequence | np.ndarray):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    raise TypeError(f"no TOML for a {type(value).__name__}")


def toml_table(header: str, values: Mapping[str, Any]) -> str:
    """A table: its header, a line for each key, an empty line; values that are None are left out.

    Parameters
    ----------
    header : str                    as "[object]", or empty for the root
    values : mapping
    """
    lines = [header] if header else []
    lines += [f"{key} = {toml_value(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines) + "\n\n"
