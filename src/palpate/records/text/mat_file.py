"""MATLAB files of version 5 to 7.2, whose structure is validated before they are read.

SciPy's reader trusts the sizes in a file: one wrong byte can crash the process.
"""

import math
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from scipy.io import loadmat

from palpate.files import damage, most_unpacked, read_bytes

MAT_MARK = b"MATLAB 5.0 MAT-file"
_HEADER = 128
# Types of data elements: numbers with their sizes in bytes, matrices, compressed elements.
_NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
# Classes of arrays.
_CELL, _STRUCT, _OBJECT, _CHAR, _PLAIN = 1, 2, 3, 4, range(6, 16)
_COMPLEX = 0x800
Elements = list[tuple[int, memoryview]]


def read_mat(path: Path, *, what: str, cure: str, **options: Any) -> dict[str, Any]:
    """The variables of a file, as `scipy.io.loadmat` gives them.

    Parameters
    ----------
    path : Path
    what, cure : str                as in `damage`
    **options                       passed on to `loadmat`

    Raises
    ------
    RecordError                     missing, of another version, damaged

    Source
    ------
    The MathWorks, "MAT-file format", Level 5 MAT-files.
    """
    content = read_bytes(path)
    with damage(path, cure, what=what):
        if not content.startswith(MAT_MARK):
            raise ValueError(f"it starts with {content[:19]!r}")
        order = {b"IM": "<", b"MI": ">"}[content[126:_HEADER]]
        room = most_unpacked(len(content))
        for kind, data in _elements(memoryview(content)[_HEADER:], order):
            if kind == _COMPRESSED:
                plain = _inflated(data, room)
                room -= len(plain)
                for inner in _elements(plain, order):
                    _check(*inner, order)
            else:
                _check(kind, data, order)
        return loadmat(path, simplify_cells=True, **options)


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and content of every element of a block."""
    place = 0
    while place < len(data):
        kind, size = struct.unpack_from(order + "II", data, place)
        start = place + 8
        place = start + size + (0 if kind == _COMPRESSED else -size % 8)
        # Small data element format: up to four bytes of data are in the tag itself.
        if kind >> 16:
            kind, size, start = kind & 0xFFFF, kind >> 16, start - 4
            place = start + 4
        if kind not in (*_NUMBERS, _MATRIX, _COMPRESSED) or start + size > len(data):
            raise ValueError("an element is of no known type, or cut off")
        yield kind, data[start : start + size]


def _inflated(data: memoryview, most: int) -> memoryview:
    """Decompressed content of an element, refused if larger than `most` bytes."""
    unpacker = zlib.decompressobj()
    plain = unpacker.decompress(data, most + 1)
    if not unpacker.eof or len(plain) > most:
        raise ValueError("a compressed element is cut off, or too large")
    return memoryview(plain)


def _check(kind: int, data: memoryview, order: str) -> None:
    """Refuse an element whose parts are inconsistent."""
    if kind == _COMPRESSED:
        raise ValueError("an element is compressed within another one")
    if kind == _MATRIX and len(data):
        parts = list(_elements(data, order))
        if not _fits(parts, order):
            raise ValueError("the parts of an array do not belong together")
        for element in parts:
            _check(*element, order)


def _fits(parts: Elements, order: str) -> bool:
    """Whether an array has the number and types of parts that its class and size require."""
    if [kind for kind, _ in parts[:3]] != [_UINT32, _INT32, _INT8] or len(parts[0][1]) != 8:
        return parts[:1] != [] and parts[0][0] == _UINT32 and parts[0][1][0] not in (
            _CELL, _STRUCT, _OBJECT, _CHAR, *_PLAIN
        )  # fmt: skip
    flags = struct.unpack(order + "II", parts[0][1])[0]
    count = math.prod(_whole(parts[1][1], order))
    sort, rest = flags & 0xFF, parts[3:]
    if sort in (_CHAR, *_PLAIN):
        sizes = [len(data) / _NUMBERS.get(kind, math.inf) for kind, data in rest]
        parted = 2 if flags & _COMPLEX else 1
        return len(rest) == parted and (sort == _CHAR or sizes == [count] * parted)
    if sort == _OBJECT:
        rest = rest[1:]
    if sort in (_STRUCT, _OBJECT):
        if [kind for kind, _ in rest[:2]] != [_INT32, _INT8] or len(rest[0][1]) != 4:
            return False
        (width,) = _whole(rest[0][1], order)
        if width <= 0:
            return False
        count *= len(rest[1][1]) // width
        rest = rest[2:]
    whole = len(rest) == count and all(kind == _MATRIX for kind, _ in rest)
    return whole or sort not in (_CELL, _STRUCT, _OBJECT)


def _whole(data: memoryview, order: str) -> Sequence[int]:
    """Four-byte integers of a size; negative ones are refused."""
    numbers = struct.unpack(f"{order}{len(data) // 4}i", data)
    if min(numbers, default=-1) < 0:
        raise ValueError("a size is negative")
    return numbers
