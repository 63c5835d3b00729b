"""What errors of a calibration do to lengths: space as cameras see it, stretched and sheared."""

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
# Where the first four of them stand in the matrix of a camera.
_INNER = np.array([0, 1, 0, 1]), np.array([0, 1, 2, 2])
_POSE = ("rx", "ry", "rz", "tx", "ty", "tz")
# Points that space is looked at, around those that are given; how far around, of their extent.
_MAX_POINTS, _AROUND = 100, 0.05
# Fewer say nothing.
_FEWEST = 12
# A step of so many standard deviations both ways: what follows is linear in it.
_STEP = 0.5
# Strains that add less than this to the variance of the largest are left out.
_LEAST_VARIANCE = 1e-3


def calibration_numbers(cameras: Sequence[Camera], names: Sequence[str]) -> Float[np.ndarray, " p"]:
    """Numbers of cameras by the names that a covariance gives them (`RigCovariance.names`).

    Parameters
    ----------
    cameras : sequence of Camera    the first of the calibration is the one without a pose in
                                    `names`
    names : sequence of p str

    Returns
    -------
    (p,) float                      of the pose with respect to that first camera

    Raises
    ------
    CalibrationError                a name of no camera or term
    """
    by_name = {camera.name: camera for camera in cameras}
    first = _first(cameras, names)
    found: dict[str, float] = {}
    for name, camera in by_name.items():
        lens = (*camera.matrix[_INNER], *camera.distortion[:5])
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
    """Strains of what cameras measure around some points, by the errors of their calibration.

    A point that cameras triangulate lies beside the true one; what differs between points changes
    displacements. Its mean over all that two cameras have in their pictures counts. A common turn
    is left out: a surface that was measured with the same cameras, or registered to what they see,
    is turned alike.

    Parameters
    ----------
    rig : Rig                       object frame
    known : RigCovariance           of the same cameras
    points : (n, 3) float [m]       of a surface, seen or not

    Returns
    -------
    (m, 3, 3) float [-]             symmetric, for one standard deviation of independent errors, the
                                    largest first, m <= 6

    Raises
    ------
    CalibrationError                the covariance is of other cameras; two cameras do not see the
                                    points
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
    keep = size**2 > _LEAST_VARIANCE * size[0] ** 2
    return (size[keep, None] * strain[keep]).reshape(-1, 3, 3)


def _cloud(rig: Rig, points: Points) -> Float[np.ndarray, "m 3"]:
    """Points that two cameras see, and some around each, lest a flat surface leave its normal
    open."""
    points = points[:: max(len(points) // _MAX_POINTS, 1)]
    reach = _AROUND * float(np.ptp(points, axis=0).max())
    around = reach * np.concatenate([np.eye(3), -np.eye(3)])
    points = (points[:, None] + around).reshape(-1, 3)
    count = np.zeros(len(points), dtype=np.int64)
    for camera in rig.cameras:
        pixel = project(camera, points)
        # Beyond the picture nothing holds the lens.
        end = np.array(camera.size or (np.inf, np.inf)) - 1.0
        with np.errstate(invalid="ignore"):
            count += ((pixel >= 0.0) & (pixel <= end)).all(axis=1)
    seen = count >= 2
    if seen.sum() < _FEWEST:
        raise CalibrationError(
            f"{rig.source}: two cameras together see {int(seen.sum())} of {len(points)} points on"
            " and about the object; check its pose, and the length units of rig and mesh"
        )
    return points[seen]


def _first(cameras: Sequence[Camera], names: Sequence[str]) -> Camera:
    """The camera whose frame the poses are in: the one that has none."""
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
    """Refuse a covariance of numbers that are not the rig's."""
    try:
        found = calibration_numbers(rig.cameras, known.names)
    except CalibrationError as error:
        raise CalibrationError(f"{known.source}: {error}") from error
    std = np.sqrt(np.diag(known.covariance))
    # Files are written with all digits; a turn and its inverse are not exact to the last.
    off = np.abs(found - known.value) - std - 1e-6 * np.abs(known.value)
    if np.any(off > 1e-9):
        worst = int(off.argmax())
        raise CalibrationError(
            f"{known.source}: {known.names[worst]} is {known.value[worst]:.6g} there and"
            f" {found[worst]:.6g} in {rig.source}: it is the covariance of another calibration;"
            " copy the file that was written with this rig, or remove it"
        )


def moved_rig(rig: Rig, names: Sequence[str], step: Float[np.ndarray, " p"]) -> Rig:
    """The rig with its numbers off by a step; poses with respect to the first camera.

    Parameters
    ----------
    rig : Rig
    names : sequence of p str       as in `RigCovariance`
    step : (p,) float               a turn is added after that of the pose

    Returns
    -------
    Rig
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
        matrix[_INNER] += lens[:4]
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
