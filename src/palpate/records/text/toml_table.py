"""Reading TOML, and JSON through the same interface, with errors that name the file, the table and
the key, and suggest the nearest valid name for a misspelt one; writing of JSON, with null for NaN.
"""

import json
import math
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from palpate.arrays import LARGEST_NUMBER
from palpate.errors import InputError, RecordError, quoted
from palpate.files import is_file, read_errors
from palpate.records.text.text_file import read_text
from palpate.shapes import Vector3

T = TypeVar("T")
# Counterpart of `LARGEST_NUMBER`: a smaller non-zero number is a mistake.
_SMALLEST_NUMBER = 1 / LARGEST_NUMBER
_RANGE = f" (0, or {_SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g} in size)"
# Limits on what is compared, as the comparison takes quadratic time.
_LONGEST_WORD, _MAX_NAMES = 100, 1000


@dataclass(frozen=True, slots=True)
class TomlTable:
    """One table of a TOML file, which knows its file and name for error messages.

    Its readers, from `text` on, take the name of a key; they raise `RecordError` if the key is
    missing, or if its value is not what the reader is for.

    Parameters
    ----------
    file : Path
    name : str                      as in the file, e.g. "[object]"
    values : dict
    """

    file: Path
    name: str
    values: dict[str, Any]

    def fail(self, key: str, what: str) -> NoReturn:
        """Raise a `RecordError` about one key.

        Parameters
        ----------
        key : str                       empty: the table itself
        what : str                      what is wrong with it, and what is allowed

        Raises
        ------
        RecordError                     always
        """
        key_path = f"{self.name} {key}".strip()
        raise RecordError(": ".join(filter(None, (str(self.file), key_path, what))))

    def check_keys(self, allowed: Sequence[str]) -> None:
        """Refuse unknown keys; the error suggests the nearest allowed one.

        Parameters
        ----------
        allowed : sequence of str

        Raises
        ------
        RecordError                     a key that is not allowed
        """
        for key in self.values:
            if key not in allowed:
                self.fail("", f"unknown key {not_allowed(key, allowed)}")

    def check_format(self, wanted: str) -> None:
        """Refuse a file that is not in the format that its key `format` should name.

        Parameters
        ----------
        wanted : str                    e.g. "palpate-session/1"

        Raises
        ------
        RecordError                     the key is missing, or names another format
        """
        if (given := self.get("format")) != wanted:
            self.fail("format", f"is {quoted(given)}; this version reads '{wanted}'")

    def get(self, key: str) -> Any:
        """Value of a required key.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     the key is missing
        """
        if key not in self.values:
            self.fail("", f"the key '{key}' is missing")
        return self.values[key]

    def checked(self, fits: Callable[[Any], object], key: str, must: str) -> Any:
        """Value of a required key, after a test.

        Parameters
        ----------
        fits : callable                 value -> whether it is accepted
        key : str
        must : str                      what the value must do or be, for the message

        Raises
        ------
        RecordError                     the key is missing, or its value does not pass the test
        """
        value = self.get(key)
        if not fits(value):
            self.fail(key, f"is {quoted(value)}; must {must}")
        return value

    def each(self, read: "Callable[[TomlTable, str], T]", key: str) -> list[T]:
        """Items of a list, each read as if it were the value of its key.

        Parameters
        ----------
        read : callable                 a method of this class, e.g. `TomlTable.vector`
        key : str                       of a list

        Raises
        ------
        RecordError                     missing, or not a list; as `read`
        """
        items = self.checked(is_list_of(object), key, "be a list")
        return [read(replace(self, values={key: item}), key) for item in items]

    def optional(self, key: str, read: Callable[[str], T]) -> T | None:
        """Value of an optional key, read by a method of this table, or None if it is missing.

        Parameters
        ----------
        key : str
        read : callable                 key -> value, e.g. `self.number`

        Raises
        ------
        RecordError                     as `read`
        """
        return read(key) if key in self.values else None

    @contextmanager
    def error_context(self) -> Iterator[None]:
        """Prefix errors that records raise within the block with this file and table.

        Raises
        ------
        RecordError                 in place of an `InputError`
        """
        try:
            yield
        except RecordError:
            raise
        except InputError as error:
            prefix = f"{self.file}: {self.name}" if self.name else f"{self.file}"
            raise RecordError(f"{prefix}: {error}") from error

    def text(self, key: str) -> str:
        """A non-empty string."""
        self.checked(lambda value: isinstance(value, str), key, "be a text in quotes")
        return self.checked(str.strip, key, "not be empty")

    def label(self, key: str) -> str:
        """A one-line text for use in tables and pictures."""
        self.text(key)
        return self.checked(str.isprintable, key, "have no line break or control character")

    def choice(self, key: str, allowed: Sequence[str]) -> str:
        """One of some words.

        Parameters
        ----------
        key : str
        allowed : sequence of str

        Raises
        ------
        RecordError                     missing, or not among them; the error suggests the nearest
        """
        value = self.text(key)
        if value not in allowed:
            self.fail(key, f"is {not_allowed(value, allowed)}")
        return value

    def number(self, key: str) -> float:
        """A finite number.

        Returns
        -------
        float
        """
        return float(self.checked(_is_number, key, f"be a finite number{_RANGE}"))

    def quantity(self, key: str, units: Mapping[str, float], plain: float | None = None) -> float:
        """A number with its unit, in quotes, such as "0.5 mm"; or a plain number.

        Parameters
        ----------
        key : str
        units : mapping                 unit -> its value in SI units
        plain : float or None           factor for a number without a unit; None: only zero may be
                                        given without one

        Returns
        -------
        float                           in SI units

        Raises
        ------
        RecordError                     missing, not a number, not finite, an unknown unit
        """
        value = self.get(key)
        factor = plain
        if isinstance(value, str):
            number, _, unit = value.strip().partition(" ")
            factor = units.get(unit.strip())
            try:
                value = float(number)
            except ValueError:
                factor = None
        elif value == 0:
            factor = 1.0
        if factor is None or not _is_number(value):
            example = ", ".join(f'"1 {unit}"' for unit in units)
            self.fail(
                key,
                f"is {quoted(self.get(key))}; must be a number with its unit: {example}"
                + ("" if plain is None else ", or a plain number"),
            )
        return factor * float(value)

    def count(self, key: str) -> int:
        """A non-negative integer."""
        return self.checked(
            lambda value: type(value) is int and 0 <= value < 2**53, key,
            "be a whole number, 0 or more, less than 2^53",
        )  # fmt: skip

    def boolean(self, key: str) -> bool:
        """True or false."""
        return self.checked(
            lambda value: isinstance(value, bool), key, "be true or false, without quotes"
        )

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        return tuple(self.checked(is_list_of(str), key, "be a list of texts in quotes"))

    def vector(self, key: str) -> Vector3:
        """Three finite numbers.

        Returns
        -------
        (3,) float
        """
        value = self.checked(_is_vector, key, "be three finite numbers, e.g. [0, 0, -1.2]")
        return np.array(value, dtype=np.float64)

    def number_or_vector(self, key: str) -> Vector3:
        """Three finite numbers, or one that stands for all three.

        Returns
        -------
        (3,) float
        """
        if isinstance(self.get(key), list):
            return self.vector(key)
        must = "be a finite number, or three of them in brackets"
        return np.full(3, float(self.checked(_is_number, key, must)))

    def table(self, key: str, name: str | None = None) -> "TomlTable":
        """A table inside this one, called `[key]`, or `name`, in messages.

        Parameters
        ----------
        key : str
        name : str or None              for messages

        Raises
        ------
        RecordError                     missing, or not a table
        """
        value = self.checked(lambda value: isinstance(value, dict), key, "be a table")
        return TomlTable(self.file, name or f"[{key}]", value)

    def tables(self, key: str, name: str | None = None) -> "tuple[TomlTable, ...]":
        """An array of tables; one alone counts as an array of one.

        Parameters
        ----------
        key : str
        name : str or None              of each, for messages; None: `[[key]] number 1` and so on

        Raises
        ------
        RecordError                     missing, or something else
        """
        value = self.get(key)
        items = value if isinstance(value, list) else [value]
        if not is_list_of(dict)(items):
            self.fail(key, f"is {quoted(value)}; must be a table or a list of tables")
        return tuple(
            TomlTable(self.file, name or f"[[{key}]] number {number}", item)
            for number, item in enumerate(items, start=1)
        )

    def existing_file(self, key: str) -> Path:
        """Path of an existing file, which is given relative to the folder of this TOML file.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     missing, or no such file; the error suggests the nearest
        """
        path = self.file.parent / self.text(key)
        if not is_file(path):
            what = "is a folder, not a file" if os.path.isdir(path) else "no such file"
            near = nearest_file(path, exclude=self.file.name)
            # The folder is that of the message's own file: it is not elided.
            shown = self.file.parent / quoted(self.text(key))[1:-1]
            self.fail(key, f"{what}: {shown}{near}")
        return path


def read_toml(path: Path) -> TomlTable:
    """Root table of a TOML file.

    Parameters
    ----------
    path : Path

    Returns
    -------
    TomlTable                       without a name

    Raises
    ------
    RecordError                     missing, not readable, not TOML (with line and column)
    """
    text = read_text(path)
    with read_errors(path, "correct it there", what="is not valid TOML"):
        return TomlTable(path, "", tomllib.loads(text))


def is_list_of(kind: type) -> Callable[[Any], bool]:
    """Test for a list whose items are all of one type, for `TomlTable.checked`.

    Parameters
    ----------
    kind : type
    """
    return lambda value: isinstance(value, list) and all(isinstance(x, kind) for x in value)


def _is_vector(value: object) -> bool:
    """True for a list of three numbers."""
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _is_number(value: object) -> bool:
    """True for zero, or a finite int or float of plausible magnitude; False for a boolean."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return value == 0 or _SMALLEST_NUMBER <= abs(value) <= LARGEST_NUMBER


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
        table = dict(pairs)
        if len(table) < len(pairs):
            names = [name for name, _ in pairs]
            repeated = next(name for name in names if names.count(name) > 1)
            raise RecordError(f"{path}: has {quoted(repeated)} twice in one object; keep one")
        return table

    with read_errors(path, "write it again", what="is not valid JSON"):
        content = json.loads(text, object_pairs_hook=unique_keys)
        # Half of a pair of surrogates is no character and could not be written.
        json.dumps(content, ensure_ascii=False).encode()
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


def nearest_word(word: str, allowed: Sequence[str]) -> str:
    """Part of an error message that suggests the nearest allowed word, if any.

    Parameters
    ----------
    word : str                      as written by the user
    allowed : sequence of str

    Returns
    -------
    str                             e.g. "; did you mean 'force'?", or empty
    """
    near = get_close_matches(word.lower()[:_LONGEST_WORD], allowed, n=1, cutoff=0.6)
    return f"; did you mean '{near[0]}'?" if near else ""


def not_allowed(word: str, allowed: Sequence[str]) -> str:
    """Part of an error message that quotes a word and lists those that are allowed in its place.

    Parameters
    ----------
    word : str                      as written by the user
    allowed : sequence of str

    Returns
    -------
    str                             e.g. "'forse'; did you mean 'force'? (allowed: force, name)"
    """
    return f"{quoted(word)}{nearest_word(word, allowed)} (allowed: {', '.join(allowed)})"


def nearest_file(path: Path, *, exclude: str = "") -> str:
    """Part of an error message that suggests the file with the nearest name in the same folder.

    Parameters
    ----------
    path : Path                     of the missing file
    exclude : str                   name of the referring file, which is never suggested

    Returns
    -------
    str                             as in `nearest_word`; also empty if there is no such folder
    """
    try:
        others = [name for name in os.listdir(path.parent) if name not in (path.name, exclude)]
        return nearest_word(path.name, sorted(others)[:_MAX_NAMES])
    except (OSError, ValueError):
        return ""
