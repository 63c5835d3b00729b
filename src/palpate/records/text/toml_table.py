"""Reading TOML with errors that name the file, the table and the key."""

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from palpate.arrays import LARGEST_NUMBER
from palpate.errors import InputError, RecordError, quoted
from palpate.files import is_file, read_errors
from palpate.records.text.nearest import nearest_file, nearest_word
from palpate.records.text.text_file import read_text
from palpate.shapes import Vector3

T = TypeVar("T")

# Counterpart of `LARGEST_NUMBER`: a smaller non-zero number is a mistake.
_SMALLEST_NUMBER = 1 / LARGEST_NUMBER
_RANGE = f" (0, or {_SMALLEST_NUMBER:g} to {LARGEST_NUMBER:g} in size)"


@dataclass(frozen=True, slots=True)
class TomlTable:
    """One table of a TOML file, which knows its file and name for error messages.

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
        place = f"{self.name} {key}".strip()
        raise RecordError(": ".join(filter(None, (str(self.file), place, what))))

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
                near = nearest_word(key, allowed)
                self.fail("", f"unknown key {quoted(key)}{near} (allowed: {', '.join(allowed)})")

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
            place = f"{self.file}: {self.name}" if self.name else f"{self.file}"
            raise RecordError(f"{place}: {error}") from error

    def text(self, key: str) -> str:
        """A non-empty string.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     missing, not a text, or blank
        """
        value = self.get(key)
        if not isinstance(value, str):
            self.fail(key, f"is {quoted(value)}; must be a text in quotes")
        if not value.strip():
            self.fail(key, f"is {quoted(value)}; must not be empty")
        return value

    def label(self, key: str) -> str:
        """A one-line text for use in tables, pictures and file names.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     as `text`; a line break or another unprintable character
        """
        if not (value := self.text(key)).isprintable():
            self.fail(key, f"is {quoted(value)}; must have no line break or control character")
        return value

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
            near = nearest_word(value, allowed)
            self.fail(key, f"is {quoted(value)}{near} (allowed: {', '.join(allowed)})")
        return value

    def number(self, key: str) -> float:
        """A finite number.

        Parameters
        ----------
        key : str

        Returns
        -------
        float

        Raises
        ------
        RecordError                     missing, not a number, or not finite
        """
        value = self.get(key)
        if not _is_number(value):
            self.fail(key, f"is {quoted(value)}; must be a finite number{_RANGE}")
        return float(value)

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
        """A non-negative integer.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     missing, or something else
        """
        value = self.get(key)
        if not isinstance(value, int) or isinstance(value, bool) or value < 0:
            self.fail(key, f"is {quoted(value)}; must be a whole number, 0 or more")
        return value

    def boolean(self, key: str) -> bool:
        """True or false.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     missing, or something else
        """
        value = self.get(key)
        if not isinstance(value, bool):
            self.fail(key, f"is {quoted(value)}; must be true or false, without quotes")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts.

        Parameters
        ----------
        key : str

        Raises
        ------
        RecordError                     missing, or something else
        """
        value = self.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            self.fail(key, f"is {quoted(value)}; must be a list of texts in quotes")
        return tuple(value)

    def vector(self, key: str) -> Vector3:
        """Three finite numbers.

        Parameters
        ----------
        key : str

        Returns
        -------
        (3,) float

        Raises
        ------
        RecordError                     missing, or not three finite numbers
        """
        value = self.get(key)
        if not (isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))):
            self.fail(key, f"is {quoted(value)}; must be three finite numbers, e.g. [0, 0, -1.2]")
        return np.array(value, dtype=np.float64)

    def number_or_vector(self, key: str) -> Vector3:
        """Three finite numbers, or one that stands for all three.

        Parameters
        ----------
        key : str

        Returns
        -------
        (3,) float

        Raises
        ------
        RecordError                     missing, or neither
        """
        value = self.get(key)
        if _is_number(value):
            return np.full(3, float(value))
        if not isinstance(value, list):
            self.fail(
                key, f"is {quoted(value)}; must be a finite number, or three of them in brackets"
            )
        return self.vector(key)

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
        value = self.get(key)
        if not isinstance(value, dict):
            self.fail(key, f"is {quoted(value)}; must be a table")
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
        if not all(isinstance(item, dict) for item in items):
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
            self.fail(key, f"{what}: {quoted(str(path))[1:-1]}{near}")
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


def _is_number(value: object) -> bool:
    """True for zero, or a finite int or float of plausible magnitude; False for a boolean."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return value == 0 or _SMALLEST_NUMBER <= abs(value) <= LARGEST_NUMBER
