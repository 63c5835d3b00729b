"""A mesh fine enough for pictures: what is drawn at its vertices looks continuous to the cameras.

Edges that a camera sees longer than asked for are halved, with all triangles at them, until none is
left; what no camera sees stays coarse. New vertices lie on the smooth surface that the mesh stands
for. Along creases vertices are double, so that each side has its own normals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.arrays import lengths
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, displacement_nodes, quadratic_shapes, split_sides
from palpate.records import Camera, camera_centre, picture_size
from palpate.shapes import Triangles, Vertices
from palpate.vision import project

# Cosine between a triangle's normal and the direction to the camera: one that faces away a little
# is refined too, since the body's deformation may turn it into view.
_MIN_COSINE = -0.2
# So is a triangle outside the picture by no more than this share of it.
_MAX_OUTSIDE = 0.05
# A triangle's marked edges as one number.
_BITS = np.array([1, 2, 4])


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Triangles during the refinement; corners are places on base triangles.

    `weld` numbers the vertices of both sides of a crease alike: both are split alike.
    """

    vertices: Vertices
    weld: Int[np.ndarray, " v"]
    triangles: Triangles
    base: Int[np.ndarray, " m"]
    weight: Float[np.ndarray, "m 3 3"]


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Edges of triangles.

    `ends` (e, 2) are vertices, `of` (m, 3) is the edge from corner k to k + 1 of each triangle,
    `weld` (e,) numbers the two sides of a crease's edge alike, `first` (e,) is a place in `of`.
    """

    ends: Int[np.ndarray, "e 2"]
    of: Int[np.ndarray, "m 3"]
    weld: Int[np.ndarray, " e"]
    first: Int[np.ndarray, " e"]


def make_render_mesh(
    mesh: TriangleMesh, cameras: Sequence[Camera], *, edge: float = 1.0, max_vertices: int = 400_000
) -> TriangleMesh:
    """Refine a mesh for the pictures of some cameras.

    Parameters
    ----------
    mesh : TriangleMesh             closed
    cameras : sequence of Camera    each with a size
    edge : float [px]               longest edge in any camera; what is drawn between vertices is
                                    linear, and moves with the material whatever its length
    max_vertices : int              where they do not suffice the longest edges are halved first

    Returns
    -------
    TriangleMesh                    fine triangles on the smooth surface that the mesh stands for;
                                    vertices along creases are double

    Raises
    ------
    InputError                      edge out of range, fewer vertices allowed than the mesh has, a
                                    camera without a size
    """
    sides = split_sides(mesh, np.zeros(len(mesh.triangles), dtype=np.int64))
    if not edge > 0.0 or max_vertices < len(sides.vertex):
        raise InputError(
            f"edge is {edge:g} px, at most {max_vertices} vertices; must be positive, and at least"
            f" the {len(sides.vertex)} of the mesh with those of its creases doubled"
        )
    nodes = displacement_nodes(mesh, sides)
    corner = np.concatenate([mesh.vertices, nodes.weights @ mesh.vertices])[nodes.element]
    count = len(mesh.triangles)
    pieces = _Pieces(
        mesh.vertices[sides.vertex],
        sides.vertex,
        sides.corner,
        np.arange(count),
        np.broadcast_to(np.eye(3), (count, 3, 3)).copy(),
    )
    while True:
        edges = _edges(pieces)
        length = _seen_lengths(pieces, edges, cameras)
        marked = _edges_to_halve(edges, length, edge, max_vertices - len(pieces.vertices))
        if not marked.any():
            return TriangleMesh(pieces.vertices, pieces.triangles)
        pieces = _halved(pieces, edges, marked, corner)


def _edges(pieces: _Pieces) -> _Edges:
    """The edges of all triangles."""
    triangles = pieces.triangles
    count = np.int64(len(pieces.vertices))
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
    key, first, of = np.unique(
        (ends[..., 0] * count + ends[..., 1]).ravel(), return_index=True, return_inverse=True
    )
    pair = np.stack([key // count, key % count], axis=1)
    welded = np.sort(pieces.weld[pair], axis=1)
    _, weld = np.unique(welded[:, 0] * count + welded[:, 1], return_inverse=True)
    return _Edges(pair, of.reshape(-1, 3), weld, first)


def _seen_lengths(
    pieces: _Pieces, edges: _Edges, cameras: Sequence[Camera]
) -> Float[np.ndarray, " e"]:
    """Length of each edge where a camera sees it longest [px]; zero where none does."""
    length = np.zeros(len(edges.ends))
    a, b, c = (pieces.vertices[column] for column in pieces.triangles.T)
    middle, normal = (a + b + c) / 3.0, np.cross(b - a, c - a)
    # Axis by axis: numpy sums and compares along a short last axis ten times as slowly.
    size = lengths(normal)
    for camera in cameras:
        toward = camera_centre(camera) - middle
        facing = np.einsum("ma,ma->m", normal, toward)
        facing /= size * lengths(toward)
        pixel = project(camera, pieces.vertices)
        seen = np.zeros(len(length), dtype=bool)
        in_view = (facing > _MIN_COSINE) & _in_picture(camera, pixel, pieces.triangles)
        seen[edges.of[in_view].ravel()] = True
        ends = edges.ends[seen]
        away = pixel[ends[:, 1]] - pixel[ends[:, 0]]
        length[seen] = np.fmax(length[seen], np.hypot(*away.T))  # NaN: beyond the lens
    # Both sides of a crease as the side that is seen longer.
    both = np.zeros(edges.weld.max() + 1)
    np.maximum.at(both, edges.weld, length)
    return both[edges.weld]


def _in_picture(
    camera: Camera, pixel: Float[np.ndarray, "v 2"], triangles: Triangles
) -> Bool[np.ndarray, " m"]:
    """Triangles whose box reaches into a camera's picture, or nearly so."""
    inside = np.ones(len(triangles), dtype=bool)
    for place, size in zip(pixel.T, picture_size(camera), strict=True):
        a, b, c = (place[column] for column in triangles.T)
        inside &= np.maximum(np.maximum(a, b), c) > -_MAX_OUTSIDE * size
        inside &= np.minimum(np.minimum(a, b), c) < (1.0 + _MAX_OUTSIDE) * size
    return inside


def _edges_to_halve(
    edges: _Edges, length: Float[np.ndarray, " e"], limit: float, room: int
) -> Bool[np.ndarray, " e"]:
    """Edges to halve: those above the limit, the longest first if there is not room for all."""
    marked = length > limit
    if marked.sum() <= room:
        return marked
    # By welded edges: both sides of a crease or none.
    order = np.lexsort((edges.weld, -length))[:room]
    kept = np.zeros_like(marked)
    kept[order] = True
    whole = np.bincount(edges.weld[kept], minlength=edges.weld.max() + 1)
    there = np.bincount(edges.weld, minlength=edges.weld.max() + 1)
    return kept & marked & (whole == there)[edges.weld]


def _halved(
    pieces: _Pieces,
    edges: _Edges,
    marked: Bool[np.ndarray, " e"],
    corner: Float[np.ndarray, "k 6 3"],
) -> _Pieces:
    """Split marked edges at their middle on the base triangle, and the triangles at them."""
    number = np.full(len(marked), -1)
    number[marked] = len(pieces.vertices) + np.arange(marked.sum())
    _, weld = np.unique(edges.weld[marked], return_inverse=True)
    middle = 0.5 * (pieces.weight + np.roll(pieces.weight, -1, axis=1))
    first = edges.first[marked]
    shape = quadratic_shapes(middle.reshape(-1, 3)[first])
    place = np.einsum("kn,nka->na", shape, corner[pieces.base[first // 3]])
    split = _split_triangles(
        np.concatenate([pieces.triangles, number[edges.of]], axis=1),
        marked[edges.of],
    )
    weight = np.concatenate([pieces.weight, middle], axis=1)
    return replace(
        pieces,
        vertices=np.concatenate([pieces.vertices, place]),
        weld=np.concatenate([pieces.weld, pieces.weld.max() + 1 + weld]),
        triangles=np.concatenate([vertex for _, _, vertex in split]),
        base=np.concatenate([pieces.base[row] for row, _, _ in split]),
        weight=np.concatenate([weight[row[:, None], local] for row, local, _ in split]),
    )


def _split_triangles(
    vertex: Int[np.ndarray, "m 6"], marked: Bool[np.ndarray, "m 3"]
) -> list[tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k 3"], Int[np.ndarray, "k 3"]]]:
    """Parts of triangles with any edges halved: rows of the wholes, local nodes, vertices.

    Local nodes 0 to 2 are the corners, 3 to 5 the middles of the edges 01, 12, 20.
    """
    patterns = {
        (False, False, False): [(0, 1, 2)],
        (True, False, False): [(0, 3, 2), (3, 1, 2)],
        (True, True, False): [(3, 1, 4), (0, 3, 4), (0, 4, 2)],
        (True, True, True): [(0, 3, 5), (3, 1, 4), (5, 4, 2), (3, 4, 5)],
    }
    parts, code = [], marked @ _BITS
    for pattern, small in patterns.items():
        for turn in range(3 if 0 < sum(pattern) < 3 else 1):
            rows = np.flatnonzero(code == np.roll(pattern, turn) @ _BITS)
            for nodes in small:
                turned = [(k + turn) % 3 + (0 if k < 3 else 3) for k in nodes]
                local = np.broadcast_to(np.array(turned), (len(rows), 3))
                parts.append((rows, local, vertex[rows[:, None], local]))
    return parts
