"""Triangle surfaces, and quantities that follow directly from them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from scipy.sparse import coo_array, csgraph

from palpate.arrays import fixed_array
from palpate.errors import MeshError
from palpate.shapes import Flags, Indices, Triangles, TriangleScalars, TriangleVectors, Vertices


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
