"""Disparity of every pixel of a rectified reference picture, by area matching in all cameras.

For each trial disparity, the windows of all other cameras are correlated with the reference's and
the correlations added; the best sum is refined by a parabola. A pixel without texture, without an
inner maximum, with a second maximum nearly as high, or whose partner in another camera belongs to a
better match of another pixel has no disparity.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from palpate.errors import InputError
from palpate.vision.lang_pai.correlation import ROWS

# NaN marks what no picture shows, so it must stay NaN.
_FAST = {"contract", "reassoc", "arcp", "nsz"}
# Rows that are matched together: a band and its trial disparities stay in the processor's cache.
_BAND = 16
# Trial disparities beside the best one that belong to the same maximum: texture is matched within
# about its own size, and a parabola takes one on either side.
_SAME = 2
# Sum of squares of a window that is all alike, with rounding [grey levels^2]: greys to 1e3 in
# double precision leave 1e-8, contrast of a hundredth of a grey level 5e-3.
_ALIKE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """How disparity moves a pixel of the rectified reference into the other cameras.

    A pixel lies in camera i at offset + ratio * disparity beyond its place in the reference, along
    columns or rows; row 0 of the arrays is the reference itself, with no shift.

    Attributes
    ----------
    along : (c,) int                `COLUMNS` or `ROWS`
    ratio : (c,) float [-]          shift for one pixel of disparity, 1 or -1 for the longest
                                    baseline
    offset : (c,) float [px]        shift at no disparity
    """

    along: Int[np.ndarray, " c"]
    ratio: Float[np.ndarray, " c"]
    offset: Float[np.ndarray, " c"]


@dataclass(frozen=True, slots=True)
class DisparitySettings:
    """How windows are matched between the cameras.

    Parameters
    ----------
    window : int [px]               side, odd
    contrast : float [grey levels]  least standard deviation in a window; the noise of an 8-bit
                                    camera is 1 to 2, and below it noise is matched with noise
    uniqueness : float [-]          a second maximum higher than this share of the best one leaves
                                    the match in doubt

    Raises
    ------
    InputError                      an even or tiny window
    """

    window: int = 7
    contrast: float = 2.0
    uniqueness: float = 0.95

    def __post_init__(self) -> None:
        if self.window < 3 or self.window % 2 == 0:
            raise InputError(
                f"stereo window is {self.window}; must be an odd number of pixels, 3 or more"
            )


def disparity_map(
    pictures: Sequence[Float[np.ndarray, "rows columns"]],
    views: Views,
    limits: tuple[float, float],
    *,
    settings: DisparitySettings = DisparitySettings(),
) -> Float[np.ndarray, "rows columns"]:
    """Match every pixel of the reference in all other cameras.

    Parameters
    ----------
    pictures : sequence of c (rows, columns) float [grey levels]    rectified, the reference first;
                                    NaN where a camera sees nothing
    views : Views                   of the c cameras
    limits : (least, greatest) [px] disparities to try
    settings : DisparitySettings

    Returns
    -------
    (rows, columns) float [px]      to a fraction of a pixel; NaN where there is no valid match

    Raises
    ------
    InputError                      as many pictures as views, and some disparities, are needed
    """
    if len(pictures) != len(views.along) or len(pictures) < 2:
        raise InputError(
            f"{len(pictures)} pictures for {len(views.along)} views; must be as many, two or more"
        )
    if not limits[1] > limits[0]:
        raise InputError(f"disparities from {limits[0]:g} to {limits[1]:g}; must be rising")
    trials = _trials(views, limits)
    stack = np.stack([np.asarray(picture, dtype=np.float64) for picture in pictures])
    # Sums of squares are exact to more digits around zero.
    stack -= np.nanmean(stack)
    disparity, score = _matched(
        stack,
        views.along,
        views.ratio,
        views.offset,
        trials,
        settings.window // 2,
        settings.contrast**2,
        settings.uniqueness,
    )
    kept = np.isfinite(disparity)
    for i in range(1, len(pictures)):
        shift = views.offset[i] + views.ratio[i] * disparity
        kept &= _is_mutual(disparity, score, shift, int(views.along[i]), abs(views.ratio[i]))
    return np.where(kept, disparity, np.nan)


def _trials(views: Views, limits: tuple[float, float]) -> Float[np.ndarray, " t"]:
    """Disparities one pixel apart, whole pixels in the camera of the longest baseline."""
    longest = int(np.argmax(np.abs(views.ratio)))
    beyond = views.offset[longest] * np.sign(views.ratio[longest])
    low, high = np.floor(limits[0] + beyond), np.ceil(limits[1] + beyond)
    # One more at either end: a maximum there must not be cut off.
    return np.arange(low - 1.0, high + 1.5) - beyond


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def _matched(pictures, along, ratio, offset, trials, half, least_square, uniqueness):
    """Disparity and sum of correlations of every pixel, NaN without a maximum that is alone."""
    rows, columns = pictures.shape[1:]
    disparity = np.full((rows, columns), np.nan)
    best = np.full((rows, columns), np.nan)
    for band in prange((rows + _BAND - 1) // _BAND):
        top = band * _BAND
        height = min(_BAND, rows - top)
        mean, inverse = _statistics(pictures[0], top, height, half, least_square)
        score = np.zeros((len(trials), height, columns))
        other = np.empty((height + 2 * half, columns))
        for t in range(len(trials)):
            for i in range(1, len(pictures)):
                shift = offset[i] + ratio[i] * trials[t]
                _shifted(pictures[i], top - half, shift, along[i], other)
                _add_correlation(pictures[0], top, other, mean, inverse, half, score[t])
        for y in range(height):
            for x in range(columns):
                t = _lone_maximum(score[:, y, x], uniqueness)
                if t > 0:
                    before, peak, after = score[t - 1, y, x], score[t, y, x], score[t + 1, y, x]
                    vertex = 0.5 * (before - after) / (before - 2.0 * peak + after)
                    disparity[top + y, x] = trials[t] + vertex
                    best[top + y, x] = peak
    return disparity, best


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _statistics(grey, top, height, half, least_square):
    """Mean and inverse norm of the windows of a band; NaN without texture or outside."""
    rows, columns = grey.shape
    mean = np.full((height, columns), np.nan)
    inverse = np.full((height, columns), np.nan)
    many = (2 * half + 1) ** 2
    for y in range(height):
        if top + y < half or top + y + half >= rows:
            continue
        for x in range(half, columns - half):
            total = 0.0
            square = 0.0
            for k in range(-half, half + 1):
                for m in range(-half, half + 1):
                    value = grey[top + y + k, x + m]
                    total += value
                    square += value * value
            square -= total * total / many
            if square > least_square * many:
                mean[y, x] = total / many
                inverse[y, x] = 1.0 / np.sqrt(square)
    return mean, inverse


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _shifted(grey, top, shift, along, result):
    """Grey levels at a shift from every pixel, linear between pixels, NaN beyond the picture."""
    rows, columns = grey.shape
    whole = int(np.floor(shift))
    part = shift - whole
    rest = 1.0 - part
    right = 0 if along == ROWS else whole
    down = whole if along == ROWS else 0
    next_x = 0 if along == ROWS or part == 0.0 else 1
    next_y = 1 if along == ROWS and part > 0.0 else 0
    result[:] = np.nan
    for k in range(len(result)):
        i = top + k + down
        if i < 0 or i + next_y >= rows:
            continue
        for x in range(max(0, -right), min(columns, columns - right - next_x)):
            j = x + right
            result[k, x] = rest * grey[i, j] + part * grey[i + next_y, j + next_x]


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _add_correlation(grey, top, other, mean, inverse, half, score):
    """Add the correlation of every window of a band with the other camera's to its score."""
    height, columns = score.shape
    rows = len(grey)
    side = 2 * half + 1
    many = side * side
    sums = np.zeros((3, columns))
    for y in range(height):
        sums[:] = 0.0
        if top + y < half or top + y + half >= rows:
            score[y] = np.nan
            continue
        for k in range(side):
            i = top + y + k - half
            for x in range(columns):
                value = other[y + k, x]
                sums[0, x] += value
                sums[1, x] += value * value
                sums[2, x] += value * grey[i, x]
        score[y, :half] = np.nan
        score[y, columns - half :] = np.nan
        for x in range(half, columns - half):
            total = 0.0
            square = 0.0
            product = 0.0
            for m in range(-half, half + 1):
                total += sums[0, x + m]
                square += sums[1, x + m]
                product += sums[2, x + m]
            spread = square - total * total / many
            if spread < _ALIKE:
                score[y, x] = np.nan
            score[y, x] += (product - mean[y, x] * total) * inverse[y, x] / np.sqrt(spread)


@njit(cache=True, error_model="numpy", inline="always")
def _lone_maximum(score, uniqueness):
    """Index of the highest inner maximum, or -1 where there is none or another comes close."""
    top = -1
    for t in range(1, len(score) - 1):
        # Comparisons with NaN are false.
        inner = score[t] > score[t - 1] and score[t] >= score[t + 1] and score[t] > 0.0
        if inner and (top < 0 or score[t] > score[top]):
            top = t
    if top < 0:
        return -1
    for t in range(len(score)):
        if score[t] > score[top] and (t == 0 or t == len(score) - 1):
            return -1
        if abs(t - top) > _SAME and score[t] > uniqueness * score[top]:
            return -1
    return top


@njit(cache=True, error_model="numpy")
def _is_mutual(disparity, score, shift, along, ratio):
    """True where no better match of another disparity claims the same pixel of the other camera."""
    rows, columns = disparity.shape
    owner = np.full((rows, columns), np.nan)
    held = np.full((rows, columns), -np.inf)
    mutual = np.zeros((rows, columns), dtype=np.bool_)
    for claim in (True, False):
        for y in range(rows):
            for x in range(columns):
                if not np.isfinite(shift[y, x]):
                    continue
                away = int(np.floor(shift[y, x] + 0.5))
                i = y + away * along
                j = x + away * (1 - along)
                if not (0 <= i < rows and 0 <= j < columns):
                    continue
                if not claim:
                    mutual[y, x] = abs(owner[i, j] - disparity[y, x]) * ratio <= 1.0
                elif score[y, x] > held[i, j]:
                    held[i, j] = score[y, x]
                    owner[i, j] = disparity[y, x]
    return mutual
