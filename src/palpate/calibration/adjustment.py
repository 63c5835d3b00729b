"""Bundle adjustment of lenses, camera poses and board poses, from all corners at once.

Levenberg-Marquardt on the reprojection errors, every camera weighted by the noise of its corners.
There are few unknowns (nine per lens, six per pose), so the normal matrix is dense and is inverted
as a whole for the covariance.

Source: Triggs et al., Bundle adjustment: a modern synthesis (2000); variance component estimation
of the noise of each camera (Foerstner, 1979).
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError
from palpate.shapes import Points

# OpenCV's model with five distortion terms; focal lengths and principal point in pixels.
LENS_TERMS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
_LENS, _POSE = len(LENS_TERMS), 6
_TOO_ALIKE = (
    "the views are too alike to tell focal length from distance: add views of the board tilted by"
    " 20 to 45 degrees {}"
)
_SIDES = ("to the right", "to the left", "up", "down")
_MAX_STEPS = 60
# Convergence: length of a step in standard deviations, by the norm of the normal matrix.
_SMALL_STEP = 1e-4
# Convergence of the noise levels, relative change.
_SETTLED = 1e-3
_MAX_ROUNDS = 12
# Corners with larger residuals, in units of the noise, are gross errors: probability 1e-6 for a
# normal distribution in two dimensions.
_GROSS = 5.3
# Minimum tilt that separates focal length from distance.
_MIN_TILT = np.deg2rad(12.0)
# Minimum eigenvalue of the normal matrix, scaled to unit diagonal, for all to be determined.
_MIN_EIGENVALUE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """Corners of boards detected in pictures.

    Attributes
    ----------
    camera, view : (m,) int         indices of the camera and of the view (board at an instant)
    point : (m, 3) float [m]        position on the board, in the board's frame
    pixel : (m, 2) float [px]
    """

    camera: Int[np.ndarray, " m"]
    view: Int[np.ndarray, " m"]
    point: Points
    pixel: Float[np.ndarray, "m 2"]

    def chosen(self, rows: Bool[np.ndarray, " m"]) -> "Corners":
        """Select some of the corners.

        Parameters
        ----------
        rows : (m,) bool

        Returns
        -------
        Corners
        """
        return Corners(self.camera[rows], self.view[rows], self.point[rows], self.pixel[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Bundle:
    """Lenses and poses of the cameras, and poses of the boards.

    Attributes
    ----------
    intrinsics : (c, 9) float       `LENS_TERMS` of every camera
    camera : (c, 4, 4) float [m]    pose: x_camera = camera x, x in the frame of the first camera
    view : (v, 4, 4) float [m]      pose of every board: x = view x_board
    """

    intrinsics: Float[np.ndarray, "c 9"]
    camera: Float[np.ndarray, "c 4 4"]
    view: Float[np.ndarray, "v 4 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """Result of a bundle adjustment.

    Attributes
    ----------
    bundle : Bundle
    residual : (m, 2) float [px]    pixel minus projection, for all corners including gross errors
    good : (m,) bool                False for gross errors, which have no weight
    noise : (c,) float [px]         standard deviation of a corner's coordinate in each camera
    covariance : (p, p) float       of the lens terms of all cameras (9 c), then of rotation [rad]
                                    and shift [m] of each camera except the first (6 (c - 1)), then
                                    of the boards (6 v); an error e of a pose is a further rotation,
                                    exp([e]) R, and a shift added to its translation
    """

    bundle: Bundle
    residual: Float[np.ndarray, "m 2"]
    good: Bool[np.ndarray, " m"]
    noise: Float[np.ndarray, " c"]
    covariance: Float[np.ndarray, "p p"]


def adjust(bundle: Bundle, corners: Corners) -> Adjusted:
    """Adjust lenses, cameras and boards to minimise the weighted reprojection errors.

    Parameters
    ----------
    bundle : Bundle                 start, accurate to some per cent
    corners : Corners               of views that at least one camera sees

    Returns
    -------
    Adjusted

    Raises
    ------
    CalibrationError                the views are too alike to determine all unknowns, or the
                                    iteration did not converge
    """
    noise = np.ones(len(bundle.intrinsics))
    good = np.ones(len(corners.pixel), dtype=bool)
    for _ in range(_MAX_ROUNDS):
        weight = good / noise[corners.camera] ** 2
        bundle, equations = _least_squares(bundle, corners, weight)
        inverse = _inverse(equations.normal_matrix(weight), bundle, corners)
        new = _noise(equations, inverse, corners.camera, weight, noise)
        still = _without_gross_errors(equations.residual, corners, len(noise))
        settled = np.all(np.abs(new / noise - 1.0) < _SETTLED) and np.array_equal(still, good)
        noise, good = new, still
        if settled:
            break
    return Adjusted(bundle, equations.residual, good, noise, inverse)


@dataclass(frozen=True, slots=True, eq=False)
class _Equations:
    """Residuals of all corners and the derivatives of their projections.

    Corners of one camera and view form a group: they depend on the same unknowns. The pose of the
    first camera, which defines the frame, has indices among the unknowns but is left out of all
    sums (`free`).
    """

    residual: Float[np.ndarray, "m 2"]
    jacobian: Float[np.ndarray, "m 2 21"]
    group: Int[np.ndarray, " m"]
    unknowns: Int[np.ndarray, "g 21"]
    free: Int[np.ndarray, " p"]

    def normal_matrix(self, weight: Float[np.ndarray, " m"]) -> Float[np.ndarray, "p p"]:
        """Normal matrix of the free unknowns."""
        matrix = np.zeros((len(self.free) + _POSE,) * 2)
        for g, unknowns in enumerate(self.unknowns):
            rows = self.group == g
            jacobian = self.jacobian[rows].reshape(-1, unknowns.size)
            both = jacobian.T @ (np.repeat(weight[rows], 2)[:, None] * jacobian)
            matrix[np.ix_(unknowns, unknowns)] += both
        return matrix[np.ix_(self.free, self.free)]

    def right_hand_side(self, weight: Float[np.ndarray, " m"]) -> Float[np.ndarray, " p"]:
        """Right-hand side of the normal equations."""
        gradient = np.einsum("m,mai,ma->mi", weight, self.jacobian, self.residual)
        index = self.unknowns[self.group].ravel()
        return np.bincount(index, gradient.ravel(), len(self.free) + _POSE)[self.free]

    def explained(self, inverse: Float[np.ndarray, "p p"]) -> Float[np.ndarray, "m 2"]:
        """Variance of every corner's projection, propagated from the unknowns' covariance."""
        whole = np.zeros((len(self.free) + _POSE,) * 2)
        whole[np.ix_(self.free, self.free)] = inverse
        part = whole[self.unknowns[:, :, None], self.unknowns[:, None, :]][self.group]
        return np.einsum("mai,mij,maj->ma", self.jacobian, part, self.jacobian, optimize=True)


def _least_squares(
    bundle: Bundle, corners: Corners, weight: Float[np.ndarray, " m"]
) -> tuple[Bundle, _Equations]:
    """Levenberg-Marquardt iteration from a bundle to the nearest minimum."""

    def cost(equations: _Equations) -> float:
        return float(weight @ (equations.residual**2).sum(axis=1))

    damping = 1e-3
    here = _linearised(bundle, corners)
    for _ in range(_MAX_STEPS):
        matrix = here.normal_matrix(weight)
        size = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
        unit = matrix / np.outer(size, size) + damping * np.eye(len(size))
        step = np.linalg.solve(unit, here.right_hand_side(weight) / size) / size
        trial = moved(bundle, step)
        # Too long a step may give overflow or NaN; it is then rejected.
        with np.errstate(all="ignore"):
            there = _linearised(trial, corners)
        if not cost(there) <= cost(here) * (1.0 + 1e-12):
            damping = max(10.0 * damping, 1e-6)
            continue
        bundle, here = trial, there
        damping = 0.1 * damping if damping > 1e-10 else 0.0
        if float(step @ matrix @ step) < _SMALL_STEP**2:
            return bundle, here
    if missing := _missing_tilts(bundle, corners):
        raise CalibrationError(_TOO_ALIKE.format(", ".join(missing)))
    raise CalibrationError(
        f"the cameras did not settle in {_MAX_STEPS} steps; are the board's dimensions right, and"
        " do all views show the same board?"
    )


def _without_gross_errors(
    residual: Float[np.ndarray, "m 2"], corners: Corners, cameras: int
) -> Bool[np.ndarray, " m"]:
    """True for corners that are not gross errors, and for all of a view with half or more gross.

    The noise is estimated from medians, which gross errors do not inflate.
    """
    length = np.linalg.norm(residual, axis=1)
    # Median of the length of a normal vector in the plane: sqrt(2 log 2).
    width = np.array(
        [
            np.median(length[corners.camera == c]) / np.sqrt(2.0 * np.log(2.0))
            for c in range(cameras)
        ]
    )
    near = length <= _GROSS * width[corners.camera]
    fraction = np.bincount(corners.view, near) / np.maximum(np.bincount(corners.view), 1)
    return near | (fraction[corners.view] < 0.5)


def _inverse(
    matrix: Float[np.ndarray, "p p"], bundle: Bundle, corners: Corners
) -> Float[np.ndarray, "p p"]:
    """Inverse of the normal matrix; raises if a combination of unknowns is undetermined."""
    size = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    if values[0] < _MIN_EIGENVALUE:
        missing = _missing_tilts(bundle, corners) or list(_SIDES)
        raise CalibrationError(_TOO_ALIKE.format(", ".join(missing)))
    return (vectors / values) @ vectors.T / np.outer(size, size)


def _missing_tilts(bundle: Bundle, corners: Corners) -> list[str]:
    """Directions in which some camera saw no board tilted."""
    missing: set[str] = set()
    for c, pose in enumerate(bundle.camera):
        views = np.unique(corners.view[corners.camera == c])
        missing.update(missing_tilts(pose @ bundle.view[views]))
    return [side for side in _SIDES if side in missing]


def view_jacobians(bundle: Bundle, corners: Corners) -> Float[np.ndarray, "m 2 6"]:
    """Derivative of every corner's pixel with respect to the pose of its board.

    Parameters
    ----------
    bundle : Bundle
    corners : Corners

    Returns
    -------
    (m, 2, 6) float                 by a rotation about the board's origin [px/rad] and a shift
                                    [px/m], both in the common frame of the cameras
    """
    return _linearised(bundle, corners).jacobian[:, :, -_POSE:]


def missing_tilts(pose: Float[np.ndarray, "v 4 4"]) -> list[str]:
    """Directions in which no board was tilted, as seen by a camera.

    Parameters
    ----------
    pose : (v, 4, 4) float          x_camera = pose x_board

    Returns
    -------
    list of str                     of "to the right", "to the left", "up", "down"
    """
    normal = pose[:, :3, 2]
    # Normals towards the camera, in whose frame right is +x and down +y.
    normal = normal * -np.sign(np.einsum("va,va->v", normal, pose[:, :3, 3]))[:, None]
    sideways = np.arctan2(normal[:, 0], -normal[:, 2])
    upward = np.arctan2(-normal[:, 1], -normal[:, 2])
    tilts = (
        sideways.max(initial=0.0), -sideways.min(initial=0.0),
        upward.max(initial=0.0), -upward.min(initial=0.0),
    )  # fmt: skip
    return [side for side, tilt in zip(_SIDES, tilts, strict=True) if tilt < _MIN_TILT]


def _noise(
    equations: _Equations,
    inverse: Float[np.ndarray, "p p"],
    camera: Int[np.ndarray, " m"],
    weight: Float[np.ndarray, " m"],
    noise: Float[np.ndarray, " c"],
) -> Float[np.ndarray, " c"]:
    """Noise of each camera from its residuals, corrected for the degrees of freedom of the fit."""
    used = weight > 0.0
    redundancy = np.where(used, 2.0 - weight * equations.explained(inverse).sum(axis=1), 0.0)
    square = np.where(used, (equations.residual**2).sum(axis=1), 0.0)
    count = len(noise)
    freedom = np.bincount(camera, redundancy, count)
    new = np.bincount(camera, square, count) / np.where(freedom > 0.0, freedom, np.inf)
    # Only simulated corners have no noise.
    return np.maximum(np.sqrt(new), 1e-9)


def _linearised(bundle: Bundle, corners: Corners) -> _Equations:
    """Residuals of all corners, and derivatives of their projections for all unknowns."""
    c, v = corners.camera, corners.view
    board = bundle.view[v]
    turned = np.einsum("mij,mj->mi", board[:, :3, :3], corners.point)
    in_world = turned + board[:, :3, 3]
    pose = bundle.camera[c]
    rotated = np.einsum("mij,mj->mi", pose[:, :3, :3], in_world)
    in_camera = rotated + pose[:, :3, 3]
    pixel, by_point = np.empty((len(c), 2)), np.empty((len(c), 2, 3))
    by_intrinsics = np.empty((len(c), 2, _LENS))
    for k in np.unique(c):
        seen = c == k
        pixel[seen], by_intrinsics[seen], by_point[seen] = seen_points(
            bundle.intrinsics[k], in_camera[seen]
        )
    by_camera = np.concatenate([by_point @ _skew_matrices(-rotated), by_point], axis=2)
    by_place = by_point @ pose[:, :3, :3]
    by_view = np.concatenate([by_place @ _skew_matrices(-turned), by_place], axis=2)
    count, views = len(bundle.intrinsics), len(bundle.view)
    groups, group = np.unique(c * views + v, return_inverse=True)
    of_camera, of_view = groups[:, None] // views, groups[:, None] % views
    start_pose, start_view = _LENS * count, (_LENS + _POSE) * count
    unknowns = np.concatenate(
        [
            _LENS * of_camera + np.arange(_LENS),
            start_pose + _POSE * of_camera + np.arange(_POSE),
            start_view + _POSE * of_view + np.arange(_POSE),
        ],
        axis=1,
    )
    return _Equations(
        corners.pixel - pixel,
        np.concatenate([by_intrinsics, by_camera, by_view], axis=2),
        group.ravel(),
        unknowns,
        np.delete(np.arange(start_view + _POSE * views), start_pose + np.arange(_POSE)),
    )


def _skew_matrices(vector: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 3 3"]:
    """Skew-symmetric matrices [v]x of the cross product with each vector."""
    x, y, z = vector.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)


def moved(bundle: Bundle, step: Float[np.ndarray, " p"]) -> Bundle:
    """Apply a step of all unknowns to a bundle.

    Parameters
    ----------
    bundle : Bundle
    step : (p,) float               in the order of `Adjusted.covariance`

    Returns
    -------
    Bundle
    """
    count = len(bundle.intrinsics)
    lens, rest = np.split(step, [_LENS * count])
    pose, view = np.split(rest.reshape(-1, _POSE), [count - 1])
    return replace(
        bundle,
        intrinsics=bundle.intrinsics + lens.reshape(count, _LENS),
        camera=_turned(bundle.camera, np.vstack([np.zeros(_POSE), pose])),
        view=_turned(bundle.view, view),
    )


def _turned(pose: Float[np.ndarray, "k 4 4"], step: Float[np.ndarray, "k 6"]) -> np.ndarray:
    """Rotate poses by `step[:, :3]`, leaving their translation, which `step[:, 3:]` is added to."""
    result = pose.copy()
    result[:, :3, :3] = Rotation.from_rotvec(step[:, :3]).as_matrix() @ pose[:, :3, :3]
    result[:, :3, 3] += step[:, 3:]
    return result


def seen_points(
    intrinsics: Float[np.ndarray, "9"], points: Points
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 9"], Float[np.ndarray, "n 2 3"]]:
    """Project points into one camera, with derivatives with respect to lens terms and points.

    Parameters
    ----------
    intrinsics : (9,) float         `LENS_TERMS` of the camera
    points : (n, 3) float [m]       frame of the camera, in front of it; at least one

    Returns
    -------
    pixel : (n, 2) float [px]
    by_intrinsics : (n, 2, 9) float  derivative with respect to `LENS_TERMS`
    by_point : (n, 2, 3) float [px/m]   derivative with respect to the point
    """
    fx, fy, cx, cy, *distortion = intrinsics
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    pixel, jacobian = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), matrix, np.array(distortion)
    )
    # OpenCV's order: rotation, shift, focal lengths, principal point, distortion.
    jacobian = jacobian.reshape(-1, 2, 15)
    return pixel[:, 0], jacobian[:, :, 6:], jacobian[:, :, 3:6]
