"""Calibration of a rig from boards: start, bundle adjustment, rejection of inconsistent views.

Each camera starts by itself; then the cameras are placed relative to each other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from palpate.calibration.adjustment import LENS_TERMS, Adjusted, Bundle, Corners, adjust
from palpate.calibration.sightings import Sightings
from palpate.calibration.targets import Target
from palpate.errors import CalibrationError
from palpate.records import Camera, RigCovariance, camera_matrix, make_pose
from palpate.vision import calibration_numbers

# A view is rejected if its residual exceeds this many times the median of all views: it then shows
# something other than the same flat board at one instant.
_MAX_EXCESS = 3.0
# Largest difference of a board's poses from two cameras, rotation [rad] plus shift over distance.
_AGREED = 0.05
# Median length of a vector of two standard normal errors.
_RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
_POSE_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")
# Largest difference between poses of one board, rotation [rad] plus shift over distance: from one
# camera alone they are accurate to a few degrees or per cent; at different instants they differ by
# more.
_MAX_DIFFERENCE = 0.1
# With fewer views, a camera's lens cannot be separated from the boards' poses.
_MIN_VIEWS = 3
_Pose = Float[np.ndarray, "4 4"]


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Calibrated cameras with the covariance of their parameters.

    Attributes
    ----------
    cameras : tuple of Camera       in the frame of the first
    covariance : (p, p) float       of the parameters in `names`
    names : tuple of p str          lens terms of every camera, then rotation [rad] and shift [m] of
                                    every camera except the first, e.g. "c1.fx", "c1.tx"
    sightings : Sightings           views that were used
    corners : Corners               with marks numbered consistently in all cameras
    adjusted : Adjusted             result of the bundle adjustment
    notes : tuple of str            what was left out, and why
    """

    cameras: tuple[Camera, ...]
    covariance: Float[np.ndarray, "p p"]
    names: tuple[str, ...]
    sightings: Sightings
    corners: Corners
    adjusted: Adjusted
    notes: tuple[str, ...]


def calibrate(sightings: Sightings, targets: Sequence[Target]) -> Calibration:
    """Calibrate all cameras together.

    Parameters
    ----------
    sightings : Sightings
    targets : sequence of Target    the boards in `sightings`

    Returns
    -------
    Calibration

    Raises
    ------
    CalibrationError                too few views; cameras that share none; views too alike; more
                                    than a third of the views contradict the others
    """
    bundle, corners, inconsistent = _start_bundle(sightings, targets)
    cameras = cameras_of(sightings, bundle)
    notes = list(sightings.notes)
    for v in np.flatnonzero(inconsistent).tolist():
        cause = _cause(corners.chosen(corners.view == v), cameras)
        notes.append(f"view '{sightings.views[v]}' has its board at two places; left out: {cause}")
    views = np.flatnonzero(~inconsistent)
    bundle, corners = without_views(bundle, corners, inconsistent)
    while True:
        adjusted = adjust(bundle, corners)
        excess = view_errors(adjusted, corners, len(bundle.view))
        bad = excess > _MAX_EXCESS * np.median(excess)
        if not bad.any():
            break
        if bad.sum() > len(bad) // 3:
            raise CalibrationError(
                f"{int(bad.sum())} of {len(bad)} views contradict the others; is the board flat,"
                " are its dimensions right, and did all cameras take each picture at one instant?"
            )
        cameras = cameras_of(sightings, adjusted.bundle)
        for v in np.flatnonzero(bad).tolist():
            cause = _cause(corners.chosen(corners.view == v), cameras)
            notes.append(
                f"view '{sightings.views[views[v]]}' leaves {excess[v]:.1f} times the usual error;"
                f" left out: {cause}"
            )
        views = views[~bad]
        bundle, corners = without_views(adjusted.bundle, corners, bad)
    used = replace(
        sightings,
        views=tuple(sightings.views[v] for v in views),
        targets=tuple(sightings.targets[v] for v in views),
        corners=corners,
    )
    count = len(LENS_TERMS) * len(sightings.cameras) + 6 * (len(sightings.cameras) - 1)
    return Calibration(
        cameras_of(sightings, adjusted.bundle),
        adjusted.covariance[:count, :count],
        _names(sightings.cameras),
        used,
        corners,
        adjusted,
        tuple(notes),
    )


def known_rig(calibration: Calibration) -> RigCovariance:
    """Parameters of a calibration with their covariance, as a `RigCovariance`.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    RigCovariance
    """
    return RigCovariance(
        calibration.names,
        calibration_numbers(calibration.cameras, calibration.names),
        calibration.covariance,
        "calibration",
    )


def board_frame(
    calibration: Calibration, targets: Sequence[Target], view: str
) -> Float[np.ndarray, "4 4"]:
    """Frame on the board of one view: origin at its centre, x along its rows, z out of the print.

    Parameters
    ----------
    calibration : Calibration
    targets : sequence of Target    with which it was made
    view : str                      name of the view

    Returns
    -------
    (4, 4) float [m]                x_first camera = T x_frame

    Raises
    ------
    CalibrationError                there is no such view, or it was left out
    """
    sightings = calibration.sightings
    if view not in sightings.views:
        raise CalibrationError(
            f"there is no view '{view}' among those that were used: {', '.join(sightings.views)};"
            " give another to --table"
        )
    number = sightings.views.index(view)
    pose = calibration.adjusted.bundle.view[number]
    # Most targets have y down, so that their z axis points away from the viewer.
    away = np.sign(pose[:3, 2] @ pose[:3, 3])
    T_board_frame = np.diag([1.0, -away, -away, 1.0])
    T_board_frame[:3, 3] = targets[sightings.targets[number]].points.mean(axis=0)
    return pose @ T_board_frame


def view_errors(adjusted: Adjusted, corners: Corners, count: int) -> Float[np.ndarray, " v"]:
    """Residual of every view, in units of the noise of its cameras.

    The median over the corners of each picture, so that one badly located mark does not reject the
    others; of each view, the maximum over its pictures.

    Parameters
    ----------
    adjusted : Adjusted
    corners : Corners               that were adjusted
    count : int                     number of views

    Returns
    -------
    (v,) float [-]                  1 for normal errors; 0 for a view without corners
    """
    distance = np.linalg.norm(adjusted.residual, axis=1) / adjusted.noise[corners.camera]
    worst = np.zeros(count)
    for camera, view in set(zip(corners.camera.tolist(), corners.view.tolist(), strict=True)):
        seen = distance[(corners.camera == camera) & (corners.view == view)]
        worst[view] = max(worst[view], float(np.median(seen)) / _RAYLEIGH_MEDIAN)
    return worst


def _cause(corners: Corners, cameras: Sequence[Camera]) -> str:
    """Likely cause of an inconsistent view, as a question or advice."""
    cause = "is the board bent or partly covered there?"
    seen = np.unique(corners.camera).tolist()
    if len(seen) > 1:
        cause = "did the board move between the pictures of the cameras?"
    for a, b in combinations(seen, 2):
        if _swapped(corners, cameras, a, b):
            cause = (
                f"its pictures of '{cameras[a].name}' and '{cameras[b].name}' look swapped: rename"
                " these files"
            )
    return cause


def _swapped(corners: Corners, cameras: Sequence[Camera], a: int, b: int) -> bool:
    """Whether two cameras agree on the board's pose only after swapping their pictures."""

    def difference(first: int, second: int) -> float:
        poses = [
            board_pose(cameras[camera], corners.chosen(corners.camera == picture))
            for camera, picture in ((a, first), (b, second))
        ]
        between = poses[0] @ np.linalg.inv(poses[1])
        angle = np.arccos(np.clip((np.trace(between[:3, :3]) - 1.0) / 2.0, -1.0, 1.0))
        shift = np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3]) / np.linalg.norm(poses[0][:3, 3])
        return float(angle + shift)

    return difference(b, a) < _AGREED < difference(a, b)


def board_pose(camera: Camera, corners: Corners) -> Float[np.ndarray, "4 4"]:
    """Pose of a board from a single camera.

    Parameters
    ----------
    camera : Camera
    corners : Corners               of one board in one picture of that camera

    Returns
    -------
    (4, 4) float [m]                x = pose x_board, x in the common frame of the cameras
    """
    _, turn, shift = cv2.solvePnP(
        corners.point, corners.pixel, camera.matrix, camera.distortion[:5], flags=cv2.SOLVEPNP_IPPE
    )
    seen = make_pose(cv2.Rodrigues(turn)[0], shift.ravel())
    return np.asarray(np.linalg.inv(camera.T_camera_object) @ seen)


def without_views(
    bundle: Bundle, corners: Corners, bad: Bool[np.ndarray, " v"]
) -> tuple[Bundle, Corners]:
    """Remove views from a bundle and its corners, renumbering the others.

    Parameters
    ----------
    bundle : Bundle
    corners : Corners
    bad : (v,) bool                 views to remove

    Returns
    -------
    Bundle, Corners
    """
    keep = ~bad
    number = np.cumsum(keep) - 1
    remaining = corners.chosen(keep[corners.view])
    return replace(bundle, view=bundle.view[keep]), replace(remaining, view=number[remaining.view])


def cameras_of(sightings: Sightings, bundle: Bundle) -> tuple[Camera, ...]:
    """The cameras of a bundle.

    Parameters
    ----------
    sightings : Sightings               provides names and sizes
    bundle : Bundle

    Returns
    -------
    tuple of Camera

    Raises
    ------
    CalibrationError                as in `Camera`
    """
    return tuple(
        Camera(name, size, camera_matrix(intrinsics[:4]), intrinsics[4:], pose)
        for name, size, intrinsics, pose in zip(
            sightings.cameras, sightings.sizes, bundle.intrinsics, bundle.camera, strict=True
        )
    )


def _names(cameras: Sequence[str]) -> tuple[str, ...]:
    lens = [f"{camera}.{term}" for camera in cameras for term in LENS_TERMS]
    return (*lens, *(f"{camera}.{term}" for camera in cameras[1:] for term in _POSE_TERMS))


def _start_bundle(
    sightings: Sightings, targets: Sequence[Target]
) -> tuple[Bundle, Corners, Bool[np.ndarray, " v"]]:
    """Initial cameras and board poses for the bundle adjustment.

    Parameters
    ----------
    sightings : Sightings
    targets : sequence of Target    the boards in `sightings`

    Returns
    -------
    bundle : Bundle
    corners : Corners               those found; marks of boards that look the same after half a
                                    turn are numbered consistently in all cameras
    inconsistent : (v,) bool        views whose board poses differ between cameras

    Raises
    ------
    CalibrationError                too few views of a camera; cameras that share no view; board
                                    poses of a camera that mostly contradict the others
    """
    intrinsics, poses = [], []
    for c, name in enumerate(sightings.cameras):
        lens, seen = _single_camera(sightings, c)
        if len(seen) < _MIN_VIEWS:
            raise CalibrationError(
                f"camera '{name}': the board was found in {len(seen)} views; at least {_MIN_VIEWS}"
                " are needed, and 15 to 25 tilted to all sides are good"
            )
        intrinsics.append(lens)
        poses.append(seen)
    camera, view, turned, inconsistent = _placed(sightings, targets, poses)
    mark = sightings.mark.copy()
    for c, v in turned:
        rows = (sightings.corners.camera == c) & (sightings.corners.view == v)
        mark[rows] = np.asarray(targets[sightings.targets[v]].turned)[mark[rows]]
    point = sightings.corners.point.copy()
    for k, target in enumerate(targets):
        rows = np.array(sightings.targets)[sightings.corners.view] == k
        point[rows] = target.points[mark[rows]]
    corners = Corners(
        sightings.corners.camera, sightings.corners.view, point, sightings.corners.pixel
    )
    flags = np.isin(np.arange(len(view)), inconsistent)
    return Bundle(np.stack(intrinsics), np.stack(camera), np.stack(view)), corners, flags


def _single_camera(sightings: Sightings, c: int) -> tuple[Float[np.ndarray, "9"], dict[int, _Pose]]:
    """Lens of one camera, and the poses of the boards it sees in its own frame."""
    mine = sightings.corners.chosen(sightings.corners.camera == c)
    views = np.unique(mine.view)
    points = [mine.point[mine.view == v].astype(np.float32) for v in views]
    pixels = [mine.pixel[mine.view == v].astype(np.float32) for v in views]
    if len(views) < _MIN_VIEWS:
        return np.zeros(9), {int(v): np.eye(4) for v in views}
    size = sightings.sizes[c]
    # Few views may not determine k3; without it the start is closer.
    _, matrix, lens, turn, shift = cv2.calibrateCamera(
        points, pixels, size, camera_matrix(np.zeros(4)), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    intrinsics = np.array(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens.ravel()[:5]]
    )
    poses = {
        int(v): make_pose(Rotation.from_rotvec(r.ravel()).as_matrix(), t.ravel())
        for v, r, t in zip(views, turn, shift, strict=True)
    }
    return intrinsics, poses


def _placed(
    sightings: Sightings, targets: Sequence[Target], poses: Sequence[Mapping[int, _Pose]]
) -> tuple[list[_Pose], list[_Pose], list[tuple[int, int]], list[int]]:
    """Poses of cameras and views in the first camera's frame; pairs (camera, view) whose marks are
    numbered the other way round; views whose poses differ between cameras."""
    camera: dict[int, _Pose] = {0: np.eye(4)}
    view: dict[int, _Pose] = dict(poses[0])
    turned: list[tuple[int, int]] = []
    inconsistent: list[int] = []
    while len(camera) < len(poses):
        remaining = [c for c in range(len(poses)) if c not in camera]
        best = max(remaining, key=lambda c: len(view.keys() & poses[c].keys()))
        common = sorted(view.keys() & poses[best].keys())
        if not common:
            names = ", ".join(f"'{sightings.cameras[c]}'" for c in remaining)
            raise CalibrationError(
                f"cameras {names} share no view of a board with the others: take pictures of the"
                " board where two cameras see it at the same instant; files of one instant must"
                " have the same name in every camera's folder"
            )
        turns = {v: half_turn(targets[sightings.targets[v]]) for v in poses[best]}
        pose, flipped, gaps = _agreed(view, poses[best], common, turns)
        difference = float(np.median(gaps))
        inconsistent += [v for v, gap in zip(common, gaps, strict=True) if gap > _MAX_DIFFERENCE]
        if difference > _MAX_DIFFERENCE:
            raise CalibrationError(
                f"camera '{sightings.cameras[best]}' and the others do not see the board at the"
                f" same place: its poses differ by {100 * difference:.0f} % of the distance in"
                f" the median of {len(common)} common views; were pictures of the same name taken"
                " at the same instant? To calibrate the lens of one camera alone, give its own"
                " folder"
            )
        camera[best] = pose
        turned += [(best, v) for v in flipped]
        for v, seen in poses[best].items():
            view.setdefault(v, np.linalg.inv(pose) @ seen)
    posed = [camera[c] for c in range(len(poses))], [view[v] for v in range(len(view))]
    return *posed, turned, inconsistent


def half_turn(target: Target) -> _Pose | None:
    """Half-turn symmetry of a target: the motion that maps it onto itself; None if it has none.

    Parameters
    ----------
    target : Target

    Returns
    -------
    (4, 4) float [m] or None        in the target's frame
    """
    if target.turned is None:
        return None
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[:3, 3] = target.points[0] + target.points[-1]
    return pose


def _agreed(
    view: Mapping[int, _Pose],
    seen: Mapping[int, _Pose],
    common: Sequence[int],
    turns: Mapping[int, _Pose | None],
) -> tuple[_Pose, list[int], list[float]]:
    """Pose of a camera with the smallest median distance to those from the shared views; the views
    seen after half a turn; and the distance of every shared view from it."""
    tries: list[list[_Pose]] = []
    for v in common:
        back = np.linalg.inv(view[v])
        candidates = [np.eye(4)] if turns[v] is None else [np.eye(4), turns[v]]
        tries.append([seen[v] @ way @ back for way in candidates])
    size = np.median([np.linalg.norm(view[v][:3, 3]) for v in common])

    def difference(a: _Pose, b: _Pose) -> float:
        angle = Rotation.from_matrix(a[:3, :3] @ b[:3, :3].T).magnitude()
        return float(angle + np.linalg.norm(a[:3, 3] - b[:3, 3]) / size)

    def gaps(pose: _Pose) -> list[float]:
        return [min(difference(pose, other) for other in candidates) for candidates in tries]

    def cost(pose: _Pose) -> float:
        return float(np.median(gaps(pose)))

    best = min((pose for candidates in tries for pose in candidates), key=cost)
    flipped = [
        v
        for v, candidates in zip(common, tries, strict=True)
        if len(candidates) > 1 and difference(best, candidates[1]) < difference(best, candidates[0])
    ]
    return best, flipped, gaps(best)
