"""Finer triangles on the smooth surface that a mesh approximates."""

import numpy as np
from jaxtyping import Float, Int

from palpate.errors import InputError
from palpate.geometry.midside_nodes import displacement_nodes, interpolation_matrix
from palpate.geometry.sides import split_sides
from palpate.geometry.triangle_mesh import TriangleMesh
from palpate.shapes import Triangles, Vertices


def refined_surface(mesh: TriangleMesh, *, pieces: int = 4) -> tuple[Vertices, Triangles]:
    """Cut every triangle into smaller ones that lie on the smooth surface through the vertices.

    The surface is that of the quadratic elements: midside nodes fitted to the surrounding vertices,
    edges where the normals of adjacent triangles differ by more than 40 degrees. The distance from
    a curved object decreases with the square of `pieces`.

    Parameters
    ----------
    mesh : TriangleMesh
    pieces : int                    parts of an edge, at least 1; pieces^2 triangles from one

    Returns
    -------
    vertices : (m q, 3) float [m]   q = (pieces + 1)(pieces + 2) / 2 for each of the m triangles;
                                    shared corners are not merged
    triangles : (m pieces^2, 3) int those of triangle k are rows k pieces^2 and following

    Raises
    ------
    InputError                      pieces below 1
    """
    if pieces < 1:
        raise InputError(f"pieces is {pieces}; must be 1 or more")
    lattice, small = _lattice(pieces)
    count = len(mesh.triangles)
    sides = split_sides(mesh, np.zeros(count, dtype=np.int64))
    nodes = displacement_nodes(mesh, sides)
    interpolation = interpolation_matrix(
        nodes, np.repeat(np.arange(count), len(lattice)), np.tile(lattice, (count, 1))
    )
    triangles = small[None] + len(lattice) * np.arange(count)[:, None, None]
    return np.asarray(interpolation @ mesh.vertices), triangles.reshape(-1, 3)


def piece_middles(pieces: int) -> Float[np.ndarray, "s 3"]:
    """Centroids of the small triangles within the one from which they are cut.

    Parameters
    ----------
    pieces : int                    parts of an edge, at least 1

    Returns
    -------
    (pieces^2, 3) float [-]         barycentric, in the order of `refined_surface`
    """
    lattice, small = _lattice(pieces)
    return lattice[small].mean(axis=1)


def _lattice(pieces: int) -> tuple[Float[np.ndarray, "q 3"], Int[np.ndarray, "s 3"]]:
    """Barycentric coordinates of the corners of the parts, and the parts."""
    number = {}
    corners: list[tuple[float, float, float]] = []
    for i in range(pieces + 1):
        for j in range(pieces + 1 - i):
            number[i, j] = len(corners)
            corners.append(((pieces - i - j) / pieces, i / pieces, j / pieces))
    parts = []
    for i in range(pieces):
        for j in range(pieces - i):
            parts.append((number[i, j], number[i + 1, j], number[i, j + 1]))
            if i + j < pieces - 1:
                parts.append((number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]))
    return np.array(corners), np.array(parts)
