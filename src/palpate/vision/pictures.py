"""Grey pictures from files and videos, for all cameras of a rig at one instant.

The codecs behind OpenCV (libjpeg, libpng, libtiff) report damage only on the process's standard
error; libjpeg even returns a picture, whose lower part is grey and would be taken for the object.
Standard error is therefore redirected to a file while a picture is decoded, so that nothing reaches
the terminal and damage is detected.
"""

import os
import re
import struct
import tempfile
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.errors import CalibrationError, RecordError, counted
from palpate.files import checked_file, read_bytes
from palpate.foreign import decoded_video, results_in_child
from palpate.machine import check_memory_for
from palpate.records import Camera, Rig

_CAMERA_FIELD = "{camera}"
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
# What a pixel takes while pictures are matched jointly [bytes]: measured at 2 and 17 million.
_BYTES_PER_PIXEL = 100.0
_PICTURE_KINDS = "PNG, JPEG, TIFF or BMP"
_PNG, _JPEG, _BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
# Classic TIFF and BigTIFF, in both byte orders.
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# JPEG markers that begin a frame: 0xC0 to 0xCF except DHT, JPG and DAC.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# TIFF tags: ImageWidth, ImageLength, NewSubfileType, Orientation.
_WIDTH, _HEIGHT, _PURPOSE, _ORIENTATION = 256, 257, 254, 274
_TAGS = frozenset({_WIDTH, _HEIGHT, _PURPOSE, _ORIENTATION})
# What precedes the EXIF data, themselves a TIFF, of a JPEG and of a PNG; they have 64 KB at most.
_EXIF_MARKS, _EXIF_BYTES = (b"Exif\0\0", b"eXIf"), 2**16
# Bits of NewSubfileType for pictures that accompany another: reduced resolution, mask.
_COMPANION = 1 | 4
# `struct` formats of the TIFF types that a size may have: SHORT, LONG, LONG8.
_FORMATS = {3: "H", 4: "I", 16: "Q"}
# JPEG markers: start of the coded data of a scan, and end of the image.
_START_OF_SCAN, _END_OF_IMAGE = b"\xff\xda", b"\xff\xd9"
# Standard error belongs to the whole process: only one thread at a time may redirect it.
_ONE_AT_A_TIME = threading.Lock()
_ERROR_STREAM = 2
_FROM_CODECS = re.compile(r"JPEG|libpng|TIFF|imgcodecs|grfmt|imdecode|\[ *(WARN|ERROR|INFO):")
# Warnings, such as one about an unknown tag, say nothing about the pixels.
_DAMAGE = re.compile(r"Corrupt JPEG|[Pp]remature end|ERROR|error")
# Prefix of an OpenCV message: the place in its sources.
_SOURCE = re.compile(r"^\[.*?\] global \S+ ")
VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")
# Longest time for a frame, where a sound video takes milliseconds.
_FRAME_SECONDS = 60.0
_CURE = "copy it again, or convert it, e.g. to MP4 with H.264 or to AVI with MJPEG"


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
    InputError                      more pixels than the memory holds while they are followed
    RecordError                     a file is missing, truncated, damaged, of an unknown type, asks
                                    to be shown turned, holds several pictures, values that are not
                                    finite, or one grey everywhere; the pattern has no `{camera}`
    CalibrationError                a picture does not have its camera's size
    """
    if _CAMERA_FIELD not in pattern and len(rig.cameras) > 1:
        raise RecordError(
            f"{what}: the pattern of image files '{pattern}' has no {_CAMERA_FIELD}, so all"
            f" {len(rig.cameras)} cameras would read the same file; write {_CAMERA_FIELD} in place"
            f" of the camera's name ({', '.join(camera.name for camera in rig.cameras)})"
        )
    grey, saturated = [], []
    cameras_of: dict[str, list[str]] = {}
    for camera in rig.cameras:
        path = _picture_file(camera, pattern, folder, what)
        label = f"{what}, camera '{camera.name}'"
        levels, fraction, remarks = _read_picture(camera, path, label)
        grey.append(levels)
        # The first picture tells: the others are as large, and may be many.
        _check_memory(len(rig.cameras), grey, what)
        saturated.append(fraction)
        for remark in remarks:
            cameras_of.setdefault(remark, []).append(camera.name)
    notes = [
        f"{what}, {'camera' if len(names) == 1 else 'cameras'} {', '.join(names)}: {remark}."
        for remark, names in cameras_of.items()
    ]
    return Pictures(tuple(grey), tuple(saturated), tuple(notes))


def _check_memory(cameras: int, grey: list[np.ndarray], what: str) -> None:
    """Refuse pictures that are too many or too large, by those that were read."""
    pixels = sum(levels.size for levels in grey) + (cameras - len(grey)) * grey[-1].size
    check_memory_for(
        f"{what}: {counted(cameras, 'picture')} of {pixels / 1e6:.0f} million pixels together",
        _BYTES_PER_PIXEL * pixels, "leave cameras out, or calibrate them for smaller pictures",
    )  # fmt: skip


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
    return folder / pattern.replace(_CAMERA_FIELD, camera.name)


def _picture_file(camera: Camera, pattern: str, folder: Path, what: str) -> Path:
    """Path of one camera's picture; if it is missing, the error names what is there instead."""
    path = picture_path(camera, pattern, folder)
    if os.path.exists(path):
        return path
    label = f"{what}, camera '{camera.name}': {path}: no such file"
    if not os.path.isdir(path.parent):
        raise RecordError(f"{label}, for there is no folder {path.parent}")
    beside = sorted(entry.name for entry in path.parent.iterdir())
    head, *rest = (re.escape(part) for part in Path(pattern).name.split(_CAMERA_FIELD))
    expression = re.compile("(.+)".join([head, *rest]))
    named = [match[1] for name in beside if rest and (match := expression.fullmatch(name))]
    if named:
        hint = f"; the pattern '{pattern}' fits the cameras {_listed(named)}"
    elif near := get_close_matches(path.name, beside, n=3):
        hint = f"; near it are {_listed(near)}"
    else:
        hint = f"; the folder has {_listed(beside)}" if beside else "; the folder is empty"
    raise RecordError(f"{label}{hint}: check the pattern and the names of the cameras in the rig")


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - _MAX_NAMES} more" if len(names) > _MAX_NAMES else ""
    return ", ".join(f"'{name}'" for name in names[:_MAX_NAMES]) + more


def _read_picture(
    camera: Camera, path: Path, label: str
) -> tuple[Float[np.ndarray, "rows columns"], float, list[str]]:
    """Grey levels, saturated fraction and remarks of one file."""
    stored, label = read_stored(path, label, camera)
    levels, remarks = _grey_levels(stored, label)
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
    stored, label = read_stored(path, "picture", None)
    return _grey_levels(stored, label)[0]


def read_stored(path: Path, label: str, camera: Camera | None) -> tuple[np.ndarray, str]:
    """Pixels of a file as stored, and the file's name for messages.

    Parameters
    ----------
    path : Path
    label : str                     what the file is, before its name in messages
    camera : Camera or None         whose size the picture must have

    Returns
    -------
    pixels : array                  as `decode_picture` gives them
    label : str                     with the file's name

    Raises
    ------
    RecordError                     the file is missing, damaged, of an unknown type or too large,
                                    or holds several pictures
    CalibrationError                its size is not the camera's
    """
    try:
        content = read_bytes(path)
    except RecordError as error:
        raise RecordError(f"{label}: {error}") from error
    label = f"{label}: {path}"
    if size := claimed_size(content):
        _check_size(camera, size, label)
    try:
        stored = decode_picture(content)
    except RecordError as error:
        raise RecordError(f"{label}: {error}") from error
    _check_size(camera, (stored.shape[1], stored.shape[0]), label)
    return stored, label


def _check_size(camera: Camera | None, size: tuple[int, int], label: str) -> None:
    columns, rows = size
    if columns * rows > _MAX_PIXELS:
        raise RecordError(
            f"{label}: has {columns} x {rows} pixels, more than any camera; is it a picture of one?"
        )
    if camera is not None and camera.size not in (None, (columns, rows)):
        turned = "; the picture seems to be turned" if camera.size == (rows, columns) else ""
        raise CalibrationError(
            f"{label}: has {columns} x {rows} pixels, the camera was calibrated with"
            f" {camera.size[0]} x {camera.size[1]} (columns x rows){turned}; a calibration holds"
            " for pictures of its own size only, neither cut nor scaled"
        )


def _grey_levels(
    stored: np.ndarray, label: str
) -> tuple[Float[np.ndarray, "rows columns"], list[str]]:
    """Convert stored pixels to grey levels from 0 to 255; also returns remarks on what was done."""
    if stored.dtype not in (np.uint8, np.uint16, np.float32, np.float64):
        raise RecordError(
            f"{label}: has grey levels of type {stored.dtype}; must be of 8 or 16 bits without"
            " sign, or floating-point"
        )
    channels = 1 if stored.ndim == 2 else stored.shape[2]
    if channels not in (1, 3, 4):
        raise RecordError(f"{label}: has {channels} channels; must be grey, RGB or RGB and alpha")
    remarks = []
    if channels == 4:
        remarks.append("the alpha channel was left out")
        stored = stored[..., :3]
    _check_contents(stored, label)
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


def _check_contents(stored: np.ndarray, label: str) -> None:
    """Raise if grey levels are not finite or all the same."""
    whole = np.issubdtype(stored.dtype, np.integer)
    missing = 0 if whole else int((~np.isfinite(_single(stored))).sum())
    if missing:
        raise RecordError(
            f"{label}: has {missing} grey levels that are not finite; every pixel needs a number"
        )
    low, high = float(stored.min()), float(stored.max())
    if high - low <= (_MAX_CONSTANT_RANGE if whole else 0.0):
        what = "black" if low == 0.0 else "of one grey"
        raise RecordError(
            f"{label}: is {what} all over (grey levels {low:g} to {high:g}); nothing can be"
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


def claimed_size(content: bytes) -> tuple[int, int] | None:
    """Columns and rows of the first picture in a PNG, JPEG, TIFF or BMP file.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    (int, int) or None              columns, rows; None where the header is truncated or not valid

    Source
    ------
    PNG specification, 11.2.2; ITU-T T.81, B.2.2; TIFF 6.0, section 2, and the BigTIFF design;
    BITMAPINFOHEADER of Windows.
    """
    try:
        if content.startswith(_PNG):
            return struct.unpack_from(">II", content, 16)
        if content.startswith(_BMP):
            # The old 12-byte header has 16-bit sizes; a negative height means top-down rows.
            old = struct.unpack_from("<I", content, 14) == (12,)
            columns, rows = struct.unpack_from("<HH" if old else "<ii", content, 18)
            return abs(columns), abs(rows)
        if content.startswith(_TIFF):
            first = next(_tiff_directories(content), {})
            return (first[_WIDTH], first[_HEIGHT]) if {_WIDTH, _HEIGHT} <= set(first) else None
        return _jpeg_size(content) if content.startswith(_JPEG) else None
    except struct.error:
        return None


def _picture_count(content: bytes) -> int:
    """Number of pictures in a file, without reduced-size copies and masks in a TIFF.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    int                             1 for all but TIFF; for a truncated TIFF, those before the end
    """
    if not content.startswith(_TIFF):
        return 1
    count = 0
    with suppress(struct.error):
        for directory in _tiff_directories(content):
            count += not directory.get(_PURPOSE, 0) & _COMPANION
    return count


def _orientation(content: bytes) -> int:
    """Orientation in which a picture asks to be shown, as its EXIF data or TIFF tag say.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    int                             2 to 8: turned or mirrored; else, or 1 where nothing is said:
                                    as stored

    Source
    ------
    Exif 2.32, 4.6.4, tag Orientation.
    """
    places = [content.find(mark) + len(mark) for mark in _EXIF_MARKS if mark in content]
    blocks = [content[start : start + _EXIF_BYTES] for start in places]
    for block in (content, *blocks):
        if block.startswith(_TIFF):
            with suppress(struct.error):
                return next(_tiff_directories(block), {}).get(_ORIENTATION, 1)
    return 1


def decode_picture(content: bytes) -> np.ndarray:
    """Decode the pixels of a file as stored: not converted, not turned.

    A file that asks to be shown turned is refused: a calibration refers to the sensor, and programs
    differ in whether they turn such a picture (OpenCV turns a TIFF, but a JPEG only on request).

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    array                           (rows, columns) or (rows, columns, channels) with the channels
                                    blue, green, red, alpha

    Raises
    ------
    RecordError                     the file is empty, of an unknown type, truncated or damaged, or
                                    a TIFF with several pictures, to be shown turned; the message
                                    continues a sentence that begins with the file's name
    """
    if not content:
        raise RecordError("is empty; copy or record it again")
    if not content.startswith((_PNG, _JPEG, _BMP, *_TIFF)):
        raise RecordError(
            f"is none of {_PICTURE_KINDS} (it starts with {content[:8]!r}); copy or record it again"
        )
    if (count := _picture_count(content)) > 1:
        raise RecordError(f"holds {count} pictures; give each a file of its own")
    if 2 <= (shown := _orientation(content)) <= 8:
        raise RecordError(
            f"has the EXIF orientation {shown}, which asks programs to show it turned; must be 1,"
            " as a calibration refers to pixels as the sensor gave them: remove the tag from these"
            " pictures and from those of the calibration (`exiftool -Orientation= FILES`)"
        )
    pixels = None
    buffer = np.frombuffer(content, dtype=np.uint8)
    with _codec_messages() as messages, suppress(cv2.error):
        if not _is_cut_png(content):
            pixels = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    damage = [_SOURCE.sub("", line.strip()) for line in messages if _DAMAGE.search(line)]
    # The end marker 0xFF 0xD9 cannot occur within coded data.
    if content.startswith(_JPEG) and content.rfind(_END_OF_IMAGE) < content.rfind(_START_OF_SCAN):
        damage.insert(0, "it has no end-of-image marker")
    if damage or pixels is None:
        detail = f" ({damage[0]})" if damage else ""
        raise RecordError(
            f"is cut off or damaged, or of a kind that cannot be decoded{detail}; it has"
            f" {len(content)} bytes: copy or record it again"
        )
    return pixels


def _is_cut_png(content: bytes) -> bool:
    """True for a PNG file that ends within a chunk: OpenCV takes memory for all that a chunk claims
    to have, up to four gigabytes, before it reads the chunk."""
    if not content.startswith(_PNG):
        return False
    # A chunk is its length, its name of four letters, so many bytes, and their checksum.
    offset = len(_PNG)
    while offset + 8 <= len(content):
        length, name = struct.unpack_from(">I4s", content, offset)
        offset += 12 + length
        if name == b"IEND":
            break
    return offset > len(content)


@contextmanager
def _codec_messages() -> Iterator[list[str]]:
    """Redirect standard error to a file; on exit the list holds the codecs' messages.

    Anything else written there meanwhile is passed on.
    """
    messages: list[str] = []
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as aside:
        try:
            original = os.dup(_ERROR_STREAM)
        except OSError:  # standard error is closed
            yield messages
            return
        try:
            os.dup2(aside.fileno(), _ERROR_STREAM)
            yield messages
        finally:
            os.dup2(original, _ERROR_STREAM)
            os.close(original)
        aside.seek(0)
        lines = aside.read().decode(errors="replace").splitlines(keepends=True)
        messages += [line for line in lines if _FROM_CODECS.search(line)]
        others = [line for line in lines if line.strip() and not _FROM_CODECS.search(line)]
        with suppress(OSError):
            os.write(_ERROR_STREAM, "".join(others).encode())


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Columns and rows from the first frame header, searched segment by segment."""
    offset = 2
    while True:
        mark, kind, length = struct.unpack_from(">BBH", content, offset)
        if mark != 0xFF:
            return None
        if kind in _FRAMES:
            rows, columns = struct.unpack_from(">HH", content, offset + 5)
            return columns, rows
        # A marker may be preceded by any number of 0xFF.
        offset += 1 if kind == 0xFF else 2 + length


def _tiff_directories(content: bytes) -> Iterator[dict[int, int]]:
    """Yield the values of `_TAGS` in each image file directory of a TIFF."""
    order = "<" if content.startswith(b"II") else ">"
    large = content[2:4] in (b"+\0", b"\0+")
    head, count, entry, value = ("Q", "Q", 20, 12) if large else ("I", "H", 12, 8)
    (offset,) = struct.unpack_from(order + head, content, 8 if large else 4)
    seen = set()
    while 0 < offset < len(content) and offset not in seen:
        seen.add(offset)
        (entries,) = struct.unpack_from(order + count, content, offset)
        start = offset + struct.calcsize(order + count)
        fields = {}
        for k in range(min(entries, 4096)):
            tag, kind = struct.unpack_from(order + "HH", content, start + k * entry)
            if tag in _TAGS and kind in _FORMATS:
                number = order + _FORMATS[kind]
                (fields[tag],) = struct.unpack_from(number, content, start + k * entry + value)
        yield fields
        end = min(start + entries * entry, len(content))
        (offset,) = struct.unpack_from(order + head, content, end)


def video_frame_count(path: Path) -> int:
    """Number of frames of a video by its header.

    Parameters
    ----------
    path : Path

    Returns
    -------
    int                             0 if the header does not tell

    Raises
    ------
    RecordError                     the file does not exist or cannot be decoded as a video
    """
    with _opened(path) as (count, _):
        return count


def video_frames(path: Path) -> Iterator[tuple[float, UInt8[np.ndarray, "_ _"]]]:
    """Iterate over all frames of a video, holding no more than two in memory.

    Parameters
    ----------
    path : Path

    Yields
    ------
    float [s], (rows, columns) uint8    time stamp in the file, grey levels

    Raises
    ------
    RecordError                     as `video_frame_count`; or fewer than two frames can be decoded,
                                    which is raised before the first one is yielded
    """
    with _opened(path) as (_, frames):
        begun = list(islice(frames, 2))
        if len(begun) < 2:
            count = "only one frame" if begun else "not one frame"
            raise RecordError(f"{path}: {count} can be decoded, two are needed; {_CURE}")
        while begun:
            yield begun.pop(0)
        yield from frames


@contextmanager
def _opened(path: Path) -> Iterator[tuple[int, Iterator[Any]]]:
    """The number of frames by a video's header, and the frames."""
    checked_file(path)
    with closing(results_in_child(decoded_video, path, seconds=_FRAME_SECONDS)) as made:
        try:
            yield next(made), made
        except RuntimeError as error:
            raise RecordError(f"{path}: cannot be decoded as a video ({error}); {_CURE}") from error
