"""VTK's polygon files, and rows of text PLY files, of which trimesh ignores missing entries."""

import base64
import lzma
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable, Iterator
from itertools import islice
from typing import Any, Literal

import numpy as np
from jaxtyping import Int

from palpate.files import max_unpacked_size
from palpate.shapes import Triangles, Vertices

_MARKER = b"<AppendedData"
_UNPACKERS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}
_CORNERS = (b"vertex_indices", b"vertex_index")


def parse_vtp(content: bytes) -> tuple[Vertices, Triangles]:
    """Vertices and triangles of a .vtp file, in its own unit; polygons are cut into fans.

    Text, base64 and raw appended arrays are read, compressed (zlib, LZMA) or not.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    vertices : (v, 3) float         in the unit of the file
    triangles : (m, 3) int          indices from 0

    Raises
    ------
    ValueError, TypeError, LookupError, SyntaxError, zlib.error, lzma.LZMAError     not a PolyData
                                    file, an array is missing or malformed

    Source
    ------
    VTK file formats, "XML File Formats", https://docs.vtk.org
    """
    root, appended = _parsed_vtp(content)
    data = root.find("PolyData")
    if data is None:
        raise ValueError("it holds no PolyData")
    points, connectivity, offsets = [], [], []
    first_point = 0
    for piece in data.iter("Piece"):
        xyz = _vtp_array(piece.find("Points/DataArray"), root, appended).reshape(-1, 3)
        ring = _vtp_array(piece.find("Polys/DataArray[@Name='connectivity']"), root, appended)
        ends = _vtp_array(piece.find("Polys/DataArray[@Name='offsets']"), root, appended)
        sizes = np.diff(whole_numbers(ends), prepend=0)
        if (sizes < 0).any() or sizes.sum() > len(ring):
            raise ValueError("its offsets do not fit its polygons")
        corners = whole_numbers(ring)
        # An index outside this piece would be taken for a vertex of another one.
        if len(corners) and not 0 <= corners.min() <= corners.max() < len(xyz):
            raise ValueError(f"a polygon names a vertex that is none of {len(xyz)} in its piece")
        points.append(xyz.astype(np.float64))
        offsets.append(sizes)
        connectivity.append(corners + first_point)
        first_point += len(xyz)
    return np.concatenate(points), _fans(np.concatenate(connectivity), np.concatenate(offsets))


def _fans(ring: np.ndarray, sizes: np.ndarray) -> Triangles:
    """Triangles (first, i, i + 1) of every polygon."""
    start = np.cumsum(sizes) - sizes
    triangles = []
    for size in np.unique(sizes[sizes >= 3]):
        polygon = ring[start[sizes == size][:, None] + np.arange(size)]
        triangles += [polygon[:, [0, i, i + 1]] for i in range(1, size - 1)]
    return np.concatenate(triangles) if triangles else np.zeros((0, 3), dtype=np.int64)


def _parsed_vtp(content: bytes) -> tuple[ElementTree.Element, bytes]:
    """XML tree and the appended block, which need not be XML when it is raw."""
    begin = content.find(_MARKER)
    if begin < 0:
        return ElementTree.fromstring(content), b""
    opening = content.index(b">", begin) + 1
    closing = content.rindex(b"</AppendedData>")
    root = ElementTree.fromstring(content[:opening] + content[closing:])
    block = content[opening:closing]
    return root, block[block.index(b"_") + 1 :]


def _vtp_array(
    node: ElementTree.Element | None, root: ElementTree.Element, appended: bytes
) -> np.ndarray:
    """Numbers of one DataArray, in any of the four ways of storing them."""
    if node is None:
        raise ValueError("an array of points or polygons is missing")
    order: Literal["<", ">"] = "<"
    if root.get("byte_order", "LittleEndian") != "LittleEndian":
        order = ">"
    kind = np.dtype(node.attrib["type"].lower()).newbyteorder(order)
    if node.get("format", "ascii") == "ascii":
        return np.array((node.text or "").split(), dtype=kind)
    header = np.dtype(root.get("header_type", "UInt32").lower()).newbyteorder(order)
    compressor = root.get("compressor")
    if compressor not in (None, *_UNPACKERS):
        raise ValueError(f"compressor {compressor} is not read")
    block = root.find("AppendedData")
    inline = node.get("format") == "binary"
    stored = (node.text or "").strip().encode()
    if not inline:
        stored = appended[int(node.attrib["offset"]) :]
    if inline or (block is not None and block.get("encoding") == "base64"):
        stored = _from_base64(stored, header, zipped=compressor is not None)
    return np.frombuffer(_payload(stored, header, compressor), dtype=kind)


def _payload(block: bytes, header: np.dtype, compressor: str | None) -> bytes:
    """Bytes of an array after its header: the size, or the table of compressed blocks."""
    first = int(np.frombuffer(block, header, 1)[0])
    if compressor is None:
        return block[header.itemsize : header.itemsize + first]
    sizes = np.frombuffer(block, header, first, offset=3 * header.itemsize).astype(np.int64)
    ends = (3 + first) * header.itemsize + np.cumsum(sizes)
    parts, room = [], max_unpacked_size(len(block))
    for end, size in zip(ends, sizes, strict=True):
        unpacker = _UNPACKERS[compressor]()
        parts.append(unpacker.decompress(block[end - size : end], room + 1))
        room -= len(parts[-1])
        if not unpacker.eof or room < 0:
            raise ValueError("a compressed block is cut off, or too large")
    return b"".join(parts)


def _from_base64(text: bytes, header: np.dtype, *, zipped: bool) -> bytes:
    """Header and data in the form of `_payload`; a compressed array encodes them separately."""

    def decoded(begin: int, size: int) -> bytes:
        return base64.b64decode(text[begin : begin + 4 * -(-size // 3)])[:size]

    count = int(np.frombuffer(decoded(0, header.itemsize), header, 1)[0])
    if not zipped:
        return decoded(0, header.itemsize + count)
    size = (3 + count) * header.itemsize
    head = decoded(0, size)
    sizes = np.frombuffer(head, header, count, offset=3 * header.itemsize)
    return head + decoded(4 * -(-size // 3), int(sizes.sum()))


def whole_numbers(values: np.ndarray) -> Int[np.ndarray, "..."]:
    """Indices as integers.

    Parameters
    ----------
    values : array of numbers

    Returns
    -------
    int array                       of the same shape

    Raises
    ------
    ValueError                      one is not an integer
    """
    if values.dtype.kind == "f":
        wrong = values[~np.isfinite(values) | (values % 1 != 0)]
        if wrong.size:
            raise ValueError(f"a face names vertex {wrong[0]:g}; must be a whole number")
    return values.astype(np.int64)


def check_text_ply(content: bytes) -> None:
    """Refuse a text PLY file with rows that do not match its header.

    Parameters
    ----------
    content : bytes                 the whole file

    Raises
    ------
    ValueError                      the message names the line

    Source
    ------
    Turk, "The PLY polygon file format" (1994).
    """
    head, _, rest = content.partition(b"end_header")
    elements: list[tuple[bytes, int, list[list[bytes]]]] = []
    for line in head.splitlines():
        word, *words = line.split() or [b""]
        if word == b"element":
            elements.append((words[0], int(words[1]), []))
        elif word == b"property" and elements:
            elements[-1][2].append(words)
    rows = _text_rows(rest, first=head.count(b"\n") + 1)
    for name, count, properties in elements:
        for number, words in islice(rows, count):
            index = 0
            for kind, *more in properties:
                index += 1
                if kind == b"list":
                    held = _whole(number, words[index - 1 : index])
                    if more[-1] in _CORNERS:
                        _check_face(number, words[index : index + held], held)
                    index += held
            if index != len(words) or any(b"_" in word for word in words):
                text = b" ".join(words).decode(errors="replace")[:40]
                raise ValueError(f"line {number}: '{text}' is no row of {name.decode()}")


def _text_rows(content: bytes, *, first: int) -> Iterator[tuple[int, list[bytes]]]:
    """Number and words of every line that is not blank; the number of the first one is given."""
    for number, line in enumerate(content.split(b"\n"), start=first):
        if words := line.split():
            yield number, words


def _check_face(number: int, corners: list[bytes], count: int) -> None:
    """Refuse a face with fewer than three corners, or fewer than it declares."""
    for corner in corners:
        _whole(number, [corner])
    if count < 3 or len(corners) < count:
        raise ValueError(f"line {number}: the face says {count} corners, and has {len(corners)}")


def _whole(number: int, words: list[bytes]) -> int:
    """The first of some words as an integer."""
    text = words[0].decode(errors="replace") if words else ""
    if not text.removeprefix("-").isdecimal():
        raise ValueError(f"line {number}: '{text[:40]}' is no whole number")
    return int(text)
