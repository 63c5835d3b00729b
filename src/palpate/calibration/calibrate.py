"""Calibration of a rig from boards: start, bundle adjustment, rejection of inconsistent views."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from jaxtyping import Bool, Float

from palpate.calibration.adjustment import Adjusted, Bundle, Corners, adjust
from palpate.calibration.lens_model import LENS_TERMS
from palpate.calibration.sightings import Sightings
from palpate.calibration.start import start_bundle
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


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Calibrated cameras with the covariance of their parameters.

    Attributes
    ----------
    cameras : tuple of Camera       in the frame of the first
    covariance : (p, p) float       of the parameters in `names`
    names : tuple of p str          lens terms of every camera, then rotation [rad] and shift [m] of
                                    every camera except the first, e.g. "c1.fx", "c1.tx"
    found : Sightings               views that were used
    corners : Corners               with marks numbered consistently in all cameras
    adjusted : Adjusted             result of the bundle adjustment
    notes : tuple of str            what was left out, and why
    """

    cameras: tuple[Camera, ...]
    covariance: Float[np.ndarray, "p p"]
    names: tuple[str, ...]
    found: Sightings
    corners: Corners
    adjusted: Adjusted
    notes: tuple[str, ...]


def calibrate(found: Sightings, targets: Sequence[Target]) -> Calibration:
    """Calibrate all cameras together.

    Parameters
    ----------
    found : Sightings
    targets : sequence of Target    the boards in `found`

    Returns
    -------
    Calibration

    Raises
    ------
    CalibrationError                too few views; cameras that share none; views too alike; more
                                    than a third of the views contradict the others
    """
    bundle, corners, inconsistent = start_bundle(found, targets)
    cameras = cameras_of(found, bundle)
    notes = list(found.notes)
    for v in np.flatnonzero(inconsistent).tolist():
        cause = _cause(corners.chosen(corners.view == v), cameras)
        notes.append(f"view '{found.views[v]}' has its board at two places; left out: {cause}")
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
        cameras = cameras_of(found, adjusted.bundle)
        for v in np.flatnonzero(bad).tolist():
            cause = _cause(corners.chosen(corners.view == v), cameras)
            notes.append(
                f"view '{found.views[views[v]]}' leaves {excess[v]:.1f} times the usual error; left"
                f" out: {cause}"
            )
        views = views[~bad]
        bundle, corners = without_views(adjusted.bundle, corners, bad)
    used = replace(
        found,
        views=tuple(found.views[v] for v in views),
        targets=tuple(found.targets[v] for v in views),
        corners=corners,
    )
    count = len(LENS_TERMS) * len(found.cameras) + 6 * (len(found.cameras) - 1)
    return Calibration(
        cameras_of(found, adjusted.bundle),
        adjusted.covariance[:count, :count],
        _names(found.cameras),
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
    found = calibration.found
    if view not in found.views:
        raise CalibrationError(
            f"there is no view '{view}' among those that were used: {', '.join(found.views)}; give"
            " another to --table"
        )
    number = found.views.index(view)
    pose = calibration.adjusted.bundle.view[number]
    # Most targets have y down, so that their z axis points away from the viewer.
    away = np.sign(pose[:3, 2] @ pose[:3, 3])
    T_board_frame = np.diag([1.0, -away, -away, 1.0])
    T_board_frame[:3, 3] = targets[found.targets[number]].points.mean(axis=0)
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


def cameras_of(found: Sightings, bundle: Bundle) -> tuple[Camera, ...]:
    """The cameras of a bundle.

    Parameters
    ----------
    found : Sightings               provides names and sizes
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
            found.cameras, found.sizes, bundle.intrinsics, bundle.camera, strict=True
        )
    )


def _names(cameras: Sequence[str]) -> tuple[str, ...]:
    lens = [f"{camera}.{term}" for camera in cameras for term in LENS_TERMS]
    return (*lens, *(f"{camera}.{term}" for camera in cameras[1:] for term in _POSE_TERMS))
