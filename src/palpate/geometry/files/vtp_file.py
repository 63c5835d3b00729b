"""Polygon surfaces in VTK's XML format (.vtp)."""

import base64
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path
from typing import Literal

import numpy as np

from palpate.errors import MeshError
from palpate.shapes import Triangles, Vertices

_MARKER = b"<AppendedData"


def read_vtp(path: Path) -> tuple[Vertices, Triangles]:
    """Vertices and triangles of a .vtp file, in its own unit; polygons are cut into fans.

    Text, base64 and raw appended arrays are read, with or without zlib compression.

    Parameters
    ----------
    path : Path

    Raises
    ------
    MeshError                       not a PolyData file, an array is missing or malformed

    Source
    ------
    VTK file formats, "XML File Formats", https://docs.vtk.org
    """
    try:
        root, appended = _parsed(path.read_bytes())
        data = root.find("PolyData")
        if data is None:
            raise ValueError("it holds no PolyData")
        points, connectivity, offsets = [], [], []
        first_point = 0
        for piece in data.iter("Piece"):
            xyz = _array(piece.find("Points/DataArray"), root, appended).reshape(-1, 3)
            ring = _array(piece.find("Polys/DataArray[@Name='connectivity']"), root, appended)
            ends = _array(piece.find("Polys/DataArray[@Name='offsets']"), root, appended)
            points.append(xyz.astype(np.float64))
            offsets.append(np.diff(ends.astype(np.int64), prepend=0))
            connectivity.append(ring.astype(np.int64) + first_point)
            first_point += len(xyz)
        sizes = np.concatenate(offsets)
        return np.concatenate(points), _fans(np.concatenate(connectivity), sizes)
    except (ValueError, TypeError, KeyError, IndexError, zlib.error) as error:
        raise MeshError(
            f"{path}: cannot be read as a VTP surface ({error});"
            " open it in a mesh program and save it again, e.g. as PLY"
        ) from error
    except ElementTree.ParseError as error:
        raise MeshError(f"{path}: is not well-formed XML ({error}); save it again") from error


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
    """Numbers of one DataArray, in whichever of the four ways they are stored."""
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
    if compressor not in (None, "vtkZLibDataCompressor"):
        raise ValueError(f"compressor {compressor} is not read")
    block = root.find("AppendedData")
    inline = node.get("format") == "binary"
    stored = (node.text or "").strip().encode()
    if not inline:
        stored = appended[int(node.attrib["offset"]) :]
    if inline or (block is not None and block.get("encoding") == "base64"):
        stored = _from_base64(stored, header, zipped=compressor is not None)
    return np.frombuffer(_payload(stored, header, zipped=compressor is not None), dtype=kind)


def _payload(block: bytes, header: np.dtype, *, zipped: bool) -> bytes:
    """Bytes of an array behind its header: the size, or the table of compressed blocks."""
    first = int(np.frombuffer(block, header, 1)[0])
    if not zipped:
        return block[header.itemsize : header.itemsize + first]
    sizes = np.frombuffer(block, header, first, offset=3 * header.itemsize).astype(np.int64)
    ends = (3 + first) * header.itemsize + np.cumsum(sizes)
    return b"".join(
        zlib.decompress(block[end - size : end]) for end, size in zip(ends, sizes, strict=True)
    )


def _from_base64(text: bytes, header: np.dtype, *, zipped: bool) -> bytes:
    """Header and data as `_payload` takes them; a compressed array encodes them separately."""

    def decoded(begin: int, size: int) -> bytes:
        return base64.b64decode(text[begin : begin + 4 * -(-size // 3)])[:size]

    count = int(np.frombuffer(decoded(0, header.itemsize), header, 1)[0])
    if not zipped:
        return decoded(0, header.itemsize + count)
    size = (3 + count) * header.itemsize
    head = decoded(0, size)
    sizes = np.frombuffer(head, header, count, offset=3 * header.itemsize)
    return head + decoded(4 * -(-size // 3), int(sizes.sum()))
