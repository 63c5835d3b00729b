"""Evenly spaced points on a surface and inside it, for use as the nodes of a mesh.

Many candidate points are thinned to a minimum distance, a fraction of the wanted spacing; each
point kept is then moved to the centroid of the candidates nearest to it (Lloyd's algorithm). The
candidates are deterministic sequences, so that the same surface gives the same points.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from palpate.geometry import (
    CREASE_ANGLE,
    Sides,
    TriangleMesh,
    closest_points,
    half_edges,
    split_sides,
    unit_normals,
)
from palpate.shapes import Points, PointScalars

Spacing = Callable[[np.ndarray], np.ndarray]

# Least distance of points, as a fraction of the spacing: thinned points lie 1.0 to 2.0 times this
# apart, about 1.35 times after smoothing.
_NEAREST = 0.75
# Candidates per square of the spacing: enough for an accurate centroid.
_CANDIDATES = 40.0
_LLOYD_ROUNDS = 8
# Candidates on sharp edges lie at most this fraction of the spacing apart.
_PIECE = 0.25
# The spacing grows by this much per metre away from a refined region: neighbours differ little.
_GROWTH = 0.3
# Least distance of interior points from the surface, as a fraction of the spacing: a regular
# tetrahedron is 0.8 of its edge high, and a flatter first layer is better than slivers.
_OFF_SURFACE = 0.6
# Edge of the cubic cells of a body-centred lattice, as a multiple of the spacing: its nearest
# (0.87 cells) and second nearest neighbours (1 cell) are then about one spacing apart.
_CELL = 1.08
# Distance of candidates, as a fraction of the spacing, where the spacing varies: with fewer, the
# thinned points would be uneven.
_CHOICE = 0.5
_EIGHTHS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)


def make_spacing(edge: float, fine: Sequence[tuple[np.ndarray, float, float]]) -> Spacing:
    """Wanted spacing of points as a function of position.

    Parameters
    ----------
    edge : float [m]                    spacing far from the refined regions
    fine : (point (3,), radius, edge)   refined regions: at most `edge` [m] within `radius` [m] of
                                        `point`

    Returns
    -------
    (n, 3) -> (n,) float [m]            grows by 0.3 m/m outside a refined region
    """

    # A refined line is many regions with the same radius and edge: only the nearest one matters.
    kinds: dict[tuple[float, float], list[np.ndarray]] = {}
    for centre, radius, small in fine:
        kinds.setdefault((radius, small), []).append(centre)
    trees = [(cKDTree(np.array(centres)), *kind) for kind, centres in kinds.items()]

    def spacing(points: np.ndarray) -> np.ndarray:
        size = np.full(len(points), edge)
        for tree, radius, small in trees:
            beyond = np.clip(tree.query(points)[0] - radius, 0.0, None)
            size = np.minimum(size, small + _GROWTH * beyond)
        return size

    return spacing


def surface_points(
    mesh: TriangleMesh, spacing: Spacing, marked: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "n 3"]:
    """Evenly spaced points on a surface, including points on its sharp edges and corners.

    Parameters
    ----------
    mesh : TriangleMesh                 closed
    spacing : (n, 3) -> (n,) [m]        of `make_spacing`
    marked : (k, 3) float [m]           points of the surface that are included, except those too
                                        close to a sharp edge or to each other

    Returns
    -------
    (n, 3) float [m]
    """
    sharp = _crease_candidates(mesh, spacing)
    fixed = _thinned(np.concatenate([sharp, marked]), spacing)
    candidates, share = _surface_candidates(mesh, spacing)
    points = _thinned(np.concatenate([fixed, candidates]), spacing)
    for _ in range(_LLOYD_ROUNDS):
        _, owner = cKDTree(points).query(candidates)
        weight = np.bincount(owner, share, minlength=len(points))
        centre = np.stack(
            [np.bincount(owner, share * candidates[:, i], minlength=len(points)) for i in range(3)],
            axis=1,
        )
        moves = weight > 0.0
        moves[: len(fixed)] = False
        points[moves] = centre[moves] / weight[moves, None]
    points[len(fixed) :] = closest_points(mesh, points[len(fixed) :]).position
    return points


def volume_points(mesh: TriangleMesh, spacing: Spacing, shell: Points) -> Float[np.ndarray, "k 3"]:
    """Points inside a closed surface, at a distance from the points on it.

    Parameters
    ----------
    mesh : TriangleMesh                 closed, outward normals
    spacing : (n, 3) -> (n,) [m]        of `make_spacing`
    shell : (n, 3) float [m]            the points on the surface

    Returns
    -------
    (k, 3) float [m]                    a body-centred lattice where the spacing is constant,
                                        thinned points of finer lattices where it decreases
    """
    largest = float(spacing(mesh.vertices).max())
    cell = _CELL * largest
    corner = _lattice(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), cell)
    levels = []
    while len(corner):
        levels += [corner, corner + 0.5 * cell]
        size = spacing(levels[-1])
        split = (size < largest) & (cell > _CHOICE * (size - _GROWTH * cell))
        cell *= 0.5
        corner = (corner[split][:, None] + cell * _EIGHTHS).reshape(-1, 3)
    points = np.concatenate(levels)
    distance, _ = cKDTree(shell).query(points)
    # The cheap test first: testing whether points are inside is costly.
    points = _thinned(points[distance > _OFF_SURFACE * spacing(points)], spacing)
    points = points[inside(mesh, points)]
    gap = closest_points(mesh, points).distance
    return points[gap > _OFF_SURFACE * spacing(points)]


def inside(mesh: TriangleMesh, points: Points) -> Bool[np.ndarray, " n"]:
    """Which points lie inside a closed surface with outward normals.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward normals
    points : (n, 3) float [m]

    Returns
    -------
    (n,) bool

    Source
    ------
    Baerentzen and Aanaes, Signed distance computation using the angle weighted pseudonormal (2005):
    the sign of the offset from the closest surface point along the pseudonormal of the face, edge
    or vertex that contains it.
    """
    closest = closest_points(mesh, points)
    normals = unit_normals(mesh)
    corner = mesh.vertices[mesh.triangles]
    along = np.roll(corner, -1, axis=1) - corner
    along /= np.linalg.norm(along, axis=2, keepdims=True)
    cosine = -np.einsum("mva,mva->mv", along, np.roll(along, 1, axis=1))
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    at_vertex = np.zeros_like(mesh.vertices)
    np.add.at(at_vertex, mesh.triangles, angle[:, :, None] * normals[:, None])
    # An edge's pseudonormal is the sum of its two faces' normals. The normal of one of these faces
    # alone would give the wrong sign in ties across a sharp edge.
    zero = closest.barycentric <= 1e-9
    normal = normals[closest.triangle]
    on_edge = zero.sum(axis=1) == 1
    side = (zero.argmax(axis=1) + 1) % 3
    normal[on_edge] += normals[_sides(mesh).twin[closest.triangle, side][on_edge] // 3]
    on_vertex = zero.sum(axis=1) == 2
    nearest = mesh.triangles[closest.triangle, closest.barycentric.argmax(axis=1)]
    normal[on_vertex] = at_vertex[nearest[on_vertex]]
    return np.einsum("na,na->n", points - closest.position, normal) < 0.0


def _crease_candidates(mesh: TriangleMesh, spacing: Spacing) -> Points:
    """Corners, where sharp edges end or turn, followed by points along the sharp edges."""
    normals = unit_normals(mesh)
    sides = _sides(mesh)
    edge = half_edges(mesh.triangles).ends[sides.cut]
    along = mesh.vertices[edge[:, 1]] - mesh.vertices[edge[:, 0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    degree = np.bincount(edge.ravel(), minlength=len(mesh.vertices))
    straight = np.zeros((len(mesh.vertices), 3))
    np.add.at(straight, edge[:, 0], along)
    np.add.at(straight, edge[:, 1], -along)
    sharp = np.linalg.norm(straight, axis=1) > 2.0 * np.sin(0.5 * CREASE_ANGLE)
    ends_or_turns = (degree > 0) & ((degree != 2) | sharp)
    corners = mesh.vertices[ends_or_turns | ((degree == 0) & _pointed(mesh, normals))]
    piece, points = mesh.vertices[edge], [corners]
    while len(piece):
        points.append(piece.reshape(-1, 3))
        middle = piece.mean(axis=1)
        long = np.linalg.norm(piece[:, 1] - piece[:, 0], axis=1) > _PIECE * spacing(middle)
        start, middle, end = piece[long, 0], middle[long], piece[long, 1]
        piece = np.concatenate(
            [np.stack(ends, axis=1) for ends in ((start, middle), (middle, end))]
        )
    return np.concatenate(points)


def _sides(mesh: TriangleMesh) -> Sides:
    """Edges of a mesh, with the sharp ones marked."""
    return split_sides(mesh, np.zeros(len(mesh.triangles), dtype=np.int64))


def _pointed(mesh: TriangleMesh, normals: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " v"]:
    """Vertices like the apex of a cone: pointed, although none of their edges is sharp."""
    mean = np.zeros_like(mesh.vertices)
    np.add.at(mean, mesh.triangles, normals[:, None])
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    level = np.einsum("mva,ma->mv", mean[mesh.triangles], normals)
    pointed = np.zeros(len(mesh.vertices), dtype=bool)
    pointed[mesh.triangles[level < np.cos(CREASE_ANGLE)]] = True
    return pointed


def _surface_candidates(mesh: TriangleMesh, spacing: Spacing) -> tuple[Points, PointScalars]:
    """Candidate points on a surface, and the fraction of a wanted point that each represents."""
    corner, small = mesh.vertices[mesh.triangles], []
    while len(corner):
        longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
        large = longest > spacing(corner.mean(axis=1))
        small.append(corner[~large])
        a, b, c = corner[large].transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
        corner = np.concatenate([np.stack(part, axis=1) for part in quarters])
    corner = np.concatenate(small)
    side = corner[:, 1:] - corner[:, :1]
    share = 0.5 * np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    share /= spacing(corner.mean(axis=1)) ** 2
    count = np.maximum(1, np.ceil(_CANDIDATES * share)).astype(np.int64)
    row = np.repeat(np.arange(len(share)), count)
    k = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    # Roberts' two-dimensional low-discrepancy sequence, with another start in each triangle.
    u = (0.5 + 0.7548776662466927 * k + 0.6180339887498949 * row) % 1.0
    v = (0.5 + 0.5698402909980532 * k + 0.4142135623730951 * row) % 1.0
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    points = corner[row, 0] + u[:, None] * side[row, 0] + v[:, None] * side[row, 1]
    return points, (share / count)[row]


def _lattice(low: np.ndarray, high: np.ndarray, cell: float) -> Points:
    """Corners of a cubic lattice that covers a box and is centred on it."""
    count = np.ceil((high - low) / cell).astype(int) + 1
    start = 0.5 * (low + high) - 0.5 * cell * count
    axes = [start[i] + cell * np.arange(count[i] + 1) for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _thinned(points: Points, spacing: Spacing) -> Float[np.ndarray, "k 3"]:
    """Greedy thinning in the given order: drops points too close to one already kept."""
    if not len(points):
        return points
    tree = cKDTree(points)
    reach = _NEAREST * spacing(points)
    alive = np.ones(len(points), dtype=bool)
    kept = []
    for i in range(len(points)):
        if alive[i]:
            kept.append(i)
            alive[tree.query_ball_point(points[i], reach[i], return_sorted=False)] = False
    return points[kept]
