"""Projection of object points into a camera with its Jacobian, and rays through its pixels.

OpenCV's pinhole model with the rational distortion: x = X/Z, y = Y/Z, r2 = x^2 + y^2,
radial = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3), then
x' = x radial + 2 p1 x y + p2 (r2 + 2 x^2), y' = y radial + p1 (r2 + 2 y^2) + 2 p2 x y and
column = fx x' + skew y' + cx, row = fy y' + cy. In the kernels `c` is a camera packed into one row:
fx fy cx cy skew, k1 k2 p1 p2 k3 k4 k5 k6, R by rows, t.

Far from the axis the distortion is not invertible: two rays map to one pixel. Only the branch that
contains the axis describes the lens; `lens_radius_limit` gives its radius.

No `fastmath` here: NaN means "not seen" and must propagate.

Source: OpenCV, Camera calibration and 3D reconstruction, detailed description.
"""

import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.errors import InputError
from palpate.records import Camera, Rig, camera_centre, lens_radius_limit
from palpate.shapes import Points, PointScalars, Vector3
from palpate.threads import in_threads

# Minimum number of pixels per thread: each takes about 0.1 us.
_MIN_PIXELS_PER_THREAD = 1024
# Tolerance of the inverse in the plane z = 1: 1e-13 is 7e-10 px at a focal length of 7000 px, and
# well above rounding.
_MAX_ERROR = 1e-13
# Newton converges quadratically: after a step from an error below `_NEARLY`, only rounding is left,
# unless the Jacobian determinant is below `_MIN_AREA`, as it is where the distortion folds over.
_NEARLY, _MIN_AREA = 1e-8, 1e-2
_MAX_STEPS = 50
# Largest radius of a ray in the plane z = 1 (89.94 degrees off the axis).
_MAX_RADIUS = 1e3


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
    _jacobians_kernel(packed_camera(camera), radius_limit, points, pixels, jacobian)
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
    _normalised_kernel(0, len(pixels), packed_camera(camera), radius_limit, pixels, directions)
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
        _normalised_kernel, len(pixels), packed_camera(camera),
        lens_radius_limit(camera.distortion), pixels, flat, min_items=_MIN_PIXELS_PER_THREAD,
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


@njit(cache=True, error_model="numpy", inline="always")
def _radial_kernel(c, r2):
    """Radial factor of the distortion, and its derivative with respect to r^2."""
    over = 1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[9]))
    under = 1.0 + r2 * (c[10] + r2 * (c[11] + r2 * c[12]))
    over_slope = c[5] + r2 * (2.0 * c[6] + 3.0 * r2 * c[9])
    under_slope = c[10] + r2 * (2.0 * c[11] + 3.0 * r2 * c[12])
    radial = over / under
    return radial, (over_slope - radial * under_slope) / under


@njit(cache=True, error_model="numpy")
def distort_kernel(c, a, b):
    """Distorted coordinates of a ray and their derivatives.

    Parameters
    ----------
    c : (25,) float                 `packed_camera`
    a, b : float [-]                x / z and y / z of the ray, within the lens's reach

    Returns
    -------
    x, y : float [-]                distorted coordinates in the plane z = 1
    xa, xb, yb : float [-]          dx/da, dx/db (= dy/da), dy/db
    """
    r2 = a * a + b * b
    radial, slope = _radial_kernel(c, r2)
    p1, p2 = c[7], c[8]
    x = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    y = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    xa = radial + 2.0 * a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
    xb = 2.0 * a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
    yb = radial + 2.0 * b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
    return x, y, xa, xb, yb


@njit(cache=True, error_model="numpy", inline="always")
def _pinhole_kernel(c, x, y, z):
    """x / z, y / z and z of an object point in the camera frame."""
    zc = c[19] * x + c[20] * y + c[21] * z + c[24]
    a = (c[13] * x + c[14] * y + c[15] * z + c[22]) / zc
    b = (c[16] * x + c[17] * y + c[18] * z + c[23]) / zc
    return a, b, zc


@njit(cache=True, error_model="numpy")
def project_kernel(c, x, y, z):
    """Pixel of an object point that the camera sees.

    Parameters
    ----------
    c : (25,) float                 `packed_camera`
    x, y, z : float [m]             object frame; in front of the camera, within the lens's reach

    Returns
    -------
    column, row : float [px]        meaningless for a point that the camera does not see
    """
    a, b, _ = _pinhole_kernel(c, x, y, z)
    xd, yd, _, _, _ = distort_kernel(c, a, b)
    return c[0] * xd + c[4] * yd + c[2], c[1] * yd + c[3]


@njit(cache=True, error_model="numpy")
def jacobian_kernel(c, x, y, z, out):
    """Pixel of an object point, its Jacobian, and quantities that tell whether it is visible.

    Parameters
    ----------
    c : (25,) float                 `packed_camera`
    x, y, z : float [m]             object frame
    out : (2, 3) float [px/m]       filled with the Jacobian of column and row

    Returns
    -------
    column, row : float [px]
    depth : float [m]               positive in front of the camera
    square : float [-]              squared distance from the axis in the plane z = 1: below the
                                    square of `lens_radius_limit` on the valid branch of the lens
    area : float [-]                determinant of the distortion's Jacobian: positive there
    """
    a, b, zc = _pinhole_kernel(c, x, y, z)
    xd, yd, xa, xb, yb = distort_kernel(c, a, b)
    column_a, column_b = c[0] * xa + c[4] * xb, c[0] * xb + c[4] * yb
    row_a, row_b = c[1] * xb, c[1] * yb
    for k in range(3):
        along_a = (c[13 + k] - a * c[19 + k]) / zc
        along_b = (c[16 + k] - b * c[19 + k]) / zc
        out[0, k] = column_a * along_a + column_b * along_b
        out[1, k] = row_a * along_a + row_b * along_b
    column, row = c[0] * xd + c[4] * yd + c[2], c[1] * yd + c[3]
    return column, row, zc, a * a + b * b, xa * yb - xb * xb


@njit(cache=True, error_model="numpy")
def _jacobians_kernel(c, radius_limit, points, pixels, jacobians):
    """Pixels of points and their Jacobians, NaN where the camera does not see the point.

    Parameters
    ----------
    c : (25,) float                 `packed_camera`
    radius_limit : float [-]        `lens_radius_limit`
    points : (n, 3) float [m]       object frame
    pixels : (n, 2) float [px]      filled; NaN behind the camera and off the valid branch of the
                                    lens
    jacobians : (n, 2, 3) float [px/m]  filled likewise
    """
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        column, row, depth, square, area = jacobian_kernel(c, x, y, z, jacobians[i])
        pixels[i, 0], pixels[i, 1] = column, row
        if not (depth > 0.0 and square < radius_limit * radius_limit and area > 0.0):
            pixels[i, :] = np.nan
            jacobians[i, :, :] = np.nan


@njit(cache=True, error_model="numpy")
def _radial_start(c, distorted, radius_limit):
    """Undistorted radius for a distorted one, by the radial terms alone, on the valid branch.

    If no radius is mapped that far out, the limit of the branch. By bisection.
    """
    low, high = 0.0, min(radius_limit, _MAX_RADIUS)
    for _ in range(_MAX_STEPS):
        radius = 0.5 * (low + high)
        radial, _ = _radial_kernel(c, radius * radius)
        if radius * radial < distorted:
            low = radius
        else:
            high = radius
    return low


@njit(cache=True, error_model="numpy")
def _newton_kernel(c, radius_limit, x, y, a, b):
    """Solve for the point near (a, b) that is distorted to (x, y); NaN where Newton fails."""
    limit = radius_limit * radius_limit
    allowed = _MAX_ERROR * (1.0 + np.hypot(x, y))
    for _ in range(_MAX_STEPS):
        u, v, xa, xb, yb = distort_kernel(c, a, b)
        area = xa * yb - xb * xb
        error = abs(x - u) + abs(y - v)
        if error <= allowed and area <= _MIN_AREA:
            return (a, b) if area > 0.0 else (np.nan, np.nan)
        step_a = (yb * (x - u) - xb * (y - v)) / area
        step_b = (xa * (y - v) - xb * (x - u)) / area
        # Halve the step if it would leave the valid branch.
        for _ in range(_MAX_STEPS):
            if (a + step_a) ** 2 + (b + step_b) ** 2 < limit:
                break
            step_a, step_b = 0.5 * step_a, 0.5 * step_b
        a, b = a + step_a, b + step_b
        if error <= _NEARLY and area > _MIN_AREA:
            return a, b
    return np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _normalised_kernel(begin, end, c, radius_limit, pixels, out):
    """x / z and y / z of the rays through pixels.

    Parameters
    ----------
    begin, end : int                range of rows of `pixels` to process
    c : (25,) float                 `packed_camera`
    radius_limit : float [-]        `lens_radius_limit`
    pixels : (n, 2) float [px]
    out : (n, 2) float [-]          filled; NaN where no ray maps to the pixel
    """
    for i in range(begin, end):
        y = (pixels[i, 1] - c[3]) / c[1]
        x = (pixels[i, 0] - c[2] - c[4] * y) / c[0]
        a, b = _newton_kernel(c, radius_limit, x, y, x, y)
        if np.isnan(a):
            # Strong distortion, or near its fold: the radial terms alone give a better start.
            distorted = np.hypot(x, y)
            scale = _radial_start(c, distorted, radius_limit) / distorted
            a, b = _newton_kernel(c, radius_limit, x, y, scale * x, scale * y)
        out[i, 0], out[i, 1] = a, b
