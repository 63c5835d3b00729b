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
from palpate.vision.cameras import Rectified, project, rays, rectify_pair, remapped
from palpate.vision.images import EvenPicture, Features, matched

# Side of the blocks of semi-global matching [px]: three to five speckles.
_BLOCK = 7
# More pixels times disparities than this take longer than seconds: the pictures are halved.
_MOST_WORK = 1_000_000_000
# Disparities are looked for beyond those of the features by this share of their range, and pixels.
_BEYOND, _BEYOND_PIXELS = 0.25, 16
# Features of textured pictures come in hundreds; fewer than this give no range to be trusted.
_FEWEST = 8
# Six coefficients of the correction, four features each.
_FEWEST_BENT = 24
# Disparities of a window that belong to one surface differ by this much [px], and this per pixel.
_SLACK, _SLOPE = 1.5, 0.5
# Mean of an even picture [grey levels].
_GREY = 128.0
# Samples along a side of the window.
_SAMPLES = 7


@dataclass(frozen=True, slots=True, eq=False)
class PairView:
    """One camera of a pair with what was found in its picture.

    Attributes
    ----------
    camera : Camera
    picture : EvenPicture
    features : Features
    """

    camera: Camera
    picture: EvenPicture
    features: Features


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
class _Bend:
    """Row of a feature in the first rectified picture minus that in the second, a polynomial.

    In (1, x, y, x^2, x y, y^2), x and y the second's column and the first's row scaled to (-1, 1)
    over the features; constant beyond them.
    """

    centre: Float[np.ndarray, "2"]
    half: Float[np.ndarray, "2"]
    coefficients: Float[np.ndarray, "6"]

    def at(self, place: Float[np.ndarray, "n 2"]) -> PointScalars:
        """The difference of rows [px] at columns and rows."""
        return self.over(place[:, 0], place[:, 1])

    def over(self, column: np.ndarray, row: np.ndarray) -> np.ndarray:
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
    bend: _Bend

    def into_first(self, pixels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Rectified place of pixels of the first camera."""
        return _turned(self.first, self.rectified.cameras[0], pixels)

    def out_of_second(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """Pixels of the second camera, of places whose rows are the first's."""
        raw = place - np.column_stack([np.zeros(len(place)), self.bend.at(place)])
        return _turned(self.rectified.cameras[1], self.second, raw)


def make_view(camera: Camera, picture: EvenPicture, features: Features) -> PairView:
    """A camera ready to be paired; its size is that of the picture, whatever it was."""
    return PairView(replace(camera, size=None), picture, features)


def stereo_start(
    first: PairView,
    second: PairView,
    points: Float[np.ndarray, "n 2"],
    *,
    half: int,
    depth_range: tuple[float, float] | None = None,
) -> StereoStart:
    """Match points of one camera in another, without being told where to look.

    Parameters
    ----------
    first, second : PairView
    points : (n, 2) float [px]      in the first picture
    half : int [px]                 half side of the windows that will be matched
    depth_range : (near, far) [m] or None   distance along the first camera's axis; None where
                                    features of both pictures are to give it

    Returns
    -------
    StereoStart

    Raises
    ------
    CalibrationError                the pair cannot be rectified
    InputError                      no depth range given and too few features seen by both
    """
    shape = tuple(np.maximum(first.picture.even.shape, second.picture.even.shape).tolist())
    rectified = rectify_pair(first.camera, second.camera, shape)
    matches = matched(first.features, second.features)
    place = _turned(first.camera, rectified.cameras[0], matches.first)
    other = _turned(second.camera, rectified.cameras[1], matches.second)
    bend, agree = _bend(place, other)
    pair = _Pair(first.camera, second.camera, rectified, bend)
    if depth_range is not None:
        low, high = _range_of_depths(pair, points, depth_range)
    elif agree.sum() >= _FEWEST:
        low, high = _range_of_features((place - other)[agree, 0])
    else:
        raise InputError(
            f"cameras '{first.camera.name}' and '{second.camera.name}' have {int(agree.sum())}"
            f" features in common; {_FEWEST} are needed to know how far the object is. Do their"
            " pictures show the same, textured object? A depth range helps where they do"
        )
    disparity = _disparity(pair, (first.picture, second.picture), low, high)
    return _start(pair, points, disparity, half)


def _turned(
    camera: Camera, other: Camera, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """Pixels of one camera as another with the same centre sees them."""
    centre, direction = rays(camera, pixels)
    return project(other, centre + direction)


def _bend(place: Float[np.ndarray, "n 2"], other: Float[np.ndarray, "n 2"]) -> tuple[_Bend, Flags]:
    """Correction of the rows, and the features that agree on it."""
    away = place[:, 1] - other[:, 1]
    spot = np.column_stack([other[:, 0], place[:, 1]])
    agree = np.isfinite(away) & np.isfinite(spot).all(axis=1)
    flat = _Bend(np.zeros(2), np.ones(2), np.zeros(6))
    if agree.sum() < _FEWEST:
        return flat, agree
    middle = float(np.median(away[agree]))
    bend = replace(flat, coefficients=np.array([middle, 0.0, 0.0, 0.0, 0.0, 0.0]))
    for _ in range(6):
        rest = np.where(np.isfinite(away), away - bend.at(np.nan_to_num(spot)), np.inf)
        agree = np.abs(rest) < max(5.0 * float(np.median(np.abs(rest))), 1.0)
        if agree.sum() < _FEWEST_BENT:
            break
        bend = _fitted(spot[agree], away[agree])
    return bend, agree


def _fitted(spot: Float[np.ndarray, "n 2"], away: PointScalars) -> _Bend:
    low, high = spot.min(axis=0), spot.max(axis=0)
    bend = _Bend(0.5 * (low + high), np.maximum(0.5 * (high - low), 1.0), np.zeros(6))
    x, y = ((spot - bend.centre) / bend.half).T
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)
    # Slopes that the features do not tell, on a line say, stay small.
    normal = terms.T @ terms + 1e-3 * len(terms) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    return replace(bend, coefficients=np.linalg.solve(normal, terms.T @ away))


def _range_of_features(disparity: PointScalars) -> tuple[float, float]:
    low, high = np.percentile(disparity, [0.5, 99.5])
    beyond = _BEYOND * (high - low) + _BEYOND_PIXELS
    return float(low - beyond), float(high + beyond)


def _range_of_depths(
    pair: _Pair, points: Float[np.ndarray, "n 2"], depth_range: tuple[float, float]
) -> tuple[float, float]:
    """Least and greatest disparity of points at the ends of a range of depths."""
    centre, direction = rays(pair.first, points)
    axis = pair.first.T_camera_object[2, :3]
    found = []
    for depth in depth_range:
        space = centre + direction * (depth / (direction @ axis))[:, None]
        ends = [project(camera, space)[:, 0] for camera in pair.rectified.cameras]
        found.append(ends[0] - ends[1])
    return float(np.nanmin(found)) - 1.0, float(np.nanmax(found)) + 1.0


def _disparity(
    pair: _Pair, pictures: tuple[EvenPicture, EvenPicture], low: float, high: float
) -> Float[np.ndarray, "rows columns"]:
    """Column in the first minus column in the second rectified picture; NaN where not found."""
    turned = [
        np.nan_to_num(remapped(_corrected(pair), k, picture.even.astype(np.float32)), nan=_GREY)
        for k, picture in enumerate(pictures)
    ]
    grey = [np.clip(picture, 0.0, 255.0).astype(np.uint8) for picture in turned]
    shape, shrink = grey[0].shape, 1
    while grey[0].size * (high - low) / shrink > _MOST_WORK:
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
    column, row = np.arange(columns, dtype=np.float32), np.arange(rows, dtype=np.float32)
    bent = (row[:, None] - pair.bend.over(column[None], row[:, None])).astype(np.float32)
    straight = np.ascontiguousarray(np.broadcast_to(column, (rows, columns)))
    moved = [
        cv2.remap(one, straight, bent, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for one in pair.rectified.maps[1]
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
        return pair.out_of_second(place - np.column_stack([shift, np.zeros(len(shift))]))

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
    # The middle third decides which surface is meant.
    third = away[np.abs(away).max(axis=1) <= half / 3.0 + 0.1]
    middle, _ = _sampled(disparity, at, third)
    good = np.isfinite(middle).sum(axis=1) > len(third) // 2
    plane = np.zeros((len(at), 3))
    if not good.any():
        return plane, good
    centre = np.nanmedian(middle[good], axis=1)[:, None]
    value, offset = _sampled(disparity, at[good], away)
    reach = _SLACK + _SLOPE * np.linalg.norm(away, axis=1)
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
