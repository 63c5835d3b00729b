"""Reading and writing of triangle surfaces: PLY, OBJ, STL, OFF, MSH, VTU; reading of VTP, STEP."""

import re
from dataclasses import replace
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from palpate.disk import atomic_replacement, write_bytes, write_errors
from palpate.errors import InputError, MeshError
from palpate.files import read_bytes, read_errors
from palpate.foreign import read_by_meshio, result_in_child, triangles_of_step
from palpate.geometry.mesh_content import check_text_ply, parse_vtp, whole_numbers
from palpate.geometry.triangle_mesh import TriangleMesh, connected_components, is_outer
from palpate.optional_imports import late_import
from palpate.shapes import Triangles, Vertices

_TRIMESH_SUFFIXES = (".ply", ".obj", ".stl", ".off")
# With the format's name in meshio: by the suffix .msh alone it tries a reader that may never end.
_MESHIO_SUFFIXES = {".msh": "gmsh", ".vtu": "vtu"}
# Of files that `write_mesh` writes, and of those that `read_mesh` reads.
WRITTEN_SUFFIXES = (*_TRIMESH_SUFFIXES, *_MESHIO_SUFFIXES)
MESH_SUFFIXES = (*WRITTEN_SUFFIXES, ".vtp")
STEP_SUFFIXES = (".step", ".stp")
# CAD files hold no mesh, but are converted to triangles.
_READ = (*MESH_SUFFIXES, *STEP_SUFFIXES)
# Flat triangles of each cell of a surface, in the cell's own numbering (VTK and gmsh agree here).
_FACETS = {
    "triangle": [[0, 1, 2]],
    "triangle6": [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]],
    "quad": [[0, 1, 2], [0, 2, 3]],
}
_TETRAHEDRON_FACES = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]
# The checks of a surface take seconds at this many; the model runs out of memory long before.
_MOST_TRIANGLES = 100_000
# Volume meshes and text formats take more bytes than the triangles that they yield.
_MOST_BYTES = 10_000 * _MOST_TRIANGLES
# A volume mesh has several cells for each triangle of its surface.
_CELLS_PER_TRIANGLE = 5
# Patterns that capture the declared number of cells, and strings that occur once per cell.
_CELLS = {
    ".ply": re.compile(rb"element\s+face\s+(\d+)"),
    ".off": re.compile(rb"^OFF\s+(?:#.*\s+)*\d+\s+(\d+)"),
    ".vtp": re.compile(rb'NumberOfPolys="\s*(\d+)'),
    ".vtu": re.compile(rb'NumberOfCells="\s*(\d+)'),
    # The only number in version 2 of the format; in version 4 that of the blocks precedes it.
    ".msh": re.compile(rb"\$Elements\s+(?:\d+[ \t]+)?(\d+)"),
}
_CELL_STARTS = {".obj": b"\nf ", ".stl": b"endfacet"}
# A binary STL: an arbitrary header of 80 bytes, the number of triangles, 50 bytes for each.
_STL_HEAD, _STL_TRIANGLE = 84, 50
# A text STL has a facet within so many bytes; a binary one may begin with the same word.
_STL_TEXT = 2000
# Sizes of objects [m], from a cell to a mountain. Beyond these a unit is wrong, and squares and
# cubes of lengths may overflow.
_SPAN = (1e-6, 1e4)
# Deflection of the triangles from the surface, relative to its edges, and angle between adjacent
# ones [rad]: a ball gets 20,000 triangles, and loses 0.1 % of its volume.
_STEP_DEVIATION, _STEP_ANGLE = 5e-4, 0.3
# Statements of the format and of its extensions that are ignored.
_IGNORED_STATEMENTS = frozenset({
    "vt", "vn", "vp", "p", "l", "o", "g", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "lod",
    "bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj", "cstype", "deg", "bmat", "step",
    "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end", "con", "ctech", "stech",
    "call", "csh",
})  # fmt: skip


def read_mesh(
    path: Path | str, *, metres_per_unit: float = 1.0, most: int = _MOST_TRIANGLES
) -> TriangleMesh:
    """Read the surface of an object, in metres, with coinciding vertices merged.

    Unused vertices are removed; the others keep their order. Quadrangles are cut in two, quadratic
    triangles in four; a file that holds tetrahedra and no triangles gives their boundary. Faces of
    a STEP file are converted to triangles. Whether the surface is closed is not checked here: see
    `checked_mesh`.

    Parameters
    ----------
    path : path                     suffix .ply .obj .stl .off .msh .vtu .vtp .step .stp
    metres_per_unit : float         length of the file's unit, e.g. 0.001 for millimetres; > 0;
                                    ignored for a STEP file, which states its own
    most : int                      largest number of triangles

    Returns
    -------
    TriangleMesh                    in metres; open or closed

    Raises
    ------
    MeshError                       no such file, unknown suffix, unreadable, no triangles or too
                                    many, vertices that are not finite, implausible size
    InputError                      unit not positive; the optional package for MSH, VTU or STEP is
                                    missing
    """
    path = Path(path)
    if not (np.isfinite(metres_per_unit) and metres_per_unit > 0.0):
        raise InputError(f"metres_per_unit is {metres_per_unit}; must be positive")
    suffix = path.suffix.lower()
    if suffix not in _READ:
        raise MeshError(
            f"{path}: mesh files of type '{suffix}' are not read;"
            f" convert it to one of {' '.join(_READ)}"
        )
    content = read_bytes(path, max_bytes=_MOST_BYTES, kind=MeshError)
    if suffix in STEP_SUFFIXES:
        metres_per_unit = 1.0
    with read_errors(
        path,
        "open it in a mesh program and save it again",
        what=f"cannot be read as a surface in the format {suffix[1:].upper()}",
        kind=MeshError,
    ):
        _check_count(path, _claimed(content, suffix), most, solid=suffix in _MESHIO_SUFFIXES)
        _check_whole(content, suffix)
        vertices, triangles = _raw_surface(path, content)
        if triangles.max(initial=-1) >= len(vertices):
            raise ValueError(
                f"a face names vertex {triangles.max()}, counted from 0, of {len(vertices)}"
            )
        used = np.zeros(len(vertices), dtype=bool)
        used[triangles] = True
    if len(triangles) == 0:
        raise MeshError(f"{path}: holds no triangles; give a closed triangle surface")
    _check_count(path, len(triangles), most)
    if not np.isfinite(vertices[used]).all():
        raise MeshError(f"{path}: has vertices that are not finite; write the file again")
    _check_span(path, vertices[used] * metres_per_unit)
    try:
        return welded(TriangleMesh(vertices=vertices * metres_per_unit, triangles=triangles))
    except InputError as error:
        raise MeshError(f"{path}: {error}") from error


def write_mesh(path: Path | str, mesh: TriangleMesh, *, metres_per_unit: float = 1.0) -> None:
    """Write a surface atomically: the file holds all of it or its old content.

    PLY and VTU keep every digit, OBJ and OFF eight decimals or more.

    Parameters
    ----------
    path : path                     suffix .ply .obj .stl .off .msh .vtu
    mesh : TriangleMesh
    metres_per_unit : float         unit of the coordinates in the file

    Raises
    ------
    MeshError                       unknown suffix
    InputError                      the optional package for MSH or VTU is missing
    RecordError                     the file cannot be written; an existing one is unchanged
    """
    path = Path(path)
    mesh = replace(mesh, vertices=mesh.vertices / metres_per_unit)
    with write_errors(path):
        _write_surface(path, path.suffix.lower(), mesh)


def _write_surface(path: Path, suffix: str, mesh: TriangleMesh) -> None:
    """Write a surface in the format of its suffix."""
    if suffix == ".ply":
        _write_ply(path, mesh)
    elif suffix in _TRIMESH_SUFFIXES:
        trimesh = late_import("trimesh", extra=None, purpose=f"writing {path.name}")
        body = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
        content = body.export(file_type=suffix[1:])
        write_bytes(path, content if isinstance(content, bytes) else content.encode())
    elif suffix in _MESHIO_SUFFIXES:
        meshio = late_import("meshio", extra=None, purpose=f"writing {path.name}")
        content = meshio.Mesh(mesh.vertices, [("triangle", mesh.triangles)])
        with atomic_replacement(path) as staged:
            content.write(staged, file_format=_MESHIO_SUFFIXES[suffix])
    else:
        raise MeshError(
            f"{path}: cannot write '{suffix}'; choose one of {' '.join(WRITTEN_SUFFIXES)}"
        )


def welded(mesh: TriangleMesh) -> TriangleMesh:
    """A surface with coinciding vertices merged and unused ones removed.

    Vertices coincide that are closer than 1e-7 of the longest side of the bounding box, or than
    single precision resolves. The first of each group is kept, and the order of vertices.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    TriangleMesh                    with as many triangles, in the same order
    """
    vertices = mesh.vertices
    span = float(np.ptp(vertices, axis=0).max())
    near = max(1e-7 * span, 4.0 * float(np.finfo(np.float32).eps) * float(abs(vertices).max()))
    pairs = cKDTree(vertices).query_pairs(near, output_type="ndarray")
    _, group = connected_components(pairs, len(vertices))
    _, first = np.unique(group, return_index=True)
    triangles = first[group][mesh.triangles]
    used, compact = np.unique(triangles, return_inverse=True)
    return TriangleMesh(vertices=vertices[used], triangles=compact.reshape(-1, 3))


def _claimed(content: bytes, suffix: str) -> int:
    """Number of triangles or polygons that a file declares, found before it is parsed."""
    if suffix in _CELLS:
        return sum(map(int, _CELLS[suffix].findall(content)))
    if suffix == ".stl" and (len(content) - _STL_HEAD) % _STL_TRIANGLE == 0:
        count = (len(content) - _STL_HEAD) // _STL_TRIANGLE
        if content[_STL_HEAD - 4 : _STL_HEAD] == count.to_bytes(4, "little"):
            return count
    return content.count(_CELL_STARTS[suffix]) if suffix in _CELL_STARTS else 0


def _check_whole(content: bytes, suffix: str) -> None:
    """Refuse a file that holds less, or more, than it declares: truncated, or edited by hand."""
    if suffix == ".ply":
        head, _, rows = content.partition(b"end_header")
        counts = re.findall(rb"element\s+\w+\s+(\d+)", head)
        if re.search(rb"property\s+list\s+\w+\s+(float|double)\w*\s+vertex_ind", head):
            raise ValueError("its faces name vertices by numbers that need not be whole")
        if b"format ascii" in head and counts:
            _check_said(sum(map(int, counts)), sum(bool(row.strip()) for row in rows.splitlines()))
            check_text_ply(content)
    elif suffix == ".off":
        words = [line for row in content.splitlines() if (line := row.partition(b"#")[0].split())]
        # Some programs write the counts on the line of the word OFF.
        counted, *faces = [words[0][1:], *words[1:]] if words[0][1:] else words[1:]
        _check_said(int(counted[0]) + int(counted[1]), len(faces))
    elif suffix == ".stl" and content.startswith(b"solid") and b"facet" in content[:_STL_TEXT]:
        if b"endsolid" not in content:
            raise ValueError("its last line, endsolid, is missing: it was cut off")
    elif suffix == ".stl" and len(content) >= _STL_HEAD:
        declared = int.from_bytes(content[_STL_HEAD - 4 : _STL_HEAD], "little")
        _check_said(declared, (len(content) - _STL_HEAD) / _STL_TRIANGLE, "triangles")


def _check_said(declared: int, actual: int | float, what: str = "rows") -> None:
    if declared != actual:
        raise ValueError(f"it says that it has {declared} {what}, and holds {actual:g}")


def _check_count(path: Path, count: int, most: int, *, solid: bool = False) -> None:
    limit = _CELLS_PER_TRIANGLE * most if solid else most
    if count > limit:
        cure = "in a mesh program (decimate, remesh)"
        if most == _MOST_TRIANGLES:
            cure = f"with `palpate mesh`, or {cure}"
        raise MeshError(
            f"{path}: has {count} {'cells' if solid else 'triangles'}, too large: at most {limit}"
            f" are read; reduce it {cure}: 1000 to 10000 are enough for an object"
        )


def _check_span(path: Path, vertices: Vertices) -> None:
    """Refuse implausible dimensions, before lengths are squared."""
    span, farthest = float(np.ptp(vertices, axis=0).max()), float(abs(vertices).max())
    if not (_SPAN[0] <= span and farthest <= _SPAN[1]):
        raise MeshError(
            f"{path}: is {span:.3g} m across, and up to {farthest:.3g} m from the origin; an object"
            f" must be {_SPAN[0]:g} m across or more, within {_SPAN[1]:g} m: check length_unit"
        )


def _raw_surface(path: Path, content: bytes) -> tuple[Vertices, Triangles]:
    """Vertices and triangles as they are in the file."""
    suffix = path.suffix.lower()
    if suffix in STEP_SUFFIXES:
        vertices, triangles = _read_step(path)
    elif suffix == ".vtp":
        vertices, triangles = parse_vtp(content)
    elif suffix == ".obj":
        vertices, triangles = _parse_obj(content)
    elif suffix in _TRIMESH_SUFFIXES:
        trimesh = late_import("trimesh", extra=None, purpose=f"reading {path.name}")
        loaded = trimesh.load_mesh(
            BytesIO(content), file_type=suffix[1:], process=False, maintain_order=True
        )
        vertices, triangles = loaded.vertices, loaded.faces
    else:
        surface = result_in_child(read_by_meshio, path, _MESHIO_SUFFIXES[suffix])
        vertices, triangles = _surface_of_cells(surface)
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        whole_numbers(np.asarray(triangles)).reshape(-1, 3),
    )


def _surface_of_cells(content: Any) -> tuple[Float[np.ndarray, "v 3"], Int[np.ndarray, "m 3"]]:
    """Triangles of a mesh of any cells: its surface cells, else its tetrahedra's boundary."""
    facets = [
        whole_numbers(block.data[:, corners])
        for block in content.cells
        if block.type in _FACETS
        for corners in _FACETS[block.type]
    ]
    solids = [
        whole_numbers(block.data[:, :4])
        for block in content.cells
        if block.type in ("tetra", "tetra10")
    ]
    if not facets and solids:
        faces = np.concatenate(solids)[:, _TETRAHEDRON_FACES].reshape(-1, 3)
        facets = [faces[is_outer(faces)]]
    points = np.zeros((len(content.points), 3))
    points[:, : content.points.shape[1]] = content.points
    empty = np.zeros((0, 3), dtype=np.int64)
    return points, np.concatenate(facets) if facets else empty


def _write_ply(path: Path, mesh: TriangleMesh) -> None:
    """Binary PLY in double precision."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(mesh.triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    face = np.zeros(len(mesh.triangles), dtype=[("count", "u1"), ("index", "<i4", 3)])
    face["count"] = 3
    face["index"] = mesh.triangles
    write_bytes(path, header.encode() + mesh.vertices.astype("<f8").tobytes() + face.tobytes())


def _read_step(path: Path) -> tuple[Vertices, Triangles]:
    """Vertices [m] and triangles of all solids of a STEP file, which states its own unit.

    Adjacent faces have separate, coinciding vertices along their common edge.

    Parameters
    ----------
    path : Path

    Returns
    -------
    vertices : (v, 3) float [m]
    triangles : (m, 3) int

    Raises
    ------
    InputError                      the optional package is missing
    MeshError                       the file holds no solid, is damaged, or takes 300 s or 4 GB
    """
    late_import("cascadio", extra="cad", purpose=f"reading {path.name}")
    trimesh = late_import("trimesh", extra=None, purpose=f"reading {path.name}")
    with TemporaryDirectory() as scratch:
        target = Path(scratch) / "solid.glb"
        try:
            read = result_in_child(triangles_of_step, path, target, _STEP_DEVIATION, _STEP_ANGLE)
        except RuntimeError as error:
            raise MeshError(
                f"{path}: cannot be covered with triangles ({error}); leave out of the drawing what"
                " is not the object, or export an STL"
            ) from error
        # glTF is in metres by definition.
        drawn = trimesh.load(target, force="mesh", process=False) if read else None
    if drawn is None or len(drawn.faces) == 0:
        raise MeshError(
            f"{path}: no solid can be read of this STEP file; open it in a drawing program, check"
            " that it is there, and export it again (STEP AP214 or AP242), or as an STL"
        )
    return np.array(drawn.vertices, dtype=np.float64), np.array(drawn.faces, dtype=np.int64)


def _parse_obj(content: bytes) -> tuple[Vertices, Triangles]:
    """Vertices and triangles of an OBJ file, in its own unit; polygons are cut into fans.

    Texture coordinates and normals, which would split vertices, are ignored.

    Parameters
    ----------
    content : bytes                 the whole file

    Returns
    -------
    vertices : (v, 3) float         in the unit of the file
    triangles : (m, 3) int          indices from 0

    Raises
    ------
    ValueError                      a vertex or a face that cannot be read, or a face of a vertex
                                    that does not exist; the message names the line

    Source
    ------
    Wavefront, "Object files (.obj)": indices count from 1, negative ones from the latest vertex.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    latest, goes_on = (0, 0), False
    for number, line in enumerate(content.decode("utf-8", errors="replace").splitlines(), start=1):
        kind, *words = line.partition("#")[0].split() or [""]
        continued, goes_on = goes_on, line.endswith("\\")
        if not kind or continued or kind in _IGNORED_STATEMENTS:
            continue
        try:
            if kind not in ("v", "f"):
                raise ValueError
            if "_" in line:  # Python reads "1_000" as a number, the format does not
                raise ValueError
            if kind == "v":
                x, y, z = map(float, words[:3])
                vertices.append([x, y, z])
            else:
                first, second, third, *more = (_obj_index(word, len(vertices)) for word in words)
                others = (second, third, *more)
                triangles += [(first, a, b) for a, b in pairwise(others)]
                latest = max(latest, (max(first, *others), number))
        except ValueError as error:
            raise ValueError(f"line {number}: '{line[:40]}' is no vertex or face of it") from error
    if latest[0] >= len(vertices):
        raise ValueError(
            f"line {latest[1]}: the face names vertex {latest[0] + 1}, of {len(vertices)} vertices"
        )
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(triangles, dtype=np.int64).reshape(-1, 3),
    )


def _obj_index(word: str, count: int) -> int:
    """Vertex index from 0 of a face's corner such as 3, 3/1, 3//2 or -1."""
    given = int(word.partition("/")[0])
    if given == 0 or given < -count:
        raise ValueError
    return given - 1 if given > 0 else count + given
