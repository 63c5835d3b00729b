"""Projection of object points into a camera, and rays through its pixels, for whole arrays."""

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.records import Camera, Rig, camera_centre, lens_radius_limit
from palpate.shapes import Points, PointScalars, Vector3
from palpate.threads import in_threads
from palpate.vision.cameras.lens import jacobians_kernel, normalised_kernel

# Minimum number of pixels per thread: each takes about 0.1 us.
_MIN_PIXELS_PER_THREAD = 1024


def packed_camera(camera: Camera) -> Float[np.ndarray, "25"]:
    """Pack a camera into one row of numbers for the kernels.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    (25,) float                     fx fy cx cy skew, k1 k2 p1 p2 k3 k4 k5 k6, R by rows, t [m]
    """
    k = camera.matrix
    pose = camera.T_camera_object
    intrinsics = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1]]
    return np.concatenate([intrinsics, camera.distortion, pose[:3, :3].ravel(), pose[:3, 3]])


def packed_rig(rig: Rig) -> Float[np.ndarray, "c 25"]:
    """Pack all cameras of a rig for the kernels.

    Parameters
    ----------
    rig : Rig                       c cameras

    Returns
    -------
    (c, 25) float                   a row each, see `packed_camera`
    """
    return np.stack([packed_camera(camera) for camera in rig.cameras])


def project(camera: Camera, points: Points) -> Float[np.ndarray, "n 2"]:
    """Project points of the object into a camera.

    Parameters
    ----------
    camera : Camera
    points : (n, 3) float [m]       object frame

    Returns
    -------
    (n, 2) float [px]               column and row, inside or outside the picture; NaN for a point
                                    at or behind the camera's centre, or so far off the axis that
                                    the lens model is no longer invertible (`lens_radius_limit`)
    """
    return project_jacobian(camera, points)[0]


def project_jacobian(
    camera: Camera, points: Points
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 3"]]:
    """Project points into a camera, with the Jacobian of the projection.

    Parameters
    ----------
    camera : Camera
    points : (n, 3) float [m]       object frame

    Returns
    -------
    pixels : (n, 2) float [px]      as `project`
    jacobian : (n, 2, 3) float [px/m]   [n, i, j]: d(pixel coordinate i) / d(point coordinate j);
                                    NaN where the pixel is
    """
    # A copy is writable, so the kernel is compiled for one array type only.
    points = np.array(points, dtype=np.float64, order="C")
    pixels, jacobian = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    radius_limit = lens_radius_limit(camera.distortion)
    jacobians_kernel(packed_camera(camera), radius_limit, points, pixels, jacobian)
    return pixels, jacobian


def normalised(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Invert camera matrix and lens: directions in the camera frame, as x / z and y / z.

    Newton's method with the analytic Jacobian; a round trip through `project` is exact to 1e-9 px.

    Parameters
    ----------
    camera : Camera
    pixels : (n, 2) float [px]      column and row

    Returns
    -------
    (n, 2) float [-]                NaN where the pixel is, and where the lens model maps no ray to
                                    the pixel
    """
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    directions = np.empty_like(pixels)
    radius_limit = lens_radius_limit(camera.distortion)
    normalised_kernel(0, len(pixels), packed_camera(camera), radius_limit, pixels, directions)
    return directions


def check_picture_size(camera: Camera, shape: tuple[int, int]) -> None:
    """Raise if pictures do not have the camera's size.

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]

    Raises
    ------
    InputError                      the camera's size is known and differs from `shape`
    """
    rows, columns = shape
    if camera.size is not None and camera.size != (columns, rows):
        raise InputError(
            f"camera '{camera.name}' has {camera.size[0]} x {camera.size[1]} pixels; asked for"
            f" {columns} x {rows} (columns x rows)"
        )


def pixel_grid(camera: Camera, shape: tuple[int, int]) -> Float[np.ndarray, "2 rows columns"]:
    """Intersection of every pixel's ray with the plane z = 1 of the camera.

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]    of its pictures

    Returns
    -------
    (2, rows, columns) float [-]    x / z and y / z; NaN where the lens model has no such ray

    Raises
    ------
    InputError                      a shape that contradicts the camera's size
    """
    check_picture_size(camera, shape)
    row, column = np.indices(shape, dtype=np.float64).reshape(2, -1)
    pixels = np.column_stack([column, row])
    flat = np.empty_like(pixels)
    in_threads(
        normalised_kernel, len(pixels), packed_camera(camera), lens_radius_limit(camera.distortion),
        pixels, flat, min_items=_MIN_PIXELS_PER_THREAD,
    )  # fmt: skip
    return np.ascontiguousarray(flat.T).reshape(2, *shape)


def rays(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> tuple[Vector3, Points]:
    """Rays from the camera through pixels, in the object frame.

    Parameters
    ----------
    camera : Camera
    pixels : (n, 2) float [px]      column and row

    Returns
    -------
    origin : (3,) float [m]         the camera's centre
    direction : (n, 3) float [-]    of unit length, away from the camera; NaN as `normalised`
    """
    flat = normalised(camera, pixels)
    direction = np.column_stack([flat, np.ones(len(flat))])
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    pose = camera.T_camera_object
    return camera_centre(camera), direction @ pose[:3, :3]


def pixel_sizes(camera: Camera, point: Points) -> PointScalars:
    """Side of a pixel projected onto a surface that faces the camera.

    Parameters
    ----------
    camera : Camera
    point : (n, 3) float [m]        object frame, in front of the camera

    Returns
    -------
    (n,) float [m]                  depth over focal length
    """
    pose = camera.T_camera_object
    return (point @ pose[2, :3] + pose[2, 3]) / camera.matrix[0, 0]


def camera_sigma(
    covariance: Float[np.ndarray, "n 3 3"], camera: Camera
) -> tuple[PointScalars, PointScalars]:
    """Standard deviations across and along the axis of a camera.

    Parameters
    ----------
    covariance : (n, 3, 3) float [m^2]  object frame
    camera : Camera

    Returns
    -------
    lateral : (n,) float [m]        rms of the components to the right and down
    depth : (n,) float [m]          component along the optical axis
    """
    rotation = camera.T_camera_object[:3, :3]
    variance = np.einsum("ai,nij,aj->na", rotation, covariance, rotation)
    return np.sqrt(0.5 * (variance[:, 0] + variance[:, 1])), np.sqrt(variance[:, 2])
