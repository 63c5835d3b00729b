"""Quality of a calibration: residuals by camera and region, missing views, checks of lengths."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.calibration.adjustment import Corners, adjust, missing_tilts
from palpate.calibration.calibrate import Calibration, cameras_of, known_rig, without_views
from palpate.errors import CalibrationError
from palpate.records import Rig
from palpate.vision import space_strains, triangulate

# Regions of a picture in each direction.
REGIONS = 3
_ROWS, _COLUMNS = ("upper", "middle", "lower"), ("left", "centre", "right")
# Minimum number of corners for a region to count as covered.
_MIN_CORNERS = 10
# Largest relative error of a baseline measured from outside; a larger one means a wrong board size.
_MAX_BASELINE_ERROR = 0.05
# One view in this many is held out to check lengths.
_FOLD = 4


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
    size = np.array(calibration.found.sizes[c])
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
    found = []
    for c, camera in enumerate(calibration.cameras):
        for v, view in enumerate(calibration.found.views):
            mine = (corners.camera == c) & (corners.view == v)
            if not mine.any():
                continue
            kept = mine & good
            rms = float(np.sqrt(square[kept].mean())) if kept.any() else np.nan
            rejected = int(mine.sum() - kept.sum())
            found.append(PictureError(camera.name, view, int(mine.sum()), rejected, rms))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class LengthCheck:
    """Lengths on boards held out from the calibration that measures them.

    Attributes
    ----------
    views : int                     number of board views measured
    error : float [-]               mean ratio of measured to true size, minus one
    scatter : float [-]             standard deviation of a single ratio
    """

    views: int
    error: float
    scatter: float


def length_check(calibration: Calibration) -> LengthCheck | None:
    """Calibrate without a quarter of the views, and measure the size of the board in those.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    LengthCheck or None             None for a single camera, fewer than 12 views, or fewer than two
                                    held-out ones that two cameras share; None, too, if the
                                    calibration of the others fails
    """
    corners, views = calibration.corners, len(calibration.found.views)
    held = np.arange(views) % _FOLD == 0
    if len(calibration.cameras) < 2 or views < 3 * _FOLD:
        return None
    bundle, rest = without_views(calibration.adjusted.bundle, corners, held)
    try:
        adjusted = adjust(bundle, rest)
    except CalibrationError:
        return None
    rig = Rig(cameras_of(calibration.found, adjusted.bundle), 0, "calibration")
    good = calibration.adjusted.good
    scales = [_scale(rig, corners.chosen(good & (corners.view == v))) for v in np.flatnonzero(held)]
    known = np.array([scale for scale in scales if scale is not None])
    if len(known) < 2:
        return None
    return LengthCheck(len(known), float(known.mean() - 1.0), float(known.std(ddof=1)))


def _scale(rig: Rig, corners: Corners) -> float | None:
    """Ratio of a board's measured to its true size; None if two cameras share too few corners.

    Source
    ------
    Umeyama, Least-squares estimation of transformation parameters between two point patterns (1991)
    """
    points, number = np.unique(corners.point, axis=0, return_inverse=True)
    pixels = np.full((len(rig.cameras), len(points), 2), np.nan)
    pixels[corners.camera, number.ravel()] = corners.pixel
    found = triangulate(rig, pixels, 1.0).point
    seen = np.isfinite(found[:, 0])
    if seen.sum() < _MIN_CORNERS:
        return None
    true = points[seen] - points[seen].mean(axis=0)
    return float(np.linalg.svd(true.T @ found[seen], compute_uv=False).sum() / (true**2).sum())


def length_sigma(calibration: Calibration) -> float:
    """Relative standard deviation of the scale of lengths measured where the boards were.

    It is the error common to all lengths, from the covariance alone; an error of the board's own
    dimensions is not included.

    Parameters
    ----------
    calibration : Calibration       of two cameras at least

    Returns
    -------
    float [-]

    Raises
    ------
    CalibrationError                there is only one camera
    """
    corners, bundle = calibration.corners, calibration.adjusted.bundle
    pose = bundle.view[corners.view]
    points = np.einsum("mij,mj->mi", pose[:, :3, :3], corners.point) + pose[:, :3, 3]
    strains = space_strains(
        Rig(calibration.cameras, 0, "calibration"),
        known_rig(calibration),
        points,
    )
    # Relative change of the rms extent of all corners under each strain.
    covariance = np.cov(points.T)
    return float(np.linalg.norm(np.einsum("ij,mij->m", covariance, strains)) / np.trace(covariance))


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
    found = float(np.linalg.norm(second.T_camera_object[:3, 3]))
    text = (
        f"'{first.name}' and '{second.name}' are {1e3 * found:.2f} mm apart by the boards and"
        f" {1e3 * baseline:.2f} mm as was measured"
    )
    ratio = baseline / found
    if abs(ratio - 1.0) > _MAX_BASELINE_ERROR:
        raise CalibrationError(
            f"{text}: the board has another size than was said, by a factor of {ratio:.3f}; measure"
            " a row of its squares and give their true side to --square, or correct --baseline"
        )
    return f"{text}: {100.0 * (1.0 / ratio - 1.0):+.2f} %\n"
