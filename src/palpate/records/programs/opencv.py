"""Calibrations with OpenCV's camera model and no results beside them: OpenCV's FileStorage or the
same form (YAML, JSON, XML); TOML with a table per camera (caliscope, Anipose, Pose2Sim); and
Kalibr's chain of cameras (camchain.yaml).
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.records.program import CalibrationFile, Program, camera_matrix, make_pose
from palpate.records.rig import Camera, Rig

# The letter or word of a quantity, then the number or side of its camera. Next to R and T, R1 and
# R2 are rotations of a rectification, and are ignored.
_CAMERA_SUFFIX = r"_?(\d+|[Ll]eft|[Rr]ight|[LR])?$"
_MATRIX = re.compile(
    r"(?:K|M|[Cc]amera_?[Mm]atrix|[Cc]amera_?[Mm]at|[Ii]ntrinsics?)" + _CAMERA_SUFFIX
)
_LENS = re.compile(r"(?:D|(?:dist|Dist)(?:ortion)?_?(?:[Cc]oeff?(?:icient)?s?)?)" + _CAMERA_SUFFIX)
_ROTATION = re.compile(r"(?:R|[Rr]vec|(?:rotation|Rotation)(?:_?[Mm]atrix)?)" + _CAMERA_SUFFIX)
_TRANSLATION = re.compile(r"(?:T|t|[Tt]vec|[Tt]ranslation(?:_?[Vv]ector)?)" + _CAMERA_SUFFIX)
_SIZE = re.compile(r"(?:[Ii]ma?ge?_?)?[Ss]ize" + _CAMERA_SUFFIX)
_SHAPE_KEYS = frozenset({"rows", "sizes"})
# Names of OpenCV's standard lens model in ROS and elsewhere; OpenCV's calibration sample writes
# `fisheye_model`.
_LENS_MODELS = ("plumb_bob", "rational_polynomial", "radtan", "brown_conrady", "opencv", "none", "")
_COUNTERPART = {"intrinsic": "extrinsic", "extrinsic": "intrinsic"}


def _holds_rig(file: CalibrationFile) -> bool:
    """True if a file, or one in a folder, has a camera matrix, or a rotation and a translation."""
    if file.path.is_dir():
        return any(_holds_rig(other) for other in file.files_in_folder())
    entries = _entries(file)
    return any(_MATRIX.match(name) for name in entries) or {"R", "T"} <= set(entries)


def _read_opencv_rig(file: CalibrationFile) -> Rig:
    """Rig of a stereo calibration, of several cameras in one file, or of a folder of such files.

    With K1 D1 K2 D2 R T, or M1, cameraMatrix1, camera_matrix_left and the like, the object frame is
    that of the first camera. With K1 D1 R1 T1 (or rvec1 tvec1), K2 ... but without R and T, each
    camera has its own pose. In a folder each file has one camera with matrix, distortion and pose.
    The unit of length must be given, by the caller or in an entry `length_unit`.

    Parameters
    ----------
    file : CalibrationFile          a file, or a folder with a file per camera

    Returns
    -------
    Rig                             cameras named by their number or side: '1', '2' or 'left',
                                    'right'; in a folder by their file's name without suffix

    Raises
    ------
    CalibrationError                a missing part, no unit of length, or as in `Camera` and `Rig`
    InputError                      the given unit of length is unknown
    RecordError                     a file of the folder cannot be read
    """
    if file.path.is_dir():
        cameras = [other for other in file.files_in_folder() if _holds_rig(other)]
        return file.rig([_only_camera(camera) for camera in cameras])
    entries = _entries(file)
    if other := _counterpart(file.path):
        entries = {**_entries(CalibrationFile.read(other)), **entries}
    matrices = _numbered(entries, _MATRIX)
    names = sorted((name for name in matrices if name), key=lambda name: (len(name), name))
    if "R" in entries and "T" in entries:
        if len(names) != 2:
            file.fail(
                f"has R and T, which tie two cameras, but {len(names)} camera matrices (known"
                f" names: K1, M1, cameraMatrix1, ...; found: {', '.join(entries)}); put"
                " intrinsics.yml and extrinsics.yml side by side, or all into one file"
            )
        metres = _metres(file, entries)
        second = _opencv_pose(file, "camera 2", entries["R"], entries["T"], metres)
        poses = [np.eye(4), second]
    else:
        poses = [_own_pose(file, entries, name) for name in names]
    return file.rig([_camera(file, entries, *both) for both in zip(names, poses, strict=True)])


def _only_camera(file: CalibrationFile) -> Camera:
    """The camera of a file in a folder, which must hold exactly one."""
    entries = _entries(file)
    matrices = _numbered(entries, _MATRIX)
    if list(matrices) != [""]:
        file.fail(
            f"has {len(matrices)} camera matrices ({', '.join(entries)}); in a folder of cameras"
            " each file has one, e.g. camera_matrix"
        )
    return _camera(file, entries, "", _own_pose(file, entries, ""))


def _counterpart(path: Path) -> Path | None:
    """The extrinsics file next to an intrinsics file, or vice versa, if there is one."""
    for word, other in _COUNTERPART.items():
        if word in path.name:
            file = path.with_name(path.name.replace(word, other))
            return file if file.is_file() else None
    return None


def _entries(file: CalibrationFile) -> dict[str, Any]:
    """Entries of a file by name; matrices as their numbers, row by row."""
    if isinstance(file.content, Element):
        return {child.tag: _xml_value(child) for child in file.content}
    content = file.content if isinstance(file.content, dict) else {}
    return {str(key): _matrix_numbers(value) for key, value in content.items()}


def _camera(
    file: CalibrationFile, entries: Mapping[str, Any], name: str, pose: np.ndarray
) -> Camera:
    where = f"camera '{name or file.path.stem}'"
    model = str(entries.get("distortion_model") or "").lower()
    if model not in _LENS_MODELS or str(entries.get("fisheye_model") or "0") not in ("0", "False"):
        file.fail(
            f"{where} has the lens model {model or 'fisheye'}; only OpenCV's usual one is known"
            " (k1 k2 p1 p2 k3 ..., plumb_bob): calibrate again with it"
        )
    matrix = _numbered(entries, _MATRIX)[name]
    lens = _numbered(entries, _LENS).get(name, [])
    return file.camera(
        name or file.path.stem,
        size=_size(file, entries, name),
        matrix=file.numbers(f"camera matrix {name}".strip(), matrix, (3, 3)),
        distortion=file.numbers(f"distortion {name}".strip(), lens, None),
        pose=pose,
    )


def _own_pose(file: CalibrationFile, entries: Mapping[str, Any], name: str) -> np.ndarray:
    where = f"camera '{name or file.path.stem}'"
    rotation = _numbered(entries, _ROTATION).get(name)
    translation = _numbered(entries, _TRANSLATION).get(name)
    if rotation is None or translation is None:
        file.fail(
            f"{where} has no pose: give R and T between two cameras, or"
            f" a rotation and a translation for each (found: {', '.join(entries)})"
        )
    return _opencv_pose(file, where, rotation, translation, _metres(file, entries))


def _metres(file: CalibrationFile, entries: Mapping[str, Any]) -> float:
    return file.metres(stated=entries.get("length_unit"), default=None)


def _opencv_pose(
    file: CalibrationFile, where: str, rotation: Any, translation: Any, metres: float
) -> Float[np.ndarray, "4 4"]:
    """Pose x_camera = R x_object + t from OpenCV's rotation and translation.

    Parameters
    ----------
    file : CalibrationFile
    where : str                     which camera it is, for the message
    rotation : 3 or 9 numbers       rotation vector (axis times angle in radians), or matrix
    translation : 3 numbers         translation
    metres : float [m]              unit of `translation`

    Returns
    -------
    (4, 4) float                    translation in metres

    Raises
    ------
    CalibrationError                wrong counts, numbers that are not finite
    """
    matrix = file.numbers(f"{where} rotation", rotation, None)
    if matrix.size == 3:
        matrix = Rotation.from_rotvec(matrix).as_matrix()
    matrix = file.numbers(f"{where} rotation", matrix, (3, 3))
    return make_pose(matrix, metres * file.numbers(f"{where} translation", translation, (3,)))


def _size(file: CalibrationFile, entries: Mapping[str, Any], name: str) -> tuple[int, int] | None:
    """Columns and rows, if the file gives them."""
    sizes = _numbered(entries, _SIZE)
    given = sizes.get(name, sizes.get(""))
    if given is None and "image_width" in entries and "image_height" in entries:
        given = [entries["image_width"], entries["image_height"]]
    return file.size(given)


def _numbered(entries: Mapping[str, Any], pattern: re.Pattern[str]) -> dict[str, Any]:
    """Entries of one kind, by the number or side in their names; '' if there is none."""
    matches = ((pattern.match(key), value) for key, value in entries.items())
    return {match[1] or "": value for match, value in matches if match}


def _matrix_numbers(value: Any) -> Any:
    """The numbers of a table with rows, cols (or sizes) and data, which represents a matrix."""
    is_matrix = isinstance(value, Mapping) and "data" in value and not _SHAPE_KEYS.isdisjoint(value)
    return value["data"] if is_matrix else value


def _xml_value(node: Element) -> Any:
    """The numbers of a matrix, or the words of an entry."""
    parts = {child.tag: (child.text or "") for child in node}
    if "data" in parts and not _SHAPE_KEYS.isdisjoint(parts):
        return parts["data"].split()
    words = (node.text or "").strip().strip('"').split()
    return words if len(words) > 1 else "".join(words)


OPENCV = Program(
    calibrations="OpenCV (YAML, JSON, XML)", holds_rig=_holds_rig, read_rig=_read_opencv_rig
)


def holds_camera_tables(content: Any) -> bool:
    """True if a TOML file has camera tables in the form of these programs.

    Parameters
    ----------
    content : any                   parsed content of the file
    """
    return isinstance(content, dict) and bool(_camera_tables(content))


def _read_camera_tables(file: CalibrationFile) -> Rig:
    """Rig of tables with matrix, distortions, rotation (Rodrigues vector or matrix), translation.

    x_camera = R x_world + t, with OpenCV's distortion terms. A camera with ignore = true is left
    out. caliscope ([cameras.N], or tables with a port) writes metres; for the others the unit of
    length must be given, by the caller or in a line `length_unit`.

    Parameters
    ----------
    file : CalibrationFile          parsed TOML

    Returns
    -------
    Rig                             cameras named by `name`, else by their table

    Raises
    ------
    CalibrationError                a fisheye lens, a missing part, no unit of length, or as in
                                    `Camera` and `Rig`
    InputError                      the given unit of length is unknown

    Source
    ------
    Files in the repositories of caliscope (github.com/mprib/caliscope, tests/sessions,
    camera_array.toml) and aniposelib (CameraGroup.dump); Pose2Sim's Calib.toml is the same.
    """
    tables = _camera_tables(file.content)
    is_caliscope = "cameras" in file.content or any("port" in t for t in tables.values())
    default = "m" if is_caliscope else None
    metres = file.metres(stated=file.content.get("length_unit"), default=default)
    used = {key: table for key, table in tables.items() if table.get("ignore") is not True}
    return file.rig([_camera_of_table(file, key, table, metres) for key, table in used.items()])


def _camera_tables(content: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The cameras' tables by name."""
    inner = content.get("cameras")
    tables = inner if isinstance(inner, dict) else content
    return {k: t for k, t in tables.items() if isinstance(t, dict) and "matrix" in t}


def _camera_of_table(
    file: CalibrationFile, key: str, table: Mapping[str, Any], metres: float
) -> Camera:
    name = str(table.get("name", key))
    where = f"camera '{name}'"
    if table.get("fisheye") is True:
        file.fail(f"{where} has a fisheye lens, which is not known; calibrate it as a usual one")
    if not {"rotation", "translation"} <= set(table):
        file.fail(
            f"{where} has no rotation and translation: its place among the others was not"
            " calibrated; finish that, or set ignore = true in its table"
        )
    return file.camera(
        name,
        size=file.size(table.get("size")),
        matrix=file.numbers(f"{where} matrix", table["matrix"], (3, 3)),
        distortion=file.numbers(f"{where} distortions", table.get("distortions", []), None),
        pose=_opencv_pose(file, where, table["rotation"], table["translation"], metres),
    )


TOML_CAMERAS = Program(
    calibrations="caliscope and Anipose (TOML)",
    holds_rig=lambda file: holds_camera_tables(file.content),
    read_rig=_read_camera_tables,
)


def _holds_chain(file: CalibrationFile) -> bool:
    return isinstance(file.content, dict) and isinstance(file.content.get("cam0"), dict)


def _read_kalibr_rig(file: CalibrationFile) -> Rig:
    """Rig of a camera chain, in the frame of its first camera; lengths are in metres.

    Parameters
    ----------
    file : CalibrationFile          with the tables cam0, cam1, ...

    Returns
    -------
    Rig                             cameras 'cam0', 'cam1', ...

    Raises
    ------
    CalibrationError                a model other than pinhole with radtan or no distortion, a
                                    missing key, or as in `Camera`
    InputError                      the given unit of length is unknown

    Source
    ------
    Kalibr (github.com/ethz-asl/kalibr), wiki "yaml formats": T_cn_cnm1 maps points from the frame
    of the previous camera to this one; radtan is k1 k2 p1 p2 of OpenCV.
    """
    metres = file.metres(default="m")
    tables = {name: table for name, table in file.content.items() if isinstance(table, dict)}
    names = sorted((n for n in tables if n.startswith("cam")), key=lambda n: (len(n), n))
    cameras: list[Camera] = []
    pose = np.eye(4)
    for name in names:
        if cameras:
            step = file.numbers(
                f"{name} T_cn_cnm1", file.entry(tables[name], "T_cn_cnm1", name), (4, 4)
            )
            pose = make_pose(step[:3, :3], metres * step[:3, 3]) @ pose
        cameras.append(_kalibr_camera(file, name, tables[name], pose))
    return file.rig(cameras)


def _kalibr_camera(
    file: CalibrationFile, name: str, table: Mapping[str, Any], pose: np.ndarray
) -> Camera:
    model = file.entry(table, "camera_model", name)
    lens = str(table.get("distortion_model", "none")).lower()
    if model != "pinhole" or lens not in ("radtan", "plumb_bob", "none"):
        file.fail(
            f"{name} is of the model {model} with {lens}; only pinhole with radtan (or none) is"
            " known: calibrate with --models pinhole-radtan"
        )
    intrinsics = file.numbers(f"{name} intrinsics", file.entry(table, "intrinsics", name), (4,))
    terms = [] if lens == "none" else file.entry(table, "distortion_coeffs", name)
    return file.camera(
        name,
        size=file.size(table.get("resolution")),
        matrix=camera_matrix(intrinsics),
        distortion=file.numbers(f"{name} distortion_coeffs", terms, None),
        pose=pose,
    )


KALIBR = Program(
    calibrations="Kalibr (camchain YAML)", holds_rig=_holds_chain, read_rig=_read_kalibr_rig
)
