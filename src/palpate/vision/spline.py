"""Interpolation of pictures between pixels by quintic B-splines.

The spline passes through every grey level and has continuous fourth derivatives. What interpolation
adds to a picture are images of its spectrum beyond the band limit, which do not move with the
object. Weaker by the sixth power of the ratio of the frequencies, they make small motions 0.01 %
too long in pictures with a low-pass of 1 px; those of a cubic spline, by the fourth power, 0.2 %
(Schreier, Braasch and Sutton, Systematic errors in digital image correlation caused by intensity
interpolation, Optical Engineering 39(11), 2000; Unser, Splines: a perfect fit for signal and image
processing, IEEE Signal Processing Magazine 16(6), 1999).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.threads import map_in_threads

# Filters that take a spline's coefficients to its value and its derivative at the pixel centres.
_VALUE = np.array([1.0, 26.0, 66.0, 26.0, 1.0]) / 120.0
_SLOPE = np.array([-1.0, -10.0, 0.0, 10.0, 1.0]) / 24.0
# Coefficients that an interpolated position takes along each axis.
_TAPS = 6
# Distance beyond which the filter from values to coefficients has decayed below the rounding of
# single precision [px].
_REACH = 20
# Coefficients are mirrored this far beyond the picture [px], so that a window may touch its edge.
PADDING = 5
# q: fraction of the variance of white noise left by interpolation at t = 1/2, i.e. the sum over k
# of L(t - k)^2 with the cardinal quintic spline L. For other t, 1 - (1 - q)(4 t (1 - t))^2 is
# within 0.01 of it.
_FRACTION_HALF_WAY = 0.83647


def _inverse(value: Float[np.ndarray, " k"]) -> Float[np.ndarray, " n"]:
    """Filter that takes a spline's values at the pixel centres to its coefficients, given the one
    that goes back."""
    ring = np.zeros(8 * _REACH)
    ring[: len(value)] = value
    inverse = np.fft.irfft(1.0 / np.fft.rfft(np.roll(ring, -(len(value) // 2))))
    return np.asarray(np.roll(inverse, _REACH)[: 2 * _REACH + 1])


_COEFFICIENT = _inverse(_VALUE)


@dataclass(frozen=True, slots=True, eq=False)
class SplinePicture:
    """A grey picture prepared for matching.

    Attributes
    ----------
    grey : (rows, columns) float32              grey levels
    along_column, along_row : (rows, columns) float32
                                                derivatives of the spline with respect to column and
                                                row at the pixel centres [grey levels/px]
    coefficients : (rows + 10, columns + 10) float32  of the spline, mirrored beyond the edge
    """

    grey: Float[np.ndarray, "rows columns"]
    along_column: Float[np.ndarray, "rows columns"]
    along_row: Float[np.ndarray, "rows columns"]
    coefficients: Float[np.ndarray, "prows pcolumns"]


def make_spline_picture(
    grey: Float[np.ndarray, "rows columns"], *, smoothing: float = 0.0
) -> SplinePicture:
    """Spline coefficients and gradient of a picture.

    Parameters
    ----------
    grey : (rows, columns) float    grey levels, finite
    smoothing : float [px]          standard deviation of a Gaussian low-pass applied first. Without
                                    it, structure finer than the pixels is aliased to coarser
                                    structure that does not move with the object, and interpolation
                                    makes motions of a fraction of a pixel 0.1 to 0.2 % too large

    Returns
    -------
    SplinePicture
    """
    grey = np.ascontiguousarray(grey, dtype=np.float32)
    if smoothing > 0.0:
        grey = cv2.GaussianBlur(grey, (0, 0), smoothing, borderType=cv2.BORDER_REFLECT_101)
    # OpenCV's default border mirrors at the edge, as do the coefficients.
    coefficients = cv2.sepFilter2D(grey, -1, _COEFFICIENT, _COEFFICIENT)
    along_column = cv2.sepFilter2D(coefficients, -1, _SLOPE, _VALUE)
    along_row = cv2.sepFilter2D(coefficients, -1, _VALUE, _SLOPE)
    padded = cv2.copyMakeBorder(
        coefficients, PADDING, PADDING, PADDING, PADDING, cv2.BORDER_REFLECT_101
    )
    return SplinePicture(grey, along_column, along_row, padded)


def spline_pictures(
    pictures: Sequence[Float[np.ndarray, "_ _"]], smoothing: float
) -> tuple[SplinePicture, ...]:
    """Apply `make_spline_picture` to every camera's picture.

    Parameters
    ----------
    pictures : sequence of c (rows, columns) float [grey levels]    finite
    smoothing : float [px]          >= 0, as in `make_spline_picture`

    Returns
    -------
    tuple of c SplinePicture
    """
    return tuple(map_in_threads(partial(make_spline_picture, smoothing=smoothing), pictures))


def smoothing_gain(smoothing: float) -> float:
    """Factor by which the low-pass reduces the standard deviation of white noise.

    Parameters
    ----------
    smoothing : float [px]          as in `make_spline_picture`; 0: no low-pass

    Returns
    -------
    float [-]                       above 0, at most 1
    """
    return float((_low_pass(smoothing) ** 2).sum())


def slope_gain(smoothing: float) -> float:
    """Standard deviation of a derivative of the spline per standard deviation of white noise.

    Parameters
    ----------
    smoothing : float [px]          as in `make_spline_picture`; 0: no low-pass

    Returns
    -------
    float [1/px]                    of `SplinePicture.along_column` and of `along_row`, above 0
    """
    slope = np.convolve(np.convolve(_low_pass(smoothing), _COEFFICIENT), _SLOPE)
    return float(np.sqrt((slope**2).sum() * smoothing_gain(smoothing)))


def _low_pass(smoothing: float) -> Float[np.ndarray, " k"]:
    """Weights of the low-pass along one axis, which add up to one."""
    if smoothing <= 0.0:
        return np.ones(1)
    reach = int(np.ceil(4.0 * smoothing))
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / smoothing) ** 2)
    return np.asarray(weight / weight.sum())


def interpolate(
    picture: SplinePicture, pixels: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Grey level at any position; up to 3 px beyond the edge, of the mirrored picture.

    Parameters
    ----------
    picture : SplinePicture
    pixels : (n, 2) float [px]      column, row

    Returns
    -------
    (n,) float [grey levels]
    """
    grey = np.empty(len(pixels), dtype=np.float32)
    columns, rows = np.ascontiguousarray(pixels.T, dtype=np.float32)
    sample_kernel(picture.coefficients, columns, rows, grey)
    return grey.astype(np.float64)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _spline_weights_kernel(t):
    """B-spline weights of six coefficients in a row, at a fraction t beyond the third.

    Parameters
    ----------
    t : float32 [px]                0 to 1

    Returns
    -------
    tuple of six float32            they add up to one
    """
    unity, share = np.float32(1.0), np.float32(1.0 / 120.0)
    r = unity - t
    far_left, left = _outer_weights_kernel(r, share)
    far_right, right = _outer_weights_kernel(t, share)
    r2 = r * r
    even = np.float32(26.0) + np.float32(20.0) * r2 * (unity - r2)
    odd = np.float32(50.0) - np.float32(20.0) * r2 + np.float32(10.0) * (r2 * r2)
    near = (even + r * odd) * share
    return (
        far_left,
        left,
        near,
        unity - far_left - left - near - right - far_right,
        right,
        far_right,
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _outer_weights_kernel(s, share):
    """The spline from its end, at s and at 1 + s, with s from 0 to 1; `share` is 1 / 120."""
    unity, five = np.float32(1.0), np.float32(5.0)
    s2 = s * s
    rise = unity + five * (s + s2 * (np.float32(2.0) + np.float32(2.0) * s + s2 * (unity - s)))
    return s2 * s2 * s * share, rise * share


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_kernel(coefficients, columns, rows, sampled):
    """Grey levels of the spline at positions in the picture.

    Parameters
    ----------
    coefficients : (rows + 10, columns + 10) float32 [grey levels]    of a `SplinePicture`
    columns, rows : (n,) float32 [px]       clamped to the padded coefficients
    sampled : (n,) float32 [grey levels]    filled
    """
    # Shifted to be positive, so that truncation is floor.
    zero, lead = np.float32(0.0), np.float32(PADDING + 1 - _TAPS // 2)
    last_column = np.float32(coefficients.shape[1] - _TAPS)
    last_row = np.float32(coefficients.shape[0] - _TAPS)
    # The weights of all positions first: that loop is vectorised, the other one not.
    first = np.empty((2, len(sampled)), dtype=np.uint32)
    weight = np.empty((2 * _TAPS, len(sampled)), dtype=np.float32)
    for p in range(len(sampled)):
        x = min(max(columns[p] + lead, zero), last_column)
        y = min(max(rows[p] + lead, zero), last_row)
        ix, iy = np.int32(x), np.int32(y)
        first[0, p], first[1, p] = ix, iy
        a, b = (
            _spline_weights_kernel(x - np.float32(ix)),
            _spline_weights_kernel(y - np.float32(iy)),
        )
        weight[0, p], weight[1, p], weight[2, p] = a[0], a[1], a[2]
        weight[3, p], weight[4, p], weight[5, p] = a[3], a[4], a[5]
        weight[6, p], weight[7, p], weight[8, p] = b[0], b[1], b[2]
        weight[9, p], weight[10, p], weight[11, p] = b[3], b[4], b[5]
    for p in range(len(sampled)):
        # Indices without sign: they need no test for counting from the end.
        x, y = np.uint64(first[0, p]), np.uint64(first[1, p])
        t0 = t1 = t2 = t3 = t4 = t5 = zero
        for i in range(_TAPS):
            line, b = coefficients[y + np.uint64(i)], weight[_TAPS + i, p]
            t0 += b * line[x]
            t1 += b * line[x + np.uint64(1)]
            t2 += b * line[x + np.uint64(2)]
            t3 += b * line[x + np.uint64(3)]
            t4 += b * line[x + np.uint64(4)]
            t5 += b * line[x + np.uint64(5)]
        left = weight[0, p] * t0 + weight[1, p] * t1 + weight[2, p] * t2
        sampled[p] = left + weight[3, p] * t3 + weight[4, p] * t4 + weight[5, p] * t5


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def noise_fraction_kernel(column, row):
    """Fraction of the variance of white noise that interpolation at a position leaves.

    Parameters
    ----------
    column, row : float32 [px]

    Returns
    -------
    float32 [-]                     1 at pixel centres, 0.70 in the middle of four; within 0.015 of
                                    the exact value
    """
    unity = np.float32(1.0)
    drop = np.float32(16.0 * (1.0 - _FRACTION_HALF_WAY))
    # The same on both sides of a pixel centre, so the sign does not matter.
    t, s = abs(column), abs(row)
    t -= np.float32(np.int32(t))
    s -= np.float32(np.int32(s))
    t = t * (unity - t)
    s = s * (unity - s)
    return (unity - drop * t * t) * (unity - drop * s * s)
