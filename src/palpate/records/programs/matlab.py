"""Stereo calibrations of MATLAB (stereoParameters), also used by DuoDIC."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from palpate.records.program import CalibrationFile, Program, make_pose
from palpate.records.rig import Camera, Rig
from palpate.records.text.hdf5 import checked_size
from palpate.records.text.mat_file import open_mat
from palpate.records.text.units import FILE_LENGTH_UNITS, unit_name

_CAMERAS = ("CameraParameters1", "CameraParameters2")
_ROTATION, _TRANSLATION = "RotationOfCamera2", "TranslationOfCamera2"
_EXPORT = (
    "in MATLAB, with p the stereoParameters (DuoDIC: p = calibrationSession.CameraParameters):"
    f" s = toStruct(p); s.{_ROTATION} = p.{_ROTATION}; s.{_TRANSLATION} = p.{_TRANSLATION};"
    " save('stereo.mat', '-struct', 's')"
)
# Deepest nesting at which the structure is sought: DIC3D.stereoParams, calibrationSession.x.y.
_MAX_DEPTH = 4


@dataclass(frozen=True, slots=True)
class _Opaque:
    """A MATLAB object: its class can be read, its content only by MATLAB."""

    kind: str


def _holds_rig(file: CalibrationFile) -> bool:
    """True for MATLAB's files but those of MultiDIC, which are recognised by their names."""
    path = file.path
    is_multidic = path.is_dir() or path.name.startswith("DLTstruct")
    return path.suffix.lower() == ".mat" and not is_multidic


def read_matlab_rig(file: CalibrationFile) -> Rig:
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
    content = _variables(file.path)
    table = next((t for t in _tables(content) if _CAMERAS[0] in t), None)
    values = [value for t in _tables(content) for value in t.values()]
    objects = [value.kind for value in values if isinstance(value, _Opaque)]
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
    found = file.entry(values, "IntrinsicMatrix" if old else "K", key)
    matrix = file.numbers(f"the intrinsic matrix of {key}", found, (3, 3))
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
    with open_mat(path) as found:
        return {name: _value(item) for name, item in found.items()}


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
    read_rig=read_matlab_rig,
)
