"""Mesh files: each format gives the same welded surface in metres."""

import base64
import struct
import sys
import zlib
from pathlib import Path

import meshio
import numpy as np
import pytest
from drawn_ball import INCH, MILLIMETRE, written_ball
from fault_injection import largest_file
from surfaces import box, sphere

from palpate.errors import InputError, MeshError, RecordError
from palpate.geometry import (
    TriangleMesh,
    checked_mesh,
    enclosed_volume,
    read_mesh,
    triangle_areas,
    welded,
    write_mesh,
)
from palpate.optional_imports import late_import


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".msh", ".vtu"])
def test_every_format_gives_the_surface_back(tmp_path, suffix):
    mesh = sphere(2, radius=40.0)
    path = tmp_path / f"ball{suffix}"
    write_mesh(path, mesh)
    checked, notes = checked_mesh(read_mesh(path, metres_per_unit=0.001))
    assert notes == ()
    assert len(checked.vertices) == len(mesh.vertices)
    # STL holds single precision: 6e-8 of 40 mm in a coordinate, a few times that in the volume.
    assert enclosed_volume(checked) == pytest.approx(1e-9 * enclosed_volume(mesh), rel=5e-7)
    if suffix != ".stl":
        np.testing.assert_allclose(checked.vertices, 0.001 * mesh.vertices, atol=1e-9)
        assert np.array_equal(checked.triangles, mesh.triangles)


def test_ply_keeps_every_digit(tmp_path):
    mesh = sphere(1, radius=np.pi)
    write_mesh(tmp_path / "ball.ply", mesh)
    reread = read_mesh(tmp_path / "ball.ply")
    assert np.array_equal(reread.vertices, mesh.vertices)
    assert np.array_equal(reread.triangles, mesh.triangles)


def test_separate_triangles_are_welded():
    mesh = sphere(2)
    soup = TriangleMesh(
        mesh.vertices[mesh.triangles].reshape(-1, 3),
        np.arange(3 * len(mesh.triangles)).reshape(-1, 3),
    )
    joined = welded(soup)
    assert len(joined.vertices) == len(mesh.vertices)
    checked_mesh(joined)


def test_welding_keeps_a_mesh_that_needs_none():
    mesh = sphere(2)
    assert np.array_equal(welded(mesh).vertices, mesh.vertices)
    assert np.array_equal(welded(mesh).triangles, mesh.triangles)


def test_unused_vertices_are_left_out_and_the_order_kept():
    mesh = box()
    stray = np.concatenate([[[9.0, 9.0, 9.0]], mesh.vertices])
    assert np.array_equal(welded(TriangleMesh(stray, mesh.triangles + 1)).vertices, mesh.vertices)


def test_tetrahedra_give_their_boundary(tmp_path):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]]
    meshio.Mesh(corners, [("tetra", np.array(six))]).write(tmp_path / "cube.vtu")
    cube, _ = checked_mesh(read_mesh(tmp_path / "cube.vtu"))
    assert len(cube.triangles) == 12
    assert enclosed_volume(cube) == pytest.approx(1.0, rel=1e-14)


def test_quadratic_and_quadrangular_cells_are_cut(tmp_path):
    points = np.array([[0, 0, 0], [2, 0, 0], [0, 2, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    meshio.Mesh(points, [("triangle6", np.arange(6)[None])]).write(tmp_path / "a.vtu")
    assert len(read_mesh(tmp_path / "a.vtu").triangles) == 4
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    meshio.Mesh(square, [("quad", np.arange(4)[None])]).write(tmp_path / "b.vtu")
    assert triangle_areas(read_mesh(tmp_path / "b.vtu")).sum() == pytest.approx(1.0)


def _vtp(points, connectivity, offsets, *, kind, compressed=False):
    """A .vtp file as VTK writes it, the arrays stored in one of four ways."""
    arrays = [
        ("points", "Float64", np.asarray(points, "<f8").tobytes(), 'NumberOfComponents="3"'),
        ("connectivity", "Int64", np.asarray(connectivity, "<i8").tobytes(), ""),
        ("offsets", "Int64", np.asarray(offsets, "<i8").tobytes(), ""),
    ]

    def packed(data):
        if not compressed:
            return struct.pack("<I", len(data)), data
        half = len(data) // 2
        blocks = [zlib.compress(data[:half]), zlib.compress(data[half:])]
        head = struct.pack("<5I", 2, half, len(data) - half, len(blocks[0]), len(blocks[1]))
        return head, b"".join(blocks)

    def base64_of(data):
        head, body = packed(data)
        if compressed:
            return base64.b64encode(head) + base64.b64encode(body)
        return base64.b64encode(head + body)

    nodes, block = [], b""
    for name, type_, data, extra in arrays:
        tag = f'<DataArray Name="{name}" type="{type_}" {extra} format="{kind}"'
        if kind == "ascii":
            flat = np.frombuffer(data, "<f8" if type_ == "Float64" else "<i8")
            nodes.append(f"{tag}>{' '.join(map(repr, flat.tolist()))}</DataArray>")
        elif kind == "binary":
            nodes.append(f"{tag}>\n  {base64_of(data).decode()}\n</DataArray>")
        else:
            nodes.append(f'{tag} offset="{len(block)}"/>')
            block += b"".join(packed(data))
    header = 'compressor="vtkZLibDataCompressor"' if compressed else ""
    text = (
        f'<?xml version="1.0"?>\n<VTKFile type="PolyData" byte_order="LittleEndian" {header}>'
        f"<PolyData><Piece><Points>{nodes[0]}</Points><Polys>{nodes[1]}{nodes[2]}</Polys></Piece>"
        "</PolyData>"
    ).encode()
    if kind == "appended":
        text += b'<AppendedData encoding="raw">\n_' + block + b"</AppendedData>"
    return text + b"</VTKFile>\n"


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["ascii", "binary", "appended"])
def test_vtp_is_read_however_it_is_stored(tmp_path, kind, compressed):
    mesh = sphere(1)
    offsets = 3 * np.arange(1, len(mesh.triangles) + 1)
    path = tmp_path / "ball.vtp"
    path.write_bytes(
        _vtp(mesh.vertices, mesh.triangles.ravel(), offsets, kind=kind, compressed=compressed)
    )
    reread = read_mesh(path)
    assert np.array_equal(reread.vertices, mesh.vertices)
    assert np.array_equal(reread.triangles, mesh.triangles)


def test_obj_with_quadrangles_normals_and_relative_indices_is_read(tmp_path):
    path = tmp_path / "house.obj"
    path.write_text(
        "o house\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 0.5 0\nvn 0 0 1\nvt 0 0\n"
        "g wall\nusemtl brick\nf 1/1/1 2/1/1 3/1/1 4/1/1\ng roof\nusemtl tile\nf -5 -2 -1\n"
    )
    mesh = read_mesh(path)
    assert triangle_areas(mesh).sum() == pytest.approx(1.5)
    assert len(mesh.vertices) == 5


def test_text_ply_with_colours_and_quadrangles_is_read(tmp_path):
    path = tmp_path / "square.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 1\nproperty list uchar int vertex_index\nend_header\n"
        "0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0 1 2 3\n4 0 1 2 3\n"
    )
    assert triangle_areas(read_mesh(path)).sum() == pytest.approx(1.0)


def test_text_stl_is_read(tmp_path):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in corner.tolist())
        + "endloop\nendfacet\n"
        for corner in box(cells=2).vertices[box(cells=2).triangles]
    )
    (tmp_path / "box.stl").write_text(f"solid box\n{facets}endsolid box\n")
    cube, _ = checked_mesh(read_mesh(tmp_path / "box.stl"))
    assert (len(cube.vertices), enclosed_volume(cube)) == (26, pytest.approx(1.0))


def test_vtp_polygons_are_cut_into_fans(tmp_path):
    points = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [-1, 0.5, 0]]
    path = tmp_path / "house.vtp"
    path.write_bytes(_vtp(points, [0, 1, 2, 3, 0, 3, 4], [4, 7], kind="ascii"))
    assert triangle_areas(read_mesh(path)).sum() == pytest.approx(1.5)


def test_missing_file_and_unknown_suffix_are_refused(tmp_path):
    with pytest.raises(MeshError, match="No such file"):
        read_mesh(tmp_path / "none.ply")
    with pytest.raises(MeshError, match=r"'\.iges' are not read; convert it to one of \.ply"):
        read_mesh(tmp_path / "part.iges")
    with pytest.raises(MeshError, match="cannot write"):
        write_mesh(tmp_path / "part.iges", box())


def test_file_without_triangles_is_refused(tmp_path):
    path = tmp_path / "cloud.obj"
    path.write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")
    with pytest.raises(MeshError, match=r"cloud\.obj"):
        read_mesh(path)


def test_unit_must_be_positive(tmp_path):
    write_mesh(tmp_path / "box.ply", box())
    with pytest.raises(InputError, match="metres_per_unit is 0"):
        read_mesh(tmp_path / "box.ply", metres_per_unit=0.0)


def test_missing_package_says_what_to_install():
    with pytest.raises(InputError, match=r"pip install 'palpate\[cad\]'") as raised:
        late_import("no_such_package", extra="cad", purpose="reading part.step")
    # With the Python that runs it: another's pip would install it elsewhere.
    assert f"run: {sys.executable} -m pip" in str(raised.value)


def test_shared_meshes_are_closed(shared_data):
    """Needs ../shared."""
    for path in sorted(shared_data.glob("*/mesh*.ply")):
        _, notes = checked_mesh(read_mesh(path))
        assert notes == ()


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off", ".msh", ".vtu"])
def test_a_write_that_fails_halfway_leaves_the_old_file(tmp_path, suffix):
    path = tmp_path / f"ball{suffix}"
    write_mesh(path, box())
    before = path.read_bytes()
    with (
        largest_file(2000),
        pytest.raises(RecordError, match=rf"ball\{suffix}: cannot be written \("),
    ):
        write_mesh(path, sphere(3))
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == [path.name]


pytest.importorskip("cascadio", reason="needs cascadio, the extra `cad`, which is not installed")


@pytest.mark.parametrize(("unit", "metres"), [(MILLIMETRE, 1e-3), (INCH, 25.4e-3)])
def test_a_drawing_has_its_own_unit(tmp_path: Path, unit: str, metres: float) -> None:
    """Whatever unit is said for files that have none."""
    mesh = read_mesh(written_ball(tmp_path, unit), metres_per_unit=0.01)
    away = np.linalg.norm(mesh.vertices - [10.0 * metres, 0.0, 0.0], axis=1)
    # Vertices lie on the ball, in single precision; chords cut 0.05 % of the edges' length off.
    np.testing.assert_allclose(away, 30.0 * metres, rtol=1e-6)
    volume = 4.0 / 3.0 * np.pi * (30.0 * metres) ** 3
    assert enclosed_volume(mesh) == pytest.approx(volume, rel=2e-3)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("#16=CLOSED_SHELL", "#96=CLOSED_SHELL"), ("ENDSEC;\nEND-ISO-10303-21;\n", "")],
    ids=["a reference to what is not there", "cut off"],
)
def test_a_damaged_drawing_is_refused(tmp_path: Path, right: str, wrong: str) -> None:
    file = written_ball(tmp_path, MILLIMETRE)
    file.write_text(file.read_text().replace(right, wrong))
    with pytest.raises(MeshError, match="no solid can be read of this STEP file") as caught:
        read_mesh(file)
    assert "export it again" in str(caught.value)
