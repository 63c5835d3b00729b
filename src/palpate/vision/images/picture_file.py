"""Picture files: sizes as stated in their headers, and pixels decoded with OpenCV, with detection
of damaged files.

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
from contextlib import contextmanager, suppress

import cv2
import numpy as np

from palpate.errors import RecordError

PICTURE_KINDS = "PNG, JPEG, TIFF or BMP"
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


def picture_count(content: bytes) -> int:
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
        for found in _tiff_directories(content):
            count += not found.get(_PURPOSE, 0) & _COMPANION
    return count


def orientation(content: bytes) -> int:
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
    blocks = [content[place : place + _EXIF_BYTES] for place in places]
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
            f"is none of {PICTURE_KINDS} (it starts with {content[:8]!r}); copy or record it again"
        )
    if (count := picture_count(content)) > 1:
        raise RecordError(f"holds {count} pictures; give each a file of its own")
    if 2 <= (shown := orientation(content)) <= 8:
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
        said = f" ({damage[0]})" if damage else ""
        raise RecordError(
            f"is cut off or damaged, or of a kind that cannot be decoded{said}; it has"
            f" {len(content)} bytes: copy or record it again"
        )
    return pixels


def _is_cut_png(content: bytes) -> bool:
    """True for a PNG file that ends within a chunk: OpenCV takes memory for all that a chunk claims
    to have, up to four gigabytes, before it reads the chunk."""
    if not content.startswith(_PNG):
        return False
    # A chunk is its length, its name of four letters, so many bytes, and their checksum.
    place = len(_PNG)
    while place + 8 <= len(content):
        length, name = struct.unpack_from(">I4s", content, place)
        place += 12 + length
        if name == b"IEND":
            break
    return place > len(content)


@contextmanager
def _codec_messages() -> Iterator[list[str]]:
    """Redirect standard error to a file; on exit the list holds the codecs' messages.

    Anything else written there meanwhile is passed on.
    """
    messages: list[str] = []
    with _ONE_AT_A_TIME, tempfile.TemporaryFile() as aside:
        try:
            kept = os.dup(_ERROR_STREAM)
        except OSError:  # standard error is closed
            yield messages
            return
        try:
            os.dup2(aside.fileno(), _ERROR_STREAM)
            yield messages
        finally:
            os.dup2(kept, _ERROR_STREAM)
            os.close(kept)
        aside.seek(0)
        lines = aside.read().decode(errors="replace").splitlines(keepends=True)
        messages += [line for line in lines if _FROM_CODECS.search(line)]
        others = [line for line in lines if line.strip() and not _FROM_CODECS.search(line)]
        with suppress(OSError):
            os.write(_ERROR_STREAM, "".join(others).encode())


def _jpeg_size(content: bytes) -> tuple[int, int] | None:
    """Columns and rows from the first frame header, searched segment by segment."""
    place = 2
    while True:
        mark, kind, length = struct.unpack_from(">BBH", content, place)
        if mark != 0xFF:
            return None
        if kind in _FRAMES:
            rows, columns = struct.unpack_from(">HH", content, place + 5)
            return columns, rows
        # A marker may be preceded by any number of 0xFF.
        place += 1 if kind == 0xFF else 2 + length


def _tiff_directories(content: bytes) -> Iterator[dict[int, int]]:
    """Yield the values of `_TAGS` in each image file directory of a TIFF."""
    order = "<" if content.startswith(b"II") else ">"
    large = content[2:4] in (b"+\0", b"\0+")
    head, count, entry, value = ("Q", "Q", 20, 12) if large else ("I", "H", 12, 8)
    (place,) = struct.unpack_from(order + head, content, 8 if large else 4)
    seen = set()
    while place and place not in seen:
        seen.add(place)
        (entries,) = struct.unpack_from(order + count, content, place)
        start = place + struct.calcsize(order + count)
        found = {}
        for k in range(min(entries, 4096)):
            tag, kind = struct.unpack_from(order + "HH", content, start + k * entry)
            if tag in _TAGS and kind in _FORMATS:
                number = order + _FORMATS[kind]
                (found[tag],) = struct.unpack_from(number, content, start + k * entry + value)
        yield found
        (place,) = struct.unpack_from(order + head, content, start + entries * entry)
