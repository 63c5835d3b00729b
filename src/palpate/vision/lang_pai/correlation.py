"""Normalised cross-correlation of windows between whole pixels: equation 6 of Lang and Pai.

A window between two pixels is the linear mixture of the windows at both. Mean, products and sums
are linear in it, so correlating mixed windows gives the same number as the paper's mixture of the
correlations at whole pixels, and costs less where one window meets many others.

Two places of the printed equation cannot be meant. Its second line weights (1 - p) q with the pixel
b at column c_b; it must be c_b + 1 (and subscripts such as c_{a+1} mean c_a + 1). Its last line
takes the square root of the squared correlation, which would let a negative print match its
positive; here the correlation keeps its sign.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange

from palpate.errors import InputError

# Along which axis of the picture a place may lie between whole pixels.
COLUMNS = 0
ROWS = 1
# What `window_kernel` found: a window, one that reaches beyond what is known, one without contrast.
KNOWN = 0
OFF = 1
ALIKE = 2

# NaN marks what no picture shows, so it must stay NaN.
_FAST = {"contract", "reassoc", "arcp", "nsz"}


def correlation(
    first: Float[np.ndarray, "rows columns"],
    second: Float[np.ndarray, "rows columns"],
    pixel: Int[np.ndarray, "n 2"],
    fraction: Float[np.ndarray, " n"],
    other: Int[np.ndarray, "n 2"],
    other_fraction: Float[np.ndarray, " n"],
    *,
    window: int,
    along: int = COLUMNS,
) -> Float[np.ndarray, " n"]:
    """Normalised cross-correlation of windows of two pictures around places between pixels.

    Parameters
    ----------
    first, second : (rows, columns) float [grey levels]     NaN where nothing is known
    pixel, other : (n, 2) int [px]          column and row of the centres; a and b in the source
    fraction, other_fraction : (n,) float [px]      how far the places lie beyond them, 0 to 1; p
                                            and q in the source
    window : int [px]                       side, odd; 2 n + 1 in the source
    along : COLUMNS or ROWS                 the direction of the fractions

    Returns
    -------
    (n,) float [-]                          -1 to 1; NaN where a window leaves its picture or has no
                                            contrast

    Raises
    ------
    InputError                              an even window, fractions outside 0 to 1

    Source
    ------
    Lang and Pai (2001), equation 6, with the corrections named at the top of this file.
    """
    if window < 3 or window % 2 == 0:
        raise InputError(f"window is {window}; must be an odd number of pixels, 3 or more")
    for shares in (fraction, other_fraction):
        if len(shares) and not (shares.min() >= 0.0 and shares.max() <= 1.0):
            raise InputError(
                f"fractions reach from {shares.min():g} to {shares.max():g}; must be within 0 to 1:"
                " put whole pixels into the pixel"
            )
    return _correlations(
        np.ascontiguousarray(first, dtype=np.float64),
        np.ascontiguousarray(second, dtype=np.float64),
        np.ascontiguousarray(pixel, dtype=np.int64),
        np.ascontiguousarray(fraction),
        np.ascontiguousarray(other, dtype=np.int64),
        np.ascontiguousarray(other_fraction),
        window // 2,
        along,
    )


@njit(cache=True, parallel=True, fastmath=_FAST, error_model="numpy")
def _correlations(first, second, pixel, fraction, other, other_fraction, half, along):
    score = np.empty(len(pixel))
    for i in prange(len(pixel)):
        a = np.empty((2 * half + 1) ** 2)
        b = np.empty_like(a)
        one = window_kernel(first, pixel[i, 0], pixel[i, 1], fraction[i], along, half, a)
        two = window_kernel(second, other[i, 0], other[i, 1], other_fraction[i], along, half, b)
        score[i] = dot_kernel(a, b) if one == KNOWN and two == KNOWN else np.nan
    return score


@njit(cache=True, fastmath=_FAST, error_model="numpy")
def window_kernel(grey, column, row, fraction, along, half, window):
    """Write a window without its mean, scaled to length 1; `KNOWN`, `OFF` or `ALIKE`.

    The place is `fraction` of a pixel beyond (column, row), along columns (0) or rows (1).
    """
    right = 1 - along
    reach = half + 1 if fraction > 0.0 else half
    if column < half or column + half + (reach - half) * right >= grey.shape[1]:
        return OFF
    if row < half or row + half + (reach - half) * along >= grey.shape[0]:
        return OFF
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
    mean = total / (side * side)
    square = 0.0
    for k in range(side * side):
        window[k] -= mean
        square += window[k] * window[k]
    if np.isnan(square):
        return OFF
    # Rounding leaves less than this of a window that is all alike.
    if square < 1e-20 * (1.0 + mean * mean) * side * side:
        return ALIKE
    scale = 1.0 / np.sqrt(square)
    for k in range(side * side):
        window[k] *= scale
    return KNOWN


@njit(cache=True, fastmath=_FAST, error_model="numpy", inline="always")
def dot_kernel(a, b):
    """Sum of products."""
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
