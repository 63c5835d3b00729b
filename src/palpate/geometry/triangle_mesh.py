"""Triangle surfaces, and what follows directly from them: normals, areas, edges, smooth sides.

A side is a part of the surface within which normals, tractions and gradients are continuous; they
may jump from one side to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csgraph
from scipy.spatial import ConvexHull, QhullError

from palpate.arrays import fixed_array
from palpate.errors import InputError, MeshError
from palpate.shapes import (
    Flags,
    Indices,
    Points,
    Triangles,
    TriangleScalars,
    TriangleVectors,
    Vector3,
    Vertices,
)

CREASE_ANGLE = np.radians(40.0)
# Cosine between normals below which a face lies beside another one: what presses on that does not
# press on it. Some degrees less than a right angle, so that rounding does not decide.
BESIDE = 0.1
_MORTON_BITS = 10
# Largest difference in volume between a mesh and its convex hull, relative to the latter.
_CONVEXITY_TOLERANCE = 1e-6
# Decimals, of the normal and of the offset over the body's size, to which planes are the same.
_PLANE_DECIMALS = 9


@dataclass(frozen=True, slots=True, eq=False)
class TriangleMesh:
    """Triangle surface of an object at rest; `checked_mesh` checks whether it is closed.

    Parameters
    ----------
    vertices : (v, 3) float [m]
    triangles : (m, 3) int          vertex indices, counter-clockwise seen from outside

    Raises
    ------
    MeshError                       no triangles, an index out of range
    InputError                      wrong shape, not finite
    """

    vertices: Vertices
    triangles: Triangles

    def __post_init__(self) -> None:
        vertices = fixed_array(self.vertices, name="vertices", shape=(None, 3))
        triangles = fixed_array(self.triangles, name="triangles", shape=(None, 3), integer=True)
        if len(triangles) == 0:
            raise MeshError("the mesh has no triangles; give a closed triangle surface")
        low, high = int(triangles.min()), int(triangles.max())
        if low < 0 or high >= len(vertices):
            raise MeshError(
                f"triangles use vertex indices {low} to {high}, but there are {len(vertices)}"
                f" vertices (0 to {len(vertices) - 1}); write the mesh file again"
            )
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "triangles", triangles)

    def __repr__(self) -> str:
        sides = " x ".join(f"{1e3 * side:.4g}" for side in np.ptp(self.vertices, axis=0))
        return (
            f"TriangleMesh: {len(self.vertices)} vertices, {len(self.triangles)} triangles,"
            f" {sides} mm"
        )


def area_vectors(mesh: TriangleMesh) -> TriangleVectors:
    """Outward normal of every triangle times its area.

    Parameters
    ----------
    mesh : TriangleMesh             of m triangles

    Returns
    -------
    (m, 3) float [m^2]              they sum to zero over a closed surface
    """
    corner = mesh.vertices[mesh.triangles]
    return 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def triangle_areas(mesh: TriangleMesh) -> TriangleScalars:
    """Area of every triangle.

    Parameters
    ----------
    mesh : TriangleMesh             of m triangles

    Returns
    -------
    (m,) float [m^2]                >= 0
    """
    return np.linalg.norm(area_vectors(mesh), axis=1)


def random_points(mesh: TriangleMesh, count: int, rng: np.random.Generator) -> Points:
    """Random points, uniformly distributed over the area of a surface.

    Parameters
    ----------
    mesh : TriangleMesh
    count : int
    rng : Generator

    Returns
    -------
    (count, 3) float [m]
    """
    cumulative = np.cumsum(triangle_areas(mesh))
    triangle = np.searchsorted(cumulative, rng.random(count) * cumulative[-1])
    corner = mesh.vertices[mesh.triangles[np.minimum(triangle, len(cumulative) - 1)]]
    a, b = rng.random((2, count))
    root = np.sqrt(a)
    weight = np.stack([1.0 - root, root * (1.0 - b), root * b], axis=1)
    return np.einsum("kc,kca->ka", weight, corner)


def unit_normals(mesh: TriangleMesh) -> TriangleVectors:
    """Outward unit normal of every triangle.

    Parameters
    ----------
    mesh : TriangleMesh             of m triangles

    Returns
    -------
    (m, 3) float [-]

    Raises
    ------
    MeshError                       a triangle of zero area has no normal
    """
    vectors = area_vectors(mesh)
    areas = np.linalg.norm(vectors, axis=1)
    flat = np.flatnonzero(areas == 0.0)
    if len(flat):
        raise MeshError(
            f"{len(flat)} triangles have zero area, the first: {flat[:5].tolist()};"
            " remove them (most mesh programs: merge close vertices)"
        )
    return vectors / areas[:, None]


def vertex_normals(vertices: Vertices, triangles: Triangles) -> Vertices:
    """Unit normals at vertices: the mean over the triangles around, weighted with their area.

    Parameters
    ----------
    vertices : (v, 3) float [m]     at rest or moved
    triangles : (m, 3) int          counter-clockwise seen from outside

    Returns
    -------
    (v, 3) float [-]                zero at a vertex without a triangle of positive area
    """
    corner = vertices[triangles]
    area = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    corner_vertex = triangles.ravel()
    total = np.stack(
        [np.bincount(corner_vertex, np.repeat(area[:, k], 3), len(vertices)) for k in range(3)],
        axis=1,
    )
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return total / np.where(length > 0.0, length, 1.0)


def enclosed_volume(mesh: TriangleMesh) -> float:
    """Volume inside a closed surface.

    Parameters
    ----------
    mesh : TriangleMesh             closed

    Returns
    -------
    float [m^3]                     negative where the normals point inward

    Source
    ------
    Divergence theorem with the field x / 3, about the centroid of the vertices to limit rounding.
    """
    corner = mesh.vertices[mesh.triangles] - mesh.vertices.mean(axis=0)
    return float(np.einsum("ea,ea->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0)


def bounding_diagonal(mesh: TriangleMesh) -> float:
    """Length of the diagonal of the box that holds all used vertices.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    float [m]                       > 0
    """
    used = mesh.vertices[mesh.triangles.ravel()]
    return float(np.linalg.norm(used.max(axis=0) - used.min(axis=0)))


@dataclass(frozen=True, slots=True, eq=False)
class HalfEdges:
    """The sides of all triangles: half-edge 3 e + i leaves corner i of triangle e for corner i + 1.

    Attributes
    ----------
    tail : (3 m,) int         vertex from which each starts
    following : (3 m,) int    the next one around its triangle
    edge : (3 m,) int         edge on which it lies, the same for both directions
    ends : (k, 2) int         vertices of each edge, the lower one first
    count : (k,) int          half-edges on each edge, 2 on a closed surface
    """

    tail: Indices
    following: Indices
    edge: Indices
    ends: Int[np.ndarray, "e 2"]
    count: Int[np.ndarray, " e"]

    def pairs(self) -> Int[np.ndarray, "p 2"]:
        """The two half-edges of every edge that has exactly two, (p, 2), the lower one first."""
        order = np.argsort(self.edge, kind="stable")
        first = (np.cumsum(self.count) - self.count)[self.count == 2]
        return np.stack([order[first], order[first + 1]], axis=1)

    def rim(self, chosen: Flags) -> Int[np.ndarray, "k 2"]:
        """Both vertices of every edge between a chosen triangle and one that is not.

        Parameters
        ----------
        chosen : (m,) bool

        Returns
        -------
        (k, 2) int
        """
        a, b = self.pairs().T
        return self.ends[self.edge[a[chosen[a // 3] != chosen[b // 3]]]]

    def opposite(self) -> Indices:
        """Opposite half-edge of each half-edge, (3 m,); itself where its edge has not two."""
        a, b = self.pairs().T
        other = np.arange(len(self.tail))
        other[a], other[b] = b, a
        return other


def half_edges(triangles: Triangles) -> HalfEdges:
    """Number the edges of triangles.

    Parameters
    ----------
    triangles : (m, 3) int    vertex indices

    Returns
    -------
    HalfEdges
    """
    tail, head = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    ends, edge, count = np.unique(
        np.sort(np.stack([tail, head], axis=1), axis=1),
        axis=0, return_inverse=True, return_counts=True,
    )  # fmt: skip
    half = np.arange(len(tail))
    following = half - half % 3 + (half + 1) % 3
    return HalfEdges(tail, following, edge.ravel(), ends, count)


def connected_components(links: Int[np.ndarray, "p 2"], count: int) -> tuple[int, Indices]:
    """Connected components of a graph.

    Parameters
    ----------
    links : (p, 2) int        pairs of linked items
    count : int               number of items

    Returns
    -------
    int                       number of components
    (count,) int              component of each item
    """
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    components, label = csgraph.connected_components(graph, directed=False)
    return int(components), label.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """The mesh with its vertices split wherever the surface has an edge.

    A side is a fan of triangles around one vertex in which no edge is cut. An edge is cut where the
    surface turns by more than the crease angle or where the support ends. A corner of a cube has
    three sides, a vertex of a sphere one.

    Attributes
    ----------
    corner : (m, 3) int       side at each corner of each triangle
    vertex : (s,) int         vertex that each side belongs to
    edge : (m, 3) int         edge from corner k to corner k + 1 of each triangle
    twin : (m, 3) int         half-edge 3 * triangle + k on the other side of that edge
    cut : (e,) bool           whether the edge is cut
    """

    corner: Int[np.ndarray, "m 3"]
    vertex: Int[np.ndarray, " s"]
    edge: Int[np.ndarray, "m 3"]
    twin: Int[np.ndarray, "m 3"]
    cut: Bool[np.ndarray, " e"]


def split_sides(
    mesh: TriangleMesh, region: Int[np.ndarray, " m"], *, crease_angle: float = CREASE_ANGLE
) -> Sides:
    """Split the vertices of a mesh at its creases and where one region of its surface ends.

    Parameters
    ----------
    mesh : TriangleMesh               consistently oriented; closed, or with a rim
    region : (m,) int                 label of each triangle (say 1 where held, 0 where free)
    crease_angle : float [rad]        angle between the normals of two triangles above which their
                                      edge is a crease

    Returns
    -------
    Sides
    """
    halves = half_edges(mesh.triangles)
    edge, twin, following = halves.edge, halves.opposite(), halves.following
    normals = unit_normals(mesh)
    triangle = np.arange(edge.size) // 3
    turn = np.einsum("hi,hi->h", normals[triangle], normals[twin // 3])
    cut_half = (turn < np.cos(crease_angle)) | (region[triangle] != region[twin // 3])
    cut_half |= twin == np.arange(edge.size)
    cut = np.zeros(len(halves.ends), dtype=bool)
    cut[edge[cut_half]] = True

    # Across an edge that is not cut the corners at both of its ends belong together.
    joined = np.flatnonzero(~cut_half)
    across = twin[joined]
    corners = np.concatenate([joined, following[joined]])
    partners = np.concatenate([following[across], across])
    count, label = connected_components(np.stack([corners, partners], axis=1), edge.size)
    vertex = np.empty(count, dtype=np.int64)
    vertex[label] = halves.tail
    return Sides(label.reshape(-1, 3), vertex, edge.reshape(-1, 3), twin.reshape(-1, 3), cut)


def cut_distance(
    mesh: TriangleMesh, sides: Sides, triangles: Int[np.ndarray, " k"], point: Vector3
) -> float:
    """Distance of a point from the nearest cut edge of some triangles.

    Parameters
    ----------
    mesh : TriangleMesh
    sides : Sides                     of that mesh
    triangles : (k,) int
    point : (3,) float [m]

    Returns
    -------
    float [m]                         infinite where no edge of theirs is cut
    """
    cut = sides.cut[sides.edge[triangles]]
    corner = mesh.vertices[mesh.triangles[triangles]]
    start, along = corner[cut], (np.roll(corner, -1, axis=1) - corner)[cut]
    fraction = np.einsum("ei,ei->e", point - start, along) / np.einsum("ei,ei->e", along, along)
    nearest = start + np.clip(fraction, 0.0, 1.0)[:, None] * along
    return float(np.linalg.norm(nearest - point, axis=1).min(initial=np.inf))


def morton_order(point: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Order of points along a Morton curve, in which neighbours in space stay close.

    Parameters
    ----------
    point : (n, 3) float [m]  NaN where a position is missing; at least one is not

    Returns
    -------
    (n,) int                  indices; the bounding box is cut into 1024 cells along its longest
                              side, points of one cell keep their order, those without a position
                              come last
    """
    low = np.nanmin(point, axis=0)
    size = max(float((np.nanmax(point, axis=0) - low).max()), np.finfo(float).tiny)
    cell = np.nan_to_num((point - low) / size * (2**_MORTON_BITS - 1)).astype(np.int64)
    bits = (cell[:, None, :] >> np.arange(_MORTON_BITS)[:, None]) & 1
    code = bits.reshape(len(point), -1) @ 2 ** np.arange(3 * _MORTON_BITS)
    code[np.isnan(point).any(axis=1)] = 2 ** (3 * _MORTON_BITS)
    return np.argsort(code, kind="stable")


def convex_planes(mesh: TriangleMesh) -> Float[np.ndarray, "p 4"]:
    """The planes of the faces of a convex mesh, coplanar triangles as one.

    Parameters
    ----------
    mesh : TriangleMesh             closed, convex

    Returns
    -------
    (p, 4) float                    outward unit normals, and their offsets from the origin [m]

    Raises
    ------
    InputError                      a mesh that is flat, open or not convex
    """
    size = float(np.ptp(mesh.vertices, axis=0).max(initial=0.0))
    try:
        hull = ConvexHull(mesh.vertices / size)
    except (QhullError, ValueError, ZeroDivisionError) as error:
        raise InputError("the tool's mesh has no volume; give a closed convex surface") from error
    volume, hull_volume = abs(enclosed_volume(mesh)), hull.volume * size**3
    if hull_volume - volume > _CONVEXITY_TOLERANCE * hull_volume:
        raise InputError(
            f"the tool's mesh holds {1e6 * volume:.4g} ml, its convex hull {1e6 * hull_volume:.4g}"
            " ml; a tool must be convex and closed: give its hull, or several convex tools"
        )
    planes = np.unique(np.round(hull.equations, _PLANE_DECIMALS), axis=0)
    return np.column_stack([planes[:, :3], -size * planes[:, 3]])


def is_outer(faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Which faces of tetrahedra belong to one of them only, and so bound all.

    Parameters
    ----------
    faces : (f, 3) int              vertices, in any order

    Returns
    -------
    (f,) bool
    """
    _, where, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return np.asarray(count[where.ravel()] == 1)


def place_text(point: Vector3 | Sequence[float], *, decimals: int = 2) -> str:
    """Coordinates in millimetres, for a message.

    Parameters
    ----------
    point : (3,) float [m]
    decimals : int                  of the millimetres, at most

    Returns
    -------
    str                             e.g. `(1.25, 0, 40) mm`
    """
    # What is rounded to zero has no sign.
    rounded = np.round(1e3 * np.asarray(point), decimals) + 0.0
    return "(" + ", ".join(f"{x:.10g}" for x in rounded) + ") mm"
