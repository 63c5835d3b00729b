"""Optical flow by whole pixels, on which all cameras must agree: the vote of Lang and Pai.

The window around a tracked pixel is correlated, in every camera, with the windows around all pixels
of the search range; disparity says where a pixel of the reference lies in the other cameras. The
highest sum of correlations wins, and stands only if each camera's own highest is that pixel or one
of the eight around it. The flow is a whole number of pixels of the reference: nothing finer is
sought.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from palpate.errors import InputError
from palpate.shapes import PointIndices, PointScalars
from palpate.vision.lang_pai.correlation import ALIKE, KNOWN, dot_kernel, window_kernel
from palpate.vision.lang_pai.disparity import Views
from palpate.vision.range_flow import Outcome

# NaN marks what no picture shows, so it must stay NaN.
_FAST = {"contract", "reassoc", "arcp", "nsz"}
# Outcomes as plain numbers, for the kernels.
_VALID = int(Outcome.VALID)
_HIDDEN = int(Outcome.HIDDEN)
_TEXTURE = int(Outcome.TEXTURE)
_OUTSIDE = int(Outcome.OUTSIDE)
_LOST = int(Outcome.LOST)
_SCORE = int(Outcome.SCORE)
_REPROJECTION = int(Outcome.REPROJECTION)


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """Rectified pictures of one instant, and the disparity of the reference's pixels.

    Attributes
    ----------
    pictures : (c, rows, columns) float32 [grey levels]     the reference first; NaN: nothing known
    disparity : (rows, columns) float [px]                  NaN where there is none
    """

    pictures: Float[np.ndarray, "c rows columns"]
    disparity: Float[np.ndarray, "rows columns"]


@dataclass(frozen=True, slots=True)
class VoteSettings:
    """Windows of the optical flow.

    Parameters
    ----------
    window : int [px]               side, odd
    search : int [px]               side of the square of candidates around a pixel, odd
    least_score : float [-]         a mean correlation below this is no match; the source has no
                                    such limit, 0 refuses only what looks like a negative

    Raises
    ------
    InputError                      even or tiny sizes
    """

    window: int = 7
    search: int = 13
    least_score: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("window", self.window), ("search range", self.search)):
            if value < 3 or value % 2 == 0:
                raise InputError(f"{name} is {value}; must be an odd number of pixels, 3 or more")


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """What became of tracked pixels.

    Attributes
    ----------
    pixel : (n, 2) int [px]         column and row that won, accepted or not; where there were no
                                    candidates, the pixel that was looked for
    score : (n,) float [-]          lowest correlation over the cameras at that pixel
    apart : (n,) float [px]         rms distance of the cameras' own maxima from it
    agreed : (n,) int               cameras whose own maximum is it or one of the eight around it
    outcome : (n,) int              an `Outcome`: VALID; HIDDEN: no disparity before; TEXTURE;
                                    OUTSIDE: windows reach beyond the pictures; LOST: no candidate
                                    has a disparity; SCORE; REPROJECTION: the vote was lost
    """

    pixel: Int[np.ndarray, "n 2"]
    score: PointScalars
    apart: PointScalars
    agreed: PointIndices
    outcome: PointIndices


def vote(
    before: Instant,
    after: Instant,
    views: Views,
    pixel: Int[np.ndarray, "n 2"],
    *,
    settings: VoteSettings = VoteSettings(),
) -> Vote:
    """Find pixels of the reference camera at the next instant.

    Parameters
    ----------
    before, after : Instant         of the same rectified cameras
    views : Views
    pixel : (n, 2) int [px]         column and row in the reference before, where the disparity is
                                    known
    settings : VoteSettings

    Returns
    -------
    Vote

    Source
    ------
    Lang and Pai (2001), section 4. Candidates are the pixels that have a disparity afterwards; only
    the reference's own maximum is sought among all pixels, for it needs none.
    """
    found, score, apart, agreed, outcome = _vote(
        before.pictures,
        after.pictures,
        before.disparity,
        after.disparity,
        views.along,
        views.ratio,
        views.offset,
        np.ascontiguousarray(pixel, dtype=np.int64),
        settings.window // 2,
        settings.search // 2,
        settings.least_score,
    )
    return Vote(found, score, apart, agreed, outcome)


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def _vote(before, after, near, far, along, ratio, offset, pixel, half, reach, least_score):
    """Vote for every pixel; `near` and `far` are the disparities before and after."""
    n = len(pixel)
    cameras = len(before)
    found = pixel.copy()
    score = np.full(n, np.nan)
    apart = np.full(n, np.nan)
    agreed = np.zeros(n, dtype=np.int64)
    outcome = np.empty(n, dtype=np.int64)
    for i in prange(n):
        column, row = pixel[i]
        window = np.empty((cameras, (2 * half + 1) ** 2))
        outcome[i] = _start_windows(
            before, near[row, column], along, ratio, offset, column, row, half, window
        )
        if outcome[i] != _VALID:
            continue
        table = np.full((cameras, 2 * reach + 1, 2 * reach + 1), np.nan)
        outcome[i] = _fill_table(
            after, far, along, ratio, offset, column, row, half, reach, window, table
        )
        if outcome[i] != _VALID:
            continue
        y, x = _highest_sum(table)
        if y < 0:
            outcome[i] = _OUTSIDE
            continue
        found[i, 0] = column + x - reach
        found[i, 1] = row + y - reach
        score[i], mean = _lowest_and_mean(table, y, x)
        agreed[i], apart[i] = _agreement(table, y, x)
        if mean < least_score:
            outcome[i] = _SCORE
        elif agreed[i] < cameras:
            outcome[i] = _REPROJECTION
    return found, score, apart, agreed, outcome


@njit(cache=True, error_model="numpy", inline="always")
def _shifted_window(grey, column, row, shift, along, half, window):
    """`window_kernel` at a pixel moved by a shift along an axis."""
    whole = int(np.floor(shift))
    return window_kernel(
        grey,
        column + whole * (1 - along),
        row + whole * along,
        shift - whole,
        along,
        half,
        window,
    )


@njit(cache=True, error_model="numpy")
def _start_windows(pictures, disparity, along, ratio, offset, column, row, half, window):
    """Write every camera's window around a tracked pixel; an outcome."""
    if np.isnan(disparity):
        return _HIDDEN
    for c in range(len(pictures)):
        shift = offset[c] + ratio[c] * disparity
        state = _shifted_window(pictures[c], column, row, shift, along[c], half, window[c])
        if state != KNOWN:
            return _TEXTURE if state == ALIKE else _OUTSIDE
    return _VALID


@njit(cache=True, error_model="numpy")
def _fill_table(pictures, disparity, along, ratio, offset, column, row, half, reach, window, table):
    """Write every camera's correlation at every candidate; LOST where none has a disparity."""
    rows, columns = disparity.shape
    other = np.empty(window.shape[1])
    outcome = _LOST
    for y in range(2 * reach + 1):
        i = row + y - reach
        for x in range(2 * reach + 1):
            j = column + x - reach
            if not (0 <= i < rows and 0 <= j < columns):
                continue
            known = not np.isnan(disparity[i, j])
            outcome = _VALID if known else outcome
            for c in range(len(pictures) if known else 1):
                # The reference has no shift, whatever the disparity.
                shift = offset[c] + ratio[c] * disparity[i, j] if c > 0 else 0.0
                if _shifted_window(pictures[c], j, i, shift, along[c], half, other) == KNOWN:
                    table[c, y, x] = dot_kernel(window[c], other)
    return outcome


@njit(cache=True, error_model="numpy")
def _highest_sum(table):
    """Row and column of the highest sum over all cameras; -1, -1 where there is none."""
    best = -np.inf
    top, left = -1, -1
    for y in range(table.shape[1]):
        for x in range(table.shape[2]):
            total = 0.0
            for c in range(len(table)):
                total += table[c, y, x]
            if total > best:
                best = total
                top, left = y, x
    return top, left


@njit(cache=True, error_model="numpy")
def _lowest_and_mean(table, y, x):
    """Lowest and mean correlation over the cameras at a candidate."""
    lowest = np.inf
    total = 0.0
    for c in range(len(table)):
        lowest = min(lowest, table[c, y, x])
        total += table[c, y, x]
    return lowest, total / len(table)


@njit(cache=True, error_model="numpy")
def _agreement(table, y, x):
    """How many cameras have their own maximum at or beside a candidate; rms distance of all."""
    agreed = 0
    square = 0.0
    for c in range(len(table)):
        best = -np.inf
        down, right = 0, 0
        for i in range(table.shape[1]):
            for j in range(table.shape[2]):
                if table[c, i, j] > best:
                    best = table[c, i, j]
                    down, right = i - y, j - x
        square += down * down + right * right
        if abs(down) <= 1 and abs(right) <= 1:
            agreed += 1
    return agreed, np.sqrt(square / len(table))
