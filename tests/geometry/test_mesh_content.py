"""Vertex indices and node numbers that mesh files may not hold."""

import base64
import lzma
import re
import resource
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import meshio
import pytest
from surfaces import box

from palpate import files
from palpate.errors import MeshError
from palpate.geometry import read_mesh

_PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property {flag}list uchar int vertex_indices
end_header
0 0 0
1 0 0
0 1 0
0 0 1
3 0 2 1
3 0 1 3
3 0 3 2
3 1 2 3
"""
_FORMATS = [("2.2", False), ("2.2", True), ("4.0", False), ("4.0", True),
            ("4.1", False), ("4.1", True)]  # fmt: skip


def _ply(old: str = "3 1 2 3", new: str = "3 1 2 3") -> str:
    text = _PLY.replace("{flag}", "")
    assert old in text
    return text.replace(old, new)


def test_a_good_text_ply_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(_ply())
    assert read_mesh(tmp_path / "a.ply").triangles.tolist()[3] == [1, 2, 3]
    # Other values of a face may stand before and behind its corners.
    text = _ply("property list", "property uchar flag\nproperty list")
    for row in ("3 0 2 1", "3 0 1 3", "3 0 3 2", "3 1 2 3"):
        text = text.replace(f"\n{row}", f"\n7 {row}")
    (tmp_path / "b.ply").write_text(text)
    assert len(read_mesh(tmp_path / "b.ply").triangles) == 4


@pytest.mark.parametrize(
    ("row", "says"),
    [
        ("3 1.5 2 3", "line 17: '1.5' is no whole number"),
        ("3.7 1 2 3", "line 17: '3.7' is no whole number"),
        ("3 1 2 nan", "line 17: 'nan' is no whole number"),
        ("3 1 2", "line 17: the face says 3 corners, and has 2"),
        ("2 1 2", "line 17: the face says 2 corners"),
        ("4 1 2 3", "line 17: the face says 4 corners, and has 3"),
        ("3 1 2 3 9", "line 17: '3 1 2 3 9' is no row of face"),
        ("3 1 2 -1", "-1 to 3"),
    ],
)
def test_rows_of_a_text_ply(tmp_path: Path, row: str, says: str) -> None:
    (tmp_path / "a.ply").write_text(_ply(new=row))
    with pytest.raises(MeshError, match=re.escape(says)):
        read_mesh(tmp_path / "a.ply")


def _vtp(corners: str, offsets: str = "3 6 9 12", kind: str = "Float64") -> str:
    def array(name: str, kind: str, values: str) -> str:
        return f'<DataArray Name="{name}" type="{kind}" format="ascii">{values}</DataArray>'

    points = array("points", "Float64", "0 0 0 1 0 0 0 1 0 0 0 1")
    polys = array("connectivity", kind, corners) + array("offsets", kind, offsets)
    piece = f"<Piece><Points>{points}</Points><Polys>{polys}</Polys></Piece>"
    return f'<VTKFile type="PolyData"><PolyData>{piece}</PolyData></VTKFile>'


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (_vtp("0 2 1 0 1 3 0 3 2 1 2.5 3"), "vertex 2.5; must be a whole number"),
        (_vtp("0 2 1 0 1 3 0 3 2 1 2 nan"), "vertex nan; must be a whole number"),
        (_vtp("0 2 1 0 1 3 0 3 2 1 2 3", "3 6 9 11.5"), "11.5; must be a whole number"),
        (_vtp("0 2 1 0 1 3 0 3 2 1 2 -1", kind="Int64"), "none of 4 in its piece"),
        (_vtp("0 2 1 0 1 3 0 3 2 1 2 4", kind="Int64"), "none of 4 in its piece"),
    ],
)
def test_corners_of_a_vtp(tmp_path: Path, content: str, says: str) -> None:
    (tmp_path / "a.vtp").write_text(_vtp("0 2 1 0 1 3 0 3 2 1 2 3"))
    assert len(read_mesh(tmp_path / "a.vtp").triangles) == 4
    (tmp_path / "a.vtp").write_text(content)
    with pytest.raises(MeshError, match=re.escape(says)):
        read_mesh(tmp_path / "a.vtp")


def test_corners_of_a_vtu(tmp_path: Path) -> None:
    mesh, path = box(), tmp_path / "a.vtu"
    grid = meshio.Mesh(mesh.vertices, [("triangle", mesh.triangles)])
    meshio.vtu.write(path, grid, binary=True, compression=None)
    text = path.read_text()
    match = re.search(r'type="Int64" (Name="connectivity"[^>]*>)\s*(\S+)', text)
    assert match is not None
    corners = mesh.triangles.astype(float).ravel()
    corners[0] += 0.5
    size = struct.pack("<I", corners.nbytes)
    packed = base64.b64encode(size + corners.tobytes()).decode()
    text = text.replace(match[0], f'type="Float64" {match[1]}{packed}')
    path.write_text(text)
    with pytest.raises(MeshError, match="must be a whole number"):
        read_mesh(path)


@pytest.mark.parametrize(
    ("compressor", "pack"),
    [("vtkZLibDataCompressor", zlib.compress), ("vtkLZMADataCompressor", lzma.compress)],
)
def test_a_few_bytes_that_unpack_to_many(
    compressor: str, pack: Callable[[bytes], bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "_ANY_RATIO_BYTES", 2**16)
    block = pack(bytes(2**22))
    head = struct.pack("<4I", 1, 2**22, 0, len(block))
    data = base64.b64encode(head).decode() + base64.b64encode(block).decode()
    points = f'<DataArray Name="Points" type="Float64" format="binary">{data}</DataArray>'
    (tmp_path / "a.vtp").write_text(
        f'<VTKFile type="PolyData" byte_order="LittleEndian" compressor="{compressor}"><PolyData>'
        f"<Piece><Points>{points}</Points></Piece></PolyData></VTKFile>"
    )
    with pytest.raises(MeshError, match="cut off, or too large"):
        read_mesh(tmp_path / "a.vtp")


def _written(path: Path, version: str, *, binary: bool) -> bytes:
    mesh = box(size=(0.02, 0.03, 0.04), cells=2)
    stored = meshio.Mesh(mesh.vertices, [("triangle", mesh.triangles)])
    meshio.gmsh.write(path, stored, fmt_version=version, binary=binary)
    return path.read_bytes()


@pytest.mark.parametrize(("version", "binary"), _FORMATS)
def test_every_version_is_read(tmp_path: Path, version: str, binary: bool) -> None:
    _written(tmp_path / "a.msh", version, binary=binary)
    mesh = box(size=(0.02, 0.03, 0.04), cells=2)
    assert read_mesh(tmp_path / "a.msh").triangles.tolist() == mesh.triangles.tolist()


@pytest.mark.parametrize(("version", "binary"), [pair for pair in _FORMATS if pair != _FORMATS[1]])
def test_a_number_that_would_fill_the_memory(tmp_path: Path, version: str, binary: bool) -> None:
    content = _written(tmp_path / "a.msh", version, binary=binary)
    nodes = content.index(b"$Nodes")
    count = len(box(size=(0.02, 0.03, 0.04), cells=2).vertices)
    if binary:
        size = 4 if version == "4.0" else 8
        last, high = (number.to_bytes(size, "little") for number in (count, 2_000_000_000))
        # The header counts the nodes, too; the last of these bytes is the number of the last node.
        start = content.rindex(last, nodes, content.index(b"$EndNodes"))
    else:
        last, high = f"\n{count}".encode(), b"\n2000000000"
        start = content.rindex(last, nodes, content.index(b"$EndNodes"))
    (tmp_path / "a.msh").write_bytes(content[:start] + high + content[start + len(last) :])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(MeshError, match=r"a\.msh: .*more than 4 GB of memory"):
        read_mesh(tmp_path / "a.msh")
    # Kilobytes: the table would have taken sixteen gigabytes.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000
