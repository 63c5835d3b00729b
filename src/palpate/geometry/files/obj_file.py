"""Surfaces in Wavefront's OBJ format: vertices and faces; other statements are ignored."""

from itertools import pairwise

import numpy as np

from palpate.shapes import Triangles, Vertices

# Statements of the format and of its extensions that are ignored.
_OTHERS = frozenset({
    "vt", "vn", "vp", "p", "l", "o", "g", "s", "mg", "usemtl", "mtllib", "usemap", "maplib", "lod",
    "bevel", "c_interp", "d_interp", "shadow_obj", "trace_obj", "cstype", "deg", "bmat", "step",
    "curv", "curv2", "surf", "parm", "trim", "hole", "scrv", "sp", "end", "con", "ctech", "stech",
    "call", "csh",
})  # fmt: skip


def parse_obj(content: bytes) -> tuple[Vertices, Triangles]:
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
        if not kind or continued or kind in _OTHERS:
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
                first, second, third, *more = (_index(word, len(vertices)) for word in words)
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


def _index(word: str, count: int) -> int:
    """Vertex index from 0 of a face's corner such as 3, 3/1, 3//2 or -1."""
    given = int(word.partition("/")[0])
    if given == 0 or given < -count:
        raise ValueError
    return given - 1 if given > 0 else count + given
