"""Initial stereo matches of a pair of cameras, to half a pixel, by semi-global matching.

The pair is rectified, feature matches give the range of disparities, and semi-global matching the
disparity of every pixel. A plane fitted to the disparities around a point gives its match and the
match's gradient. If the calibration has drifted, matching features do not lie in the same row; a
smooth correction of the rows, fitted to them, lets the search work all the same.

Source: Hirschmueller, Stereo processing by semiglobal matching and mutual information, IEEE PAMI
30(2), 2008, in OpenCV's implementation.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.errors import InputError
from palpate.records import Camera
from palpate.shapes import Flags, PointScalars
from palpate.vision.matching.features import PreparedPictures, match_features
from palpate.vision.normalisation import NormalisedImage
from palpate.vision.projection import normalised, project
from palpate.vision.rectification import Rectified, rectify, remapped

# Block side of semi-global matching [px]: three to five speckles.
_BLOCK = 7
# If pixels times disparities exceed this, matching takes more than seconds: pictures are halved.
_MAX_WORK = 1_000_000_000
# Margin of the disparity search beyond those of the features: fraction of their range, plus pixels.
_MARGIN, _MARGIN_PX = 0.25, 16
# Textured pictures have hundreds of features; fewer than this give no reliable range.
_MIN_FEATURES = 8
# Four features per coefficient of the correction.
_MIN_FEATURES_TO_FIT = 24
# Fits of the correction, each to the features consistent with the previous one.
_FITS = 6
# Disparities in a window belong to one surface if they differ by less than this [px], plus this per
# pixel of distance.
_MAX_JUMP_PX, _MAX_SLOPE = 1.5, 0.5
# Mean of a normalised picture [grey levels].
_GREY = 128.0
# Samples along each side of a window.
_SAMPLES = 7


@dataclass(frozen=True, slots=True, eq=False)
class _RowOffset:
    """Row in the first rectified picture minus row in the second, as a quadratic polynomial.

    Its terms are 1, x, y, x^2, x y, y^2, with x and y the second's column and the first's row,
    scaled to (-1, 1) over the range of the features; clamped outside it.
    """

    centre: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    coefficients: Float[np.ndarray, "6"]

    def at(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
        """Row difference [px] at columns and rows, of shapes that broadcast."""
        x = np.clip((column - self.centre[0]) / self.half[0], -1.0, 1.0)
        y = np.clip((row - self.centre[1]) / self.half[1], -1.0, 1.0)
        c = self.coefficients
        return (c[0] + x * (c[1] + c[3] * x)) + y * (c[2] + c[4] * x + c[5] * y)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """A rectified pair and its row correction."""

    first: Camera
    second: Camera
    rectified: Rectified
    offset: _RowOffset

    def into_first(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Map pixels of the first camera into its rectified picture."""
        return _seen_by(self.rectified.cameras[0], self.first, pixels)

    def out_of_second(self, column: PointScalars, row: PointScalars) -> Float[np.ndarray, "n 2"]:
        """Pixels of the second camera from its rectified columns and the first's rectified rows."""
        pixel = np.column_stack([column, row - self.offset.at(column, row)])
        return _seen_by(self.second, self.rectified.cameras[1], pixel)


def stereo_start(
    pictures: PreparedPictures, partner: int, points: Float[np.ndarray, "n 2"], *, half: int
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Match points of the reference camera in another one, without knowing the object's position.

    Parameters
    ----------
    pictures : PreparedPictures
    partner : int                   index of the other camera in the rig
    points : (n, 2) float [px]      in the reference picture
    half : int [px]                 half side of the windows to be matched later

    Returns
    -------
    displacement : (n, 2) float [px]    NaN where no match was found
    gradient : (n, 2, 2) float [-]      [i, j]: d(component i) / d(coordinate j); 0 without match

    Raises
    ------
    CalibrationError                the pair cannot be rectified
    InputError                      fewer than 8 consistent feature matches
    """
    indices = (pictures.rig.reference, partner)
    # The pictures define the size here; the cameras' own is not checked again.
    first, second = (replace(pictures.rig.cameras[k], size=None) for k in indices)
    images = [pictures.normalised[k] for k in indices]
    rows, columns = np.max([image.levels.shape for image in images], axis=0).tolist()
    rectified = rectify((first, second), (rows, columns))
    matches = match_features(*(pictures.features[k] for k in indices))
    pixel = _seen_by(rectified.cameras[0], first, matches.point)
    other = _seen_by(rectified.cameras[1], second, matches.moved)
    offset, agree = _row_offset(pixel, other)
    if agree.sum() < _MIN_FEATURES:
        raise InputError(
            f"{pictures.rig.source}: cameras '{first.name}' and '{second.name}' have"
            f" {int(agree.sum())} features in common; {_MIN_FEATURES} are needed to know how far"
            " the object is. Do their pictures show the same, textured object?"
        )
    pair = _Pair(first, second, rectified, offset)
    low, high = np.percentile((pixel - other)[agree, 0], [0.5, 99.5])
    margin = _MARGIN * (high - low) + _MARGIN_PX
    disparity = _disparity(pair, images, float(low - margin), float(high + margin))
    return _start(pair, points, disparity, half)


def _seen_by(
    camera: Camera, other: Camera, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Map pixels between two cameras with the same centre, from `other` to `camera`."""
    # With a common centre, any point on the ray will do.
    ray = np.column_stack([normalised(other, pixels), np.ones(len(pixels))])
    pose = other.T_camera_object
    return project(camera, (ray - pose[:3, 3]) @ pose[:3, :3])


def _row_offset(
    pixel: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"]
) -> tuple[_RowOffset, Flags]:
    """Robust row correction, and flags of the features consistent with it."""
    gap = pixel[:, 1] - other[:, 1]
    at = np.column_stack([other[:, 0], pixel[:, 1]])
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
    # A ridge keeps undetermined coefficients small, e.g. for collinear features.
    normal = terms.T @ terms + 1e-3 * len(terms) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    return _RowOffset(centre, half, np.linalg.solve(normal, terms.T @ gap))


def _disparity(
    pair: _Pair, images: list[NormalisedImage], low: float, high: float
) -> Float[np.ndarray, "rows columns"]:
    """Disparity [px], column in the first minus column in the second; NaN where not found."""
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
    disparity = shrink * _semi_global(grey[0], grey[1], low / shrink, high / shrink)
    if shrink > 1:
        disparity = cv2.resize(disparity, shape[::-1], interpolation=cv2.INTER_NEAREST)
    return disparity


def _semi_global(
    first: UInt8[np.ndarray, "rows columns"],
    second: UInt8[np.ndarray, "rows columns"],
    low: float,
    high: float,
) -> Float[np.ndarray, "rows columns"]:
    """Disparity of every pixel within a range; NaN where not found."""
    lowest = int(np.floor(low))
    count = 16 * int(np.ceil((high - lowest) / 16.0))
    matcher = cv2.StereoSGBM.create(
        minDisparity=lowest,
        numDisparities=count,
        blockSize=_BLOCK,
        # OpenCV's recommended penalties for small and large disparity steps.
        P1=8 * _BLOCK**2,
        P2=32 * _BLOCK**2,
        disp12MaxDiff=1,
        uniquenessRatio=10,
        # Regions smaller than a window are mismatches.
        speckleWindowSize=200,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # OpenCV skips pixels for which any trial disparity leaves the picture, so the pictures are
    # padded.
    left, right = max(lowest + count, 0), max(-lowest, 0)
    wide = [
        cv2.copyMakeBorder(picture, 0, 0, left, right, cv2.BORDER_CONSTANT, value=_GREY)
        for picture in (first, second)
    ]
    disparity = matcher.compute(wide[0], wide[1])[:, left : left + first.shape[1]] / 16.0
    return np.where(disparity < lowest, np.nan, disparity)


def _corrected(pair: _Pair) -> Rectified:
    """The pair with the second picture's rows corrected to those of the first."""
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
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]]:
    """Matches and their gradients from a plane fitted to the disparities around each point."""
    at = pair.into_first(points)
    plane, good = _planes(disparity, at, half)

    def match(pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        pixel = pair.into_first(pixels)
        shift = plane[:, 0] + np.einsum("na,na->n", pixel - at, plane[:, 1:])
        return pair.out_of_second(pixel[:, 0] - shift, pixel[:, 1])

    displacement = np.where(good[:, None], match(points) - points, np.nan)
    gradient = np.empty((len(points), 2, 2))
    for j, step in enumerate(np.eye(2)):
        # Difference over the width of the window, including distortion and perspective.
        ends = match(points + half * step) - match(points - half * step)
        gradient[:, :, j] = ends / (2.0 * half) - step
    known = good & np.isfinite(gradient).all(axis=(1, 2))
    return displacement, np.where(known[:, None, None], gradient, 0.0)


def _planes(
    disparity: Float[np.ndarray, "rows columns"], at: Float[np.ndarray, "n 2"], half: int
) -> tuple[Float[np.ndarray, "n 3"], Flags]:
    """Disparity and its slopes at positions in the rectified picture, and flags where known."""
    away = np.linspace(-half, half, _SAMPLES)
    away = np.stack(np.meshgrid(away, away), axis=-1).reshape(-1, 2)
    value, offset = _sampled(disparity, at, away)
    # The middle third of the window selects the surface.
    third = np.abs(away).max(axis=1) <= half / 3.0 + 0.1
    good = np.isfinite(value[:, third]).sum(axis=1) > third.sum() // 2
    plane = np.zeros((len(at), 3))
    if not good.any():
        return plane, good
    value, offset = value[good], offset[good]
    centre = np.nanmedian(value[:, third], axis=1)[:, None]
    reach = _MAX_JUMP_PX + _MAX_SLOPE * np.linalg.norm(away, axis=1)
    near = np.where(np.isfinite(value), np.abs(value - centre), np.inf) <= reach
    terms = np.concatenate([np.ones((*value.shape, 1)), offset], axis=2) * near[..., None]
    normal = terms.swapaxes(1, 2) @ terms + 1e-6 * np.eye(3)
    right = terms.swapaxes(1, 2) @ np.where(near, value, 0.0)[..., None]
    plane[good] = np.linalg.solve(normal, right)[..., 0]
    good[good] = near.sum(axis=1) >= len(away) // 2
    return plane, good


def _sampled(
    disparity: Float[np.ndarray, "rows columns"],
    at: Float[np.ndarray, "n 2"],
    away: Float[np.ndarray, "s 2"],
) -> tuple[Float[np.ndarray, "n s"], Float[np.ndarray, "n s 2"]]:
    """Disparity at the pixels nearest to samples around points, NaN outside; and their offsets."""
    size = np.array(disparity.shape[::-1])
    known = np.isfinite(at).all(axis=1)
    pixel = np.rint(np.where(known[:, None], at, -1e6)[:, None] + away).astype(np.int64)
    inside = ((pixel >= 0) & (pixel < size)).all(axis=2)
    pixel = np.clip(pixel, 0, size - 1)
    value = np.where(inside, disparity[pixel[..., 1], pixel[..., 0]], np.nan)
    return value, pixel - np.where(known[:, None], at, 0.0)[:, None]
