"""Where the pixels of one camera are seen by another, to half a pixel, from whole pictures.

The pair is rectified, features give the range of disparities, and semi-global matching the
disparity of every pixel. A plane through the disparities around a point gives its match and how the
match changes from pixel to pixel. Where a calibration has drifted, features of the pair are not in
the same row; a smooth correction of the rows, found from them, lets the search work all the same.

Source: Hirschmueller, Stereo processing by semiglobal matching and mutual information, IEEE PAMI
30(2), 2008, as OpenCV has it.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.errors import InputError
from palpate.records import Camera
from palpate.shapes import Flags, PointScalars
from palpate.vision.cameras import Rectified, normalised, project, rectify, remapped
from palpate.vision.images import NormalisedImage, PreparedPictures, match_features

# Side of the blocks of semi-global matching [px]: three to five speckles.
_BLOCK = 7
# More pixels times disparities than this take longer than seconds: the pictures are halved.
_MAX_WORK = 1_000_000_000
# Disparities are sought beyond those of the features by this share of their range, and pixels.
_MARGIN, _MARGIN_PX = 0.25, 16
# Features of textured pictures come in hundreds; fewer than this give no range to be trusted.
_MIN_FEATURES = 8
# Six coefficients of the correction, four features each.
_MIN_FEATURES_TO_FIT = 24
# Fits of the correction, each to the features that agree with the one before.
_FITS = 6
# Disparities of a window that belong to one surface differ by this much [px], and this per pixel.
_MAX_JUMP_PX, _MAX_SLOPE = 1.5, 0.5
# Mean of a normalised image [grey levels].
_GREY = 128.0
# Samples along a side of the window.
_SAMPLES = 7


@dataclass(frozen=True, slots=True, eq=False)
class StereoStart:
    """Where points of the first picture are in the second.

    Attributes
    ----------
    displacement : (n, 2) float [px]    NaN where nothing was found
    gradient : (n, 2, 2) float [-]      [i, j]: derivative of component i by coordinate j; 0 there
    """

    displacement: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 2"]


@dataclass(frozen=True, slots=True, eq=False)
class _RowOffset:
    """Row of a feature in the first rectified picture minus that in the second, a polynomial.

    In (1, x, y, x^2, x y, y^2), x and y the second's column and the first's row scaled to (-1, 1)
    over the features; constant beyond them.
    """

    centre: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    coefficients: Float[np.ndarray, "6"]

    def at(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """The difference of rows [px] at columns and rows of shapes that broadcast."""
        x = np.clip((column - self.centre[0]) / self.half[0], -1.0, 1.0)
        y = np.clip((row - self.centre[1]) / self.half[1], -1.0, 1.0)
        c = self.coefficients
        return (c[0] + x * (c[1] + c[3] * x)) + y * (c[2] + c[4] * x + c[5] * y)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A rectified pair and its correction."""

    first: Camera
    second: Camera
    rectified: Rectified
    offset: _RowOffset

    def into_first(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Rectified place of pixels of the first camera."""
        return _seen_by(self.rectified.cameras[0], self.first, pixels)

    def out_of_second(self, column: PointScalars, row: PointScalars) -> Float[np.ndarray, "n 2"]:
        """Pixels of the second camera, of its rectified columns and the first's rectified rows."""
        place = np.column_stack([column, row - self.offset.at(column, row)])
        return _seen_by(self.second, self.rectified.cameras[1], place)


def stereo_start(
    pictures: PreparedPictures, partner: int, points: Float[np.ndarray, "n 2"], *, half: int
) -> StereoStart:
    """Match points of the reference camera in another, wherever the object is.

    Parameters
    ----------
    pictures : PreparedPictures
    partner : int                   index of the other camera in the rig
    points : (n, 2) float [px]      in the reference picture
    half : int [px]                 half side of the windows that will be matched

    Returns
    -------
    StereoStart

    Raises
    ------
    CalibrationError                the pair cannot be rectified
    InputError                      too few features seen by both
    """
    which = (pictures.rig.reference, partner)
    # Their size is that of the pictures, whatever it was.
    first, second = (replace(pictures.rig.cameras[k], size=None) for k in which)
    images = [pictures.normalised[k] for k in which]
    rows, columns = np.max([image.levels.shape for image in images], axis=0).tolist()
    rectified = rectify((first, second), (rows, columns))
    matches = match_features(*(pictures.features[k] for k in which))
    place = _seen_by(rectified.cameras[0], first, matches.first)
    other = _seen_by(rectified.cameras[1], second, matches.second)
    offset, agree = _row_offset(place, other)
    if agree.sum() < _MIN_FEATURES:
        raise InputError(
            f"cameras '{first.name}' and '{second.name}' have {int(agree.sum())} features in"
            f" common; {_MIN_FEATURES} are needed to know how far the object is. Do their pictures"
            " show the same, textured object?"
        )
    pair = _Pair(first, second, rectified, offset)
    low, high = np.percentile((place - other)[agree, 0], [0.5, 99.5])
    margin = _MARGIN * (high - low) + _MARGIN_PX
    disparity = _disparity(pair, images, float(low - margin), float(high + margin))
    return _start(pair, points, disparity, half)


def _seen_by(
    camera: Camera, other: Camera, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels of another camera with the same centre, as a camera sees them."""
    # With one centre, a point anywhere on the ray will do.
    place = np.column_stack([normalised(other, pixels), np.ones(len(pixels))])
    pose = other.T_camera_object
    return project(camera, (place - pose[:3, 3]) @ pose[:3, :3])


def _row_offset(
    place: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"]
) -> tuple[_RowOffset, Flags]:
    """Correction of the rows, and the features that agree on it."""
    gap = place[:, 1] - other[:, 1]
    at = np.column_stack([other[:, 0], place[:, 1]])
    known = np.isfinite(gap) & np.isfinite(at).all(axis=1)
    if known.sum() < _MIN_FEATURES:
        return _RowOffset(np.zeros(2), np.ones(2), np.zeros(6)), known
    offset = _RowOffset(np.zeros(2), np.ones(2), np.median(gap[known]) * np.eye(6)[0])
    for _ in range(_FITS):
        rest = np.where(known, gap - offset.at(*np.nan_to_num(at).T), np.inf)
        agree = np.abs(rest) < max(5.0 * float(np.median(np.abs(rest))), 1.0)
        if agree.sum() < _MIN_FEATURES_TO_FIT:
            break
        offset = _fitted_offset(at[agree], gap[agree])
    return offset, agree


def _fitted_offset(at: Float[np.ndarray, "n 2"], gap: PointScalars) -> _RowOffset:
    low, high = at.min(axis=0), at.max(axis=0)
    centre, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1.0)
    x, y = ((at - centre) / half).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    # Slopes that the features do not determine, on a line say, stay small.
    normal = terms.T @ terms + 1e-3 * len(terms) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    return _RowOffset(centre, half, np.linalg.solve(normal, terms.T @ gap))


def _disparity(
    pair: _Pair, images: list[NormalisedImage], low: float, high: float
) -> Float[np.ndarray, "rows columns"]:
    """Column in the first minus column in the second rectified picture; NaN where not found."""
    corrected = _corrected(pair)
    grey = []
    for k, image in enumerate(images):
        turned = remapped(corrected, k, image.levels.astype(np.float32))
        grey.append(np.clip(np.nan_to_num(turned, nan=_GREY), 0.0, 255.0).astype(np.uint8))
    shape, shrink = grey[0].shape, 1
    while grey[0].size * (high - low) / shrink > _MAX_WORK:
        size = (grey[0].shape[1] // 2, grey[0].shape[0] // 2)
        grey = [cv2.resize(picture, size, interpolation=cv2.INTER_AREA) for picture in grey]
        shrink *= 2
    found = shrink * _semi_global(grey[0], grey[1], low / shrink, high / shrink)
    if shrink > 1:
        found = cv2.resize(found, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return found


def _semi_global(
    first: UInt8[np.ndarray, "rows columns"],
    second: UInt8[np.ndarray, "rows columns"],
    low: float,
    high: float,
) -> Float[np.ndarray, "rows columns"]:
    """Disparity of every pixel within a range; NaN where not found."""
    least = int(np.floor(low))
    count = 16 * int(np.ceil((high - least) / 16.0))
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=count,
        blockSize=_BLOCK,
        # OpenCV's recommendation for the price of a small and of a large step.
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        # Islands smaller than a window are mistakes.
        speckleWindowSize=200,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # OpenCV leaves out every pixel for which one of the disparities leads out of the picture.
    left, right = max(least + count, 0), max(-least, 0)
    wide = [
        cv2.copyMakeBorder(picture, 0, 0, left, right, cv2.BORDER_CONSTANT, value=_GREY)
        for picture in (first, second)
    ]
    found = matcher.compute(wide[0], wide[1])[:, left : left + first.shape[1]] / 16.0
    return np.where(found < least, np.nan, found)


def _corrected(pair: _Pair) -> Rectified:
    """The pair with the rows of the second picture moved to those of the first."""
    rows, columns = pair.rectified.maps[1].shape[1:]
    row, column = np.mgrid[:rows, :columns].astype(np.float32)
    row = (row - pair.offset.at(column, row)).astype(np.float32)
    moved = [
        cv2.remap(part, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in pair.rectified.maps[1]
    ]
    return replace(pair.rectified, maps=(pair.rectified.maps[0], np.stack(moved)))


def _start(
    pair: _Pair,
    points: Float[np.ndarray, "n 2"],
    disparity: Float[np.ndarray, "rows columns"],
    half: int,
) -> StereoStart:
    """Match and gradient of points from a plane through the disparities around each."""
    at = pair.into_first(points)
    plane, good = _planes(disparity, at, half)

    def match(pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        place = pair.into_first(pixels)
        shift = plane[:, 0] + np.einsum("na,na->n", place - at, plane[:, 1:])
        return pair.out_of_second(place[:, 0] - shift, place[:, 1])

    displacement = np.where(good[:, None], match(points) - points, np.nan)
    gradient = np.empty((len(points), 2, 2))
    for j, step in enumerate(np.eye(2)):
        # Over the width of the window: lens and perspective included.
        ends = match(points + half * step) - match(points - half * step)
        gradient[:, :, j] = ends / (2.0 * half) - step
    known = good & np.isfinite(gradient).all(axis=(1, 2))
    return StereoStart(displacement, np.where(known[:, None, None], gradient, 0.0))


def _planes(
    disparity: Float[np.ndarray, "rows columns"], at: Float[np.ndarray, "n 2"], half: int
) -> tuple[Float[np.ndarray, "n 3"], Flags]:
    """Disparity and its slopes at places of the rectified picture; and whether they are known."""
    away = np.linspace(-half, half, _SAMPLES)
    away = np.stack(np.meshgrid(away, away), axis=-1).reshape(-1, 2)
    value, offset = _sampled(disparity, at, away)
    # The middle third decides which surface is meant.
    third = np.abs(away).max(axis=1) <= half / 3.0 + 0.1
    good = np.isfinite(value[:, third]).sum(axis=1) > third.sum() // 2
    plane = np.zeros((len(at), 3))
    if not good.any():
        return plane, good
    value, offset = value[good], offset[good]
    centre = np.nanmedian(value[:, third], axis=1)[:, None]
    reach = _MAX_JUMP_PX + _MAX_SLOPE * np.linalg.norm(away, axis=1)
    own = np.where(np.isfinite(value), np.abs(value - centre), np.inf) <= reach
    terms = np.concatenate([np.ones((*value.shape, 1)), offset], axis=2) * own[..., None]
    normal = terms.swapaxes(1, 2) @ terms + 1e-6 * np.eye(3)
    right = terms.swapaxes(1, 2) @ np.where(own, value, 0.0)[..., None]
    plane[good] = np.linalg.solve(normal, right)[..., 0]
    good[good] = own.sum(axis=1) >= len(away) // 2
    return plane, good


def _sampled(
    disparity: Float[np.ndarray, "rows columns"],
    at: Float[np.ndarray, "n 2"],
    away: Float[np.ndarray, "s 2"],
) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, "n s 2"]]:
    """Disparity at the pixels nearest to places around points, NaN outside; and where these are."""
    size = np.array(disparity.shape[::-1])
    known = np.isfinite(at).all(axis=1)
    place = np.rint(np.where(known[:, None], at, -1e6)[:, None] + away).astype(np.int64)
    inside = ((place >= 0) & (place < size)).all(axis=2)
    place = np.clip(place, 0, size - 1)
    value = np.where(inside, disparity[place[..., 1], place[..., 0]], np.nan)
    return value, place - np.where(known[:, None], at, 0.0)[:, None]
