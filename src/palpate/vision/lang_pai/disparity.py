"""Disparity of every pixel of a rectified reference picture, by area matching in all cameras.

For each trial disparity, the windows of all other cameras are correlated with the reference's and
the correlations summed; the maximum of the sum is refined by a parabola. A pixel gets no disparity
if it has no texture, no interior maximum, or a second maximum nearly as high, or if its partner in
another camera belongs to a better match of another pixel.

This replaces the commercial stereo library of the source, which is not described there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.threads import in_threads

# Axis of the picture along which a camera's disparity lies.
COLUMNS = 0
ROWS = 1
# Side of the window [px].
WINDOW = 7
# Smallest standard deviation in a window [grey levels]: the noise of an 8-bit camera is 1 to 2;
# below that, noise would be matched with noise.
MIN_CONTRAST = 2.0
# A match is ambiguous if a second maximum exceeds this fraction of the best one.
_MAX_RIVAL = 0.95
# Trial disparities on either side of the best that belong to the same maximum: its width is about
# the size of the texture, and the parabola uses one on each side.
_SAME_MAXIMUM = 2
# Rows matched together: a band and its trial disparities stay in the processor's cache.
_BAND = 32
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

    Raises
    ------
    InputError                      fewer than two pictures, their number differs from that of the
                                    views, or `limits` is not increasing
    """
    if len(pictures) != len(views.along) or len(pictures) < 2:
        raise InputError(
            f"{len(pictures)} pictures for {len(views.along)} views; must be as many, two or more"
        )
    if not limits[1] > limits[0]:
        raise InputError(f"disparities from {limits[0]:g} to {limits[1]:g}; must be rising")
    stack = np.stack([np.asarray(picture, dtype=np.float64) for picture in pictures])
    # Centred at zero, sums of squares lose fewer digits.
    stack -= np.nanmean(stack)
    disparity, score = np.full((2, *stack.shape[1:]), np.nan)
    rows = stack.shape[1] - WINDOW + 1
    trials = _trials(views, limits)
    in_threads(_match_rows, rows, stack, views, trials, disparity, score, min_items=_BAND)
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
    # One extra at each end, so that a maximum there is interior.
    return np.arange(low - 1.0, high + 1.5) - beyond


def _match_rows(
    begin: int,
    end: int,
    pictures: Float[np.ndarray, "c rows columns"],
    views: Views,
    trials: Float[np.ndarray, " t"],
    disparity: Float[np.ndarray, "rows columns"],
    best: Float[np.ndarray, "rows columns"],
) -> None:
    """Fill in disparity and correlation sum for windows whose first row is in a range."""
    half = WINDOW // 2
    for top in range(begin, end, _BAND):
        rows = np.arange(top, min(top + _BAND, end) + 2 * half)
        score = _scores(pictures, views, trials, rows)
        y, x, t = _unambiguous_maxima(score)
        before, peak, after = (score[t + k, y, x] for k in (-1, 0, 1))
        place = (top + half + y, half + x)
        disparity[place] = trials[t] + 0.5 * (before - after) / (before - 2.0 * peak + after)
        best[place] = peak


def _scores(
    pictures: Float[np.ndarray, "c rows columns"],
    views: Views,
    trials: Float[np.ndarray, " t"],
    rows: Int[np.ndarray, " k"],
) -> Float[np.ndarray, "t h w"]:
    """Correlation with the reference's windows in some rows, summed over the other cameras."""
    pixel_count = WINDOW * WINDOW
    here = pictures[0][rows]
    mean = _window_sums(here) / pixel_count
    squares = _window_sums(here * here) - pixel_count * mean * mean
    norm = np.sqrt(np.where(squares > MIN_CONTRAST**2 * pixel_count, squares, np.nan))
    score = np.zeros((len(trials), *norm.shape))
    for t, trial in enumerate(trials):
        for i in range(1, len(pictures)):
            shift = views.offset[i] + views.ratio[i] * trial
            there = _shifted(pictures[i], rows, shift, int(views.along[i]))
            total = _window_sums(there)
            squares = _window_sums(there * there) - total * total / pixel_count
            squares[squares < _MIN_SQUARES] = np.nan
            score[t] += (_window_sums(here * there) - mean * total) / (norm * np.sqrt(squares))
    return score


def _window_sums(values: Float[np.ndarray, "k m"]) -> Float[np.ndarray, "h w"]:
    """Sums over all windows that lie within an array."""
    high, wide = len(values) - WINDOW + 1, values.shape[1] - WINDOW + 1
    down = reduce(np.add, (values[k : k + high] for k in range(WINDOW)))
    return reduce(np.add, (down[:, k : k + wide] for k in range(WINDOW)))


def _shifted(
    grey: Float[np.ndarray, "rows columns"], rows: Int[np.ndarray, " k"], shift: float, along: int
) -> Float[np.ndarray, "k columns"]:
    """Some rows shifted, with linear interpolation; NaN outside the picture."""
    whole = int(np.floor(shift))
    part = shift - whole
    near = _taken(grey, rows, whole, along)
    return (
        near if part == 0.0 else (1.0 - part) * near + part * _taken(grey, rows, whole + 1, along)
    )


def _taken(
    grey: Float[np.ndarray, "rows columns"], rows: Int[np.ndarray, " k"], shift: int, along: int
) -> Float[np.ndarray, "k columns"]:
    """Some rows shifted by a whole number of pixels; NaN outside the picture."""
    row = rows + shift * along
    column = np.arange(grey.shape[1]) + shift * (1 - along)
    down = (row >= 0) & (row < grey.shape[0])
    right = (column >= 0) & (column < grey.shape[1])
    result = np.full((len(row), len(column)), np.nan)
    result[np.ix_(down, right)] = grey[np.ix_(row[down], column[right])]
    return result


def _unambiguous_maxima(
    score: Float[np.ndarray, "t h w"],
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Row, column and trial index of each pixel's highest interior maximum, where unambiguous."""
    middle = score[1:-1]
    # Comparisons with NaN are false.
    interior = (middle > score[:-2]) & (middle >= score[2:]) & (middle > 0.0)
    height = np.where(interior, middle, -np.inf)
    top, best = height.argmax(axis=0) + 1, height.max(axis=0)
    separate = np.abs(np.arange(len(score))[:, None, None] - top) > _SAME_MAXIMUM
    doubt = (separate & (score > _MAX_RIVAL * best)).any(axis=0)
    doubt |= (score[0] > best) | (score[-1] > best)
    y, x = np.nonzero(np.isfinite(best) & ~doubt)
    return y, x, top[y, x]


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
