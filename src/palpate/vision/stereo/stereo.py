"""Points of the surface that two or more cameras see, without knowing where the surface is.

For every camera but the reference: a dense start, then windows matched to a hundredth of a pixel in
the pictures as they were taken. Where a window shows more than one smooth surface, smaller ones are
tried. What the cameras say is joined by triangulation; what contradicts its neighbours or the other
cameras is rejected and counted.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.records import Rig
from palpate.shapes import PointIndices, Points, PointScalars
from palpate.vision.cameras import Triangulation, pixel_sizes, project, triangulate
from palpate.vision.images import PreparedPictures, make_spline_picture
from palpate.vision.range_flow import Outcome
from palpate.vision.stereo.pair_disparity import stereo_start
from palpate.vision.stereo.window_matches import (
    MIN_WINDOW_PX,
    WindowMatches,
    confirmed_matches,
    window_matches,
)

# A camera is left out where it misses the joint point by more standard deviations.
_MAX_DEVIATIONS = 5.0
# Standard deviation of a normal distribution over the median of its absolute values.
_PER_MEDIAN = 1.4826


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """How surface points are found from one instant's pictures.

    Parameters
    ----------
    subset : int [px]               side of the largest window, odd, at least 9; windows down to
                                    4/10 of it are taken where it shows edges of the object
    step : int [px]                 spacing of the points in the reference camera, at least 1
    reprojection : float [px]       a match is rejected where a camera misses the joint point by
                                    more, > 0: half a speckle. A rig that fits worse shows
                                    different speckles in the windows of its cameras

    Raises
    ------
    InputError                      an even or tiny subset, a step below one pixel, a limit that is
                                    not positive
    """

    subset: int = 21
    step: int = 5
    reprojection: float = 2.0

    def __post_init__(self) -> None:
        if self.subset < MIN_WINDOW_PX or self.subset % 2 == 0:
            raise InputError(
                f"subset is {self.subset}; must be an odd number of pixels, {MIN_WINDOW_PX} or more"
            )
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")
        if not self.reprojection > 0.0:
            raise InputError(f"reprojection is {self.reprojection:g}; must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Points of the surface at one instant.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera: middle of the window
    point : (n, 3) float [m]            that the windows of all cameras show, object frame; beside
                                        the ray of the pixel by as much as noise moved the windows
    covariance : (n, 3, 3) float [m^2]  from the residuals of the matches, without the errors of the
                                        calibration, which neighbours share
    residual : (n,) float [px]          rms distance between the point and the matches, over the
                                        cameras and both coordinates
    cameras : (n,) int                  how many agree, the reference included
    spacing : (n,) float [m]            width of a step of the grid there, across the line of sight
    counts : (8,) int                   points of the grid by `Outcome`; the first is n
    step : int [px]                     spacing of the grid
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    residual: PointScalars
    cameras: PointIndices
    spacing: PointScalars
    counts: Int[np.ndarray, "8"]
    step: int


@dataclass(frozen=True, slots=True, eq=False)
class StereoMatches:
    """Where all cameras see the points of a grid in the reference camera's picture.

    What a rig is judged by: the matches rest on the pictures, its poses only tell where to search.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera
    pixels : (c, n, 2) float [px]       in every camera; NaN where it was not found
    covariance : (c, n, 2, 2) float [px^2]  of the match; NaN there, and in the reference
    outcome : (n,) int                  an `Outcome`, of the camera that came farthest
    blank : int                         points of the grid without texture, which are not among n
    """

    pixel: Float[np.ndarray, "n 2"]
    pixels: Float[np.ndarray, "c n 2"]
    covariance: Float[np.ndarray, "c n 2 2"]
    outcome: PointIndices
    blank: int


def stereo_matches(
    pictures: PreparedPictures,
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoMatches:
    """Match a grid of windows of the reference camera in all others.

    Parameters
    ----------
    pictures : PreparedPictures     of 2 or more cameras
    mask, settings                  as of `stereo_points`

    Returns
    -------
    StereoMatches

    Raises
    ------
    InputError, CalibrationError    as of `stereo_points`
    """
    reference = pictures.rig.reference
    shape = pictures.grey[reference].shape
    wanted = np.ones(shape, dtype=bool) if mask is None else mask
    if wanted.shape != shape:
        raise InputError(f"mask is of {wanted.shape} pixels; the reference picture of {shape}")
    cell, pixel = _grid(wanted & pictures.normalised[reference].textured, settings.step)
    blank = len(_grid(wanted, settings.step)[0]) - len(pixel)
    splines = [make_spline_picture(grey) for grey in pictures.grey]
    found: dict[int, WindowMatches] = {}
    failures: list[InputError] = []
    for k, spline in enumerate(splines):
        if k == reference:
            continue
        try:
            start = stereo_start(pictures, k, pixel, half=settings.subset // 2)
        except InputError as failure:
            failures.append(failure)
            continue
        matches = window_matches(splines[reference], spline, pixel, start, subset=settings.subset)
        found[k] = confirmed_matches(matches, cell, pixel)
    if not found:
        raise failures[0]
    # The reason of the camera that came farthest: the outcomes are in the order of the steps.
    outcome = np.max([matches.outcome for matches in found.values()], axis=0)
    pixels = np.full((len(splines), len(pixel), 2), np.nan)
    covariance = np.full((*pixels.shape, 2), np.nan)
    pixels[reference] = pixel
    for k, matches in found.items():
        pixels[k] = pixel + matches.displacement
        covariance[k] = matches.covariance
    return StereoMatches(pixel, pixels, covariance, outcome, blank)


def stereo_points(
    pictures: PreparedPictures,
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoPoints:
    """Find the points of the surface that the reference camera and another one see.

    Parameters
    ----------
    pictures : PreparedPictures     of 2 or more cameras
    mask : (rows, columns) bool or None     pixels of the reference camera that matter; all of them
                                    where None
    settings : StereoSettings

    Returns
    -------
    StereoPoints                    does not depend on the number of threads

    Raises
    ------
    InputError                      a mask of another size; no camera shares features with the
                                    reference
    CalibrationError                no camera can be paired with the reference: at one place, or
                                    looking along the line between
    """
    matches = stereo_matches(pictures, mask=mask, settings=settings)
    return joined_matches(pictures.rig, matches, settings=settings)


def joined_cameras(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    *,
    reprojection: float,
) -> tuple[Triangulation, Bool[np.ndarray, "c n"]]:
    """Triangulate without the cameras that contradict the others; of two that disagree use neither.

    The matches of all cameras are against one reference picture and share its noise: half of their
    variance is given to the reference.

    Parameters
    ----------
    rig : Rig
    pixels : (c, n, 2) float [px]   NaN where a camera does not see the point; the reference's are
                                    whole
    covariance : (c, n, 2, 2) float [px^2]  of the match of each camera; the reference's is not read
    reprojection : float [px]       by how much a camera may miss the joint point at most

    Returns
    -------
    triangulation : Triangulation   covariance from the matches; residual and cameras as used
    used : (c, n) bool              all False for points where no two cameras agree
    """
    used = np.isfinite(pixels).all(axis=2)
    for _ in range(len(pixels) - 1):
        found, error = _triangulated(rig, pixels, covariance, used)
        excess = _excess(error, used, covariance, reprojection)
        excess[rig.reference] = -np.inf
        wrong = excess.max(axis=0) > 1.0
        lost = used.any(axis=0) & ~np.isfinite(found.point).all(axis=1)
        few = used.sum(axis=0) <= 2
        if not (wrong | lost).any():
            break
        drop = np.flatnonzero(wrong & ~few)
        used[excess.argmax(axis=0)[drop], drop] = False
        used[:, (wrong & few) | lost] = False
    found, _ = _triangulated(rig, pixels, covariance, used)
    return found, used


def _triangulated(
    rig: Rig,
    pixels: Float[np.ndarray, "c n 2"],
    covariance: Float[np.ndarray, "c n 2 2"],
    used: Bool[np.ndarray, "c n"],
) -> tuple[Triangulation, Float[np.ndarray, "c n 2"]]:
    """Joint points, and by how much each camera misses them [px]."""
    others = used.copy()
    others[rig.reference] = False
    half = np.where(others[..., None, None], 0.5 * covariance, 0.0)
    half[rig.reference] = half.sum(axis=0) / np.maximum(others.sum(axis=0), 1)[:, None, None]
    half = np.where(used[..., None, None], half, np.eye(2))
    pixels = np.where(used[..., None], pixels, np.nan)
    found = triangulate(rig, pixels, half)
    return found, pixels - np.stack([project(camera, found.point) for camera in rig.cameras])


def _excess(
    error: Float[np.ndarray, "c n 2"],
    used: Bool[np.ndarray, "c n"],
    covariance: Float[np.ndarray, "c n 2 2"],
    reprojection: float,
) -> Float[np.ndarray, "c n"]:
    """Distance of each camera from the joint point, over what is allowed; -inf where not used.

    What all points of a camera miss by is the rig's error: only `reprojection` limits it.
    """
    excess = np.full(used.shape, -np.inf)
    for c in range(len(used)):
        known = used[c] & np.isfinite(error[c]).all(axis=1)
        if not known.any():
            continue
        miss = error[c, known]
        away = np.linalg.norm(miss - np.median(miss, axis=0), axis=1)
        noise = np.trace(covariance[c, known], axis1=1, axis2=2)
        allowed = _MAX_DEVIATIONS * np.sqrt((_PER_MEDIAN * np.median(away)) ** 2 + noise)
        excess[c, known] = np.maximum(away / allowed, np.linalg.norm(miss, axis=1) / reprojection)
    return excess


def _grid(
    wanted: Bool[np.ndarray, "rows columns"], step: int
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Row and column on the grid, and column and row in the picture, of the points that matter."""
    first = step // 2
    cell = np.argwhere(wanted[first::step, first::step])
    return cell, (first + step * cell[:, ::-1]).astype(np.float64)


def joined_matches(
    rig: Rig, matches: StereoMatches, *, settings: StereoSettings = StereoSettings()
) -> StereoPoints:
    """One point from the matches of all cameras.

    Parameters
    ----------
    rig : Rig
    matches : StereoMatches         of its cameras
    settings : StereoSettings       that they were made with

    Returns
    -------
    StereoPoints
    """
    outcome = matches.outcome.copy()
    others = np.delete(matches.pixels, rig.reference, axis=0)
    rows = np.flatnonzero(np.isfinite(others).all(axis=2).any(axis=0))
    outcome[rows] = Outcome.REPROJECTION
    joint, used = joined_cameras(
        rig, matches.pixels[:, rows], matches.covariance[:, rows],
        reprojection=settings.reprojection,
    )  # fmt: skip
    good = used.any(axis=0)
    outcome[rows[good]] = Outcome.VALID
    counts = np.bincount(outcome, minlength=len(Outcome))
    counts[Outcome.TEXTURE] += matches.blank
    return StereoPoints(
        pixel=matches.pixel[rows[good]],
        point=joint.point[good],
        covariance=joint.covariance[good],
        residual=joint.residual[good],
        cameras=joint.cameras[good],
        spacing=settings.step * pixel_sizes(rig.cameras[rig.reference], joint.point[good]),
        counts=counts,
        step=settings.step,
    )
