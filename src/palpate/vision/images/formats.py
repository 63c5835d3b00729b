"""Whether the file of a picture is whole, told from its own structure before anything is decoded.

Decoders are lenient: of a file that was cut off they may return a picture whose lower part is black
or grey, which would be taken for the object. So the structure is walked to its end here.
"""

import struct
import zlib

PICTURE_KINDS = "PNG, JPEG, TIFF or BMP"
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# JPEG markers that stand alone: TEM and the restart markers.
_ALONE = (0x01, *range(0xD0, 0xD8))
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
# TIFF types that offsets and counts come in: code to struct letter.
_WHOLE_NUMBERS = {3: "H", 4: "I", 16: "Q"}
# TIFF tags of where the pixels are and how many bytes of them: strips, tiles.
_PIXELS = ((273, 279), (324, 325))


def picture_fault(content: bytes) -> str | None:
    """What is wrong with the file of a picture, or None where it is whole.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    str or None                     end of a sentence that starts with the file's name
    """
    if not content:
        return "is empty"
    try:
        if content.startswith(_PNG):
            return _png_fault(content)
        if content.startswith(b"\xff\xd8"):
            return _jpeg_fault(content)
        if content.startswith(_TIFF):
            return _tiff_fault(content)
        if content.startswith(b"BM"):
            return _bmp_fault(content)
    except struct.error:
        return f"is cut off: it ends after {len(content)} bytes, within its header"
    return f"is none of {PICTURE_KINDS} (it starts with {content[:8]!r})"


def page_count(content: bytes) -> int:
    """Number of pictures in a file: more than one only in a TIFF file.

    Parameters
    ----------
    content : bytes                 the whole file, without fault

    Returns
    -------
    int
    """
    return len(_tiff_directories(content)) if content.startswith(_TIFF) else 1


def _cut_off(content: bytes, needed: int, within: str) -> str:
    return f"is cut off: it has {len(content)} bytes, {within} ends at byte {needed}"


def _png_fault(content: bytes) -> str | None:
    """Walk the chunks to IEND; each has a length and a checksum."""
    start = len(_PNG)
    while start < len(content):
        (length,) = struct.unpack_from(">I", content, start)
        kind = content[start + 4 : start + 8]
        end = start + 12 + length
        if end > len(content):
            return _cut_off(content, end, f"its chunk {kind.decode('latin-1')}")
        (checksum,) = struct.unpack_from(">I", content, end - 4)
        if zlib.crc32(content[start + 4 : end - 4]) != checksum:
            return f"is damaged: the checksum of its chunk {kind.decode('latin-1')} is wrong"
        if kind == b"IEND":
            return None
        start = end
    return f"is cut off: it ends after {len(content)} bytes without the closing chunk IEND"


def _jpeg_fault(content: bytes) -> str | None:
    """Walk the segments to the end-of-image marker, over the coded data of each scan."""
    missing = f"is cut off: it ends after {len(content)} bytes without an end-of-image marker"
    start = 2
    while start + 1 < len(content):
        if content[start] != 0xFF:
            return f"is damaged: no marker at byte {start}"
        marker = content[start + 1]
        if marker == 0xFF:  # fill byte
            start += 1
        elif marker in _ALONE:
            start += 2
        elif marker == _END_OF_IMAGE:
            return None
        else:
            start += 2 + struct.unpack_from(">H", content, start + 2)[0]
            if marker == _START_OF_SCAN:
                start = _after_scan(content, start)
    return missing


def _after_scan(content: bytes, start: int) -> int:
    """Place of the first marker after the coded data of a scan."""
    while True:
        start = content.find(b"\xff", start)
        if start < 0 or start + 1 >= len(content):
            return len(content)
        # Within the data 0xFF is followed by 0, or it is a restart marker.
        if content[start + 1] != 0 and content[start + 1] not in _ALONE:
            return start
        start += 2


def _tiff_fault(content: bytes) -> str | None:
    """Look whether the strips or tiles of the first picture lie within the file."""
    directories = _tiff_directories(content)
    if not directories:
        return "is damaged or cut off: it holds no picture"
    tags = directories[0]
    for offsets, counts in _PIXELS:
        if offsets in tags:
            places, sizes = tags[offsets], tags.get(counts, [])
            sizes = [*sizes, *([1] * (len(places) - len(sizes)))]
            end = max((p + s for p, s in zip(places, sizes, strict=False)), default=0)
            if end > len(content):
                return _cut_off(content, end, "its pixel data")
            return None
    return "is damaged: it does not say where its pixels are"


def _tiff_directories(content: bytes) -> list[dict[int, list[int]]]:
    """Tags that hold whole numbers, of each picture in the file."""
    order = "<" if content.startswith(b"I") else ">"
    big = content[2:4] in (b"+\0", b"\0+")
    word, count, size = ("Q", "Q", 20) if big else ("I", "H", 12)
    (start,) = struct.unpack_from(order + word, content, 8 if big else 4)
    found: list[dict[int, list[int]]] = []
    seen = set()
    while start and start not in seen:
        seen.add(start)
        (entries,) = struct.unpack_from(order + count, content, start)
        first = start + struct.calcsize(count)
        tags = {}
        for entry in range(first, first + size * entries, size):
            tag, kind, number = struct.unpack_from(order + "HH" + word, content, entry)
            if kind in _WHOLE_NUMBERS and tag in {key for pair in _PIXELS for key in pair}:
                letters = f"{order}{number}{_WHOLE_NUMBERS[kind]}"
                place = entry + size - struct.calcsize(word)
                if struct.calcsize(letters) > struct.calcsize(word):
                    (place,) = struct.unpack_from(order + word, content, place)
                tags[tag] = list(struct.unpack_from(letters, content, place))
        found.append(tags)
        (start,) = struct.unpack_from(order + word, content, first + size * entries)
    return found


def _bmp_fault(content: bytes) -> str | None:
    """Compare the file with the size that its header gives the pixels."""
    start, header = struct.unpack_from("<II", content, 10)
    if header == 12:
        columns, rows, _planes, bits = struct.unpack_from("<HHHH", content, 18)
        compression, stored = 0, 0
    else:
        columns, rows, _planes, bits, compression, stored = struct.unpack_from(
            "<iiHHII", content, 18
        )
    # Rows are filled up to four bytes; run-length coded pixels say their own size.
    plain = (columns * bits + 31) // 32 * 4 * abs(rows)
    end = start + (stored if compression in (1, 2) else plain)
    return _cut_off(content, end, "its pixel data") if end > len(content) else None
