"""Points of the surface that two or more cameras see, without knowing where the surface is.

For every camera but the reference: a dense start, then windows matched to a hundredth of a pixel in
the pictures as they were taken. Where a window shows more than one smooth surface, smaller ones are
tried. What the cameras say is joined by triangulation; what contradicts its neighbours or the other
cameras is rejected and counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.records import Rig
from palpate.shapes import Flags, PointIndices, Points, PointScalars, Triangles, Vertices
from palpate.vision.even_picture import make_even_picture
from palpate.vision.features import find_features
from palpate.vision.interpolation import SplinePicture, make_spline_picture
from palpate.vision.planar_refinement import PlanarMatch, PlanarSettings, refine_planar
from palpate.vision.range_flow import Outcome
from palpate.vision.stereo_judgement import contradicts_neighbours, joined_cameras
from palpate.vision.stereo_start import StereoStart, make_view, stereo_start
from palpate.vision.tracking import grid_triangles

__all__ = ["StereoPoints", "StereoSettings", "stereo_points", "triangulated_surface"]

# A match known no better than this is not known: sub-pixel matching is ten times better [px].
_TEXTURE_LIMIT = 0.1
# Below this correlation a window shows as much noise, or something else, as texture.
_LEAST_SCORE = 0.7
# What is left of the best quarter of the windows is noise alone; it differs little among them.
_BEST = 25.0
# Sides of the windows as shares of the largest, each with half the pixels of the next; fewer than 9
# do not fix six coefficients a component.
_SHARES = (0.43, 0.53, 0.7, 1.0)
_SMALLEST_WINDOW = 9
# Half widths of the confidence intervals whose intersection chooses a window, in standard
# deviations: Katkovnik's figure.
_INTERVAL = 2.0
# Systematic error of a match from interpolation and the pixels' response, at best [px].
_BIAS = 0.005
# Tangent of 80 degrees: what is seen at a flatter angle shows no texture to be matched.
_STEEPEST = 5.7


@dataclass(frozen=True, slots=True)
class StereoSettings:
    """How surface points are found from one instant's pictures.

    Parameters
    ----------
    subset : int [px]               side of the largest window, odd; windows down to 4/10 of it are
                                    taken where it shows edges of the object
    step : int [px]                 spacing of the points in the reference camera
    shape : "quadratic" or "affine" how the match may vary within a window; affine ones see a curved
                                    surface too near or too far
    excess : float                  a match is rejected where what it leaves is more than so many
                                    times what good ones leave
    disagreement : float            a match is rejected where neighbours or cameras contradict it by
                                    more than so many standard deviations
    reprojection : float [px]       and where a camera misses the joint point by more than this:
                                    half a speckle. A rig that fits worse shows different speckles
                                    in the windows of its cameras

    Raises
    ------
    InputError                      an even or tiny subset, a step below one pixel, limits that are
                                    not positive
    """

    subset: int = 21
    step: int = 5
    shape: Literal["affine", "quadratic"] = "quadratic"
    excess: float = 2.0
    disagreement: float = 5.0
    reprojection: float = 2.0

    def __post_init__(self) -> None:
        if self.subset < _SMALLEST_WINDOW or self.subset % 2 == 0:
            raise InputError(
                f"subset is {self.subset}; must be an odd number of pixels, {_SMALLEST_WINDOW} or"
                " more"
            )
        if self.step < 1:
            raise InputError(f"step is {self.step}; must be 1 pixel or more")
        for name in ("excess", "disagreement", "reprojection"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name):g}; must be positive")


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Points of the surface at one instant.

    Attributes
    ----------
    pixel : (n, 2) float [px]           column and row in the reference camera
    point : (n, 3) float [m]            object frame
    covariance : (n, 3, 3) float [m^2]  from what the matches leave; the calibration's errors, alike
                                        for points side by side, are not in it
    score : (n,) float [-]              lowest normalised cross-correlation over the cameras used
    residual : (n,) float [px]          rms distance between the point and the matches, over the
                                        cameras and both coordinates
    cameras : (n,) int                  how many agree, the reference included
    window : (n,) int [px]              side of the smallest window used
    counts : (8,) int                   points of the grid by `Outcome`; the first is n
    step : int [px]                     spacing of the grid
    shape : (rows, columns)             of the reference camera's picture
    """

    pixel: Float[np.ndarray, "n 2"]
    point: Points
    covariance: Float[np.ndarray, "n 3 3"]
    score: PointScalars
    residual: PointScalars
    cameras: PointIndices
    window: PointIndices
    counts: Int[np.ndarray, "8"]
    step: int
    shape: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Points of the reference picture in one other picture; NaN where the outcome is not VALID."""

    displacement: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    score: PointScalars
    window: PointIndices
    outcome: PointIndices


@dataclass(frozen=True, slots=True, eq=False)
class _Try:
    """Windows of one size: their matches, what these leave, and the contrast beside the middle."""

    side: int
    match: PlanarMatch
    left: PointScalars
    beside: PointScalars


def stereo_points(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    *,
    mask: Bool[np.ndarray, "rows columns"] | None = None,
    depth_range: tuple[float, float] | None = None,
    settings: StereoSettings = StereoSettings(),
) -> StereoPoints:
    """Find the points of the surface that the reference camera and another one see.

    Parameters
    ----------
    rig : Rig                       c cameras, 2 or more
    pictures : sequence of c (rows, columns) float [grey levels]    of one instant
    mask : (rows, columns) bool or None     pixels of the reference camera that matter; all of them
                                    unless told
    depth_range : (near, far) [m] or None   where the object is, along the reference camera's axis;
                                    found from features of the pictures unless told
    settings : StereoSettings

    Returns
    -------
    StereoPoints                    does not depend on the number of threads

    Raises
    ------
    InputError                      another number of pictures, a mask of another size, a depth
                                    range that is none, too few features in common
    CalibrationError                two cameras at one place, or looking along the line between
    """
    _check(rig, pictures, mask, depth_range)
    even = [make_even_picture(picture) for picture in pictures]
    views = [
        make_view(camera, picture, find_features(picture))
        for camera, picture in zip(rig.cameras, even, strict=True)
    ]
    splines = [make_spline_picture(picture) for picture in pictures]
    reference = rig.reference
    wanted = even[reference].textured if mask is None else even[reference].textured & mask
    cell, pixel = _grid(wanted, settings.step)
    blank = _grid_size(wanted if mask is None else mask, settings.step) - len(pixel)
    found: dict[int, _Matches] = {}
    for k, view in enumerate(views):
        if k == reference:
            continue
        start = stereo_start(
            views[reference], view, pixel, half=settings.subset // 2, depth_range=depth_range
        )
        matches = _matched(splines[reference], splines[k], pixel, start, settings)
        found[k] = _confirmed(matches, cell, pixel, settings.disagreement)
    return _joined(rig, found, pixel, blank, settings, pictures[reference].shape)


def triangulated_surface(rig: Rig, stereo: StereoPoints) -> tuple[Vertices, Triangles]:
    """Stereo points joined to an open surface that faces the reference camera.

    Parameters
    ----------
    rig : Rig
    stereo : StereoPoints           n points

    Returns
    -------
    vertices : (n, 3) float [m]     all points, also those of no triangle
    triangles : (m, 3) int          two for every cell of the grid whose corners are all there and
                                    whose sides are no jump: steeper than 80 degrees
    """
    camera = rig.cameras[rig.reference]
    pose = camera.T_camera_object
    depth = stereo.point @ pose[2, :3] + pose[2, 3]
    width = stereo.step * depth / camera.matrix[0, 0]
    triangles = grid_triangles(stereo.pixel, stereo.step)
    drop = np.ptp(depth[triangles], axis=1)
    whole = drop <= _STEEPEST * np.sqrt(2.0) * width[triangles].mean(axis=1)
    # Both halves of a cell, or none.
    both = whole.reshape(2, -1).all(axis=0)
    return stereo.point, triangles.reshape(2, -1, 3)[:, both].reshape(-1, 3)


def _check(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    mask: Bool[np.ndarray, "rows columns"] | None,
    depth_range: tuple[float, float] | None,
) -> None:
    if len(pictures) != len(rig.cameras):
        raise InputError(f"{len(pictures)} pictures for {len(rig.cameras)} cameras; give one each")
    shape = pictures[rig.reference].shape
    if mask is not None and mask.shape != shape:
        raise InputError(f"mask is of {mask.shape} pixels; the reference picture of {shape}")
    if depth_range is not None and not 0.0 < depth_range[0] < depth_range[1]:
        raise InputError(
            f"depth_range is {depth_range}; must be two distances from the reference camera in"
            " metres, near and far"
        )


def _grid(
    wanted: Bool[np.ndarray, "rows columns"], step: int
) -> tuple[Int[np.ndarray, "n 2"], Float[np.ndarray, "n 2"]]:
    """Row and column on the grid, and column and row in the picture, of the points that matter."""
    first = step // 2
    cell = np.argwhere(wanted[first::step, first::step])
    return cell, (first + step * cell[:, ::-1]).astype(np.float64)


def _grid_size(wanted: Bool[np.ndarray, "rows columns"], step: int) -> int:
    return int(wanted[step // 2 :: step, step // 2 :: step].sum())


def _matched(
    first: SplinePicture,
    second: SplinePicture,
    pixel: Float[np.ndarray, "n 2"],
    start: StereoStart,
    settings: StereoSettings,
) -> _Matches:
    """Windows of the reference picture in another, each as large as what it shows allows.

    Of windows of growing size the largest is taken whose match no smaller one contradicts: a window
    across an edge of the object is contradicted by one that stays on this side of it.

    Source
    ------
    Katkovnik, A new method for varying adaptive bandwidth selection, IEEE Transactions on Signal
    Processing 47 (1999): the intersection of confidence intervals.
    """
    rows = np.flatnonzero(np.isfinite(start.displacement).all(axis=1))
    tries = []
    for side in _windows(settings.subset):
        match = refine_planar(
            first,
            second,
            pixel[rows],
            start.displacement[rows],
            start_gradient=start.gradient[rows],
            settings=PlanarSettings(subset=side, shape=settings.shape),
        )
        tries.append(_Try(side, match, *_contrast(first, pixel[rows], match, side)))
    last = tries[-1]
    decent = last.match.converged & (last.match.score > _LEAST_SCORE)
    noise = float(np.percentile(last.left[decent], _BEST)) if decent.any() else np.inf
    outcomes = [_outcomes(one, noise, settings.excess) for one in tries]
    choice = _largest(tries, outcomes, noise)
    found = choice >= 0
    # A smaller window has other reasons to fail; that of the largest one is told.
    outcome = np.full(len(pixel), int(Outcome.HIDDEN))
    outcome[rows] = np.where(outcomes[-1] == Outcome.VALID, int(Outcome.SCORE), outcomes[-1])
    outcome[rows[found]] = Outcome.VALID

    def chosen(name: str) -> np.ndarray:
        values = np.stack([getattr(one.match, name)[found] for one in tries])
        result = np.full((len(pixel), *values.shape[2:]), np.nan)
        result[rows[found]] = values[choice[found], np.arange(values.shape[1])]
        return result

    window = np.zeros(len(pixel), dtype=np.int64)
    window[rows[found]] = np.array([one.side for one in tries])[choice[found]]
    return _Matches(
        displacement=chosen("displacement"),
        gradient=chosen("gradient"),
        covariance=chosen("covariance"),
        score=chosen("score"),
        window=window,
        outcome=outcome,
    )


def _largest(
    tries: Sequence[_Try], outcomes: Sequence[Int[np.ndarray, " n"]], noise: float
) -> Int[np.ndarray, " n"]:
    """Which window of each point is the largest that no smaller one contradicts; -1: none is good."""
    n = len(tries[0].left)
    choice = np.full(n, -1)
    low, high = np.full((n, 2), -np.inf), np.full((n, 2), np.inf)
    contradicted = np.zeros(n, dtype=bool)
    for k, (one, outcome) in enumerate(zip(tries, outcomes, strict=True)):
        good = outcome == Outcome.VALID
        variance = np.einsum("nii->ni", one.match.covariance)
        # What a window leaves beyond the noise must not excuse its contradiction.
        share = np.minimum(1.0, noise / np.maximum(one.left, 1e-9))[:, None]
        reach = _INTERVAL * np.sqrt(share**2 * variance + _BIAS**2)
        new_low = np.fmax(low, one.match.displacement - reach)
        new_high = np.fmin(high, one.match.displacement + reach)
        contradicted |= good & ~(new_low <= new_high).all(axis=1)
        take = good & ~contradicted
        choice[take] = k
        low[take], high[take] = new_low[take], new_high[take]
    return choice


def _windows(subset: int) -> list[int]:
    """Sides of the windows that are tried, smallest first."""
    sides = [2 * round(0.5 * share * subset - 0.5) + 1 for share in _SHARES]
    return sorted({max(side, _SMALLEST_WINDOW) for side in sides})


def _contrast(
    picture: SplinePicture, pixel: Float[np.ndarray, "n 2"], match: PlanarMatch, side: int
) -> tuple[PointScalars, PointScalars]:
    """What each match leaves [grey levels], and the least variance beside the window's middle.

    The latter over windows of a third of the side to the left, right, above and below: where one of
    them is blank, the point may lie beyond an outline.
    """
    size = np.array(picture.grey.shape[::-1]) - 1
    column, row = pixel.astype(np.int64).T
    share = np.maximum(match.score, 1e-6) ** -2 - 1.0
    left = np.sqrt(share * _variance(picture, side)[row, column])
    third = side // 3 - 1 + (side // 3) % 2
    small = _variance(picture, third)
    away = third // 2 + 1
    beside = [
        small[np.clip(row + i, 0, size[1]), np.clip(column + j, 0, size[0])]
        for i, j in ((-away, 0), (away, 0), (0, -away), (0, away))
    ]
    return left, np.min(beside, axis=0)


def _variance(picture: SplinePicture, side: int) -> Float[np.ndarray, "rows columns"]:
    """Variance of the grey levels in the window around every pixel [grey levels^2]."""
    mean = cv2.blur(picture.grey, (side, side)).astype(np.float64)
    square = cv2.sqrBoxFilter(picture.grey, cv2.CV_64F, (side, side))
    return np.maximum(square - mean**2, 0.0)


def _outcomes(one: _Try, noise: float, excess: float) -> Int[np.ndarray, " n"]:
    """What became of windows of one size."""
    match = one.match
    outcome = np.full(len(one.left), int(Outcome.VALID))
    sigma = np.sqrt(np.trace(match.covariance, axis1=1, axis2=2))
    with np.errstate(invalid="ignore"):
        blank = ~(one.beside > 2.0 * noise**2)
        outcome[blank | (sigma > _TEXTURE_LIMIT)] = Outcome.TEXTURE
        outcome[(match.score < _LEAST_SCORE) | (one.left > excess * noise)] = Outcome.SCORE
    outcome[~match.converged] = Outcome.LOST
    return outcome


def _confirmed(
    matches: _Matches,
    cell: Int[np.ndarray, "n 2"],
    pixel: Float[np.ndarray, "n 2"],
    disagreement: float,
) -> _Matches:
    """Matches without those that their neighbours contradict."""
    wrong = contradicts_neighbours(
        cell,
        pixel,
        matches.displacement,
        matches.gradient,
        np.sqrt(np.trace(matches.covariance, axis1=1, axis2=2)),
        matches.outcome == Outcome.VALID,
        disagreement=disagreement,
    )
    outcome = np.where(wrong, int(Outcome.NEIGHBOURS), matches.outcome)
    displacement = np.where(wrong[:, None], np.nan, matches.displacement)
    return replace(matches, displacement=displacement, outcome=outcome)


def _joined(
    rig: Rig,
    found: dict[int, _Matches],
    pixel: Float[np.ndarray, "n 2"],
    blank: int,
    settings: StereoSettings,
    shape: tuple[int, int],
) -> StereoPoints:
    """One point from the matches of all cameras."""
    others = list(found)
    pixels = np.full((len(rig.cameras), *pixel.shape), np.nan)
    covariance = np.full((*pixels.shape, 2), np.nan)
    for k in others:
        pixels[k] = pixel + found[k].displacement
        covariance[k] = found[k].covariance
    seen = np.isfinite(pixels).all(axis=2).any(axis=0)
    pixels[rig.reference, seen] = pixel[seen]
    joint, used = joined_cameras(
        rig,
        pixels,
        covariance,
        disagreement=settings.disagreement,
        reprojection=settings.reprojection,
    )
    valid = used.any(axis=0)
    # The reason of the camera that came farthest: the outcomes are in the order of the steps.
    outcome = np.max([found[k].outcome for k in others], axis=0)
    outcome[seen] = Outcome.REPROJECTION
    outcome[valid] = Outcome.VALID
    counts = np.bincount(outcome, minlength=len(Outcome))
    counts[Outcome.TEXTURE] += blank
    mine = used[others]
    score = np.where(mine, np.stack([found[k].score for k in others]), np.inf)
    window = np.where(mine, np.stack([found[k].window for k in others]), settings.subset)
    return StereoPoints(
        pixel=pixel[valid],
        point=joint.point[valid],
        covariance=joint.covariance[valid],
        score=score.min(axis=0)[valid],
        residual=joint.residual[valid],
        cameras=joint.cameras[valid],
        window=window.min(axis=0)[valid],
        counts=counts,
        step=settings.step,
        shape=shape,
    )
