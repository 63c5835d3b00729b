"""Reading of grey pictures from files, for all cameras of a rig at one instant."""

import os
import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError, RecordError
from palpate.files import read_bytes
from palpate.records import Camera, Rig
from palpate.vision.images.picture_file import claimed_size, decode_picture

CAMERA_FIELD = "{camera}"
# Luminance of ITU-R BT.601, in OpenCV's order blue, green, red.
_LUMINANCE = np.array([0.114, 0.587, 0.299], dtype=np.float32)
# Maps 65535 to 255, so that grey levels mean the same for any bit depth of the file.
_LEVELS_16_PER_8 = 257.0
# Pictures of integers with no larger range count as constant.
_MAX_CONSTANT_RANGE = 2
# White levels of 16-bit files: cameras of 10, 12 and 14 bits use either the low or the high bits.
_WHITE_16 = [2**k - 1 for k in (10, 12, 14, 16)] + [2**16 - 2 ** (16 - k) for k in (10, 12, 14)]
_MAX_NAMES = 8
# The largest sensors have 150 million pixels.
_MAX_PIXELS = 2e8


@dataclass(frozen=True, slots=True, eq=False)
class Pictures:
    """Pictures of the cameras of a rig at one instant.

    Attributes
    ----------
    grey : tuple of c (rows, columns) float32   grey levels, 255 is white, in the rig's order;
                                                sizes may differ between the cameras
    saturated : tuple of c float [-]            fraction of saturated pixels; NaN for files with
                                                floating-point grey levels, which have no white
                                                level
    notes : tuple of str                        sentences about what was converted or left out
    """

    grey: tuple[Float[np.ndarray, "_rows _columns"], ...]
    saturated: tuple[float, ...]
    notes: tuple[str, ...]


def read_pictures(rig: Rig, pattern: str, *, folder: Path, what: str) -> Pictures:
    """Read the picture of every camera of a rig and convert it to grey levels.

    Reads PNG, JPEG, TIFF and BMP files. 16-bit grey levels are divided by 257, colours are
    converted to luminance, floating-point levels are kept.

    Parameters
    ----------
    rig : Rig
    pattern : str                   file name with `{camera}` in place of the camera's name
    folder : Path                   folder that the pattern is relative to
    what : str                      name of the step or probing for messages, e.g. "step 's3'"

    Returns
    -------
    Pictures

    Raises
    ------
    RecordError                     a file is missing, truncated, damaged, of an unknown type, asks
                                    to be shown turned, holds several pictures, values that are not
                                    finite, or one grey everywhere; the pattern has no `{camera}`
    CalibrationError                a picture does not have its camera's size
    """
    if CAMERA_FIELD not in pattern and len(rig.cameras) > 1:
        raise RecordError(
            f"{what}: the pattern of image files '{pattern}' has no {CAMERA_FIELD}, so all"
            f" {len(rig.cameras)} cameras would read the same file; write {CAMERA_FIELD} in place"
            f" of the camera's name ({', '.join(camera.name for camera in rig.cameras)})"
        )
    grey, saturated = [], []
    cameras_of: dict[str, list[str]] = {}
    for camera in rig.cameras:
        path = _picture_file(camera, pattern, folder, what)
        place = f"{what}, camera '{camera.name}'"
        levels, fraction, remarks = _read_picture(camera, path, place)
        grey.append(levels)
        saturated.append(fraction)
        for remark in remarks:
            cameras_of.setdefault(remark, []).append(camera.name)
    notes = [
        f"{what}, {'camera' if len(names) == 1 else 'cameras'} {', '.join(names)}: {remark}."
        for remark, names in cameras_of.items()
    ]
    return Pictures(tuple(grey), tuple(saturated), tuple(notes))


def picture_path(camera: Camera, pattern: str, folder: Path) -> Path:
    """Path of one camera's picture, whether it exists or not.

    Parameters
    ----------
    camera : Camera
    pattern : str                   file name with `{camera}` in place of the camera's name
    folder : Path                   folder that the pattern is relative to

    Returns
    -------
    Path
    """
    return folder / pattern.replace(CAMERA_FIELD, camera.name)


def _picture_file(camera: Camera, pattern: str, folder: Path, what: str) -> Path:
    """Path of one camera's picture; if it is missing, the error names what is there instead."""
    path = picture_path(camera, pattern, folder)
    if os.path.exists(path):
        return path
    place = f"{what}, camera '{camera.name}': {path}: no such file"
    if not os.path.isdir(path.parent):
        raise RecordError(f"{place}, for there is no folder {path.parent}")
    beside = sorted(entry.name for entry in path.parent.iterdir())
    head, *rest = (re.escape(part) for part in Path(pattern).name.split(CAMERA_FIELD))
    expression = re.compile("(.+)".join([head, *rest]))
    named = [found[1] for name in beside if rest and (found := expression.fullmatch(name))]
    if named:
        hint = f"; the pattern '{pattern}' fits the cameras {_listed(named)}"
    elif near := get_close_matches(path.name, beside, n=3):
        hint = f"; near it are {_listed(near)}"
    else:
        hint = f"; the folder has {_listed(beside)}" if beside else "; the folder is empty"
    raise RecordError(f"{place}{hint}: check the pattern and the names of the cameras in the rig")


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return ", ".join(f"'{name}'" for name in names[:_MAX_NAMES]) + more


def _read_picture(
    camera: Camera, path: Path, place: str
) -> tuple[Float[np.ndarray, "rows columns"], float, list[str]]:
    """Grey levels, saturated fraction and remarks of one file."""
    stored, place = read_stored(path, place, camera)
    levels, remarks = _grey_levels(stored, place)
    return levels, _saturated_fraction(stored), remarks


def read_grey(path: Path) -> Float[np.ndarray, "rows columns"]:
    """Grey levels of one picture file, converted as by `read_pictures`.

    Parameters
    ----------
    path : Path

    Returns
    -------
    (rows, columns) float32         255 is white

    Raises
    ------
    RecordError                     the file is missing, damaged, of an unknown type, holds several
                                    pictures, values that are not finite, or one grey everywhere
    """
    stored, place = read_stored(path, "picture", None)
    return _grey_levels(stored, place)[0]


def read_stored(path: Path, place: str, camera: Camera | None) -> tuple[np.ndarray, str]:
    """Pixels of a file as stored, and the file's name for messages.

    Parameters
    ----------
    path : Path
    place : str                     what the file is, before its name in messages
    camera : Camera or None         whose size the picture must have

    Returns
    -------
    pixels : array                  as `decode_picture` gives them
    place : str                     with the file's name

    Raises
    ------
    RecordError                     the file is missing, damaged, of an unknown type or too large,
                                    or holds several pictures
    CalibrationError                its size is not the camera's
    """
    try:
        content = read_bytes(path)
    except RecordError as error:
        raise RecordError(f"{place}: {error}") from error
    place = f"{place}: {path}"
    if size := claimed_size(content):
        _check_size(camera, size, place)
    try:
        stored = decode_picture(content)
    except RecordError as error:
        raise RecordError(f"{place}: {error}") from error
    _check_size(camera, (stored.shape[1], stored.shape[0]), place)
    return stored, place


def _check_size(camera: Camera | None, size: tuple[int, int], place: str) -> None:
    columns, rows = size
    if columns * rows > _MAX_PIXELS:
        raise RecordError(
            f"{place}: has {columns} x {rows} pixels, more than any camera; is it a picture of one?"
        )
    if camera is not None and camera.size not in (None, (columns, rows)):
        turned = "; the picture seems to be turned" if camera.size == (rows, columns) else ""
        raise CalibrationError(
            f"{place}: has {columns} x {rows} pixels, the camera was calibrated with"
            f" {camera.size[0]} x {camera.size[1]} (columns x rows){turned}; a calibration holds"
            " for pictures of its own size only, neither cut nor scaled"
        )


def _grey_levels(
    stored: np.ndarray, place: str
) -> tuple[Float[np.ndarray, "rows columns"], list[str]]:
    """Convert stored pixels to grey levels from 0 to 255; also returns remarks on what was done."""
    if stored.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise RecordError(
            f"{place}: has grey levels of type {stored.dtype}; must be of 8 or 16 bits without"
            " sign, or floating-point"
        )
    channels = 1 if stored.ndim == 2 else stored.shape[2]
    if channels not in (1, 3, 4):
        raise RecordError(f"{place}: has {channels} channels; must be grey, RGB or RGB and alpha")
    remarks = []
    if channels == 4:
        remarks.append("the alpha channel was left out")
        stored = stored[..., :3]
    _check_contents(stored, place)
    grey = _single(stored)
    if channels > 1:
        remarks.append("colours were turned into luminance (0.299 R + 0.587 G + 0.114 B)")
    grey = grey.reshape(stored.shape[:2]) if channels == 1 else grey @ _LUMINANCE
    if stored.dtype == np.uint16:
        remarks.append("grey levels of 16 bits were divided by 257 (65535 becomes 255)")
        grey /= np.float32(_LEVELS_16_PER_8)
    elif stored.dtype != np.uint8:
        remarks.append("floating-point grey levels were kept as they are")
    return np.ascontiguousarray(grey), remarks


def _check_contents(stored: np.ndarray, place: str) -> None:
    """Raise if grey levels are not finite or all the same."""
    whole = np.issubdtype(stored.dtype, np.integer)
    missing = 0 if whole else int((~np.isfinite(_single(stored))).sum())
    if missing:
        raise RecordError(
            f"{place}: has {missing} grey levels that are not finite; every pixel needs a number"
        )
    low, high = float(stored.min()), float(stored.max())
    if high - low <= (_MAX_CONSTANT_RANGE if whole else 0.0):
        what = "black" if low == 0.0 else "of one grey"
        raise RecordError(
            f"{place}: is {what} all over (grey levels {low:g} to {high:g}); nothing can be"
            " followed in it: check exposure, light and lens cap, or leave it out"
        )


def _single(stored: np.ndarray) -> Float[np.ndarray, "..."]:
    """Convert to single precision; values that overflow become infinite."""
    with np.errstate(over="ignore"):
        return stored.astype(np.float32)


def _saturated_fraction(stored: np.ndarray) -> float:
    """Fraction of pixels at the white level; NaN for floating-point files."""
    if not np.issubdtype(stored.dtype, np.integer):
        return float("nan")
    colours = stored[..., :3] if stored.ndim == 3 else stored[..., None]
    white = int(colours.max())
    if white not in ([255] if stored.dtype == np.uint8 else _WHITE_16):
        return 0.0
    return float((colours == white).any(axis=-1).mean())
