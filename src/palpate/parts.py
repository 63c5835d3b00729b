"""Finished parts of long work, kept on disk until the whole is done, found by what they rest on."""

import hashlib
import io
import pickle
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import palpate
from palpate.disk import write_bytes
from palpate.errors import RecordError
from palpate.files import read_bytes

T = TypeVar("T")
# Bytes of the sum that stands before a part.
_SUM = 32
# How numpy puts arrays together again.
_NUMPY = ("_reconstruct", "_frombuffer", "scalar", "ndarray", "dtype")


@dataclass(frozen=True, slots=True)
class Parts:
    """Where finished parts of one piece of work are kept.

    Parameters
    ----------
    folder : Path or None           made when the first part is kept; None: nothing is kept
    key : str                       digest of all that the work depends on; parts of other work in
                                    the same folder are not found
    """

    folder: Path | None
    key: str = ""

    def kept(self, name: str, make: Callable[[], T], known: Mapping[str, Any] | None = None) -> T:
        """A part as an earlier run kept it, or made now and kept.

        Parameters
        ----------
        name : str                  no two parts alike
        make : callable             the part: arrays, Palpate's dataclasses, plain values and texts
        known : mapping of names to objects     that are there in any run: not kept, put in again

        Returns
        -------
        the part                    the same to the last bit, whether made or read
        """
        if self.folder is None:
            return make()
        known = known or {}
        path = self.folder / content_digest((self.key, name))
        found = _read(path, known)
        if found is None:
            found = (make(),)
            content = io.BytesIO()
            _Writer(content, known).dump(found)
            # A disk that has room for the result only is no reason to end without one.
            with suppress(OSError, RecordError):
                self.folder.mkdir(exist_ok=True)
                write_bytes(path, _sum(content.getvalue()) + content.getvalue())
        part: T = found[0]
        return part


def content_digest(value: Any) -> str:
    """SHA-256 of what a tree of dataclasses, arrays, mappings, sequences and plain values holds.

    Parameters
    ----------
    value

    Returns
    -------
    str                             64 hexadecimal digits; another for another version of Palpate
    """
    digest = hashlib.sha256(palpate.__version__.encode())
    _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: "hashlib._Hash", value: Any) -> None:
    """Add a value to a digest, with its type and size, so that no two look alike."""
    digest.update(f"{type(value).__qualname__} ".encode())
    if is_dataclass(value):
        _feed(digest, {field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.shape} {value.dtype.str} ".encode())
        # As bytes where they lie: a copy of a model's integrals is as large as they are.
        digest.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
    elif isinstance(value, Mapping):
        _feed(digest, list(value.items()))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{len(value)} ".encode())
        for item in value:
            _feed(digest, item)
    else:
        text = repr(value).encode()
        digest.update(f"{len(text)} ".encode() + text)


class _Writer(pickle.Pickler):
    """Writes names in place of the objects that are known."""

    def __init__(self, file: io.BytesIO, known: Mapping[str, Any]) -> None:
        super().__init__(file, protocol=5)
        self.names = {id(item): name for name, item in known.items() if item is not None}

    def persistent_id(self, item: Any) -> str | None:
        """The name of an object that is known."""
        return self.names.get(id(item))


class _Reader(pickle.Unpickler):
    """Puts known objects in place of names; makes nothing but arrays and Palpate's dataclasses.

    A file can thus do no more than hold other values, whoever wrote it.
    """

    def __init__(self, file: io.BytesIO, known: Mapping[str, Any]) -> None:
        super().__init__(file)
        self.known = known

    def persistent_load(self, name: str) -> Any:
        """The object of a name."""
        return self.known[name]

    def find_class(self, module: str, name: str) -> Any:
        """A class that may be made."""
        found = super().find_class(module, name)
        is_record = is_dataclass(found) or (isinstance(found, type) and issubclass(found, Enum))
        if module.startswith("palpate.") and is_record:
            return found
        if module.partition(".")[0] == "numpy" and name in _NUMPY:
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is nothing that a part is made of")


def _sum(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _read(path: Path, known: Mapping[str, Any]) -> tuple[Any] | None:
    """A part in a file, or None where there is none that is as it was written."""
    try:
        stored = read_bytes(path)
        content = stored[_SUM:]
        if stored[:_SUM] != _sum(content):
            return None
        found = _Reader(io.BytesIO(content), known).load()
    except (RecordError, ValueError, LookupError, TypeError, AttributeError, ImportError, EOFError,
            pickle.UnpicklingError):  # fmt: skip
        return None
    return found if isinstance(found, tuple) and len(found) == 1 else None
