"""Points of the object from their pixels in two or more cameras."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import InputError
from palpate.records import Rig, camera_centre
from palpate.shapes import PointIndices, Points, PointScalars
from palpate.vision.cameras.projection import normalised, project_jacobian

# Gauss-Newton converges in three to six steps; a point that needs more has no minimum nearby.
_MAX_STEPS = 60
# Of the distance from the camera: a step below rounding of the projection (1e-13 px).
_CONVERGED = 1e-12
# Rounding may raise the cost of the last steps, which are too short to matter.
_TINY = 1e3 * _CONVERGED
# A determinant below this share of the diagonal's product is rounding: rays are parallel.
_MIN_DETERMINANT = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """Points of the object and how well the cameras agree on them.

    Attributes
    ----------
    point : (n, 3) float [m]        object frame; NaN where fewer than two cameras see it, where the
                                    rays are parallel, or where they meet behind a camera
    covariance : (n, 3, 3) float [m^2]  from that of the pixels; NaN where the point is
    residual : (n,) float [px]      rms distance of the point's projections from the pixels, per
                                    coordinate, over the cameras that see it; NaN where the point is
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
    covariance : (c, n, 2, 2) float [px^2] or float [px]    of each pixel, positive definite where
                                    it is given; or one standard deviation for all, > 0

    Returns
    -------
    Triangulation                   does not depend on the number of threads

    Raises
    ------
    InputError                      another number of cameras; a covariance that is not positive
                                    definite, or of another shape

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
    flat = np.stack(
        [normalised(camera, seen) for camera, seen in zip(rig.cameras, pixels, strict=True)]
    )
    seen = np.isfinite(flat).all(axis=2)
    weight = _weights(covariance, seen)
    cameras = seen.sum(axis=0, dtype=np.int64)
    start = _linear_start(rig, flat, seen)
    start[cameras < 2] = np.nan
    point, spread, square = _refined(rig, pixels, weight, start)
    with np.errstate(invalid="ignore"):
        residual = np.sqrt(square / (2.0 * cameras))
    return Triangulation(point, spread, residual, cameras)


def _weights(
    covariance: Float[np.ndarray, "_ _ 2 2"] | float, seen: np.ndarray
) -> Float[np.ndarray, "c n 2 2"]:
    """Inverse covariances; zero where a camera does not see the point."""
    if not isinstance(covariance, np.ndarray):
        if not (np.isfinite(covariance) and covariance > 0.0):
            raise InputError(
                f"the standard deviation of the pixels is {covariance:g} px; must be positive"
            )
        return seen[..., None, None] * (np.eye(2) / covariance**2)
    if covariance.shape != (*seen.shape, 2, 2):
        raise InputError(
            f"covariance has shape {covariance.shape}; must be {(*seen.shape, 2, 2)}, one per pixel"
        )
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
    """Least-squares points of the normalised rays; NaN where they are parallel."""
    pose = np.stack([camera.T_camera_object[:3] for camera in rig.cameras])[:, None]
    # x / z = place: a row of (R x + t) less place times that of z.
    rows = np.where(seen[..., None, None], pose[:, :, :2] - flat[..., None] * pose[:, :, 2:], 0.0)
    normal = np.einsum("cnai,cnaj->nij", rows[..., :3], rows[..., :3])
    right = -np.einsum("cnai,cna->ni", rows[..., :3], rows[..., 3])
    fixed = _is_regular(normal)
    normal[~fixed] = np.eye(3)
    return np.where(fixed[:, None], np.linalg.solve(normal, right[..., None])[..., 0], np.nan)


def _refined(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    weight: Float[np.ndarray, "c n 2 2"],
    point: Points,
) -> tuple[Points, Float[np.ndarray, "n 3 3"], PointScalars]:
    """Points of least cost by Gauss-Newton, their covariance and squared error [px^2].

    A step that raises the cost or leads behind a camera is halved. NaN where that does not end.
    """
    n = len(point)
    point, step, inverse = point.copy(), np.zeros((n, 3)), np.zeros((n, 3, 3))
    cost, square = np.full(n, np.inf), np.zeros(n)
    distance = np.linalg.norm(point - camera_centre(rig.cameras[0]), axis=1)
    moving = np.flatnonzero(np.isfinite(distance))
    lost = np.isnan(distance)
    for _ in range(_MAX_STEPS):
        trial = point[moving] + step[moving]
        normal, right, new_cost, new_square = _normal_equations(
            rig, pixels[:, moving], weight[:, moving], trial
        )
        tiny = np.linalg.norm(step[moving], axis=1) <= _TINY * distance[moving]
        better = _is_regular(normal) & ((new_cost <= cost[moving]) | tiny)
        step[moving[~better]] *= 0.5
        taken = moving[better]
        point[taken], cost[taken], square[taken] = (
            trial[better],
            new_cost[better],
            new_square[better],
        )
        inverse[taken] = np.linalg.inv(normal[better])
        step[taken] = np.einsum("nij,nj->ni", inverse[taken], right[better])
        short = np.linalg.norm(step[moving], axis=1) <= _CONVERGED * distance[moving]
        moving = moving[~(better & short)]
    lost[moving] = True
    point[lost], inverse[lost], square[lost] = np.nan, np.nan, np.nan
    return point, inverse, square


def _normal_equations(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    weight: Float[np.ndarray, "c n 2 2"],
    point: Points,
) -> tuple[Float[np.ndarray, "n 3 3"], Points, PointScalars, PointScalars]:
    """Gauss-Newton's matrix and right-hand side, cost and squared error [px^2]; NaN if not seen."""
    n = len(point)
    normal, right, cost, square = np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros(n), np.zeros(n)
    for camera, measured, inverse in zip(rig.cameras, pixels, weight, strict=True):
        place, jacobian = project_jacobian(camera, point)
        used = inverse.any(axis=(1, 2))
        error = np.where(used[:, None], measured - place, 0.0)
        jacobian = np.where(used[:, None, None], jacobian, 0.0)
        weighted = (inverse @ error[..., None])[..., 0]
        normal += jacobian.swapaxes(1, 2) @ (inverse @ jacobian)
        right += np.einsum("nai,na->ni", jacobian, weighted)
        cost += (error * weighted).sum(axis=1)
        square += (error**2).sum(axis=1)
    return normal, right, cost, square


def _is_regular(matrix: Float[np.ndarray, "*n k k"]) -> Bool[np.ndarray, "*n"]:
    """True for symmetric matrices that are positive definite beyond rounding; False where NaN."""
    diagonal = np.einsum("...ii->...i", matrix)
    with np.errstate(invalid="ignore"):
        determinant = np.linalg.det(matrix)
    least = _MIN_DETERMINANT * diagonal.prod(axis=-1)
    return (diagonal > 0.0).all(axis=-1) & (determinant > least)
