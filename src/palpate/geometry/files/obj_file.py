"""Surfaces in Wavefront's OBJ format: vertices and faces, all else left aside."""

from itertools import pairwise

import numpy as np

from palpate.shapes import Triangles, Vertices


def parse_obj(content: bytes) -> tuple[Vertices, Triangles]:
    """Vertices and triangles of an OBJ file, in its own unit; polygons are cut into fans.

    Texture coordinates and normals, which would split vertices, are left out.

    Parameters
    ----------
    content : bytes                 the whole file

    Raises
    ------
    ValueError                      a vertex or a face that cannot be read; the text names the line

    Source
    ------
    Wavefront, "Object files (.obj)": indices count from 1, negative ones from the latest vertex.
    """
    vertices: list[list[float]] = []
    triangles: list[tuple[int, int, int]] = []
    for number, line in enumerate(content.decode("utf-8", errors="replace").splitlines(), start=1):
        kind, *words = line.partition("#")[0].split() or [""]
        if kind not in ("v", "f"):
            continue
        try:
            if "_" in line:  # Python's own, "1_000", in no file of numbers
                raise ValueError
            if kind == "v":
                x, y, z = map(float, words[:3])
                vertices.append([x, y, z])
            else:
                first, *others = (_index(word, len(vertices)) for word in words)
                triangles += [(first, a, b) for a, b in pairwise(others)]
        except ValueError as error:
            raise ValueError(f"line {number}: '{line[:40]}' is no vertex or face of it") from error
    return (
        np.array(vertices, dtype=np.float64).reshape(-1, 3),
        np.array(triangles, dtype=np.int64).reshape(-1, 3),
    )


def _index(word: str, count: int) -> int:
    """Number of a vertex from 0, of a corner such as 3, 3/1, 3//2 or -1."""
    given = int(word.partition("/")[0])
    if given == 0 or given < -count:
        raise ValueError
    return given - 1 if given > 0 else count + given
