"""Polygon surfaces in VTK's XML format (.vtp), and a check of compressed arrays in such files."""

import base64
import lzma
import xml.etree.ElementTree as ElementTree
import zlib
from collections.abc import Callable
from typing import Any, Literal

import numpy as np

from palpate.files import max_unpacked_size
from palpate.geometry.files.corners import whole_numbers
from palpate.shapes import Triangles, Vertices

_MARKER = b"<AppendedData"
_UNPACKERS: dict[str, Callable[[], Any]] = {
    "vtkZLibDataCompressor": zlib.decompressobj,
    "vtkLZMADataCompressor": lzma.LZMADecompressor,
}


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
    root, appended = _parsed(content)
    data = root.find("PolyData")
    if data is None:
        raise ValueError("it holds no PolyData")
    points, connectivity, offsets = [], [], []
    first_point = 0
    for piece in data.iter("Piece"):
        xyz = _array(piece.find("Points/DataArray"), root, appended).reshape(-1, 3)
        ring = _array(piece.find("Polys/DataArray[@Name='connectivity']"), root, appended)
        ends = _array(piece.find("Polys/DataArray[@Name='offsets']"), root, appended)
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


def check_packed_arrays(content: bytes) -> None:
    """Refuse a VTK XML file whose compressed arrays are damaged or expand to more than is allowed.

    Parameters
    ----------
    content : bytes                 the whole file, of any kind of grid; an uncompressed one passes

    Raises
    ------
    ValueError, LookupError, SyntaxError, zlib.error, lzma.LZMAError    it is refused
    """
    root, appended = _parsed(content)
    if root.get("compressor") is None:
        return
    for node in root.iter("DataArray"):
        if node.get("format") in ("binary", "appended") and node.get("type") != "String":
            _array(node, root, appended)


def _fans(ring: np.ndarray, sizes: np.ndarray) -> Triangles:
    """Triangles (first, i, i + 1) of every polygon."""
    start = np.cumsum(sizes) - sizes
    found = []
    for size in np.unique(sizes[sizes >= 3]):
        polygon = ring[start[sizes == size][:, None] + np.arange(size)]
        found += [polygon[:, [0, i, i + 1]] for i in range(1, size - 1)]
    return np.concatenate(found) if found else np.zeros((0, 3), dtype=np.int64)


def _parsed(content: bytes) -> tuple[ElementTree.Element, bytes]:
    """XML tree and the appended block, which need not be XML when it is raw."""
    begin = content.find(_MARKER)
    if begin < 0:
        return ElementTree.fromstring(content), b""
    opening = content.index(b">", begin) + 1
    closing = content.rindex(b"</AppendedData>")
    root = ElementTree.fromstring(content[:opening] + content[closing:])
    block = content[opening:closing]
    return root, block[block.index(b"_") + 1 :]


def _array(
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
