"""MATLAB files: version 7.3, which is HDF5, and 5 to 7.2, which are validated before they are read.

SciPy's reader trusts the sizes in a file: one wrong byte can crash the process.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scipy.io import loadmat

from palpate.files import max_unpacked_size, read_bytes, read_errors
from palpate.records.text.hdf5 import HDF5_SIGNATURE, open_hdf5

_SIGNATURE, _HDF5_HEADER = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
# Where the HDF5 content of a file may begin [bytes]: behind MATLAB's header, or at once.
_HDF5_STARTS = (512, 0)
_HEADER = 128
# Types of data elements: numbers with their sizes in bytes, matrices, compressed elements.
_NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
# Classes of arrays.
_CELL, _STRUCT, _OBJECT, _CHAR, _NUMERIC = 1, 2, 3, 4, range(6, 16)
_COMPLEX = 0x800
Elements = list[tuple[int, memoryview]]


@contextmanager
def open_mat(path: Path) -> Iterator[dict[str, Any]]:
    """The variables of a file of version 5 to 7.3, to be used within the block.

    Structures are mappings. In version 7.3 arrays are data sets that are not yet loaded and
    transposed, cells are references in the data set's file.

    Parameters
    ----------
    path : Path

    Yields
    ------
    dict of str to any              variables by name

    Raises
    ------
    RecordError                     missing, of another version, damaged; also in place of errors of
                                    the block
    InputError                      h5py is not installed, for version 7.3
    """
    start, cure = read_bytes(path, 520), "save it again in MATLAB"
    in_hdf5 = any(start[at : at + 8] == HDF5_SIGNATURE for at in _HDF5_STARTS)
    is_known = in_hdf5 or start.startswith((_SIGNATURE, _HDF5_HEADER))
    what = "is damaged or cut off" if is_known else "is not a MATLAB file of version 5 to 7.3"
    with read_errors(path, cure, what=what):
        if in_hdf5 or start.startswith(_HDF5_HEADER):
            with open_hdf5(path) as file:
                yield {name: file[name] for name in file if not name.startswith("#")}
        else:
            found = read_mat(path, what=what, cure=cure)
            yield {name: found[name] for name in found if not name.startswith("__")}


def read_mat(path: Path, *, what: str, cure: str, **options: Any) -> dict[str, Any]:
    """The variables of a file, as `scipy.io.loadmat` gives them.

    Parameters
    ----------
    path : Path
    what, cure : str                as in `read_errors`
    **options                       passed on to `loadmat`

    Returns
    -------
    dict of str to array

    Raises
    ------
    RecordError                     missing, of another version, damaged

    Source
    ------
    The MathWorks, "MAT-file format", Level 5 MAT-files.
    """
    content = read_bytes(path)
    with read_errors(path, cure, what=what):
        if not content.startswith(_SIGNATURE):
            raise ValueError(f"it starts with {content[:19]!r}")
        order = {b"IM": "<", b"MI": ">"}[content[126:_HEADER]]
        remaining = max_unpacked_size(len(content))
        for kind, data in _elements(memoryview(content)[_HEADER:], order):
            if kind == _COMPRESSED:
                plain = _inflate(data, remaining)
                remaining -= len(plain)
                for inner in _elements(plain, order):
                    _check_element(*inner, order)
            else:
                _check_element(kind, data, order)
        return loadmat(path, simplify_cells=True, **options)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of every element of a block."""
    position = 0
    while position < len(data):
        kind, size = struct.unpack_from(order + "II", data, position)
        start = position + 8
        position = start + size + (0 if kind == _COMPRESSED else -size % 8)
        # Small data element format: up to four bytes of data are in the tag itself.
        if kind >> 16:
            kind, size, start = kind & 0xFFFF, kind >> 16, start - 4
            position = start + 4
        if kind not in (*_NUMBERS, _MATRIX, _COMPRESSED) or start + size > len(data):
            raise ValueError("an element is of no known type, or cut off")
        yield kind, data[start : start + size]


def _inflate(data: memoryview, max_bytes: int) -> memoryview:
    """Decompressed content of an element, refused if larger than `max_bytes` bytes."""
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(data, max_bytes + 1)
    if not unpacker.eof or len(content) > max_bytes:
        raise ValueError("a compressed element is cut off, or too large")
    return memoryview(content)


def _check_element(kind: int, data: memoryview, order: str) -> None:
    """Refuse an element whose parts are inconsistent."""
    if kind == _COMPRESSED:
        raise ValueError("an element is compressed within another one")
    if kind == _MATRIX and len(data):
        parts = list(_elements(data, order))
        if not _is_consistent(parts, order):
            raise ValueError("the parts of an array do not belong together")
        for element in parts:
            _check_element(*element, order)


def _is_consistent(parts: Elements, order: str) -> bool:
    """Whether an array has the number and types of parts that its class and size require."""
    if [kind for kind, _ in parts[:3]] != [_UINT32, _INT32, _INT8] or len(parts[0][1]) != 8:
        return parts[:1] != [] and parts[0][0] == _UINT32 and parts[0][1][0] not in (
            _CELL, _STRUCT, _OBJECT, _CHAR, *_NUMERIC
        )  # fmt: skip
    flags = struct.unpack(order + "II", parts[0][1])[0]
    count = math.prod(_sizes(parts[1][1], order))
    array_class, rest = flags & 0xFF, parts[3:]
    if array_class in (_CHAR, *_NUMERIC):
        sizes = [len(data) / _NUMBERS.get(kind, math.inf) for kind, data in rest]
        part_count = 2 if flags & _COMPLEX else 1
        return len(rest) == part_count and (array_class == _CHAR or sizes == [count] * part_count)
    if array_class == _OBJECT:
        rest = rest[1:]
    if array_class in (_STRUCT, _OBJECT):
        if [kind for kind, _ in rest[:2]] != [_INT32, _INT8] or len(rest[0][1]) != 4:
            return False
        (width,) = _sizes(rest[0][1], order)
        if width <= 0:
            return False
        count *= len(rest[1][1]) // width
        rest = rest[2:]
    is_complete = len(rest) == count and all(kind == _MATRIX for kind, _ in rest)
    return is_complete or array_class not in (_CELL, _STRUCT, _OBJECT)


def _sizes(data: memoryview, order: str) -> Sequence[int]:
    """Four-byte integers of a size; negative ones are refused."""
    numbers = struct.unpack(f"{order}{len(data) // 4}i", data)
    if min(numbers, default=-1) < 0:
        raise ValueError("a size is negative")
    return numbers
