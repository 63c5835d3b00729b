"""Points of the object from their pixels in two or more cameras."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.errors import InputError
from palpate.records import Rig
from palpate.shapes import PointIndices, Points, PointScalars
from palpate.threads import in_threads
from palpate.vision.cameras.lens import jacobian_kernel
from palpate.vision.cameras.projection import normalised, packed_rig
from palpate.vision.small_systems import (
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
)

# Gauss-Newton converges in three to six steps; a point that needs more has no minimum nearby.
_STEPS = 30
# Of the distance from the camera: a step below rounding of the projection (1e-13 px).
_CONVERGED = 1e-12
# Points that are worth a thread: each takes some 4 us.
_FEWEST = 256


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """Points of the object and how well the cameras agree on them.

    Attributes
    ----------
    point : (n, 3) float [m]        object frame; NaN where fewer than two cameras see it, where the
                                    rays are parallel, or where they meet behind a camera
    covariance : (n, 3, 3) float [m^2]  from that of the pixels; NaN where the point is
    residual : (n,) float [px]      root mean square of what is left per pixel coordinate, over the
                                    cameras that see the point; NaN where the point is
    cameras : (n,) int              how many cameras see the point
    """

    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    residual: PointScalars
    cameras: PointIndices


def triangulate(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "_ _ 2 2"] | float,
) -> Triangulation:
    """Most likely points for the pixels at which cameras see them.

    A linear start, then Gauss-Newton on the weighted distances in the pictures, lenses included.

    Parameters
    ----------
    rig : Rig                       c cameras
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point
    covariance : (c, n, 2, 2) float [px^2] or float [px]    of each pixel; or one standard
                                    deviation for all

    Returns
    -------
    Triangulation                   does not depend on the number of threads

    Raises
    ------
    InputError                      another number of cameras, a covariance that is none

    Source
    ------
    Hartley and Zisserman, Multiple View Geometry (2004), 12.2 (start) and 5.2 (covariance).
    """
    if len(pixels) != len(rig.cameras):
        raise InputError(
            f"pixels are of {len(pixels)} cameras; the rig has {len(rig.cameras)}"
            f" ({', '.join(camera.name for camera in rig.cameras)}); give NaN for one that sees"
            " nothing"
        )
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    flat = np.stack(
        [normalised(camera, seen) for camera, seen in zip(rig.cameras, pixels, strict=True)]
    )
    seen = np.isfinite(flat).all(axis=2)
    weight = _weights(covariance, seen)
    n = pixels.shape[1]
    point, spread, residual = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n)
    in_threads(
        _triangulate_range, n, packed_rig(rig), pixels, flat, seen, weight, point, spread, residual,
        fewest=_FEWEST,
    )  # fmt: skip
    return Triangulation(point, spread, residual, seen.sum(axis=0, dtype=np.int64))


def _weights(
    covariance: Float[np.ndarray, "_ _ 2 2"] | float, seen: np.ndarray
) -> Float[np.ndarray, "c n 3"]:
    """Inverse covariances as (xx, xy, yy); one where a camera does not see the point."""
    if not isinstance(covariance, np.ndarray):
        if not (np.isfinite(covariance) and covariance > 0.0):
            raise InputError(
                f"the standard deviation of the pixels is {covariance:g} px; must be positive"
            )
        weight = np.zeros((*seen.shape, 3))
        weight[..., 0] = weight[..., 2] = 1.0 / covariance**2
        return weight
    if covariance.shape != (*seen.shape, 2, 2):
        raise InputError(
            f"covariance has shape {covariance.shape}; must be {(*seen.shape, 2, 2)}, one per pixel"
        )
    xx, xy, yy = (
        np.where(seen, covariance[..., i, j], i == j) for i, j in ((0, 0), (0, 1), (1, 1))
    )
    determinant = xx * yy - xy * xy
    bad = ~((xx > 0.0) & (determinant > 0.0) & np.isfinite(determinant))
    if bad.any():
        camera, index = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"covariance of point {index} in camera {camera} is"
            f" {covariance[camera, index].tolist()} px^2; must be positive definite where the pixel"
            f" is given ({int(bad.sum())} are not); give the pixel as NaN where it was not measured"
        )
    return np.stack([yy, -xy, xx], axis=-1) / determinant[..., None]


@njit(cache=True, error_model="numpy")
def _linear_start(cameras, flat, seen, i, point):
    """Least-squares point of the normalised rays; False where they do not fix one."""
    matrix, right, row = np.empty((3, 3)), np.empty(3), np.empty(3)
    matrix[:, :] = 0.0
    right[:] = 0.0
    for k in range(len(cameras)):
        if not seen[k, i]:
            continue
        c = cameras[k]
        for j in range(2):
            place = flat[k, i, j]
            for m in range(3):
                row[m] = c[13 + 3 * j + m] - place * c[19 + m]
            value = place * c[24] - c[22 + j]
            for m in range(3):
                right[m] += row[m] * value
                for n in range(3):
                    matrix[m, n] += row[m] * row[n]
    if not cholesky_kernel(matrix):
        return False
    cholesky_solve_kernel(matrix, right)
    for m in range(3):
        point[m] = right[m]
    return True


@njit(cache=True, error_model="numpy")
def _normal_equations(cameras, pixels, seen, weight, i, point, matrix, right):
    """Gauss-Newton system of one point; its weighted cost, squared error [px^2] and least depth."""
    for m in range(3):
        right[m] = 0.0
        for n in range(3):
            matrix[m, n] = 0.0
    jacobian = np.empty((2, 3))
    cost, square, nearest = 0.0, 0.0, np.inf
    for k in range(len(cameras)):
        if not seen[k, i]:
            continue
        column, row, depth = jacobian_kernel(cameras[k], point[0], point[1], point[2], jacobian)
        x, y = pixels[k, i, 0] - column, pixels[k, i, 1] - row
        xx, xy, yy = weight[k, i, 0], weight[k, i, 1], weight[k, i, 2]
        cost += xx * x * x + 2.0 * xy * x * y + yy * y * y
        square += x * x + y * y
        nearest = min(nearest, depth)
        for m in range(3):
            first = xx * jacobian[0, m] + xy * jacobian[1, m]
            second = xy * jacobian[0, m] + yy * jacobian[1, m]
            right[m] += first * x + second * y
            for n in range(3):
                matrix[m, n] += first * jacobian[0, n] + second * jacobian[1, n]
    return cost, square, nearest


@njit(cache=True, error_model="numpy")
def _refine(cameras, pixels, seen, weight, i, point, inverse):
    """Move a point to the least cost and invert its system; its squared error, NaN where lost."""
    matrix, right = np.empty((3, 3)), np.empty(3)
    trial, step = np.empty(3), np.empty(3)
    cost, square, depth = _normal_equations(cameras, pixels, seen, weight, i, point, matrix, right)
    if not depth > 0.0:
        return np.nan
    for _ in range(_STEPS):
        if not cholesky_kernel(matrix):
            return np.nan
        cholesky_inverse_kernel(matrix, inverse)
        cholesky_solve_kernel(matrix, right)
        for m in range(3):
            step[m] = right[m]
        length = np.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        for _ in range(_STEPS):
            for m in range(3):
                trial[m] = point[m] + step[m]
            new_cost, new_square, new_depth = _normal_equations(
                cameras, pixels, seen, weight, i, trial, matrix, right
            )
            # Rounding may raise the cost of the last steps, which are too short to matter.
            if new_depth > 0.0 and (new_cost <= cost or length <= 1e3 * _CONVERGED * depth):
                break
            for m in range(3):
                step[m] *= 0.5
            length *= 0.5
        for m in range(3):
            point[m] = trial[m]
        cost, square, depth = new_cost, new_square, new_depth
        if length <= _CONVERGED * depth:
            return square
    return np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _triangulate_range(
    begin, end, cameras, pixels, flat, seen, weight, point, covariance, residual
):  # fmt: skip
    """Start, refine, covariance, residual [px] of each point; NaN where there is no such point."""
    for i in range(begin, end):
        count = 0
        for k in range(len(cameras)):
            count += seen[k, i]
        square = np.nan
        if count >= 2 and _linear_start(cameras, flat, seen, i, point[i]):
            square = _refine(cameras, pixels, seen, weight, i, point[i], covariance[i])
        if np.isnan(square):
            point[i, :] = np.nan
            covariance[i, :, :] = np.nan
        residual[i] = np.sqrt(square / (2.0 * count))
