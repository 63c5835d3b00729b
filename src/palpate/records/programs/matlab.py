"""Stereo calibrations of MATLAB (stereoParameters), also used by DuoDIC, and MATLAB's files.

These are HDF5 from version 7.3 on; files of versions 5 to 7.2 are validated before they are read:
SciPy's reader trusts the sizes in a file, and one wrong byte can crash the process.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.io import loadmat

from palpate.files import max_unpacked_size, read_bytes, read_errors
from palpate.records.program import (
    HDF5_SIGNATURE,
    CalibrationFile,
    Program,
    checked_size,
    from_hdf5,
    make_pose,
    open_hdf5,
)
from palpate.records.quantities import FILE_LENGTH_UNITS, unit_name
from palpate.records.rig import Camera, Rig

_CAMERAS = ("CameraParameters1", "CameraParameters2")
_ROTATION, _TRANSLATION = "RotationOfCamera2", "TranslationOfCamera2"
_EXPORT = (
    "in MATLAB, with p the stereoParameters (DuoDIC: p = calibrationSession.CameraParameters):"
    f" s = toStruct(p); s.{_ROTATION} = p.{_ROTATION}; s.{_TRANSLATION} = p.{_TRANSLATION};"
    " save('stereo.mat', '-struct', 's')"
)
# Deepest nesting at which the structure is sought: DIC3D.stereoParams, calibrationSession.x.y.
_MAX_DEPTH = 4
_SIGNATURE, _HDF5_HEADER = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
# Where the HDF5 content of a file may begin [bytes]: behind MATLAB's header, or at once.
_HDF5_STARTS = (512, 0)
_HEADER = 128
_AGAIN = "save it again in MATLAB"
# Types of data elements: numbers with their sizes in bytes, matrices, compressed elements.
_NUMBERS = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 16: 1, 17: 2, 18: 4}
_INT8, _INT32, _UINT32, _MATRIX, _COMPRESSED = 1, 5, 6, 14, 15
# Classes of arrays.
_CELL, _STRUCT, _OBJECT, _CHAR, _NUMERIC = 1, 2, 3, 4, range(6, 16)
_COMPLEX = 0x800
T = TypeVar("T")
Elements = list[tuple[int, memoryview]]


class _Opaque(str):
    """Class of a MATLAB object, whose content only MATLAB can read."""

    __slots__ = ()


def _holds_rig(file: CalibrationFile) -> bool:
    """True for MATLAB's files but those of MultiDIC, which are recognised by their names."""
    path = file.path
    is_multidic = path.is_dir() or path.name.startswith("DLTstruct")
    return path.suffix.lower() == ".mat" and not is_multidic


def _read_matlab_rig(file: CalibrationFile) -> Rig:
    """Rig of two cameras in the frame of the first, from a structure made by toStruct.

    MATLAB uses row vectors: x_2 = x_1 RotationOfCamera2 + TranslationOfCamera2, and IntrinsicMatrix
    is the transpose of K. Pixels are counted from 1. Distortion terms are OpenCV's. Lengths are in
    WorldUnits, else in mm.

    Parameters
    ----------
    file : CalibrationFile          .mat, version 5 to 7.3; the structure may be nested in others

    Returns
    -------
    Rig                             cameras '1' and '2'

    Raises
    ------
    RecordError                     not a readable MATLAB file
    CalibrationError                an object in place of the structure, which only MATLAB can read;
                                    no such structure, a missing part, or as in `Camera`
    InputError                      the given unit of length is unknown

    Source
    ------
    MATLAB's documentation of stereoParameters, toStruct and stereoParametersToOpenCV ("the pixel
    centre at (1, 1)"), and MathWorks support on RotationOfCamera2: [x, y, z] * R + t.
    """
    content = of_mat(_variables, file.path)
    table = next((t for t in _tables(content) if _CAMERAS[0] in t), None)
    values = [value for t in _tables(content) for value in t.values()]
    objects = [value for value in values if isinstance(value, _Opaque)]
    if table is None and objects:
        file.fail(f"holds an object ({objects[0]}), which only MATLAB can read; {_EXPORT}")
    if table is None:
        names = ", ".join(list(content)[:8]) or "nothing"
        file.fail(f"holds no stereo calibration (CameraParameters1 ...) but {names}; {_EXPORT}")
    parts = [
        file.entry(table, key, "the calibration") for key in (*_CAMERAS, _ROTATION, _TRANSLATION)
    ]
    first, second, rotation_values, translation_values = parts
    if not (isinstance(first, dict) and isinstance(second, dict)):
        file.fail(f"its CameraParameters1 and 2 are no structures; {_EXPORT}")
    unit = unit_name(str(first.get("WorldUnits", "")).strip())
    metres = file.metres(stated=unit if unit in FILE_LENGTH_UNITS else None, default="mm")
    rotation = file.numbers(_ROTATION, rotation_values, (3, 3)).T
    pose = make_pose(rotation, metres * file.numbers(_TRANSLATION, translation_values, (3,)))
    return file.rig([_camera(file, "1", first, np.eye(4)), _camera(file, "2", second, pose)])


def _camera(
    file: CalibrationFile, name: str, values: Mapping[str, Any], pose: np.ndarray
) -> Camera:
    key = f"CameraParameters{name}"
    # Newer versions store K, older ones its transpose.
    old = "IntrinsicMatrix" in values
    intrinsic = file.entry(values, "IntrinsicMatrix" if old else "K", key)
    matrix = file.numbers(f"the intrinsic matrix of {key}", intrinsic, (3, 3))
    matrix = (matrix.T if old else matrix) - [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]]
    radial, tangential = (
        file.numbers(f"{term} of {key}", values.get(term, []), None)
        for term in ("RadialDistortion", "TangentialDistortion")
    )
    lens = np.concatenate([radial[:2], np.zeros(2 - min(len(radial), 2)), np.zeros(2), radial[2:]])
    lens[2 : 2 + len(tangential)] = tangential
    size = file.numbers(f"ImageSize of {key}", values.get("ImageSize", []), None)
    shape = file.size(size[::-1]) if size.size else None
    return file.camera(name, size=shape, matrix=matrix, distortion=lens, pose=pose)


def _variables(path: Path) -> dict[str, Any]:
    """All variables of a MATLAB file, structures as dictionaries, objects as `_Opaque`."""
    with open_mat(path) as variables:
        return {name: _value(item) for name, item in variables.items()}


def _tables(content: Any, depth: int = _MAX_DEPTH) -> Iterator[dict[str, Any]]:
    """A dictionary and all dictionaries nested in it, outer ones first."""
    if isinstance(content, dict) and depth:
        yield content
        for value in content.values():
            yield from _tables(value, depth - 1)


def _value(item: Any) -> Any:
    """A variable of `open_mat` in memory."""
    if isinstance(item, Mapping):
        return {name: _value(item[name]) for name in item}
    if not hasattr(item, "attrs"):
        # Version 5: an object is an array with the fields variable, system, class and reference.
        is_object = isinstance(item, np.ndarray) and "s2" in (item.dtype.names or ())
        return _Opaque(_text(item["s2"][0])) if is_object else item
    kind = _text(item.attrs.get("MATLAB_class", b"double"))
    if kind in ("cell", "struct"):
        return None
    if "MATLAB_object_decode" in item.attrs or item.dtype.kind not in "fiub":
        return _Opaque(kind)
    array = np.asarray(checked_size(item)).T
    return "".join(map(chr, array.ravel())) if kind == "char" else array


def _text(word: Any) -> str:
    return word.decode("latin-1") if isinstance(word, bytes) else str(word)


MATLAB = Program(
    calibrations="MATLAB (structure of stereoParameters, .mat)",
    holds_rig=_holds_rig,
    read_rig=_read_matlab_rig,
)


def of_mat(use: Callable[..., T], path: Path, *arguments: Any) -> T:
    """What a function makes of `open_mat(path)`; of HDF5, in a child: the library may crash.

    Parameters
    ----------
    use : callable                  of a module; gets the path and the arguments
    path : Path
    *arguments

    Raises
    ------
    RecordError, InputError         as `open_mat`
    """
    if not _is_hdf5(read_bytes(path, 520)):
        return use(path, *arguments)
    with read_errors(path, _AGAIN):
        return from_hdf5(use, path, *arguments)


def _is_hdf5(start: bytes) -> bool:
    """Whether a file holds HDF5, behind MATLAB's header or at once."""
    inside = any(start[at : at + 8] == HDF5_SIGNATURE for at in _HDF5_STARTS)
    return inside or start.startswith(_HDF5_HEADER)


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
    start = read_bytes(path, 520)
    is_known = _is_hdf5(start) or start.startswith(_SIGNATURE)
    what = "is damaged or cut off" if is_known else "is not a MATLAB file of version 5 to 7.3"
    with read_errors(path, _AGAIN, what=what):
        if _is_hdf5(start):
            with open_hdf5(path) as file:
                yield {name: file[name] for name in file if not name.startswith("#")}
        else:
            variables = read_mat(path, what=what, cure=_AGAIN)
            yield {name: variables[name] for name in variables if not name.startswith("__")}


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
