"""Size and number of pictures as stated in a file's headers, read before decoding any pixel."""

import struct
from collections.abc import Iterator
from contextlib import suppress

PNG, JPEG, BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
# Classic TIFF and BigTIFF, in both byte orders.
TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# JPEG markers that begin a frame: 0xC0 to 0xCF except DHT, JPG and DAC.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# TIFF tags: ImageWidth, ImageLength, NewSubfileType.
_WIDTH, _HEIGHT, _PURPOSE = 256, 257, 254
# Bits of NewSubfileType for pictures that accompany another: reduced resolution, mask.
_COMPANION = 1 | 4
# `struct` formats of the TIFF types that a size may have: SHORT, LONG, LONG8.
_FORMATS = {3: "H", 4: "I", 16: "Q"}


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
        if content.startswith(PNG):
            return struct.unpack_from(">II", content, 16)
        if content.startswith(BMP):
            # The old 12-byte header has 16-bit sizes; a negative height means top-down rows.
            old = struct.unpack_from("<I", content, 14) == (12,)
            columns, rows = struct.unpack_from("<HH" if old else "<ii", content, 18)
            return abs(columns), abs(rows)
        if content.startswith(TIFF):
            first = next(_tiff_directories(content), {})
            return (first[_WIDTH], first[_HEIGHT]) if {_WIDTH, _HEIGHT} <= set(first) else None
        return _jpeg_size(content) if content.startswith(JPEG) else None
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
    if not content.startswith(TIFF):
        return 1
    count = 0
    with suppress(struct.error):
        for found in _tiff_directories(content):
            count += not found.get(_PURPOSE, 0) & _COMPANION
    return count


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
    """Yield size and purpose tags of each image file directory of a TIFF."""
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
            if tag in (_WIDTH, _HEIGHT, _PURPOSE) and kind in _FORMATS:
                number = order + _FORMATS[kind]
                (found[tag],) = struct.unpack_from(number, content, start + k * entry + value)
        yield found
        (place,) = struct.unpack_from(order + head, content, start + entries * entry)
