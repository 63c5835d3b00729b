"""Smooth sides of a triangle mesh: where normals, tractions and gradients may jump, and where they
may not."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from palpate.geometry.triangle_mesh import (
    TriangleMesh,
    connected_components,
    half_edges,
    unit_normals,
)
from palpate.shapes import Vector3

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
