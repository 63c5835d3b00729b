"""Triangulation: points of the object from their pixels in two or more cameras; and how calibration
errors of the cameras distort the space that is measured in this way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numba import njit
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError, InputError, quoted
from palpate.records import Camera, Rig, RigCovariance
from palpate.shapes import PointIndices, Points, PointScalars
from palpate.threads import in_threads
from palpate.vision.cholesky import (
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
)
from palpate.vision.projection import jacobian_kernel, normalised, packed_rig, project

# Gauss-Newton converges in three to six steps; a point that needs far more has no minimum nearby.
_MAX_STEPS = 60
# Final step length as a fraction of depth: below the rounding of the projection (1e-13 px).
_CONVERGED = 1e-12
# Steps shorter than this fraction of depth are accepted even if rounding raises the cost.
_TINY = 1e3 * _CONVERGED
# Minimum number of points per thread: each takes about 4 us.
_MIN_POINTS_PER_THREAD = 64
# A determinant below this fraction of the product of the diagonal is rounding: rays are parallel.
_MIN_DETERMINANT = 1e-9
_LENS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
# Indices of the first four of them in the camera matrix.
_INTRINSICS = np.array([0, 1, 0, 1]), np.array([0, 1, 2, 2])
_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
# Number of given points used, and the offset of further points around them as a fraction of extent.
_MAX_POINTS, _AROUND = 100, 0.05
# Minimum number of points that must be seen.
_MIN_POINTS = 12
# Central differences over this many standard deviations on each side.
_STEP = 0.5
# Principal strains whose variance is below this fraction of the largest are dropped.
_MIN_VARIANCE = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """Triangulated points of the object, with covariances and residuals.

    Attributes
    ----------
    point : (n, 3) float [m]        object frame; NaN where fewer than two cameras see it, where the
                                    rays are parallel, or where they intersect behind a camera
    covariance : (n, 3, 3) float [m^2]  propagated from the pixels; NaN where the point is
    residual : (n,) float [px]      rms reprojection error per coordinate, over the cameras that see
                                    the point; NaN where the point is
    cameras : (n,) int              number of cameras that see the point
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
    """Maximum-likelihood points from their pixels in the cameras.

    A linear start, then Gauss-Newton on the weighted reprojection errors, lens distortion included.

    Parameters
    ----------
    rig : Rig                       c cameras
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point
    covariance : (c, n, 2, 2) float [px^2] or float [px]    of each pixel, positive definite where
                                    the pixel is given; or one standard deviation for all, > 0

    Returns
    -------
    Triangulation                   independent of the number of threads

    Raises
    ------
    InputError                      a covariance is not positive definite

    Source
    ------
    Hartley and Zisserman, Multiple View Geometry (2004), 12.2 (start) and 5.2 (covariance).
    """
    flat = np.stack(
        [normalised(camera, seen) for camera, seen in zip(rig.cameras, pixels, strict=True)]
    )
    seen = np.isfinite(flat).all(axis=2)
    weight = _weights(covariance, seen)
    cameras = seen.sum(axis=0, dtype=np.int64)
    start = _linear_start(rig, flat, seen)
    start[cameras < 2] = np.nan
    inverse, square = np.full((*start.shape, 3), np.nan), np.full(len(start), np.nan)
    in_threads(
        _refine_range, len(start), packed_rig(rig), np.ascontiguousarray(pixels, dtype=np.float64),
        seen, weight, start, inverse, square, min_items=_MIN_POINTS_PER_THREAD,
    )  # fmt: skip
    with np.errstate(invalid="ignore"):
        residual = np.sqrt(square / (2.0 * cameras))
    return Triangulation(start, inverse, residual, cameras)


def _weights(
    covariance: Float[np.ndarray, "_ _ 2 2"] | float, seen: np.ndarray
) -> Float[np.ndarray, "c n 2 2"]:
    """Inverse covariances; zero where a camera does not see the point."""
    if not isinstance(covariance, np.ndarray):
        return seen[..., None, None] * (np.eye(2) / covariance**2)
    known = np.where(seen[..., None, None], covariance, np.eye(2))
    bad = ~_is_regular(known)
    if bad.any():
        camera, index = (int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"covariance of point {index} in camera {camera} is"
            f" {covariance[camera, index].tolist()} px^2; must be positive definite where the pixel"
            f" is given ({int(bad.sum())} are not); give the pixel as NaN where it was not measured"
        )
    return np.linalg.inv(known) * seen[..., None, None]


def _linear_start(
    rig: Rig, flat: Float[np.ndarray, "c n 2"], seen: Bool[np.ndarray, "c n"]
) -> Points:
    """Linear least-squares points from the normalised rays; NaN where these are parallel."""
    pose = np.stack([camera.T_camera_object[:3] for camera in rig.cameras])[:, None]
    # x = flat z: the row of (R x + t) minus flat times that of z.
    rows = np.where(seen[..., None, None], pose[:, :, :2] - flat[..., None] * pose[:, :, 2:], 0.0)
    normal = np.einsum("cnai,cnaj->nij", rows[..., :3], rows[..., :3])
    right = -np.einsum("cnai,cna->ni", rows[..., :3], rows[..., 3])
    fixed = _is_regular(normal)
    normal[~fixed] = np.eye(3)
    return np.where(fixed[:, None], np.linalg.solve(normal, right[..., None])[..., 0], np.nan)


@njit(cache=True, error_model="numpy")
def _normal_equations_kernel(cameras, pixels, seen, weight, i, point, matrix, right):
    """Gauss-Newton system of one point; returns weighted cost, squared error [px^2], min. depth."""
    right[:] = 0.0
    matrix[:, :] = 0.0
    jacobian = np.empty((2, 3))
    cost, square, nearest = 0.0, 0.0, np.inf
    for k in range(len(cameras)):
        if not seen[k, i]:
            continue
        column, row, depth, _, _ = jacobian_kernel(
            cameras[k], point[0], point[1], point[2], jacobian
        )
        x, y = pixels[k, i, 0] - column, pixels[k, i, 1] - row
        xx, xy, yy = weight[k, i, 0, 0], weight[k, i, 0, 1], weight[k, i, 1, 1]
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
def _refine_kernel(cameras, pixels, seen, weight, i, point, inverse):
    """Minimise the cost over a point and invert its normal matrix; returns the squared error.

    A step that raises the cost or leads behind a camera is halved. NaN where there is no minimum.
    """
    matrix, step = np.empty((3, 3)), np.empty(3)
    cost, square, depth = _normal_equations_kernel(
        cameras, pixels, seen, weight, i, point, matrix, step
    )
    if not depth > 0.0:
        return np.nan
    for _ in range(_MAX_STEPS):
        if not cholesky_kernel(matrix):
            return np.nan
        cholesky_inverse_kernel(matrix, inverse)
        cholesky_solve_kernel(matrix, step)
        for _ in range(_MAX_STEPS):
            trial, next_step = point + step, np.empty(3)
            length = np.sqrt((step**2).sum())
            new_cost, new_square, new_depth = _normal_equations_kernel(
                cameras, pixels, seen, weight, i, trial, matrix, next_step
            )
            if new_depth > 0.0 and (new_cost <= cost or length <= _TINY * depth):
                break
            step *= 0.5
        for a in range(3):
            point[a] = trial[a]
        cost, square, depth = new_cost, new_square, new_depth
        step = next_step
        if length <= _CONVERGED * depth:
            return square
    return np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_range(begin, end, cameras, pixels, seen, weight, point, covariance, square):
    """Refine all points that have a start; NaN for those without a minimum."""
    for i in range(begin, end):
        if not np.isnan(point[i, 0]):
            square[i] = _refine_kernel(cameras, pixels, seen, weight, i, point[i], covariance[i])
            if np.isnan(square[i]):
                point[i, :] = np.nan
                covariance[i, :, :] = np.nan


def _is_regular(matrix: Float[np.ndarray, "*n k k"]) -> Bool[np.ndarray, "*n"]:
    """True for symmetric matrices that are positive definite beyond rounding; False where NaN."""
    diagonal = np.einsum("...ii->...i", matrix)
    with np.errstate(invalid="ignore"):
        determinant = np.linalg.det(matrix)
    threshold = _MIN_DETERMINANT * diagonal.prod(axis=-1)
    return (diagonal > 0.0).all(axis=-1) & (determinant > threshold)


def calibration_numbers(cameras: Sequence[Camera], names: Sequence[str]) -> Float[np.ndarray, " p"]:
    """Values of the camera parameters named by a covariance (`RigCovariance.names`).

    Parameters
    ----------
    cameras : sequence of Camera    the calibration's first camera is the one without a pose in
                                    `names`
    names : sequence of p str       `camera.term`

    Returns
    -------
    (p,) float                      poses with respect to that first camera

    Raises
    ------
    CalibrationError                a name that matches no camera or term
    """
    by_name = {camera.name: camera for camera in cameras}
    first = _first(cameras, names)
    numbers: dict[str, float] = {}
    for name, camera in by_name.items():
        lens = (*camera.matrix[_INTRINSICS], *camera.distortion[:5])
        numbers |= zip((f"{name}.{term}" for term in _LENS), lens, strict=True)
        pose = camera.T_camera_object @ np.linalg.inv(first.T_camera_object)
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        numbers |= zip((f"{name}.{term}" for term in _POSE), (*turn, *pose[:3, 3]), strict=True)
    unknown = [name for name in names if name not in numbers]
    if unknown:
        raise CalibrationError(
            f"{quoted(unknown[0])} is no number of a camera; known are CAMERA.TERM with the terms"
            f" {' '.join(_LENS + _POSE)}"
        )
    return np.array([numbers[name] for name in names])


def space_strains(rig: Rig, known: RigCovariance, points: Points) -> Float[np.ndarray, "m 3 3"]:
    """Apparent strains around some points due to errors of the calibration.

    Calibration errors shift triangulated points; the gradient of the shift distorts measured
    displacements. Its mean over all points in the pictures of at least two cameras is taken. The
    rotation is left out: a surface measured with the same cameras, or registered to what they see,
    is rotated alike.

    Parameters
    ----------
    rig : Rig                       object frame
    known : RigCovariance           of the same cameras
    points : (n, 3) float [m]       of a surface, seen or not

    Returns
    -------
    (m, 3, 3) float [-]             symmetric strain tensors for independent errors of one standard
                                    deviation each, the largest first, m <= 6

    Raises
    ------
    CalibrationError                the covariance belongs to other cameras, or fewer than 12 points
                                    are seen by two cameras
    """
    _check_same(rig, known)
    points = _cloud(rig, points)
    pixels = np.stack([project(camera, points) for camera in rig.cameras])
    offsets = points - points.mean(axis=0)
    inverse = np.linalg.pinv(offsets)

    def stretch(step: Float[np.ndarray, " p"]) -> Float[np.ndarray, "3 3"]:
        after, before = (
            triangulate(moved_rig(rig, known.names, sign * _STEP * step), pixels, 1.0).point
            for sign in (1.0, -1.0)
        )
        gradient = (inverse @ (after - before)).T / (2.0 * _STEP)
        return 0.5 * (gradient + gradient.T)

    value, vector = np.linalg.eigh(known.covariance)
    steps = (np.sqrt(np.maximum(value, 0.0)) * vector).T
    every = np.array([stretch(step) for step in steps if step.any()]).reshape(-1, 9)
    _, size, strain = np.linalg.svd(every, full_matrices=False)
    keep = size**2 > _MIN_VARIANCE * size[0] ** 2
    return (size[keep, None] * strain[keep]).reshape(-1, 3, 3)


def _cloud(rig: Rig, points: Points) -> Float[np.ndarray, "m 3"]:
    """Points around each given point (so that a flat surface, too, determines the gradient along
    its normal), as far as two cameras see them."""
    points = points[:: max(len(points) // _MAX_POINTS, 1)]
    reach = _AROUND * float(np.ptp(points, axis=0).max())
    around = reach * np.concatenate([np.eye(3), -np.eye(3)])
    points = (points[:, None] + around).reshape(-1, 3)
    count = np.zeros(len(points), dtype=np.int64)
    for camera in rig.cameras:
        pixel = project(camera, points)
        # Outside the picture the lens model is not calibrated.
        end = np.array(camera.size or (np.inf, np.inf)) - 1.0
        with np.errstate(invalid="ignore"):
            count += ((pixel >= 0.0) & (pixel <= end)).all(axis=1)
    seen = count >= 2
    if seen.sum() < _MIN_POINTS:
        raise CalibrationError(
            f"{rig.source}: two cameras together see {int(seen.sum())} of {len(points)} points on"
            " and about the object; check its pose, and the length units of rig and mesh"
        )
    return points[seen]


def _first(cameras: Sequence[Camera], names: Sequence[str]) -> Camera:
    """The camera whose frame the poses are relative to: the one without a pose in `names`."""
    posed = {name.rpartition(".")[0] for name in names if name.rpartition(".")[2] in _POSE}
    named = {name.rpartition(".")[0] for name in names}
    known = {camera.name: camera for camera in cameras}
    if named - set(known) or len(named - posed) != 1:
        raise CalibrationError(
            f"the covariance is of the cameras {', '.join(sorted(named))}, the rig has"
            f" {', '.join(sorted(known))}; name them alike, or calibrate again"
        )
    return known[(named - posed).pop()]


def _check_same(rig: Rig, known: RigCovariance) -> None:
    """Raise if the covariance's values are not those of the rig."""
    try:
        numbers = calibration_numbers(rig.cameras, known.names)
    except CalibrationError as error:
        raise CalibrationError(f"{known.source}: {error}") from error
    std = np.sqrt(np.diag(known.covariance))
    # Files hold all digits, but converting a rotation and back rounds the last ones.
    off = np.abs(numbers - known.value) - std - 1e-6 * np.abs(known.value)
    if np.any(off > 1e-9):
        worst = int(off.argmax())
        raise CalibrationError(
            f"{known.source}: {known.names[worst]} is {known.value[worst]:.6g} there and"
            f" {numbers[worst]:.6g} in {rig.source}: it is the covariance of another calibration;"
            " copy the file that was written with this rig, or remove it"
        )


def moved_rig(rig: Rig, names: Sequence[str], step: Float[np.ndarray, " p"]) -> Rig:
    """The rig with its parameters changed by a step; poses are relative to the first camera.

    Parameters
    ----------
    rig : Rig
    names : sequence of p str       as in `RigCovariance`
    step : (p,) float               a rotation vector [rad] is applied after the pose's rotation, a
                                    shift [m] is added

    Returns
    -------
    Rig

    Raises
    ------
    CalibrationError                `names` are of other cameras, or leave no single one without a
                                    pose
    """
    change = dict(zip(names, step, strict=True))
    first = _first(rig.cameras, names).T_camera_object
    cameras = []
    for camera in rig.cameras:
        lens = np.array([change.get(f"{camera.name}.{term}", 0.0) for term in _LENS])
        turn, shift = np.split(
            np.array([change.get(f"{camera.name}.{term}", 0.0) for term in _POSE]), 2
        )
        pose = camera.T_camera_object @ np.linalg.inv(first)
        pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ pose[:3, :3]
        pose[:3, 3] += shift
        matrix = camera.matrix.copy()
        matrix[_INTRINSICS] += lens[:4]
        distortion = camera.distortion.copy()
        distortion[:5] += lens[4:]
        cameras.append(
            replace(
                camera,
                matrix=matrix,
                distortion=distortion,
                T_camera_object=pose @ first,
            )
        )
    return replace(rig, cameras=tuple(cameras))
