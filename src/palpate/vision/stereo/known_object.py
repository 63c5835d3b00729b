"""Points of the surface brought onto the mesh of the object that was looked at."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.geometry import (
    Registration,
    TriangleMesh,
    bounding_diagonal,
    refined_surface,
    register,
)
from palpate.records import Rig, camera_centre
from palpate.shapes import Points
from palpate.vision.stereo.stereo import StereoPoints

# Fewer points do not determine a pose.
LEAST_POINTS = 50
# Points this far from the middle of the mesh, in diagonals, are of the table or the wall behind.
_REACH = 0.6
# Parts of an edge of the mesh: its smooth surface, not its facets, is what the cameras see.
_PIECES = 2


def smooth_surface(mesh: TriangleMesh) -> TriangleMesh:
    """What cameras see of a mesh: the surface that bends through its vertices.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    TriangleMesh
    """
    return TriangleMesh(*refined_surface(mesh, pieces=_PIECES))


def near_object(
    points: Points, mesh: TriangleMesh, pose: Float[np.ndarray, "4 4"] | None = None
) -> Bool[np.ndarray, " n"]:
    """Points that may belong to the object if it stands where a pose has it.

    Parameters
    ----------
    points : (n, 3) float [m]       the rig's object frame
    mesh : TriangleMesh
    pose : (4, 4) float [m] or None x_mesh = pose x_points; None: one frame

    Returns
    -------
    (n,) bool
    """
    place = points if pose is None else points @ pose[:3, :3].T + pose[:3, 3]
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    away = np.linalg.norm(place - middle, axis=1)
    return np.asarray(away < _REACH * bounding_diagonal(mesh))


def register_object(
    rig: Rig,
    stereo: StereoPoints,
    smooth: TriangleMesh,
    *,
    start: Float[np.ndarray, "4 4"] | None = None,
) -> Registration | None:
    """Bring the points near an object onto its surface.

    Parameters
    ----------
    rig : Rig                       that saw the points
    stereo : StereoPoints
    smooth : TriangleMesh           `smooth_surface`
    start : (4, 4) float [m] or None    x_mesh = start x_points; None: one frame

    Returns
    -------
    Registration or None            None where fewer than `LEAST_POINTS` lie near the object
    """
    near = near_object(stereo.point, smooth, start)
    if near.sum() < LEAST_POINTS:
        return None
    return register(
        stereo.point[near], stereo.covariance[near], smooth, start=start,
        eye=camera_centre(rig.cameras[rig.reference]),
    )  # fmt: skip


def object_frame(rig: Rig, registration: Registration) -> Rig:
    """The rig in the frame of the mesh that its points were brought onto.

    Parameters
    ----------
    rig : Rig
    registration : Registration     of its points

    Returns
    -------
    Rig
    """
    # x_camera = T_camera_object x_object, and what the rig calls object is what was measured.
    back = np.linalg.inv(registration.T_mesh_points)
    cameras = tuple(
        replace(camera, T_camera_object=camera.T_camera_object @ back) for camera in rig.cameras
    )
    return replace(rig, cameras=cameras)
