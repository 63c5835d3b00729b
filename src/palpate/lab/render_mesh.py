"""A mesh fine enough for rendering, and the reflectance at its vertices.

Vertex values interpolated linearly look continuous: edges that a camera sees longer than the limit
are bisected, with all their triangles, until none is left; parts that no camera sees stay coarse.
New vertices lie on the smooth surface that the mesh approximates. Vertices along creases are
duplicated, so that each side has its own normals.

Reflectance is a function of the position at rest: it moves with the material. Textures are
evaluated at points and are smooth: the rim of a `speckle` dot is `RIM` times its diameter wide, and
`natural` has no wavelength below the given one. Points closer than a quarter of that rim or
wavelength resolve them fully.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import lengths
from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    displacement_nodes,
    quadratic_shapes,
    random_points,
    split_sides,
    triangle_areas,
)
from palpate.records import Camera, camera_centre, picture_size
from palpate.shapes import Points, PointScalars, Triangles, Vertices
from palpate.vision import project

# Least cosine between a triangle's normal and the direction to the camera. Triangles that face away
# slightly are refined too, since the deformation may turn them into view.
_MIN_COSINE = -0.2
# So are triangles outside the picture by up to this fraction of its size.
_MAX_OUTSIDE = 0.05
# Weights that encode a triangle's marked edges as one number.
_BITS = np.array([1, 2, 4])
# Fraction of the surface that dots cover; reflectance of dots and background.
_COVERAGE, _DARK, _BRIGHT = 0.5, 0.1, 0.9
# Width of the smooth rim of a dot, as a fraction of its diameter.
RIM = 0.3
# Waves per octave; from about thirty on their sum looks normally distributed.
_WAVES = 48
# Points whose waves are summed at once: some 40 MB.
_CHUNK = 16384
# Largest number of dots: more points to a mistake in the unit of length.
_MAX_DOTS = 5_000_000
# The sum of the waves saturates at this many standard deviations, to keep it within 0 to 1.
_REACH = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Triangles during the refinement, with their corners' positions on the base triangles.

    `base` is the triangle of the original mesh, `weight` the barycentric coordinates of the corners
    on it. `weld` gives duplicates of a vertex the same number, so that both sides of a crease are
    split alike.
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
    `weld` (e,) gives the two copies of an edge on a crease the same number, `first` (e,) is the
    first index of the edge in the flattened `of`.
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
    cameras : sequence of Camera    each with a picture size
    edge : float [px]               > 0; longest permitted edge in any camera. The texture is linear
                                    between vertices and moves with them, whatever the edge length
    max_vertices : int              limit on the number of vertices; the longest edges are bisected
                                    first

    Returns
    -------
    TriangleMesh                    fine triangles on the smooth surface that the mesh approximates;
                                    vertices along creases are duplicated

    Raises
    ------
    InputError                      edge out of range, `max_vertices` less than the mesh has, a
                                    camera without a picture size
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
    key, first, edge_of = np.unique(
        (ends[..., 0] * count + ends[..., 1]).ravel(), return_index=True, return_inverse=True
    )
    pair = np.stack([key // count, key % count], axis=1)
    welded = np.sort(pieces.weld[pair], axis=1)
    _, weld = np.unique(welded[:, 0] * count + welded[:, 1], return_inverse=True)
    return _Edges(pair, edge_of.reshape(-1, 3), weld, first)


def _seen_lengths(
    pieces: _Pieces, edges: _Edges, cameras: Sequence[Camera]
) -> Float[np.ndarray, " e"]:
    """Length of each edge where a camera sees it longest [px]; zero where none does."""
    length = np.zeros(len(edges.ends))
    a, b, c = (pieces.vertices[column] for column in pieces.triangles.T)
    middle, normal = (a + b + c) / 3.0, np.cross(b - a, c - a)
    # Component by component: numpy is ten times slower along a short last axis.
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
    # Both copies of an edge on a crease get the larger of their two lengths.
    both = np.zeros(edges.weld.max() + 1)
    np.maximum.at(both, edges.weld, length)
    return both[edges.weld]


def _in_picture(
    camera: Camera, pixel: Float[np.ndarray, "v 2"], triangles: Triangles
) -> Bool[np.ndarray, " m"]:
    """Triangles whose bounding box overlaps a camera's picture, or nearly so."""
    inside = np.ones(len(triangles), dtype=bool)
    for coordinate, size in zip(pixel.T, picture_size(camera), strict=True):
        a, b, c = (coordinate[column] for column in triangles.T)
        inside &= np.maximum(np.maximum(a, b), c) > -_MAX_OUTSIDE * size
        inside &= np.minimum(np.minimum(a, b), c) < (1.0 + _MAX_OUTSIDE) * size
    return inside


def _edges_to_halve(
    edges: _Edges, length: Float[np.ndarray, " e"], limit: float, room: int
) -> Bool[np.ndarray, " e"]:
    """Edges to bisect: those above the limit, or as many of the longest as `room` allows."""
    marked = length > limit
    if marked.sum() <= room:
        return marked
    # Both copies of an edge on a crease, or neither.
    order = np.lexsort((edges.weld, -length))[:room]
    chosen = np.zeros_like(marked)
    chosen[order] = True
    whole = np.bincount(edges.weld[chosen], minlength=edges.weld.max() + 1)
    count = np.bincount(edges.weld, minlength=edges.weld.max() + 1)
    return chosen & marked & (whole == count)[edges.weld]


def _halved(
    pieces: _Pieces,
    edges: _Edges,
    marked: Bool[np.ndarray, " e"],
    corner: Float[np.ndarray, "k 6 3"],
) -> _Pieces:
    """Bisect marked edges at their midpoint on the base triangle, and split their triangles."""
    number = np.full(len(marked), -1)
    number[marked] = len(pieces.vertices) + np.arange(marked.sum())
    _, weld = np.unique(edges.weld[marked], return_inverse=True)
    middle = 0.5 * (pieces.weight + np.roll(pieces.weight, -1, axis=1))
    first = edges.first[marked]
    shape = quadratic_shapes(middle.reshape(-1, 3)[first])
    position = np.einsum("kn,nka->na", shape, corner[pieces.base[first // 3]])
    split = _split_triangles(
        np.concatenate([pieces.triangles, number[edges.of]], axis=1),
        marked[edges.of],
    )
    weight = np.concatenate([pieces.weight, middle], axis=1)
    return replace(
        pieces,
        vertices=np.concatenate([pieces.vertices, position]),
        weld=np.concatenate([pieces.weld, pieces.weld.max() + 1 + weld]),
        triangles=np.concatenate([vertex for _, _, vertex in split]),
        base=np.concatenate([pieces.base[row] for row, _, _ in split]),
        weight=np.concatenate([weight[row[:, None], local] for row, local, _ in split]),
    )


def _split_triangles(
    vertex: Int[np.ndarray, "m 6"], marked: Bool[np.ndarray, "m 3"]
) -> list[tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k 3"], Int[np.ndarray, "k 3"]]]:
    """Split triangles by their marked edges: parent triangles, local nodes and vertices of parts.

    Local nodes 0 to 2 are the corners, 3 to 5 the midpoints of the edges 01, 12, 20.
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


def texture(
    kind: str,
    points: Points,
    surface: TriangleMesh,
    *,
    size: float,
    rng: np.random.Generator,
) -> PointScalars:
    """Reflectance at points of an object at rest.

    Parameters
    ----------
    kind : "speckle", "natural" or "poor"   natural: wavelengths from `size` to eight times `size`;
                                    poor: faint, to four times `size`, like a bare moulded body,
                                    and deliberately hard to match
    points : (n, 3) float [m]       on the surface, at rest
    surface : TriangleMesh          the surface itself
    size : float [m]                > 0; diameter of a dot, or shortest wavelength
    rng : Generator

    Returns
    -------
    (n,) float [-]                  0 to 1

    Raises
    ------
    InputError                      more dots than can be drawn
    """
    if kind == "speckle":
        return speckle(points, surface, size=size, rng=rng)
    longest, contrast = (8.0, 0.15) if kind == "natural" else (4.0, 0.02)
    return natural(points, coarsest=longest * size, finest=size, contrast=contrast, rng=rng)


def speckle(
    points: Points, surface: TriangleMesh, *, size: float, rng: np.random.Generator
) -> PointScalars:
    """Dark, overlapping dots at random positions on a bright surface, like sprayed paint.

    Half of the surface is covered. The dots are balls around points of the surface, with a smooth
    rim of `RIM` times their diameter.

    Parameters
    ----------
    points : (n, 3) float [m]       on the surface, at rest
    surface : TriangleMesh          that carries the dots
    size : float [m]                > 0; diameter of a dot at half contrast; three to five pixels
                                    are best for matching
    rng : Generator                 of the dots' positions

    Returns
    -------
    (n,) float [-]                  reflectance, 0.1 to 0.9

    Raises
    ------
    InputError                      more dots than can be drawn
    """
    centres = random_points(surface, rng.poisson(dot_count(surface, size)), rng)
    if len(centres) == 0:
        return np.full(len(points), _BRIGHT)
    distance, _ = cKDTree(centres).query(points)
    # 1 inside, 0 outside; a cubic step of width RIM size around half the diameter.
    inside = np.clip(0.5 + (0.5 * size - distance) / (RIM * size), 0.0, 1.0)
    return _BRIGHT + (_DARK - _BRIGHT) * inside**2 * (3.0 - 2.0 * inside)


def dot_count(surface: TriangleMesh, size: float) -> float:
    """Expected number of dots of a speckle pattern.

    Parameters
    ----------
    surface : TriangleMesh          that carries the dots
    size : float [m]                > 0; diameter of a dot

    Returns
    -------
    float

    Raises
    ------
    InputError                      more than `_MAX_DOTS`

    Source
    ------
    Boolean model: discs of area a, lambda of them in unit area, cover 1 - exp(-lambda a).
    """
    area = triangle_areas(surface).sum()
    expected = float(-np.log1p(-_COVERAGE) / (0.25 * np.pi * size**2) * area)
    if expected > _MAX_DOTS:
        raise InputError(
            f"size is {size:g} m; dots of it on {area:.3g} m^2 are {expected:.2g}, and at most"
            f" {_MAX_DOTS:.0e} are drawn: make them larger, and check the unit of length"
        )
    return expected


def natural(
    points: Points,
    *,
    coarsest: float,
    finest: float,
    contrast: float,
    rng: np.random.Generator,
) -> PointScalars:
    """Random blotches of all sizes, as on stone, skin or foam: octaves of smooth random waves.

    Every octave has twice the power of the next finer one, like the scale-free spectrum of
    photographs of natural objects.

    Parameters
    ----------
    points : (n, 3) float [m]       at rest; anywhere in space
    coarsest, finest : float [m]    longest and shortest wavelength, > 0
    contrast : float [-]            standard deviation of the reflectance, 0 to 0.25
    rng : Generator                 of the waves

    Returns
    -------
    (n,) float [-]                  reflectance, in 0 to 1 and 0.5 on average
    """
    octaves = max(1, int(np.ceil(np.log2(coarsest / finest) - 1e-9)))
    total = np.zeros(len(points))
    power = 0.0
    for k in range(octaves):
        shortest = finest * 2.0**k
        weight = 2.0 ** (0.5 * k)
        total += weight * _waves(points, shortest, min(2.0 * shortest, coarsest), rng)
        power += weight**2
    # Smooth saturation keeps the reflectance within 0 to 1: 5 % of the points would lie beyond two
    # standard deviations.
    return 0.5 + contrast * _REACH * np.tanh(total / (_REACH * np.sqrt(power)))


def _waves(
    points: Points, shortest: float, longest: float, rng: np.random.Generator
) -> PointScalars:
    """Sum of plane waves with random directions and wavelengths in a range; unit variance."""
    direction = rng.normal(size=(_WAVES, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    length = shortest * (longest / shortest) ** rng.random(_WAVES)
    number = (2.0 * np.pi / length)[:, None] * direction
    phase = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    total = np.empty(len(points))
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        total[part] = np.cos(points[part] @ number.T + phase).sum(axis=1)
    return np.sqrt(2.0 / _WAVES) * total
