"""Cameras from files that OpenCV's FileStorage wrote (YAML, JSON or XML)."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np

from palpate.errors import CalibrationError
from palpate.records.programs.calibration_parts import (
    make_camera,
    make_pose,
    make_rig,
    metres_per_unit,
    numbers,
)
from palpate.records.rig import Camera, Rig

# The letter or word of a quantity, then the number or side of its camera. Beside R and T the
# rotations R1 and R2 are those of a rectification; they are left alone.
_WHICH = r"_?(\d+|[Ll]eft|[Rr]ight|[LR])?$"
_MATRIX = re.compile(r"(?:K|M|[Cc]amera_?[Mm]atrix|[Cc]amera_?[Mm]at|[Ii]ntrinsics?)" + _WHICH)
_LENS = re.compile(r"(?:D|(?:dist|Dist)(?:ortion)?_?(?:[Cc]oeff?(?:icient)?s?)?)" + _WHICH)
_TURN = re.compile(r"(?:R|[Rr]vec|(?:rotation|Rotation)(?:_?[Mm]atrix)?)" + _WHICH)
_SHIFT = re.compile(r"(?:T|t|[Tt]vec|[Tt]ranslation(?:_?[Vv]ector)?)" + _WHICH)
_SIZE = re.compile(r"(?:[Ii]ma?ge?_?)?[Ss]ize" + _WHICH)
_SHAPES = frozenset({"rows", "sizes"})
_COUNTERPART = {"intrinsic": "extrinsic", "extrinsic": "intrinsic"}


def opencv_entries(root: Mapping[str, Any] | Element) -> dict[str, Any]:
    """Entries of a file by name; of matrices the numbers, by rows, the rest as it is.

    Parameters
    ----------
    root : dict or Element          of the YAML or JSON, or <opencv_storage>

    Returns
    -------
    dict
    """
    if isinstance(root, Element):
        return {child.tag: _xml_value(child) for child in root}
    return {str(key): _plain(value) for key, value in root.items()}


def is_opencv(entries: Mapping[str, Any]) -> bool:
    """True where a file holds a camera matrix, or a rotation and a translation."""
    pair = ("R" in entries, "T" in entries)
    return any(_MATRIX.match(name) for name in entries) or all(pair)


def read_opencv(
    path: Path,
    entries: Mapping[str, Any],
    *,
    beside: Mapping[str, Any] | None,
    length_unit: str | None,
) -> Rig:
    """Rig of a stereo calibration, or of several cameras with a pose each in one file.

    K1 D1 K2 D2 R T, or M1, cameraMatrix1, camera_matrix_left and the like: the object frame is that
    of the first camera. K1 D1 R1 T1 (or rvec1 tvec1), K2 ... without R and T: each has its pose.

    Parameters
    ----------
    path : Path
    entries : dict                  of `opencv_entries`
    beside : dict or None           entries of the other file, where intrinsics and extrinsics are
                                    kept apart
    length_unit : str or None       None: the file must say it in an entry `length_unit`

    Returns
    -------
    Rig                             cameras named by their number or side: '1', '2' or 'left',
                                    'right'

    Raises
    ------
    CalibrationError                a part missing, the unit not known, contradictions as `Camera`
                                    and `Rig` say
    """
    entries = {**(beside or {}), **entries}
    matrices = _numbered(entries, _MATRIX)
    names = sorted((name for name in matrices if name), key=lambda name: (len(name), name))
    if "R" in entries and "T" in entries:
        if len(names) != 2:
            raise CalibrationError(
                f"{path}: has R and T, which tie two cameras, but {len(names)} camera matrices"
                f" (known names: K1, M1, cameraMatrix1, ...; found: {', '.join(entries)}); put"
                " intrinsics.yml and extrinsics.yml side by side, or all into one file"
            )
        step = _pose(path, entries["R"], entries["T"], entries, length_unit)
        poses = [np.eye(4), step]
    else:
        poses = [_own_pose(path, entries, name, length_unit) for name in names]
    cameras = [
        _camera(path, entries, name, matrices[name], pose)
        for name, pose in zip(names, poses, strict=True)
    ]
    return make_rig(path, cameras)


def read_opencv_cameras(
    folder: Path, files: Sequence[tuple[Path, Mapping[str, Any]]], *, length_unit: str | None
) -> Rig:
    """Rig of one file per camera, each with its matrix, lens and pose.

    Parameters
    ----------
    folder : Path
    files : sequence of (path, entries)     entries of `opencv_entries`
    length_unit : str or None       None: each file must say it in an entry `length_unit`

    Returns
    -------
    Rig                             cameras named by their file's name without suffix

    Raises
    ------
    CalibrationError                as `read_opencv`
    """
    cameras = []
    for path, entries in files:
        matrices = _numbered(entries, _MATRIX)
        if list(matrices) != [""]:
            raise CalibrationError(
                f"{path}: has {len(matrices)} camera matrices ({', '.join(entries)}); in a folder"
                " of cameras each file has one, e.g. camera_matrix"
            )
        pose = _own_pose(path, entries, "", length_unit)
        cameras.append(_camera(path, entries, "", matrices[""], pose, title=path.stem))
    return make_rig(folder, cameras)


def counterpart(path: Path) -> Path | None:
    """The extrinsics file beside an intrinsics file, or the other way round, if there is one."""
    for word, other in _COUNTERPART.items():
        if word in path.name:
            twin = path.with_name(path.name.replace(word, other))
            return twin if twin.is_file() else None
    return None


def _camera(
    path: Path,
    entries: Mapping[str, Any],
    name: str,
    matrix: Any,
    pose: np.ndarray,
    *,
    title: str | None = None,
) -> Camera:
    lens = _numbered(entries, _LENS).get(name, [])
    return make_camera(
        path,
        title or name,
        size=_size(path, entries, name),
        matrix=numbers(path, f"camera matrix {name}".strip(), matrix, (3, 3)),
        distortion=numbers(path, f"distortion {name}".strip(), lens, None),
        pose=pose,
    )


def _own_pose(
    path: Path, entries: Mapping[str, Any], name: str, length_unit: str | None
) -> np.ndarray:
    turn, shift = _numbered(entries, _TURN).get(name), _numbered(entries, _SHIFT).get(name)
    if turn is None or shift is None:
        raise CalibrationError(
            f"{path}: camera '{name or path.stem}' has no pose: give R and T between two cameras,"
            f" or a rotation and a translation for each (found: {', '.join(entries)})"
        )
    return _pose(path, turn, shift, entries, length_unit)


def _pose(
    path: Path, turn: Any, shift: Any, entries: Mapping[str, Any], length_unit: str | None
) -> np.ndarray:
    stated = entries.get("length_unit")
    metres = metres_per_unit(path, str(stated) if stated else length_unit, usual=None)
    rotation = numbers(path, "rotation", turn, None)
    if rotation.size == 3:
        rotation = _rotation_from_vector(rotation)
    rotation = numbers(path, "rotation", rotation, (3, 3))
    return make_pose(rotation, metres * numbers(path, "translation", shift, (3,)))


def _rotation_from_vector(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: the direction is the axis, the length the angle in radians."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross)


def _size(path: Path, entries: Mapping[str, Any], name: str) -> tuple[int, int] | None:
    """Columns and rows, where the file says them."""
    sizes = _numbered(entries, _SIZE)
    given = sizes.get(name, sizes.get(""))
    if given is None and "image_width" in entries and "image_height" in entries:
        given = [entries["image_width"], entries["image_height"]]
    if given is None:
        return None
    columns, rows = numbers(path, "image size", given, (2,))
    return int(columns), int(rows)


def _numbered(entries: Mapping[str, Any], pattern: re.Pattern[str]) -> dict[str, Any]:
    """Entries of one kind by the number or side in their name, '' where there is none."""
    found = {}
    for key, value in entries.items():
        if match := pattern.match(key):
            found[(match[1] or "")] = value
    return found


def _plain(value: Any) -> Any:
    """The numbers where a table of rows, cols (or sizes) and data stands for a matrix."""
    is_matrix = isinstance(value, Mapping) and "data" in value and not _SHAPES.isdisjoint(value)
    return value["data"] if is_matrix else value


def _xml_value(node: Element) -> Any:
    """A matrix, or the words of an entry."""
    parts = {child.tag: (child.text or "") for child in node}
    if "data" in parts and not _SHAPES.isdisjoint(parts):
        return parts["data"].split()
    words = (node.text or "").strip().strip('"').split()
    return words if len(words) > 1 else "".join(words)
