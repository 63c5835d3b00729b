"""Projection of points of the object into a camera, as a kernel and on whole arrays.

OpenCV's pinhole model with the rational distortion: x = X/Z, y = Y/Z, r2 = x^2 + y^2,
radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3), then
x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2), y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y and
column = fx x' + skew y' + cx, row = fy y' + cy.
"""

import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.records import Camera, Rig, camera_centre
from palpate.shapes import Points, PointScalars, Vector3
from palpate.threads import in_threads
from palpate.vision.cameras.lens import (
    jacobians_kernel,
    lens_reach,
    normalised_kernel,
    projections_kernel,
)

# A camera as one row of numbers: fx fy cx cy skew, eight distortion terms, R by rows, t.
PACKED = 25
# Pixels that are worth a thread: each takes some 0.3 us.
_FEWEST = 1024


def packed_camera(camera: Camera) -> Float[np.ndarray, "25"]:
    """A camera as one row of numbers for the kernels.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    (25,) float                     fx fy cx cy skew, k1 k2 p1 p2 k3 k4 k5 k6, R by rows, t [m]
    """
    k = camera.matrix
    pose = camera.T_camera_object
    inner = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], k[0, 1]]
    return np.concatenate([inner, camera.distortion, pose[:3, :3].ravel(), pose[:3, 3]])


def packed_rig(rig: Rig) -> Float[np.ndarray, "c 25"]:
    """All cameras of a rig, a row each; see `packed_camera`."""
    return np.stack([packed_camera(camera) for camera in rig.cameras])


@njit(cache=True, error_model="numpy")
def project_kernel(c, x, y, z):
    """Pixel (column, row) of an object point; `c` is a packed camera."""
    zc = c[19] * x + c[20] * y + c[21] * z + c[24]
    inverse = 1.0 / zc
    a = (c[13] * x + c[14] * y + c[15] * z + c[22]) * inverse
    b = (c[16] * x + c[17] * y + c[18] * z + c[23]) * inverse
    r2 = a * a + b * b
    over = 1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[9]))
    under = 1.0 + r2 * (c[10] + r2 * (c[11] + r2 * c[12]))
    radial = over / under
    ab = 2.0 * a * b
    xd = a * radial + c[7] * ab + c[8] * (r2 + 2.0 * a * a)
    yd = b * radial + c[7] * (r2 + 2.0 * b * b) + c[8] * ab
    return c[0] * xd + c[4] * yd + c[2], c[1] * yd + c[3]


def project(camera: Camera, points: Points) -> Float[np.ndarray, "n 2"]:
    """Where a camera sees points of the object.

    Parameters
    ----------
    camera : Camera
    points : (n, 3) float [m]       object frame

    Returns
    -------
    (n, 2) float [px]               column and row, in the picture or beside it; NaN for a point at
                                    or behind the camera's centre, or so far off the axis that the
                                    lens model has folded over
    """
    # A copy can be written to, so that the kernel is compiled for one kind of array only.
    points = np.array(points, dtype=np.float64, order="C")
    pixels = np.empty((len(points), 2))
    reach = lens_reach(camera.distortion)
    projections_kernel(packed_camera(camera), reach, points, pixels)
    return pixels


def project_jacobian(
    camera: Camera, points: Points
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 3"]]:
    """Where a camera sees points, and how that moves with them.

    Parameters
    ----------
    camera : Camera
    points : (n, 3) float [m]       object frame

    Returns
    -------
    pixels : (n, 2) float [px]      as `project`
    jacobian : (n, 2, 3) float [px/m]   entry [n, i, j]: pixel coordinate i by point coordinate j;
                                    NaN where the pixel is
    """
    points = np.array(points, dtype=np.float64, order="C")
    pixels, jacobian = np.empty((len(points), 2)), np.empty((len(points), 2, 3))
    reach = lens_reach(camera.distortion)
    jacobians_kernel(packed_camera(camera), reach, points, pixels, jacobian)
    return pixels, jacobian


def normalised(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Undo the camera matrix and the lens: directions in the camera frame, as x / z and y / z.

    Newton's method with the analytic derivative; forward and back again agree to 1e-9 px.

    Parameters
    ----------
    camera : Camera
    pixels : (n, 2) float [px]      column and row

    Returns
    -------
    (n, 2) float [-]                NaN where the pixel is, and where the lens model, folding over,
                                    sends no ray
    """
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    directions = np.empty_like(pixels)
    reach = lens_reach(camera.distortion)
    in_threads(
        normalised_kernel, len(pixels), packed_camera(camera), reach, pixels, directions,
        fewest=_FEWEST,
    )  # fmt: skip
    return directions


def rays(camera: Camera, pixels: Float[np.ndarray, "n 2"]) -> tuple[Vector3, Points]:
    """Rays of light that reach pixels, in the object frame.

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
