"""Checkpoints: finished parts of a long computation, stored on disk by a digest of their inputs."""

import hashlib
import os
import pickle
import re
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import IO, Any, TypeVar

import numpy as np

import palpate
from palpate.disk import atomic_replacement, created_folder
from palpate.errors import InUseError, RecordError
from palpate.files import checked_file

T = TypeVar("T")
# Name of a part's file: a digest.
_PART_NAME = re.compile(r"[0-9a-f]{64}")
# Length of the checksum that precedes a part [bytes].
_CHECKSUM_BYTES = 32
# Largest size of a cache [bytes], and fraction of what is free without it. All of a body
# of 5000 vertices, the largest that is solved with dense matrices, takes 10 GB.
_MOST_BYTES, _MOST_FRACTION = 16 * 2**30, 0.25
# The names that numpy needs to unpickle arrays.
_NUMPY_NAMES = ("_reconstruct", "_frombuffer", "scalar", "ndarray", "dtype")


@dataclass(frozen=True, slots=True)
class Parts:
    """Store for the finished parts of one computation.

    Parameters
    ----------
    folder : Path or None           created when the first part is stored; None: nothing is stored
    key : str                       digest of everything the computation depends on; parts stored
                                    under another key in the same folder are ignored
    cache : bool                    whether the folder's size is limited: what has not been used for
                                    longest is removed beyond 16 GB, or a quarter of what would be
                                    free on the disk without it
    """

    folder: Path | None
    key: str = ""
    cache: bool = False

    def load_or_make(
        self, name: str, make: Callable[[], T], known: Mapping[str, Any] | None = None
    ) -> T:
        """A part as stored by an earlier run, or else computed now and stored.

        Parameters
        ----------
        name : str                  unique among the parts
        make : callable             computes the part: arrays, Palpate's dataclasses, plain values
                                    and texts
        known : mapping of names to objects     objects that every run has: stored by name only and
                                    put back on reading

        Returns
        -------
        the part                    bit for bit the same, whether computed or read
        """
        found: T | None = self.load(name, known)
        return self.stored(name, make(), known) if found is None else found

    def load(self, name: str, known: Mapping[str, Any] | None = None) -> Any:
        """A part as stored by an earlier run; None if there is none.

        Parameters
        ----------
        name, known                 as in `load_or_make`
        """
        if self.folder is None:
            return None
        return _read_part(self._file(self.folder, name), known or {})

    def stored(self, name: str, part: T, known: Mapping[str, Any] | None = None) -> T:
        """Store a part, and give it back.

        Parameters
        ----------
        name, known                 as in `load_or_make`
        part : any                  not None
        """
        if self.folder is not None:
            # A full disk must not stop the computation, nor another process that stores the part:
            # it is then simply not stored.
            with (
                suppress(OSError, RecordError, InUseError),
                created_folder(self.folder),
                atomic_replacement([self._file(self.folder, name)]) as (staged,),
            ):
                _write_part(staged, part, known or {})
            if self.cache:
                _trim(self.folder)
        return part

    def _file(self, folder: Path, name: str) -> Path:
        return folder / content_digest((self.key, name))


def content_digest(value: Any) -> str:
    """SHA-256 of the content of nested dataclasses, arrays, mappings, sequences and plain values.

    Parameters
    ----------
    value : any of these

    Returns
    -------
    str                             64 hexadecimal digits; depends on the version of Palpate
    """
    digest = hashlib.sha256(palpate.__version__.encode())
    _update_digest(digest, value)
    return digest.hexdigest()


def _update_digest(digest: "hashlib._Hash", value: Any) -> None:
    """Add a value to a digest, with its type and size, so that different values differ."""
    digest.update(f"{type(value).__qualname__} ".encode())
    if is_dataclass(value):
        _update_digest(digest, {field.name: getattr(value, field.name) for field in fields(value)})
    elif isinstance(value, np.ndarray):
        digest.update(f"{value.shape} {value.dtype.str} ".encode())
        # The bytes in place, without a copy: a model's integrals are large.
        digest.update(np.ascontiguousarray(value).reshape(-1).view(np.uint8).data)
    elif isinstance(value, Mapping):
        _update_digest(digest, list(value.items()))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{len(value)} ".encode())
        for item in value:
            _update_digest(digest, item)
    else:
        text = repr(value).encode()
        digest.update(f"{len(text)} ".encode() + text)


class _Writer(pickle.Pickler):
    """Pickler that writes known objects by name."""

    def __init__(self, file: IO[bytes], known: Mapping[str, Any]) -> None:
        super().__init__(file, protocol=5)
        self.names = {id(item): name for name, item in known.items() if item is not None}

    def persistent_id(self, item: Any) -> str | None:
        """Name of a known object, else None."""
        return self.names.get(id(item))


class _Reader(pickle.Unpickler):
    """Unpickler that resolves known names and creates only arrays, Palpate's dataclasses and enums.

    A forged file can therefore change values, but not run code.
    """

    def __init__(self, file: IO[bytes], known: Mapping[str, Any]) -> None:
        super().__init__(file)
        self.known = known

    def persistent_load(self, name: str) -> Any:
        """The known object of a name."""
        return self.known[name]

    def find_class(self, module: str, name: str) -> Any:
        """The class of that name, if it may be unpickled."""
        found = super().find_class(module, name)
        is_record = is_dataclass(found) or (isinstance(found, type) and issubclass(found, Enum))
        if module.startswith("palpate.") and is_record:
            return found
        if module.partition(".")[0] == "numpy" and name in _NUMPY_NAMES:
            return found
        raise pickle.UnpicklingError(f"{module}.{name} is nothing that a part is made of")


def _write_part(path: Path, part: Any, known: Mapping[str, Any]) -> None:
    """Write a part, then its checksum before it: large arrays are not copied."""
    with path.open("w+b") as file:
        file.seek(_CHECKSUM_BYTES)
        _Writer(file, known).dump(part)
        file.seek(_CHECKSUM_BYTES)
        checksum = hashlib.file_digest(file, "sha256").digest()
        file.seek(0)
        file.write(checksum)


def _is_intact(file: IO[bytes]) -> bool:
    """Whether what follows the checksum matches it; the file is then at the start of the part."""
    checksum = file.read(_CHECKSUM_BYTES)
    found = hashlib.file_digest(file, "sha256").digest()  # type: ignore[arg-type]
    file.seek(_CHECKSUM_BYTES)
    return checksum == found


def _read_part(path: Path, known: Mapping[str, Any]) -> Any:
    """A stored part, or None if the file is missing or not intact."""
    try:
        with checked_file(path).open("rb") as file:
            if not _is_intact(file):
                return None
            # A cache removes what has not been used for longest; one of somebody else, nothing.
            with suppress(OSError):
                os.utime(path)
            return _Reader(file, known).load()
    except (RecordError, OSError, ValueError, LookupError, TypeError, AttributeError, ImportError,
            EOFError, pickle.UnpicklingError):  # fmt: skip
        return None


def _trim(cache: Path) -> None:
    """Remove the parts that have not been used for longest, beyond what a cache may hold.

    Another process may read, write and remove at the same time: what it has locked or removed is
    left to it. Files of other names are not touched.
    """
    found = []
    with suppress(OSError):
        for file in cache.iterdir():
            if _PART_NAME.fullmatch(file.name):
                with suppress(OSError):
                    found.append((file.stat(), file))
    total, held = 0, sum(each.st_size for each, _ in found)
    most = min(_MOST_BYTES, _MOST_FRACTION * (_free_bytes(cache) + held))
    for each, file in sorted(found, key=lambda pair: pair[0].st_mtime, reverse=True):
        total += each.st_size
        if total > most:
            with suppress(OSError):
                file.unlink()


def _free_bytes(folder: Path) -> int:
    """What is free on the disk of a folder, 0 if that cannot be found out."""
    try:
        return shutil.disk_usage(folder).free
    except OSError:
        return 0
