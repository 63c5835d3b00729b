"""Checkpoints: finished parts of a long computation, stored on disk by a digest of their inputs."""

import hashlib
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum, EnumType
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from scipy.sparse import bsr_array, csr_array

import palpate
from palpate.disk import atomic_replacement, created_folder
from palpate.errors import InUseError, RecordError
from palpate.files import open_own_file, read_errors, unpacked_arrays
from palpate.machine import free_disk

T = TypeVar("T")
# Name of a part's file: a digest.
_PART_NAME = re.compile(r"[0-9a-f]{64}")
# Name, among a part's arrays, of the text that says what they are parts of.
_TREE = "tree"
_SPARSE = (bsr_array, csr_array)
# Largest size of a cache [bytes], and fraction of what is free without it. All of a body
# of 5000 vertices, the largest that is solved with dense matrices, takes 10 GB.
_MOST_BYTES, _MOST_FRACTION = 16 * 2**30, 0.25


class Memory(dict[str, Any]):
    """Stands in place of a folder: keeps parts for as long as it is held, as they are.

    Parameters
    ----------
    parts : mapping of names to parts   known already, such as those of another memory

    Attributes
    ----------
    pushes : dict                       what is kept of single pushes for the next fit, by its kind
    """

    def __init__(self, parts: Mapping[str, Any] = MappingProxyType({})) -> None:
        super().__init__(parts)
        self.pushes: dict[str, Any] = {}


# Where parts are kept.
Cache = Path | Memory


@dataclass(frozen=True, slots=True)
class Checkpoints:
    """Store for the finished parts of one computation.

    Parameters
    ----------
    folder : Path, Memory or None   created when the first part is stored; None: nothing is stored
    key : str                       digest of everything the computation depends on; parts stored
                                    under another key in the same folder are ignored
    cache : bool                    whether the folder's size is limited: what has not been used for
                                    longest is removed beyond 16 GB, or a quarter of what would be
                                    free on the disk without it
    """

    folder: Cache | None
    key: str = ""
    cache: bool = False

    def kept_in_memory(self, name: str, make: Callable[[], T]) -> T:
        """As `load_or_make`, of a part that is made sooner than it is read from a file: kept in
        memory only."""
        return self.load_or_make(name, make) if self.in_memory else make()

    @property
    def in_memory(self) -> bool:
        """True if parts are kept in memory, not in files."""
        return isinstance(self.folder, Memory)

    def load_or_make(
        self, name: str, make: Callable[[], T], known: Mapping[str, Any] | None = None
    ) -> T:
        """A part as stored by an earlier run, or else computed now and stored.

        Parameters
        ----------
        name : str                  unique among the parts
        make : callable             computes the part: arrays, Palpate's dataclasses, plain values
                                    and texts, and tuples, lists and dicts of these
        known : mapping of names to objects     objects that every run has: stored by name only and
                                    put back on reading

        Returns
        -------
        the part                    bit for bit the same, whether computed or read
        """
        part: T | None = self.load(name, known)
        return self.stored(name, make(), known) if part is None else part

    def load(self, name: str, known: Mapping[str, Any] | None = None) -> Any:
        """A part as stored by an earlier run; None if there is none.

        Parameters
        ----------
        name, known                 as in `load_or_make`
        """
        if self.folder is None:
            return None
        if isinstance(self.folder, Memory):
            return self.folder.get(content_digest((self.key, name)))
        return _read_part(self._file(self.folder, name), known or {})

    def stored(self, name: str, part: T, known: Mapping[str, Any] | None = None) -> T:
        """Store a part, and give it back.

        Parameters
        ----------
        name, known                 as in `load_or_make`
        part : any                  not None
        """
        if isinstance(self.folder, Memory):
            self.folder[content_digest((self.key, name))] = part
        elif self.folder is not None:
            # A full disk must not stop the computation, nor another process that stores the part:
            # it is then simply not stored.
            file = self._file(self.folder, name)
            with suppress(OSError, RecordError, InUseError), created_folder(self.folder):
                # A file is replaced where a link leads; a part belongs into this folder.
                if file.is_symlink():
                    file.unlink()
                with atomic_replacement(file) as staged:
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
    elif isinstance(value, _SPARSE):
        _update_digest(digest, (value.data, value.indices, value.indptr, value.shape))
    elif isinstance(value, Mapping):
        _update_digest(digest, list(value.items()))
    elif isinstance(value, (list, tuple)):
        digest.update(f"{len(value)} ".encode())
        for item in value:
            _update_digest(digest, item)
    else:
        text = repr(value).encode()
        digest.update(f"{len(text)} ".encode() + text)


def _write_part(path: Path, part: Any, known: Mapping[str, Any]) -> None:
    """Write a part as an NPZ file: its arrays, and a text in JSON that says where each belongs."""
    by_number: dict[int, np.ndarray] = {}
    names = {id(item): name for name, item in known.items() if item is not None}
    text = json.dumps(_as_tree(part, names, by_number)).encode()
    arrays = {str(number): array for number, array in enumerate(by_number.values())}
    arrays[_TREE] = np.frombuffer(text, np.uint8)
    with path.open("wb") as file:
        np.savez(file, **arrays)  # type: ignore[arg-type]  # mypy: a name might be an option's


def _as_tree(value: Any, names: Mapping[int, str], arrays: dict[int, np.ndarray]) -> Any:
    """What JSON holds of a value: a plain one itself, of any other a list that begins with a word.
    Arrays are added to `arrays` by their identity, one that belongs to two things once, and are
    called by their number there."""
    inner, kind = partial(_as_tree, names=names, arrays=arrays), type(value)
    if id(value) in names:
        return ["known", names[id(value)]]
    if value is None or kind in (bool, int, float, str):
        return value
    if kind in (tuple, list):
        return [kind.__name__, [inner(item) for item in value]]
    if kind is dict:
        return ["dict", [[inner(name), inner(item)] for name, item in value.items()]]
    if kind in _SPARSE:
        return [kind.__name__, [inner(part) for part in (value.data, value.indices, value.indptr)],
                [int(length) for length in value.shape]]  # fmt: skip
    if isinstance(value, Enum):
        return ["enum", kind.__module__, kind.__qualname__, value.name]
    if is_dataclass(value):
        content = {field.name: inner(getattr(value, field.name)) for field in fields(value)}
        return ["record", kind.__module__, kind.__qualname__, content]
    if kind is not bytes and kind is not np.ndarray and not isinstance(value, np.generic):
        raise TypeError(f"{kind.__qualname__} is nothing that a part is made of")
    array = np.frombuffer(value, np.uint8) if kind is bytes else np.asarray(value)
    arrays.setdefault(id(value), array)
    word = {bytes: "bytes", np.ndarray: "array"}.get(kind, "number")
    return [word, str([*arrays].index(id(value)))]


def _read_part(path: Path, known: Mapping[str, Any]) -> Any:
    """A stored part, or None if the file is missing, not the user's own or not what was written."""
    try:
        with open_own_file(path) as file, read_errors(path, "it is computed again"):
            arrays = unpacked_arrays(file, path)
            # A cache removes what has not been used for longest.
            with suppress(OSError):
                os.utime(path)
            return _from_tree(json.loads(arrays[_TREE].tobytes()), known, arrays)
    except RecordError:
        return None


def _from_tree(tree: Any, known: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Any:
    """The value of which `_as_tree` made a tree. A forged file can change values, but not run code:
    what is made are plain values, arrays and Palpate's own records and enums."""
    inner = partial(_from_tree, known=known, arrays=arrays)
    match tree:
        case None | bool() | int() | float() | str():
            return tree
        case ["known", name]:
            return known[name]
        case ["tuple", items]:
            return tuple(map(inner, items))
        case ["list", items]:
            return list(map(inner, items))
        case ["dict", pairs]:
            return {inner(name): inner(item) for name, item in pairs}
        case ["csr_array" | "bsr_array" as name, parts, shape]:
            kind = next(kind for kind in _SPARSE if kind.__name__ == name)
            matrix = kind(tuple(map(inner, parts)), shape=tuple(shape))
            # An index out of range would be read outside the array.
            matrix.check_format()
            return matrix
        case ["enum", module, name, member]:
            return _loaded_class(module, name)[member]
        case ["record", module, name, content]:
            made = {field: inner(item) for field, item in content.items()}
            return _loaded_class(module, name)(**made)
        case ["bytes", key]:
            return arrays[key].tobytes()
        case ["array", key]:
            return arrays[key]
        case ["number", key]:
            return arrays[key][()]
    raise ValueError("a value of another kind")


def _loaded_class(module: str, name: str) -> Any:
    """Palpate's dataclass or enum of a name. A name in a file has nothing imported: whoever reads a
    part has loaded what it is made of."""
    loaded = vars(sys.modules[module])[name] if module.startswith("palpate.") else None
    is_own = isinstance(loaded, type) and loaded.__module__ == module
    if is_own and (is_dataclass(loaded) or isinstance(loaded, EnumType)):
        return loaded
    raise ValueError(f"{module}.{name} is nothing that a part is made of")


def _trim(cache: Path) -> None:
    """Remove the parts that have not been used for longest, beyond what a cache may hold.

    Another process may read, write and remove at the same time: what it has locked or removed is
    left to it. Files of other names are not touched.
    """
    entries = []
    with suppress(OSError):
        for file in cache.iterdir():
            if _PART_NAME.fullmatch(file.name):
                with suppress(OSError):
                    entries.append((file.stat(), file))
    total, held = 0, sum(status.st_size for status, _ in entries)
    most = min(_MOST_BYTES, _MOST_FRACTION * (free_disk(cache) + held))
    for status, file in sorted(entries, key=lambda pair: pair[0].st_mtime, reverse=True):
        total += status.st_size
        if total > most:
            with suppress(OSError):
                file.unlink()
