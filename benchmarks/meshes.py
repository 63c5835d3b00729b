"""Surfaces for benchmarks, made by hand."""

import numpy as np
from jaxtyping import Float, Int

from palpate.geometry import TriangleMesh

CUBE_NORMALS = np.array([[-1.0, 0, 0], [1, 0, 0], [0, -1, 0], [0, 1, 0], [0, 0, -1], [0, 0, 1]])


def cube(cells: int) -> tuple[TriangleMesh, Int[np.ndarray, " m"]]:
    """Unit cube, every face `cells` by `cells` squares cut in two along alternating diagonals.

    Returns
    -------
    TriangleMesh
    (m,) int                  face of each triangle, an index of CUBE_NORMALS
    """
    return _box(np.ones(3), (cells, cells, cells))


def sheet(size: Float[np.ndarray, "3"], cells: tuple[int, int, int]) -> TriangleMesh:
    """A box from the origin, its edges cut into as many cells, as `cube`."""
    return _box(size, cells)[0]


def _box(
    size: Float[np.ndarray, "3"], cells: tuple[int, int, int]
) -> tuple[TriangleMesh, Int[np.ndarray, " m"]]:
    number: dict[tuple[int, ...], int] = {}
    triangles, face = [], []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, 1):
            for i, j in np.ndindex(cells[first], cells[second]):
                corner = []
                for p, q in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                    node = [side * cells[axis]] * 3
                    node[first], node[second] = p, q
                    corner.append(number.setdefault(tuple(node), len(number)))
                a, b, c, d = corner
                cut = [[a, b, c], [a, c, d]] if (i + j) % 2 == 0 else [[a, b, d], [b, c, d]]
                triangles += cut if side else [triangle[::-1] for triangle in cut]
                face += [2 * axis + side] * 2
    vertices = np.array(list(number), dtype=float) / cells * size
    return TriangleMesh(vertices, np.array(triangles)), np.array(face)


def ball(subdivisions: int, *, radius: float = 1.0) -> TriangleMesh:
    """Icosahedron cut in four `subdivisions` times, 10 * 4^k + 2 vertices on the sphere."""
    g = (1 + np.sqrt(5)) / 2
    pairs = np.array([[-1, g], [1, g], [-1, -g], [1, -g]])
    flat = np.zeros((4, 1))
    vertices = np.concatenate([np.roll(np.hstack([pairs, flat]), k, axis=1) for k in (0, 1, 2)])
    triangles = _hull(vertices)
    for _ in range(subdivisions):
        edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, number = np.unique(edges, axis=0, return_inverse=True)
        middle = len(vertices) + number.reshape(-1, 3)
        vertices = np.concatenate([vertices, vertices[unique].mean(axis=1)])
        nodes = np.hstack([triangles, middle])
        cut = [[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]]
        triangles = nodes[:, cut].reshape(-1, 3)
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return TriangleMesh(radius * vertices, triangles)


def geodesic(frequency: int) -> TriangleMesh:
    """Icosahedron whose edges are cut into f parts, 10 f^2 + 2 vertices on the unit sphere."""
    corners = ball(0)
    i, j = (part.ravel() for part in np.meshgrid(*[np.arange(frequency + 1)] * 2, indexing="ij"))
    inside = i + j <= frequency
    weights = np.stack([frequency - i - j, i, j], axis=1)[inside]
    number = np.full((frequency + 1, frequency + 1), -1)
    number[i[inside], j[inside]] = np.arange(len(weights))
    up = [(number[a, b], number[a + 1, b], number[a, b + 1]) for a, b in weights[:, 1:]
          if a + b < frequency]  # fmt: skip
    down = [(number[a + 1, b], number[a + 1, b + 1], number[a, b + 1]) for a, b in weights[:, 1:]
            if a + b < frequency - 1]  # fmt: skip
    cut = np.array(up + down)
    points = np.einsum("pk,fki->fpi", weights, corners.vertices[corners.triangles])
    # Faces share the points of their edges.
    _, first, vertex_of = np.unique(
        np.round(points.reshape(-1, 3), 9), axis=0, return_index=True, return_inverse=True
    )
    vertices = points.reshape(-1, 3)[first]
    triangles = vertex_of.reshape(len(points), -1)[:, cut].reshape(-1, 3)
    return TriangleMesh(vertices / np.linalg.norm(vertices, axis=1, keepdims=True), triangles)


def cap(mesh: TriangleMesh, height: float) -> Int[np.ndarray, " k"]:
    """Triangles that lie below a height z [m] with all three vertices."""
    return np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < height).all(axis=1))


def _hull(vertices: Float[np.ndarray, "12 3"]) -> Int[np.ndarray, "20 3"]:
    """Outward faces of the icosahedron: triples of vertices at the distance of an edge, 2."""
    near = np.isclose(np.linalg.norm(vertices[:, None] - vertices, axis=2), 2.0)
    faces = [
        (a, b, c)
        for a in range(12)
        for b in range(a + 1, 12)
        for c in range(b + 1, 12)
        if near[a, b] and near[b, c] and near[c, a]
    ]
    outward = [
        (a, b, c) if np.linalg.det(vertices[[a, b, c]]) > 0 else (a, c, b) for a, b, c in faces
    ]
    return np.array(outward)
