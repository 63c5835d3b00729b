"""Apparent strain of measured space caused by calibration errors of the cameras."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from palpate.errors import CalibrationError, quoted
from palpate.records import Camera, Rig, RigCovariance
from palpate.shapes import Points
from palpate.vision.cameras.projection import project
from palpate.vision.cameras.triangulation import triangulate

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
    found: dict[str, float] = {}
    for name, camera in by_name.items():
        lens = (*camera.matrix[_INTRINSICS], *camera.distortion[:5])
        found |= zip((f"{name}.{term}" for term in _LENS), lens, strict=True)
        pose = camera.T_camera_object @ np.linalg.inv(first.T_camera_object)
        turn = Rotation.from_matrix(pose[:3, :3]).as_rotvec()
        found |= zip((f"{name}.{term}" for term in _POSE), (*turn, *pose[:3, 3]), strict=True)
    unknown = [name for name in names if name not in found]
    if unknown:
        raise CalibrationError(
            f"{quoted(unknown[0])} is no number of a camera; known are CAMERA.TERM with the terms"
            f" {' '.join(_LENS + _POSE)}"
        )
    return np.array([found[name] for name in names])


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
    told = {name.rpartition(".")[0] for name in names}
    known = {camera.name: camera for camera in cameras}
    if told - set(known) or len(told - posed) != 1:
        raise CalibrationError(
            f"the covariance is of the cameras {', '.join(sorted(told))}, the rig has"
            f" {', '.join(sorted(known))}; name them alike, or calibrate again"
        )
    return known[(told - posed).pop()]


def _check_same(rig: Rig, known: RigCovariance) -> None:
    """Raise if the covariance's values are not those of the rig."""
    try:
        found = calibration_numbers(rig.cameras, known.names)
    except CalibrationError as error:
        raise CalibrationError(f"{known.source}: {error}") from error
    std = np.sqrt(np.diag(known.covariance))
    # Files hold all digits, but converting a rotation and back rounds the last ones.
    off = np.abs(found - known.value) - std - 1e-6 * np.abs(known.value)
    if np.any(off > 1e-9):
        worst = int(off.argmax())
        raise CalibrationError(
            f"{known.source}: {known.names[worst]} is {known.value[worst]:.6g} there and"
            f" {found[worst]:.6g} in {rig.source}: it is the covariance of another calibration;"
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
