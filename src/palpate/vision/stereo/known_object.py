"""Registration of stereo points to the mesh of the object."""

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
MIN_POSE_POINTS = 50
# Points farther than this from the centre of the mesh, in diagonals, belong to table or background.
_REACH = 0.6
# Subdivisions of a mesh edge: the cameras see its smooth surface, not its facets.
_PIECES = 2


def smooth_surface(mesh: TriangleMesh) -> TriangleMesh:
    """The smooth surface through a mesh's vertices, finely triangulated, as the cameras see it.

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
    """Points that may belong to the object at a given pose.

    Parameters
    ----------
    points : (n, 3) float [m]       the rig's object frame
    mesh : TriangleMesh
    pose : (4, 4) float [m] or None x_mesh = pose x_points; None: the frames coincide

    Returns
    -------
    (n,) bool
    """
    place = points if pose is None else points @ pose[:3, :3].T + pose[:3, 3]
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    distance = np.linalg.norm(place - middle, axis=1)
    return np.asarray(distance < _REACH * bounding_diagonal(mesh))


def register_object(
    rig: Rig,
    stereo: StereoPoints,
    smooth: TriangleMesh,
    *,
    start: Float[np.ndarray, "4 4"] | None = None,
) -> Registration | None:
    """Register the points near an object to its surface.

    Parameters
    ----------
    rig : Rig                       that measured the points
    stereo : StereoPoints
    smooth : TriangleMesh           from `smooth_surface`
    start : (4, 4) float [m] or None    x_mesh = start x_points; None: the frames coincide

    Returns
    -------
    Registration or None            None where fewer than `MIN_POSE_POINTS` lie near the object
    """
    near = near_object(stereo.point, smooth, start)
    if near.sum() < MIN_POSE_POINTS:
        return None
    return register(
        stereo.point[near], stereo.covariance[near], smooth, start=start,
        viewpoint=camera_centre(rig.cameras[rig.reference]),
    )  # fmt: skip


def object_frame(rig: Rig, registration: Registration) -> Rig:
    """Transform the rig to the frame of the mesh that its points were registered to.

    Parameters
    ----------
    rig : Rig
    registration : Registration     of its points

    Returns
    -------
    Rig
    """
    # x_camera = T_camera_object x_object; the points were measured in the rig's own object frame.
    back = np.linalg.inv(registration.T_mesh_points)
    cameras = tuple(
        replace(camera, T_camera_object=camera.T_camera_object @ back) for camera in rig.cameras
    )
    return replace(rig, cameras=cameras)
