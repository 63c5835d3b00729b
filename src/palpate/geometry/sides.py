"""Smooth sides of a triangle mesh: where normals, tractions and gradients may jump, and where they
may not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from palpate.geometry.triangle_mesh import TriangleMesh, unit_normals

CREASE_ANGLE = np.radians(40.0)


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
    """Split the vertices of a closed mesh at its creases and where one region of its surface ends.

    Parameters
    ----------
    mesh : TriangleMesh               closed and consistently oriented
    region : (m,) int                 label of each triangle (say 1 where held, 0 where free)
    crease_angle : float [rad]        angle between the normals of two triangles above which their
                                      edge is a crease

    Returns
    -------
    Sides
    """
    edge, twin = _edges(mesh)
    normals = unit_normals(mesh)
    triangle = np.arange(edge.size) // 3
    other = twin.ravel() // 3
    turn = np.einsum("hi,hi->h", normals[triangle], normals[other])
    cut_half = (turn < np.cos(crease_angle)) | (region[triangle] != region[other])
    cut = np.zeros(edge.max() + 1, dtype=bool)
    cut[edge.ravel()[cut_half]] = True

    joined = np.flatnonzero(~cut_half)
    across = twin.ravel()[joined]
    start, end = joined, _next(joined)
    corners = np.concatenate([start, end])
    partners = np.concatenate([_next(across), across])
    graph = coo_array((np.ones(corners.size), (corners, partners)), shape=(edge.size, edge.size))
    count, label = connected_components(graph, directed=False)
    vertex = np.empty(count, dtype=np.int64)
    vertex[label] = mesh.triangles.ravel()
    return Sides(label.reshape(-1, 3).astype(np.int64), vertex, edge, twin, cut)


def _next(half_edge: Int[np.ndarray, " h"]) -> Int[np.ndarray, " h"]:
    return half_edge - half_edge % 3 + (half_edge + 1) % 3


def _edges(mesh: TriangleMesh) -> tuple[Int[np.ndarray, "m 3"], Int[np.ndarray, "m 3"]]:
    tail = mesh.triangles
    head = np.roll(tail, -1, axis=1)
    ends = np.sort(np.stack([tail.ravel(), head.ravel()], axis=1), axis=1)
    key = ends[:, 0] * np.int64(mesh.vertices.shape[0]) + ends[:, 1]
    _, edge = np.unique(key, return_inverse=True)
    order = np.argsort(edge, kind="stable")
    twin = np.empty(edge.size, dtype=np.int64)
    twin[order[0::2]] = order[1::2]
    twin[order[1::2]] = order[0::2]
    return edge.reshape(-1, 3).astype(np.int64), twin.reshape(-1, 3)
