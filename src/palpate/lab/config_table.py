"""Frozen dataclasses of settings from tables of a TOML file, field by field."""

from dataclasses import MISSING, Field, fields
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from palpate.errors import InputError
from palpate.records import TomlTable

Settings = TypeVar("Settings")


def settings_from_table(table: TomlTable, kind: type[Settings], **given: Any) -> Settings:
    """A dataclass of settings whose fields are the keys of a table.

    Numbers, texts, truth values, whole numbers, `Literal` words and vectors are known by the
    field's type; a field with a default may be left out.

    Parameters
    ----------
    table : TomlTable
    kind : dataclass
    given : values of fields that are not the table's

    Raises
    ------
    RecordError                     an unknown or missing key, a value of another kind or out of
                                    range; names the file, the table and the key
    """
    hints = get_type_hints(kind)
    known = [field for field in fields(kind) if field.name not in given]  # type: ignore[arg-type]
    table.check_keys([field.name for field in known])
    values = dict(given)
    for field in known:
        if field.name in table.values:
            values[field.name] = _value(table, field.name, hints[field.name])
        elif _needed(field):
            table.fail("", f"the key '{field.name}' is missing")
    try:
        return kind(**values)
    except InputError as error:
        table.fail("", str(error))


def _needed(field: Field[Any]) -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _value(table: TomlTable, key: str, hint: Any) -> Any:
    """Value of a key as the field's type wants it."""
    if get_origin(hint) is UnionType:
        (hint,) = (one for one in get_args(hint) if one is not NoneType)
    if get_origin(hint) is Literal:
        return table.choice(key, get_args(hint))
    value = table.get(key)
    if hint is bool or hint is int:
        if type(value) is not hint:
            kind = "true or false" if hint is bool else "a whole number"
            table.fail(key, f"is {value!r}; must be {kind}")
        return value
    if hint is float:
        return table.number(key)
    if hint is str:
        return table.text(key)
    if getattr(hint, "array_type", None) is np.ndarray:
        return table.vector(key)
    raise TypeError(f"no way to read a {hint} from a table")
