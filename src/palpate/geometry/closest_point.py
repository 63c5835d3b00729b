"""Closest points of a triangle surface, which tie observations to the mesh."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import fixed_array, lengths
from palpate.geometry.triangle_mesh import (
    TriangleMesh,
    bounding_diagonal,
    split_sides,
    unit_normals,
)
from palpate.shapes import PointIndices, Points, PointScalars, TriangleScalars, Vector3

_POINTS_PER_BLOCK = 4096
# Up to this many points, a loop is faster than setting up a `SurfaceSearch`.
_FEW_POINTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePoints:
    """Points of a triangle surface, each in one triangle at barycentric coordinates.

    Parameters
    ----------
    triangle : (n,) int             index of the triangle
    barycentric : (n, 3) float [-]  weights of its three vertices, each in [0, 1], sum 1
    position : (n, 3) float [m]     the point on the surface
    distance : (n,) float [m]       to the query point, >= 0
    """

    triangle: PointIndices
    barycentric: Points
    position: Points
    distance: PointScalars


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSearch:
    """Search structure for the closest points of a surface (`surface_search`).

    Attributes
    ----------
    mesh : TriangleMesh
    tree : cKDTree                  centres of spheres that cover the triangles
    radius : (s,) float [m]         of each sphere
    owner : (s,) int                triangle of which each sphere covers a piece
    diagonal : float [m]            bounding diagonal of the mesh
    """

    mesh: TriangleMesh
    tree: cKDTree
    radius: Float[np.ndarray, " s"]
    owner: Int[np.ndarray, " s"]
    diagonal: float

    def closest(self, points: Points) -> SurfacePoints:
        """Point of the surface nearest to each finite point, (n, 3) [m]; see `closest_points`."""
        triangle, barycentric = np.zeros(len(points), dtype=np.int64), np.zeros((len(points), 3))
        for begin in range(0, len(points), _POINTS_PER_BLOCK):
            block = slice(begin, begin + _POINTS_PER_BLOCK)
            triangle[block], barycentric[block] = _closest_in_block(self, points[block])
        return _surface_points(self.mesh, triangle, barycentric, points)


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
    on_edge, whole = zero.sum(axis=1) == 1, np.zeros(len(mesh.triangles), dtype=np.int64)
    side = (zero.argmax(axis=1) + 1) % 3
    normal[on_edge] += normals[split_sides(mesh, whole).twin[closest.triangle, side][on_edge] // 3]
    on_vertex = zero.sum(axis=1) == 2
    nearest = mesh.triangles[closest.triangle, closest.barycentric.argmax(axis=1)]
    normal[on_vertex] = at_vertex[nearest[on_vertex]]
    return np.einsum("na,na->n", points - closest.position, normal) < 0.0


def _surface_points(
    mesh: TriangleMesh, triangle: PointIndices, barycentric: Points, points: Points
) -> SurfacePoints:
    """The points of the surface that belong to the query points."""
    position = np.einsum("nv,nva->na", barycentric, mesh.vertices[mesh.triangles[triangle]])
    return SurfacePoints(triangle, barycentric, position, lengths(points - position))


def closest_points(mesh: TriangleMesh, points: Points) -> SurfacePoints:
    """Point of the surface nearest to each given point.

    Where several triangles are equally near (an edge, a vertex), the one of lowest index is taken.

    Parameters
    ----------
    mesh : TriangleMesh
    points : (n, 3) float [m]       finite

    Returns
    -------
    SurfacePoints                   n points

    Raises
    ------
    InputError                      points of a wrong shape or not finite

    Source
    ------
    Ericson, Real-Time Collision Detection (2005), section 5.1.5, vectorised. Candidates come from
    spheres that cover the triangles, so the result is exact, not approximate.
    """
    points = fixed_array(points, name="points", shape=(None, 3))
    if len(points) > _FEW_POINTS:
        return surface_search(mesh).closest(points)
    return _surface_points(mesh, *_closest_of_few(mesh, points), points)


def distinct_points(
    parts: Sequence[SurfacePoints],
) -> tuple[SurfacePoints, list[Int[np.ndarray, " _"]]]:
    """Merge several sets of points, with every position once.

    Parameters
    ----------
    parts : sequence of SurfacePoints     at least one; points of equal position are merged

    Returns
    -------
    SurfacePoints
    list of int arrays                    for each set, the indices of its points in the result
    """
    position = np.concatenate([part.position for part in parts])
    _, first, number = np.unique(position, axis=0, return_index=True, return_inverse=True)
    distinct = SurfacePoints(
        np.concatenate([part.triangle for part in parts])[first],
        np.concatenate([part.barycentric for part in parts])[first],
        position[first],
        np.concatenate([part.distance for part in parts])[first],
    )
    ends = np.cumsum([len(part.triangle) for part in parts])
    return distinct, np.split(number.ravel(), ends[:-1])


def surface_search(mesh: TriangleMesh) -> SurfaceSearch:
    """Cover every triangle with spheres of similar size.

    Large triangles are bisected until the pieces are no larger than twice the median, so that one
    of them is not a candidate for all points.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    SurfaceSearch
    """
    corner = mesh.vertices[mesh.triangles]
    limit = 2.0 * float(np.median(_sphere_radius(corner)))
    pieces, owner = small_pieces(corner, lambda piece: _sphere_radius(piece) > limit)
    tree, radius = cKDTree(pieces.mean(axis=1)), _sphere_radius(pieces)
    return SurfaceSearch(mesh, tree, radius, owner, bounding_diagonal(mesh))


def small_pieces(
    corner: Float[np.ndarray, "m 3 3"], is_large: Callable[[np.ndarray], np.ndarray]
) -> tuple[Float[np.ndarray, "s 3 3"], Int[np.ndarray, " s"]]:
    """Halve triangles across their longest edges until none is large.

    Parameters
    ----------
    corner : (m, 3, 3) float [m]    corners of the triangles
    is_large : callable             (k, 3, 3) float -> (k,) bool

    Returns
    -------
    (s, 3, 3) float [m], (s,) int   corners of the pieces, and the triangle that each is a part of
    """
    owner = np.arange(len(corner))
    done: list[tuple[np.ndarray, np.ndarray]] = []
    while len(corner):
        large = is_large(corner)
        done.append((corner[~large], owner[~large]))
        corner, owner = _halved(corner[large]), np.repeat(owner[large], 2)
    return np.concatenate([pair[0] for pair in done]), np.concatenate([pair[1] for pair in done])


def triangle_distances(mesh: TriangleMesh, point: Vector3) -> TriangleScalars:
    """Distance of every triangle from one point, 0 for a triangle that contains it.

    Parameters
    ----------
    mesh : TriangleMesh
    point : (3,) float [m]

    Returns
    -------
    (m,) float [m]                  straight-line distance to the triangle's nearest point

    Raises
    ------
    InputError                      point of a wrong shape or not finite
    """
    point = fixed_array(point, name="point", shape=(3,))
    corner = mesh.vertices[mesh.triangles]
    barycentric = _closest_in_triangle(corner, np.broadcast_to(point, (len(corner), 3)))
    return np.linalg.norm(np.einsum("ev,eva->ea", barycentric, corner) - point, axis=1)


def _sphere_radius(corner: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, " s"]:
    """Largest distance of a corner from the centroid [m]."""
    return lengths(corner - corner.mean(axis=1, keepdims=True)).max(axis=1)


def _halved(corner: Float[np.ndarray, "s 3 3"]) -> Float[np.ndarray, "t 3 3"]:
    """Each triangle cut in two at the middle of its longest edge (edge i is opposite vertex i)."""
    edge = np.roll(corner, -1, axis=1) - np.roll(corner, 1, axis=1)
    apex = np.linalg.norm(edge, axis=2).argmax(axis=1)
    row = np.arange(len(corner))
    a, b, c = (corner[row, (apex + k) % 3] for k in range(3))
    middle = 0.5 * (b + c)
    halves = np.stack([np.stack([a, b, middle], axis=1), np.stack([a, middle, c], axis=1)], axis=1)
    return halves.reshape(-1, 3, 3)


def _closest_in_block(search: SurfaceSearch, points: Points) -> tuple[PointIndices, Points]:
    """Triangle and barycentric coordinates of the closest point, for a few thousand points."""
    mesh, tree, radius = search.mesh, search.tree, search.radius
    near, _ = tree.query(points)
    # The centroid of a piece is on the surface: its distance bounds the answer from above.
    reach = near + radius.max()
    candidates = tree.query_ball_point(points, reach * (1.0 + 1e-12), return_sorted=False)
    counts = np.fromiter(map(len, candidates), np.int64, len(candidates))
    piece = np.fromiter(chain.from_iterable(candidates), np.int64, int(counts.sum()))
    row = np.repeat(np.arange(len(points)), counts)
    gap = lengths(points[row] - tree.data[piece]) - radius[piece]
    keep = gap <= near[row] * (1.0 + 1e-12)
    # Each pair of a point and a triangle once, by point and then by triangle.
    pair = np.unique(row[keep] * len(mesh.triangles) + search.owner[piece[keep]])
    return _nearest_of_pairs(mesh, points, *np.divmod(pair, len(mesh.triangles)))


def _closest_of_few(mesh: TriangleMesh, points: Points) -> tuple[PointIndices, Points]:
    """Closest points of a few points, without a search structure."""
    corner = mesh.vertices[mesh.triangles]
    gap = lengths(corner.mean(axis=1) - points[:, None])
    near = gap - _sphere_radius(corner) <= gap.min(axis=1, keepdims=True) * (1.0 + 1e-12)
    return _nearest_of_pairs(mesh, points, *np.nonzero(near))


def _nearest_of_pairs(
    mesh: TriangleMesh,
    points: Points,
    row: Int[np.ndarray, " p"],
    triangle: Int[np.ndarray, " p"],
) -> tuple[PointIndices, Points]:
    """The nearest of the triangles that each point is paired with, and barycentric coordinates of
    its closest point. Pairs are in the order of points and triangles; every point has one."""
    corner = mesh.vertices[mesh.triangles[triangle]]
    barycentric = _closest_in_triangle(corner, points[row])
    distance = lengths(np.einsum("nv,nva->na", barycentric, corner) - points[row])
    # The first of the nearest triangles of each point.
    begin = np.searchsorted(row, np.arange(len(points)))
    nearest = np.flatnonzero(distance == np.minimum.reduceat(distance, begin)[row])
    best = nearest[np.searchsorted(nearest, begin)]
    return triangle[best], barycentric[best]


def _closest_in_triangle(
    corner: Float[np.ndarray, "p 3 3"], point: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Barycentric coordinates of the point of each triangle nearest to its point, (p, 3)."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    normal = np.cross(b - a, c - a)
    square = np.einsum("pa,pa->p", normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        weight_b = np.einsum("pa,pa->p", np.cross(point - a, c - a), normal) / square
        weight_c = np.einsum("pa,pa->p", np.cross(b - a, point - a), normal) / square
    inner = np.stack([1.0 - weight_b - weight_c, weight_b, weight_c], axis=1)
    inside = np.isfinite(inner).all(axis=1) & (inner >= 0.0).all(axis=1)
    best = np.where(inside[:, None], inner, 0.0)
    best_square = np.where(inside, -1.0, np.inf)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        p, q = corner[:, start], corner[:, end]
        length = np.einsum("pa,pa->p", q - p, q - p)
        along = np.einsum("pa,pa->p", point - p, q - p) / np.where(length > 0.0, length, 1.0)
        t = np.clip(along, 0.0, 1.0)
        gap = p + t[:, None] * (q - p) - point
        gap_square = np.einsum("pa,pa->p", gap, gap)
        closer = gap_square < best_square
        best_square = np.where(closer, gap_square, best_square)
        weight = np.zeros_like(best)
        weight[:, start], weight[:, end] = 1.0 - t, t
        best = np.where(closer[:, None], weight, best)
    return best


def ray_intersection(mesh: TriangleMesh, origin: Vector3, direction: Vector3) -> Vector3 | None:
    """First intersection of a ray with a surface, from outside.

    Parameters
    ----------
    mesh : TriangleMesh
    origin : (3,) float [m]
    direction : (3,) float          of any length

    Returns
    -------
    (3,) float [m] or None          None if there is no intersection

    Source
    ------
    Moeller and Trumbore, J. Graphics Tools 2 (1997) 21
    """
    first, second, third = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    side, other = second - first, third - first
    first_cross = np.cross(direction, other)
    scale = np.einsum("ma,ma->m", side, first_cross)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin - first
        u = np.einsum("ma,ma->m", offset, first_cross) / scale
        second_cross = np.cross(offset, side)
        v = second_cross @ direction / scale
        distance = np.einsum("ma,ma->m", other, second_cross) / scale
        # From outside: the ray runs against the normal.
        hit = (scale > 0.0) & (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
    if not hit.any():
        return None
    return np.asarray(origin + distance[hit].min() * direction)
