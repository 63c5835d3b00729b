"""A triangle surface seen from one side, as flat shaded polygons for a 2-D plot."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from palpate.geometry import TriangleMesh, unit_normals
from palpate.shapes import Matrix3, Points, TriangleScalars, Vector3

LEAST_FACING = 0.25  # cosine between normal and view under which a point is hard to see
ELEVATIONS = (15.0, 30.0, 45.0, 65.0)  # degrees above the horizon that a view is chosen from
AZIMUTHS = 24
LIGHT = (-0.45, 0.55, 0.70)  # in the viewer's frame: left, above, in front


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceView:
    """What is seen of a surface: its front triangles from the farthest to the nearest.

    Attributes
    ----------
    R_view_object : (3, 3) float      rows: right, up, toward the viewer
    polygons : (m, 3, 2) float [m]    corners in the picture plane
    brightness : (m,) float           0 dark to 1 bright
    """

    R_view_object: Matrix3
    polygons: Float[np.ndarray, "m 3 2"]
    brightness: TriangleScalars


def best_direction(normals: Points, contact_normal: Vector3) -> Vector3:
    """Direction toward the viewer from which most points, and the contact, are seen.

    Parameters
    ----------
    normals : (n, 3) float      outward unit normals at the observed points
    contact_normal : (3,) float outward unit normal at the contact

    Returns
    -------
    (3,) float, unit; z is taken as up
    """
    azimuth = np.radians(np.arange(AZIMUTHS) * 360.0 / AZIMUTHS - 60.0)
    elevation = np.radians(ELEVATIONS)
    phi, theta = (grid.ravel() for grid in np.meshgrid(azimuth, elevation))
    views = np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], 1)
    facing = normals @ views.T
    score = (facing > LEAST_FACING).mean(axis=0)
    # Half from the side is better than straight at the points: the shape is seen too.
    score -= 0.1 * np.abs(facing.mean(axis=0) - 0.6)
    score += 0.3 * np.clip(contact_normal @ views.T, -0.5, 0.5)
    return views[int(np.argmax(score))]


def make_view(mesh: TriangleMesh, direction: Vector3) -> SurfaceView:
    """The surface seen from far away along a direction.

    Parameters
    ----------
    mesh : TriangleMesh
    direction : (3,) float      unit, toward the viewer
    """
    rotation = _rotation(direction)
    corners = (mesh.vertices @ rotation.T)[mesh.triangles]
    normals = unit_normals(mesh) @ rotation.T
    front = np.flatnonzero(normals[:, 2] > 0.0)
    order = front[np.argsort(corners[front, :, 2].mean(axis=1))]
    light = np.array(LIGHT) / np.linalg.norm(LIGHT)
    brightness = np.clip(normals[order] @ light, 0.0, 1.0)
    return SurfaceView(rotation, corners[order, :, :2], brightness)


def projected(view: SurfaceView, points: Shaped[np.ndarray, "*n 3"]) -> Shaped[np.ndarray, "*n 3"]:
    """Points or vectors in the viewer's frame: right, up, toward the viewer [m]."""
    return points @ view.R_view_object.T


def _rotation(direction: Vector3) -> Matrix3:
    """Rows right, up, toward the viewer; the object's z points up in the picture."""
    right = np.cross([0.0, 0.0, 1.0], direction)
    if np.linalg.norm(right) < 1e-6:
        right = np.array([1.0, 0.0, 0.0])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction])
