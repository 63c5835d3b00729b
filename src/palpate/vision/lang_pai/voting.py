"""Optical flow in whole pixels with a vote of all cameras, after Lang and Pai.

In every camera, the window around a tracked pixel is correlated with the windows around all pixels
of the search range; the disparity gives the position of a reference pixel in the other cameras. The
candidate with the highest sum of correlations wins. It is accepted only if each camera's own
maximum is that pixel or one of its eight neighbours. There is no sub-pixel step: the flow is a
whole number of reference pixels.

A window between two pixels is the linear interpolation of the windows at both. Mean, products and
sums are linear in it, so correlating interpolated windows gives the same value as interpolating the
correlations at whole pixels (equation 6 of the source), and is cheaper when one window is compared
with many others.

The printed equation has two errors. Its second line weights (1 - p) q with the pixel b at column
c_b; it must be c_b + 1 (and subscripts such as c_{a+1} mean c_a + 1). Its last line takes the
square root of the squared correlation, which would let a negative of the picture match; here the
correlation keeps its sign.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int
from numba import njit

from palpate.shapes import PointIndices, PointScalars
from palpate.threads import in_threads
from palpate.vision.lang_pai.disparity import Instant, Views
from palpate.vision.range_flow import Outcome

# Fast-math flags that preserve NaN, which marks pixels without data.
_FAST = {"contract", "reassoc", "arcp", "nsz"}
# A mean correlation below this is no match. The source has no such limit; zero rejects only
# negative correlations.
_MIN_SCORE = 0.0
# Outcomes as plain integers, for the kernels. The first three also describe a window: good, without
# contrast, or reaching beyond known pixels.
VALID = int(Outcome.VALID)
_TEXTURE = int(Outcome.TEXTURE)
_OUTSIDE = int(Outcome.OUTSIDE)
_HIDDEN = int(Outcome.HIDDEN)
_LOST = int(Outcome.LOST)
_SCORE = int(Outcome.SCORE)
_REPROJECTION = int(Outcome.REPROJECTION)


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """Result of the vote for each tracked pixel.

    Attributes
    ----------
    pixel : (n, 2) int [px]         column and row of the winner, accepted or not; without
                                    candidates, the tracked pixel itself
    score : (n,) float [-]          lowest correlation over the cameras at that pixel
    distance : (n,) float [px]      rms distance of the cameras' own maxima from it
    agreed : (n,) int               cameras whose own maximum is it or one of its eight neighbours
    outcome : (n,) int              an `Outcome`: VALID; HIDDEN: no disparity before; TEXTURE;
                                    OUTSIDE: windows reach beyond the pictures; LOST: no candidate
                                    has a disparity; SCORE; REPROJECTION: the vote was lost
    """

    pixel: Int[np.ndarray, "n 2"]
    score: PointScalars
    distance: PointScalars
    agreed: PointIndices
    outcome: PointIndices


def vote(
    before: Instant,
    after: Instant,
    views: Views,
    pixel: Int[np.ndarray, "n 2"],
    *,
    subset: int,
    search: int,
) -> Vote:
    """Track pixels of the reference camera to the next instant.

    Parameters
    ----------
    before, after : Instant         of the same rectified cameras
    views : Views
    pixel : (n, 2) int [px]         column and row in the reference picture `before`; HIDDEN where
                                    it has no disparity
    subset : int [px]               side of the windows, odd
    search : int [px]               side of the square of candidates around a pixel, odd

    Returns
    -------
    Vote

    Source
    ------
    Lang and Pai (2001), section 4. Candidates are the pixels that have a disparity in `after`; only
    the reference's own maximum, which needs no disparity, is taken over all pixels.
    """
    n = len(pixel)
    votes = Vote(
        np.array(pixel, dtype=np.int64, order="C"),
        np.full(n, np.nan),
        np.full(n, np.nan),
        np.zeros(n, dtype=np.int64),
        np.empty(n, dtype=np.int64),
    )
    geometry, half = (views.along, views.ratio, views.offset), subset // 2
    scale = np.full(after.pictures.shape, np.nan)
    in_threads(
        _fill_scales, len(after.disparity), after.pictures, after.disparity, *geometry, half, scale
    )
    in_threads(
        _vote_range, n, before.pictures, after.pictures, before.disparity, after.disparity, scale,
        *geometry, half, search // 2,
        votes.pixel, votes.score, votes.distance, votes.agreed, votes.outcome,
    )  # fmt: skip
    return votes


@njit(cache=True, nogil=True, fastmath=_FAST, error_model="numpy")
def _vote_range(
    begin, end, before, after, near, far, scale, along, ratio, offset, half, reach, votes, score,
    distance, agreed, outcome,
):  # fmt: skip
    """Vote for the pixels from `begin` to `end`; `near` and `far`: disparities before and after;
    `scale`: of the windows after (`_fill_scales`)."""
    cameras, side = len(before), 2 * reach + 1
    window = np.empty((cameras, (2 * half + 1) ** 2))
    table = np.empty((cameras, side, side))
    for i in range(begin, end):
        column, row = votes[i]
        outcome[i] = _start_windows(
            before, near[row, column], along, ratio, offset, column, row, half, window
        )
        if outcome[i] != VALID:
            continue
        outcome[i] = _fill_table(
            after, far, scale, along, ratio, offset, column, row, half, reach, window, table
        )
        if outcome[i] != VALID:
            continue
        y, x = _highest(table.sum(axis=0))
        total = 0.0
        lowest = np.inf
        square = 0.0
        for c in range(cameras):
            value = table[c, y, x]
            total += value
            lowest = min(lowest, value)
            i_own, j_own = _highest(table[c])
            square += (i_own - y) ** 2 + (j_own - x) ** 2
            agreed[i] += abs(i_own - y) <= 1 and abs(j_own - x) <= 1
        if total == -np.inf:
            outcome[i] = _OUTSIDE
            agreed[i] = 0
            continue
        votes[i, 0] = column + x - reach
        votes[i, 1] = row + y - reach
        score[i] = lowest
        distance[i] = np.sqrt(square / cameras)
        if total / cameras < _MIN_SCORE:
            outcome[i] = _SCORE
        elif agreed[i] < cameras:
            outcome[i] = _REPROJECTION


@njit(cache=True, error_model="numpy")
def _highest(values):
    """Row and column of the highest value; of equal values, the first."""
    return divmod(values.argmax(), values.shape[1])


@njit(cache=True, error_model="numpy")
def _start_windows(pictures, disparity, along, ratio, offset, column, row, half, window):
    """Fill `window` with every camera's window around a tracked pixel; returns an outcome."""
    if np.isnan(disparity):
        return _HIDDEN
    for c in range(len(pictures)):
        shift = offset[c] + ratio[c] * disparity
        state = window_kernel(pictures[c], column, row, shift, along[c], half, window[c])
        if state != VALID:
            return state
    return VALID


@njit(cache=True, nogil=True, error_model="numpy")
def _fill_scales(begin, end, pictures, disparity, along, ratio, offset, half, scale):
    """Fill in what takes the windows of some rows of pixels, in all cameras, to a norm of one; it
    stays NaN where there is no window."""
    window = np.empty((2 * half + 1) ** 2)
    for i in range(begin, end):
        for j in range(disparity.shape[1]):
            for c in range(len(pictures)):
                # The reference is not shifted, and its disparity may be NaN.
                shift = offset[c] + ratio[c] * disparity[i, j] if c > 0 else 0.0
                if not np.isnan(shift) and _interpolate(
                    pictures[c], j, i, shift, along[c], half, window
                ):
                    scale[c, i, j] = _normalise(window)


@njit(cache=True, error_model="numpy")
def _fill_table(
    pictures, disparity, scale, along, ratio, offset, column, row, half, reach, window, table
):  # fmt: skip
    """Fill `table` with every camera's correlation at every candidate, -inf where undefined.

    Returns LOST if no candidate has a disparity, otherwise VALID.
    """
    rows, columns = disparity.shape
    outcome = _LOST
    table[:] = -np.inf
    for y in range(2 * reach + 1):
        i = row + y - reach
        for x in range(2 * reach + 1):
            j = column + x - reach
            if not (0 <= i < rows and 0 <= j < columns):
                continue
            known = not np.isnan(disparity[i, j])
            outcome = VALID if known else outcome
            for c in range(len(pictures) if known else 1):
                if not np.isnan(scale[c, i, j]):
                    shift = offset[c] + ratio[c] * disparity[i, j] if c > 0 else 0.0
                    product = _shifted_dot(pictures[c], j, i, shift, along[c], half, window[c])
                    table[c, y, x] = scale[c, i, j] * product
    return outcome


@njit(cache=True, error_model="numpy")
def window_kernel(grey, column, row, shift, along, half, window):
    """Fill `window` with zero mean and unit norm; returns `VALID`, `_OUTSIDE` or `_TEXTURE`.

    `grey` is (rows, columns) [grey levels], `window` ((2 half + 1)^2,), row by row.

    Its centre is `shift` pixels from (column, row), along columns (`along` = 0) or rows (1). The
    inner product of two such windows is equation 6 of the source.
    """
    if not _interpolate(grey, column, row, shift, along, half, window):
        return _OUTSIDE
    return _TEXTURE if np.isnan(_normalise(window)) else VALID


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _interpolate(grey, column, row, shift, along, half, window):
    """Fill `window` with a window between pixels; False where it reaches beyond known ones."""
    whole = int(np.floor(shift))
    fraction = shift - whole
    right = 1 - along
    column += whole * right
    row += whole * along
    reach = half + 1 if fraction > 0.0 else half
    if column < half or column + half + (reach - half) * right >= grey.shape[1]:
        return False
    if row < half or row + half + (reach - half) * along >= grey.shape[0]:
        return False
    side = 2 * half + 1
    total = 0.0
    rest = 1.0 - fraction
    for k in range(side):
        i = row - half + k
        for m in range(side):
            j = column - half + m
            value = np.float64(grey[i, j])
            if fraction > 0.0:
                value = rest * value + fraction * grey[i + along, j + right]
            window[k * side + m] = value
            total += value
    return not np.isnan(total)


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _normalise(window):
    """Take the mean away and make the norm one; returns the factor, NaN without contrast."""
    mean = window.sum() / len(window)
    square = 0.0
    for k in range(len(window)):
        window[k] -= mean
        square += window[k] * window[k]
    # A window without contrast leaves less than this by rounding.
    if square < 1e-20 * (1.0 + mean * mean) * len(window):
        return np.nan
    scale = 1.0 / np.sqrt(square)
    for k in range(len(window)):
        window[k] *= scale
    return scale


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def _shifted_dot(grey, column, row, shift, along, half, window):
    """Inner product of a window of zero mean with one between known pixels."""
    whole = int(np.floor(shift))
    fraction = shift - whole
    top = row + whole * along - half
    left = column + whole * (1 - along) - half
    here = _dot(grey, top, left, half, window)
    if fraction == 0.0:
        return here
    beyond = _dot(grey, top + along, left + 1 - along, half, window)
    return (1.0 - fraction) * here + fraction * beyond


@njit(cache=True, fastmath=_FAST, error_model="numpy", inline="always")
def _dot(grey, top, left, half, window):
    """Inner product of a window with the pixels from (top, left) on."""
    side = 2 * half + 1
    total = 0.0
    for k in range(side):
        for m in range(side):
            total += window[k * side + m] * grey[top + k, left + m]
    return total
