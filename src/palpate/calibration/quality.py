"""Quality of a calibration: residuals by camera and region, missing views, lengths, timing; files.

Timing errors, a rolling shutter or unsynchronised cameras, are seen while boards move, whose motion
need not be known. The residuals of a view are compared with those that a velocity of its board
would cause: with a rolling shutter, each row is shifted by the time at which it is read; if a
camera is late, all its corners are shifted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from jaxtyping import Float, Int

from palpate.calibration.adjustment import Corners, adjust, missing_tilts, view_jacobians
from palpate.calibration.calibrate import (
    Calibration,
    board_frame,
    cameras_of,
    known_rig,
    without_views,
)
from palpate.calibration.targets import Target
from palpate.errors import CalibrationError, RecordError
from palpate.records import (
    Camera,
    Rig,
    spreadsheet_text,
    write_rig,
    write_rig_covariance,
    write_text,
)
from palpate.vision import space_strains, triangulate

# Regions of a picture in each direction.
REGIONS = 3
_ROWS, _COLUMNS = ("upper", "middle", "lower"), ("left", "centre", "right")
# Minimum number of corners for a region to count as covered.
_MIN_CORNERS = 10
# Largest relative error of a baseline measured from outside; a larger one means a wrong board size.
_MAX_BASELINE_ERROR = 0.05
# An object on a board is so high, over the board's extent; what is said of its lengths is that of
# the worst of so many directions.
_HEIGHT, _DIRECTIONS = 0.5, 200
# One view in this many is held out to check lengths.
_FOLD = 4
# Minimum fraction of the residual variance explained by velocities, adjusted for their number; and
# its minimum excess for rows over columns, because a bent board is fitted equally well by both.
_MUCH, _MORE = 0.3, 0.1
_POSE, _VELOCITY = 6, 3
_ROLLS = (
    "boards that move while rows are read one after another explain {fraction:.0%} of the variance"
    " of the corners: a shutter rolls; hold the board still for a second in each place"
)
_LATE = (
    "boards that move between the cameras' pictures explain {fraction:.0%} of the variance of the"
    " corners: {who} not at one instant; start the cameras by one trigger, or hold the board still"
    " for a second in each place"
)


@dataclass(frozen=True, slots=True, eq=False)
class CameraQuality:
    """Residuals and coverage of a calibration in the pictures of one camera.

    Attributes
    ----------
    name : str
    views, corners, rejected : int  counts of views, of corners in them, of gross errors among these
    noise : float [px]              standard deviation of a corner's coordinate
    rms : (3, 3) float [px]         rms reprojection distance by region of the picture, rows from
                                    top to bottom; NaN without corners
    seen : (3, 3) int               number of corners in each region
    missing : tuple of str          advice on views to add
    """

    name: str
    views: int
    corners: int
    rejected: int
    noise: float
    rms: Float[np.ndarray, "3 3"]
    seen: Int[np.ndarray, "3 3"]
    missing: tuple[str, ...]


def camera_quality(calibration: Calibration) -> tuple[CameraQuality, ...]:
    """Quality of every camera.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    tuple of CameraQuality
    """
    return tuple(_quality(calibration, c) for c in range(len(calibration.cameras)))


def _quality(calibration: Calibration, c: int) -> CameraQuality:
    adjusted, corners = calibration.adjusted, calibration.corners
    mine = corners.camera == c
    good = mine & adjusted.good
    size = np.array(calibration.sightings.sizes[c])
    cell = np.clip(REGIONS * corners.pixel[good] / size, 0, REGIONS - 1e-9).astype(np.int64)
    number = REGIONS * cell[:, 1] + cell[:, 0]
    seen = np.bincount(number, minlength=REGIONS**2)
    square = np.bincount(number, (adjusted.residual[good] ** 2).sum(axis=1), REGIONS**2)
    rms = np.sqrt(np.where(seen > 0, square / np.maximum(seen, 1), np.nan))
    shape = (REGIONS, REGIONS)
    views = np.unique(corners.view[mine])
    name = calibration.cameras[c].name
    pose = adjusted.bundle.camera[c] @ adjusted.bundle.view[views]
    missing = [*_missing_regions(name, seen.reshape(shape)), *_tilt_texts(name, pose)]
    return CameraQuality(
        name, len(views), int(mine.sum()), int(mine.sum() - good.sum()), float(adjusted.noise[c]),
        rms.reshape(shape), seen.reshape(shape), tuple(missing),
    )  # fmt: skip


def _missing_regions(name: str, seen: Int[np.ndarray, "3 3"]) -> list[str]:
    """Advice on regions of the picture that no board covered."""
    empty = [f"{_ROWS[row]} {_COLUMNS[column]}" for row, column in np.argwhere(seen < _MIN_CORNERS)]
    if not empty:
        return []
    return [f"{name}: no board in the {', '.join(empty)} of the picture: show it there too"]


def _tilt_texts(name: str, pose: Float[np.ndarray, "v 4 4"]) -> list[str]:
    missing = missing_tilts(pose)
    return [f"{name}: tilt the board {', '.join(missing)}, by 20 to 45 degrees"] if missing else []


@dataclass(frozen=True, slots=True)
class PictureError:
    """Residuals of a calibration in one picture.

    Attributes
    ----------
    camera, view : str
    corners, rejected : int         corners found, and gross errors among these
    rms : float [px]                rms reprojection distance of the others; NaN if there are none
    """

    camera: str
    view: str
    corners: int
    rejected: int
    rms: float


def picture_errors(calibration: Calibration) -> tuple[PictureError, ...]:
    """Residuals in every picture that was used.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    tuple of PictureError           camera by camera, views in their order
    """
    corners, good = calibration.corners, calibration.adjusted.good
    square = (calibration.adjusted.residual**2).sum(axis=1)
    errors = []
    for c, camera in enumerate(calibration.cameras):
        for v, view in enumerate(calibration.sightings.views):
            mine = (corners.camera == c) & (corners.view == v)
            if not mine.any():
                continue
            accepted = mine & good
            rms = float(np.sqrt(square[accepted].mean())) if accepted.any() else np.nan
            rejected = int(mine.sum() - accepted.sum())
            errors.append(PictureError(camera.name, view, int(mine.sum()), rejected, rms))
    return tuple(errors)


def length_check(calibration: Calibration) -> tuple[int, float, float] | None:
    """Calibrate without a quarter of the views, and measure the size of the board in those.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    views : int                     number of board views measured, none of which the calibration
                                    that measures them has seen
    error : float [-]               mean ratio of measured to true size, minus one
    scatter : float [-]             standard deviation of a single ratio
                                    None for a single camera, fewer than 12 views, or fewer than two
                                    held-out ones that two cameras share; None, too, if the
                                    calibration of the others fails
    """
    corners, views = calibration.corners, len(calibration.sightings.views)
    held = np.arange(views) % _FOLD == 0
    if len(calibration.cameras) < 2 or views < 3 * _FOLD:
        return None
    bundle, rest = without_views(calibration.adjusted.bundle, corners, held)
    try:
        adjusted = adjust(bundle, rest)
    except CalibrationError:
        return None
    rig = Rig(cameras_of(calibration.sightings, adjusted.bundle), 0, "calibration")
    good = calibration.adjusted.good
    scales = [_scale(rig, corners.chosen(good & (corners.view == v))) for v in np.flatnonzero(held)]
    known = np.array([scale for scale in scales if scale is not None])
    if len(known) < 2:
        return None
    return len(known), float(known.mean() - 1.0), float(known.std(ddof=1))


def _scale(rig: Rig, corners: Corners) -> float | None:
    """Ratio of a board's measured to its true size; None if two cameras share too few corners.

    Source
    ------
    Umeyama, Least-squares estimation of transformation parameters between two point patterns (1991)
    """
    points, number = np.unique(corners.point, axis=0, return_inverse=True)
    pixels = np.full((len(rig.cameras), len(points), 2), np.nan)
    pixels[corners.camera, number.ravel()] = corners.pixel
    corner_points = triangulate(rig, pixels, 1.0).point
    seen = np.isfinite(corner_points[:, 0])
    if seen.sum() < _MIN_CORNERS:
        return None
    true = points[seen] - points[seen].mean(axis=0)
    return float(
        np.linalg.svd(true.T @ corner_points[seen], compute_uv=False).sum() / (true**2).sum()
    )


def length_sigma(calibration: Calibration, targets: Sequence[Target], view: str) -> float:
    """Relative standard deviation of lengths on an object that stands where a board lay, along the
    direction in which it is largest.

    It is common to all lengths along that direction, and from the covariance alone: an error of the
    board's own dimensions is not in it.

    Parameters
    ----------
    calibration : Calibration       of two cameras at least
    targets : sequence of Target    with which it was made
    view : str                      of the board; the object is as wide, and half as high

    Returns
    -------
    float [-]

    Raises
    ------
    CalibrationError                there is no such view, or two cameras together hardly see the
                                    object
    """
    frame = board_frame(calibration, targets, view)
    sightings = calibration.sightings
    board = targets[sightings.targets[sightings.views.index(view)]].points
    flat = board - board.mean(axis=0)
    height = _HEIGHT * float(np.ptp(flat, axis=0).max())
    points = np.concatenate([flat, flat + np.array([0.0, 0.0, height])])
    strains = space_strains(
        Rig(calibration.cameras, 0, "calibration"),
        known_rig(calibration),
        points @ frame[:3, :3].T + frame[:3, 3],
    )
    along = np.random.default_rng(0).standard_normal((_DIRECTIONS, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    stretches = np.einsum("di,mij,dj->dm", along, strains, along)
    return float(np.linalg.norm(stretches, axis=1).max())


def middle_view(calibration: Calibration) -> str:
    """Name of the view whose board was nearest to the mean place of all boards.

    Parameters
    ----------
    calibration : Calibration
    """
    corners, views = calibration.corners, calibration.sightings.views
    pose = calibration.adjusted.bundle.view[corners.view]
    points = np.einsum("mij,mj->mi", pose[:, :3, :3], corners.point) + pose[:, :3, 3]
    places = np.stack([points[corners.view == v].mean(axis=0) for v in range(len(views))])
    return views[int(np.linalg.norm(places - places.mean(axis=0), axis=1).argmin())]


def baseline_text(calibration: Calibration, baseline: float) -> str:
    """Compare an independently measured distance between two cameras with the calibration.

    Parameters
    ----------
    calibration : Calibration
    baseline : float [m]            between the first two cameras

    Returns
    -------
    str                             one line, ending in the difference in per cent

    Raises
    ------
    CalibrationError                there is only one camera, or the difference exceeds 5 %, so that
                                    the board must have another size than stated
    """
    if len(calibration.cameras) < 2:
        raise CalibrationError("a baseline is between two cameras; this calibration has one")
    first, second = calibration.cameras[:2]
    calibrated = float(np.linalg.norm(second.T_camera_object[:3, 3]))
    text = (
        f"'{first.name}' and '{second.name}' are {1e3 * calibrated:.2f} mm apart by the boards and"
        f" {1e3 * baseline:.2f} mm as was measured"
    )
    ratio = baseline / calibrated
    if abs(ratio - 1.0) > _MAX_BASELINE_ERROR:
        raise CalibrationError(
            f"{text}: the board has another size than was said, by a factor of {ratio:.3f}; measure"
            " a row of its squares and give their true side to --square, or correct --baseline"
        )
    return f"{text}: {100.0 * (1.0 / ratio - 1.0):+.2f} %\n"


def timing_note(calibration: Calibration) -> str:
    """Note on timing errors, if velocities of the boards explain the residuals of the corners.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    str                             cause and remedy; empty if they do not
    """
    names, sizes = calibration.sightings.cameras, calibration.sightings.sizes
    corners = calibration.corners
    late = corners.pixel / np.array(sizes, dtype=np.float64)[corners.camera] - 0.5
    by_column, by_row = (explained_by_velocity(calibration, late[:, k]) for k in range(2))
    fractions = [by_row if by_row - by_column > _MORE else 0.0]
    if len(names) > 1:
        fractions += [
            explained_by_velocity(calibration, (corners.camera == c).astype(np.float64))
            for c in range(len(names))
        ]
    best = int(np.argmax(fractions))
    if not fractions[best] > _MUCH:
        return ""
    who = f"'{names[best - 1]}' and the others take theirs"
    if len(names) == 2:
        who = f"'{names[0]}' and '{names[1]}' take theirs"
    return (_LATE if best else _ROLLS).format(fraction=fractions[best], who=who)


def explained_by_velocity(calibration: Calibration, late: Float[np.ndarray, " m"]) -> float:
    """Fraction of the residual variance of the corners explained by a velocity of each board.

    Parameters
    ----------
    calibration : Calibration
    late : (m,) float               time at which each corner was recorded, in any unit

    Returns
    -------
    float [-]                       relative to the variance left by a pose per view, adjusted for
                                    degrees of freedom; 0 (no more than as many arbitrary terms
                                    would explain) to 1
    """
    adjusted, corners = calibration.adjusted, calibration.corners
    unit = 1.0 / adjusted.noise[corners.camera]
    jacobian = unit[:, None, None] * view_jacobians(adjusted.bundle, corners)
    residual = unit[:, None] * adjusted.residual
    squares, freedom = np.zeros(2), np.zeros(2)
    for view in range(len(adjusted.bundle.view)):
        rows = (corners.view == view) & adjusted.good
        if rows.sum() <= _POSE + _VELOCITY:
            continue
        pose = jacobian[rows].reshape(-1, _POSE)
        moved = (late[rows, None, None] * jacobian[rows, :, -_VELOCITY:]).reshape(-1, _VELOCITY)
        for k, terms in enumerate((pose, np.hstack([pose, moved]))):
            base = _independent(terms)
            remainder = residual[rows].ravel()
            remainder = remainder - base @ (base.T @ remainder)
            squares[k] += remainder @ remainder
            freedom[k] += len(remainder) - base.shape[1]
    if not (freedom > 0.0).all():
        return 0.0
    before, after = squares / freedom
    return float(max(1.0 - after / before, 0.0))


def _independent(terms: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n r"]:
    """Orthonormal basis of the span of all terms. They may be dependent: if one camera alone sees a
    view, its delay is already part of the pose."""
    size = np.linalg.norm(terms, axis=0)
    base, values, _ = np.linalg.svd(terms[:, size > 0.0] / size[size > 0.0], full_matrices=False)
    return base[:, values > 1e-9 * values[0]]


def write_calibration(
    folder: Path, calibration: Calibration, *, frame: Float[np.ndarray, "4 4"] | None = None
) -> None:
    """Write rig.toml, rig_covariance.npz, views.csv, opencv.yml and kalibr.yaml.

    Parameters
    ----------
    folder : Path                   exists
    calibration : Calibration
    frame : (4, 4) float [m] or None    x_first camera = frame x_rig; None: the frames coincide

    Raises
    ------
    RecordError                     a file cannot be written
    """
    cameras = calibration.cameras
    if frame is not None:
        cameras = tuple(
            replace(camera, T_camera_object=camera.T_camera_object @ frame) for camera in cameras
        )
    if len(cameras) > 1:
        write_rig(folder / "rig.toml", Rig(cameras, 0, str(folder)))
        _write_kalibr(folder / "kalibr.yaml", cameras)
    _write_opencv(folder / "opencv.yml", cameras)
    write_rig_covariance(folder, known_rig(calibration), calibration.adjusted.noise)
    _write_pictures(folder / "views.csv", calibration)


def _write_pictures(path: Path, calibration: Calibration) -> None:
    """Write one row per picture; the rms is left empty where no corner was kept."""
    rows: list[tuple[object, ...]] = [("camera", "view", "corners", "left out", "rms [px]")]
    for picture in picture_errors(calibration):
        rms = "" if np.isnan(picture.rms) else f"{picture.rms:.4f}"
        rows.append((picture.camera, picture.view, picture.corners, picture.rejected, rms))
    write_text(path, spreadsheet_text(rows))


def _write_opencv(path: Path, cameras: Sequence[Camera]) -> None:
    """Write K1 D1 R1 T1 size1, K2 ... with `cv2.FileStorage`; lengths in metres."""
    storage = cv2.FileStorage(str(path), cv2.FileStorage_WRITE)
    if not storage.isOpened():
        raise RecordError(f"{path}: cannot be written; check the folder's rights")
    storage.write("length_unit", "m")
    for number, camera in enumerate(cameras, start=1):
        pose = camera.T_camera_object
        storage.write(f"K{number}", np.array(camera.matrix))
        storage.write(f"D{number}", np.array(camera.distortion[None]))
        storage.write(f"R{number}", pose[:3, :3].copy())
        storage.write(f"T{number}", pose[:3, 3:].copy())
        if camera.size is not None:
            storage.write(f"size{number}", np.array(camera.size)[None])
    storage.release()


def _write_kalibr(path: Path, cameras: Sequence[Camera]) -> None:
    """Write a chain cam0, cam1, ...; the radtan model has no third radial term, k3 is dropped."""
    chain = {}
    for number, camera in enumerate(cameras):
        k = camera.matrix
        entry = {
            "camera_model": "pinhole",
            "intrinsics": [float(x) for x in (k[0, 0], k[1, 1], k[0, 2], k[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": [float(term) for term in camera.distortion[:4]],
            "resolution": list(camera.size or ()),
            "rostopic": f"/{camera.name}/image_raw",
        }
        if number:
            before = cameras[number - 1].T_camera_object
            step = camera.T_camera_object @ np.linalg.inv(before)
            entry["T_cn_cnm1"] = step.tolist()
        chain[f"cam{number}"] = entry
    write_text(path, yaml.safe_dump(chain, sort_keys=False))
