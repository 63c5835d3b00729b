"""Disparity of every pixel of a rectified reference picture, by area matching in all cameras of the
head: a pair, or three in an L.

For each trial disparity, the windows of all other cameras are correlated with the reference's and
the correlations summed; the maximum of the sum is refined by a parabola. A pixel gets no disparity
if it has no texture, no interior maximum, or a second maximum nearly as high, or if its partner in
another camera belongs to a better match of another pixel. This replaces the commercial stereo
library of the source, which is not described there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from palpate.records import Rig, camera_centre
from palpate.shapes import Points, PointScalars
from palpate.threads import in_threads
from palpate.vision.rectification import Rectified, rectify, remapped

# Axis of the picture along which a camera's disparity lies.
COLUMNS = 0
ROWS = 1
# Side of the window [px]; half of it, its pixels.
WINDOW = 7
_HALF, _PIXELS = WINDOW // 2, WINDOW * WINDOW
# Smallest standard deviation in a window [grey levels]: the noise of an 8-bit camera is 1 to 2;
# below that, noise would be matched with noise.
MIN_CONTRAST = 2.0
# A match is ambiguous if a second maximum exceeds this fraction of the best one.
_MAX_RIVAL = 0.95
# Trial disparities on either side of the best that belong to the same maximum: its width is about
# the size of the texture, and the parabola uses one on each side.
_SAME_MAXIMUM = 2
# Rows matched together: a band and its trial disparities stay in the processor's cache.
_BAND = 8
# Rounding error in the sum of squares of a window without contrast stays below this [grey
# levels^2]: double precision leaves 1e-8 of grey levels up to 1e3; a contrast of 0.01 gives 5e-3.
_MIN_SQUARES = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Shift of a pixel from the rectified reference into the other cameras by its disparity.

    In camera i a pixel is shifted by offset + ratio * disparity from its position in the reference,
    along columns or rows. Entry 0 of the arrays is the reference itself, with zero shift.

    Attributes
    ----------
    along : (c,) int                `COLUMNS` or `ROWS`
    ratio : (c,) float [-]          shift per pixel of disparity; 1 or -1 for the longest baseline
    offset : (c,) float [px]        shift at zero disparity
    """

    along: Int[np.ndarray, " c"]
    ratio: Float[np.ndarray, " c"]
    offset: Float[np.ndarray, " c"]


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """Rectified pictures of one instant, and the disparity of the reference's pixels.

    Attributes
    ----------
    pictures : (c, rows, columns) float32 [grey levels]     the reference first; NaN where no data
    disparity : (rows, columns) float [px]                  NaN where there is none
    """

    pictures: Float[np.ndarray, "c rows columns"]
    disparity: Float[np.ndarray, "rows columns"]


def disparity_map(
    pictures: Sequence[Float[np.ndarray, "rows columns"]],
    views: Views,
    limits: tuple[float, float],
) -> Float[np.ndarray, "rows columns"]:
    """Match every pixel of the reference in all other cameras.

    Parameters
    ----------
    pictures : sequence of c (rows, columns) float [grey levels]    rectified, the reference first;
                                    NaN where a camera has no data
    views : Views                   of the c cameras
    limits : (float, float) [px]    minimum and maximum disparity to try

    Returns
    -------
    (rows, columns) float [px]      sub-pixel disparity; NaN where there is no valid match
    """
    stack = np.stack([np.asarray(picture, dtype=np.float64) for picture in pictures])
    # Centred at zero, sums of squares lose fewer digits.
    stack -= np.nanmean(stack)
    disparity, score = np.full((2, *stack.shape[1:]), np.nan)
    rows = stack.shape[1] - WINDOW + 1
    trials = _trials(views, limits)
    in_threads(
        _match_rows, rows, stack, views.along, views.ratio, views.offset, trials, disparity, score,
        min_items=_BAND,
    )  # fmt: skip
    mutual = np.isfinite(disparity)
    for i in range(1, len(pictures)):
        shift = views.offset[i] + views.ratio[i] * disparity
        mutual &= _is_mutual(disparity, score, shift, int(views.along[i]), abs(views.ratio[i]))
    return np.where(mutual, disparity, np.nan)


def _trials(views: Views, limits: tuple[float, float]) -> Float[np.ndarray, " t"]:
    """Disparities one pixel apart, whole pixels in the camera of the longest baseline."""
    longest = int(np.argmax(np.abs(views.ratio)))
    beyond = views.offset[longest] * np.sign(views.ratio[longest])
    low, high = np.floor(limits[0] + beyond), np.ceil(limits[1] + beyond)
    # One extra at each end, so that a maximum there is interior.
    return np.arange(low - 1.0, high + 1.5) - beyond


@njit(cache=True, nogil=True, error_model="numpy")
def _match_rows(begin, end, pictures, along, ratio, offset, trials, disparity, best):
    """Fill in disparity and correlation sum for windows whose first row is in a range."""
    columns = pictures.shape[2]
    score = np.empty((len(trials), _BAND, columns - 2 * _HALF))
    for top in range(begin, end, _BAND):
        count = min(_BAND, end - top)
        _fill_scores(pictures, along, ratio, offset, trials, top, count, score)
        for row in range(count):
            _refine_maxima(
                score[:, row], trials, disparity[top + _HALF + row, _HALF:],
                best[top + _HALF + row, _HALF:],
            )  # fmt: skip


@njit(cache=True, error_model="numpy")
def _fill_scores(pictures, along, ratio, offset, trials, top, count, score):
    """Correlation with the reference's windows in a band of rows from `top` on, summed over the
    other cameras."""
    columns = pictures.shape[2]
    here = pictures[0, top : top + count + 2 * _HALF]
    shifted = np.empty_like(here)
    mean, norm, total, square, product = np.empty((5, count, columns - 2 * _HALF))
    down = np.empty((3, columns))
    _sum_windows(here, here, down, mean, norm, product)
    for y in range(count):
        for x in range(columns - 2 * _HALF):
            mean[y, x] /= _PIXELS
            square_sum = norm[y, x] - _PIXELS * mean[y, x] * mean[y, x]
            is_textured = square_sum > MIN_CONTRAST**2 * _PIXELS
            norm[y, x] = np.sqrt(square_sum) if is_textured else np.nan
    score[:] = 0.0
    for t in range(len(trials)):
        for c in range(1, len(pictures)):
            _fill_shifted(pictures[c], top, offset[c] + ratio[c] * trials[t], along[c], shifted)
            _sum_windows(shifted, here, down, total, square, product)
            for y in range(count):
                for x in range(columns - 2 * _HALF):
                    squares = square[y, x] - total[y, x] * total[y, x] / _PIXELS
                    squares = np.nan if squares < _MIN_SQUARES else squares
                    covariance = product[y, x] - mean[y, x] * total[y, x]
                    score[t, y, x] += covariance / (norm[y, x] * np.sqrt(squares))


@njit(cache=True, error_model="numpy")
def _sum_windows(values, others, down, total, square, product):
    """Sums over all windows within an array: of its values, of their squares, and of their products
    with those of another array. `down` is work space."""
    columns = values.shape[1]
    for y in range(len(total)):
        down[:] = 0.0
        for k in range(WINDOW):
            value, other = values[y + k], others[y + k]
            for x in range(columns):
                down[0, x] += value[x]
                down[1, x] += value[x] * value[x]
                down[2, x] += value[x] * other[x]
        _sum_across(down[0], total[y])
        _sum_across(down[1], square[y])
        _sum_across(down[2], product[y])


@njit(cache=True, error_model="numpy")
def _sum_across(values, sums):
    """Sums over `WINDOW` neighbours in a row."""
    for x in range(len(sums)):
        total = 0.0
        for k in range(WINDOW):
            total += values[x + k]
        sums[x] = total


@njit(cache=True, error_model="numpy")
def _fill_shifted(grey, top, shift, along, shifted):
    """Rows from `top` on, shifted, with linear interpolation; NaN outside the picture."""
    whole = int(np.floor(shift))
    part = shift - whole
    right, below = whole * (1 - along), whole * along
    more_right, more_below = (0, 0) if part == 0.0 else (1 - along, along)
    rows, columns = grey.shape
    first = max(0, -right)
    last = min(columns, columns - right - more_right)
    for y in range(len(shifted)):
        row = top + y + below
        if row < 0 or row + more_below >= rows or last <= first:
            shifted[y] = np.nan
            continue
        near = grey[row, first + right : last + right]
        far = grey[row + more_below, first + right + more_right : last + right + more_right]
        shifted[y, :first] = np.nan
        shifted[y, last:] = np.nan
        for x in range(last - first):
            shifted[y, first + x] = (1.0 - part) * near[x] + part * far[x]


@njit(cache=True, error_model="numpy")
def _refine_maxima(score, trials, disparity, best):
    """Disparity and score of each pixel's highest interior maximum in a row, where unambiguous."""
    count, columns = score.shape
    for x in range(columns):
        highest, peak = -np.inf, 0
        for t in range(1, count - 1):
            value = score[t, x]
            # Comparisons with NaN are false.
            is_maximum = value > score[t - 1, x] and value >= score[t + 1, x] and value > 0.0
            if is_maximum and value > highest:
                highest, peak = value, t
        if peak == 0 or score[0, x] > highest or score[count - 1, x] > highest:
            continue
        is_alone = True
        for t in range(count):
            is_rival = score[t, x] > _MAX_RIVAL * highest
            is_alone &= not (is_rival and abs(t - peak) > _SAME_MAXIMUM)
        if is_alone:
            before, after = score[peak - 1, x], score[peak + 1, x]
            curvature = before - 2.0 * highest + after
            disparity[x] = trials[peak] + 0.5 * (before - after) / curvature
            best[x] = highest


def _is_mutual(
    disparity: Float[np.ndarray, "rows columns"],
    score: Float[np.ndarray, "rows columns"],
    shift: Float[np.ndarray, "rows columns"],
    along: int,
    ratio: float,
) -> Bool[np.ndarray, "rows columns"]:
    """True where no better match with another disparity claims the same pixel of the camera."""
    y, x = np.nonzero(np.isfinite(shift))
    # The best match is written last and overwrites the others.
    order = np.argsort(score[y, x], kind="stable")
    y, x = y[order], x[order]
    shift_px = np.floor(shift[y, x] + 0.5).astype(np.int64)
    i, j = y + shift_px * along, x + shift_px * (1 - along)
    inside = (i >= 0) & (i < shift.shape[0]) & (j >= 0) & (j < shift.shape[1])
    y, x, i, j = y[inside], x[inside], i[inside], j[inside]
    owner = np.full(shift.shape, np.nan)
    owner[i, j] = disparity[y, x]
    mutual = np.zeros(shift.shape, dtype=bool)
    mutual[y, x] = np.abs(owner[i, j] - disparity[y, x]) * ratio <= 1.0
    return mutual


@dataclass(frozen=True, slots=True, eq=False)
class StereoHead:
    """Rectified cameras of a rig.

    Disparity is measured in pixels for the longest baseline; it is zero at infinity.

    Attributes
    ----------
    rectified : Rectified
    order : tuple of c int          index in the rig of each rectified camera, the reference first
    views : Views                   of the c cameras
    parallax : float [px m]         disparity times depth
    shape : (rows, columns) [px]    of the original pictures
    canvas : (rows, columns) [px]   of the rectified pictures
    """

    rectified: Rectified
    order: tuple[int, ...]
    views: Views
    parallax: float
    shape: tuple[int, int]
    canvas: tuple[int, int]


def make_head(rig: Rig, shape: tuple[int, int]) -> StereoHead:
    """Rectify the reference camera of a rig with its partner, or with two that form an L with it.

    Parameters
    ----------
    rig : Rig                       of more than three cameras, the method uses the two whose
                                    directions from the reference are nearest to a right angle
    shape : (rows, columns) [px]    of the pictures

    Returns
    -------
    StereoHead

    Raises
    ------
    CalibrationError                cameras that cannot be rectified
    InputError                      `shape` contradicts a camera's size
    """
    order = (rig.reference, *_partners(rig))
    rectified = rectify([rig.cameras[i] for i in order], shape)
    reference = rectified.cameras[0]
    slope, offset = np.zeros(len(order)), np.zeros(len(order))
    for i, axis in enumerate(rectified.axis, start=1):
        other = rectified.cameras[i]
        arm = other.T_camera_object[:3, 3] - reference.T_camera_object[:3, 3]
        slope[i] = (reference.matrix @ arm)[axis]
        offset[i] = (other.matrix - reference.matrix)[axis, 2]
    parallax = float(np.abs(slope).max())
    views = Views(np.array([0, *rectified.axis]), slope / parallax, offset)
    canvas = rectified.maps[0].shape[1:]
    return StereoHead(rectified, order, views, parallax, shape, canvas)


def make_instant(
    head: StereoHead,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    limits: tuple[float, float],
) -> Instant:
    """Rectify the pictures of one instant and match them with each other.

    Parameters
    ----------
    head : StereoHead
    pictures : sequence of (rows, columns) float [grey levels]  of all cameras of the rig
    limits : (float, float) [px]    minimum and maximum disparity to try

    Returns
    -------
    Instant

    Raises
    ------
    InputError                      as in `disparity_map`
    """
    flat = [remapped(head.rectified, k, pictures[i]) for k, i in enumerate(head.order)]
    disparity = disparity_map(flat, head.views, limits)
    # Zero is at infinity; trials extend a pixel or two beyond the limits.
    return Instant(np.stack(flat), np.where(disparity > 0.0, disparity, np.nan))


def head_points(head: StereoHead, pixel: Int[np.ndarray, "n 2"], disparity: PointScalars) -> Points:
    """Points of the object from pixels of the rectified reference and their disparities.

    Parameters
    ----------
    head : StereoHead
    pixel : (n, 2) int [px]         column and row
    disparity : (n,) float [px]     above zero

    Returns
    -------
    (n, 3) float [m]                object frame
    """
    camera = head.rectified.cameras[0]
    pose = camera.T_camera_object
    flat = np.column_stack([pixel, np.ones(len(pixel))]) @ np.linalg.inv(camera.matrix).T
    return ((head.parallax / disparity)[:, None] * flat - pose[:3, 3]) @ pose[:3, :3]


def head_disparity(
    head: StereoHead, points: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "..."]:
    """Disparity of points of the object.

    Parameters
    ----------
    head : StereoHead
    points : (..., 3) float [m]     object frame, in front of the reference camera

    Returns
    -------
    (...,) float [px]               parallax over depth
    """
    pose = head.rectified.cameras[0].T_camera_object
    return head.parallax / (points @ pose[2, :3] + pose[2, 3])


def _partners(rig: Rig) -> tuple[int, ...]:
    """Index of the other camera, or indices of the left and the top one."""
    others = [i for i in range(len(rig.cameras)) if i != rig.reference]
    if len(others) == 1:
        return tuple(others)
    reference = rig.cameras[rig.reference]
    right = reference.T_camera_object[0, :3]
    arm = {i: camera_centre(rig.cameras[i]) - camera_centre(reference) for i in others}
    unit = {i: arm[i] / max(float(np.linalg.norm(arm[i])), 1e-300) for i in others}
    pairs = list(permutations(others, 2))
    # The pair nearest to a right angle, in the order whose first arm lies along the rows.
    bent = [float(np.linalg.norm(np.cross(unit[i], unit[j]))) for i, j in pairs]
    along = [abs(float(unit[i] @ right)) - abs(float(unit[j] @ right)) for i, j in pairs]
    best = max(range(len(pairs)), key=lambda k: (round(bent[k], 9), along[k]))
    return pairs[best]
