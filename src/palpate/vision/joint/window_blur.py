"""Kernel for how much a window has lost in sharpness since the first instant."""

from typing import NamedTuple

import numpy as np
from numba import njit

from palpate.vision.cameras.lens import project_kernel
from palpate.vision.images.spline import sample_kernel

# What gain, offset and shading multiply: 1, the grey level, column and row of a pixel.
_ILLUMINATION = 4


class CameraInstants(NamedTuple):
    """One camera's first picture and a later one.

    Attributes
    ----------
    camera : (25,) float                    `packed_camera`
    grey, laplacian : (rows, columns) float32     of the first picture
    surface : (rows, columns, 3) float32 [m]      point behind each pixel
    interior : (rows, columns) float32      > 0 where a pixel shows only one part of the surface
    later, later_laplacian : (rows + 10, columns + 10) float32     spline coefficients
    """

    camera: np.ndarray
    grey: np.ndarray
    laplacian: np.ndarray
    surface: np.ndarray
    interior: np.ndarray
    later: np.ndarray
    later_laplacian: np.ndarray


class MovedWindows(NamedTuple):
    """Windows of the surface and their motions.

    Attributes
    ----------
    point : (w, 3) float [m]
    tangent : (w, 2, 3) float
    half_window : (w,) float [m]
    motion : (w, 6, 3) float [m]            see `Match`
    """

    point: np.ndarray
    tangent: np.ndarray
    half_window: np.ndarray
    motion: np.ndarray


@njit(cache=True, nogil=True, error_model="numpy")
def window_variances_kernel(begin, end, instants, windows, half, found):
    """Later blur variance minus that of the first picture, for the windows from `begin` to `end`.

    Parameters
    ----------
    begin, end : int
    instants : CameraInstants
    windows : MovedWindows
    half : int [px]                         half the side of a window, rounded down
    found : (w,) float [px^2]               filled: the later picture regressed on half the
                                            Laplacian, without what illumination explains
    """
    pixels = (2 * half + 1) ** 2
    column, row = np.empty(pixels, dtype=np.float32), np.empty(pixels, dtype=np.float32)
    later, theirs = np.empty(pixels, dtype=np.float32), np.empty(pixels, dtype=np.float32)
    ours = np.empty(pixels)
    basis = np.empty((_ILLUMINATION, pixels))
    for w in range(begin, end):
        count = _load_window(instants, windows, w, half, column, row, ours, basis)
        sample_kernel(instants.later, column[:count], row[:count], later[:count])
        sample_kernel(instants.later_laplacian, column[:count], row[:count], theirs[:count])
        laplacian, difference = np.empty(count), np.empty(count)
        for p in range(count):
            laplacian[p], difference[p] = 0.5 * (ours[p] + theirs[p]), later[p]
        for a in range(_ILLUMINATION):
            for b in range(a):
                _remove(basis[b, :count], basis[a, :count])
            _remove(basis[a, :count], laplacian)
            _remove(basis[a, :count], difference)
        found[w] = 2.0 * _product(laplacian, difference) / _product(laplacian, laplacian)


@njit(cache=True, error_model="numpy")
def _load_window(instants, windows, w, half, column, row, ours, basis):
    """Where the surface points of a window appear later, and the first picture there; how many."""
    camera, point, q = instants.camera, windows.point[w], windows.motion[w]
    tangent, scale = windows.tangent[w], 1.0 / windows.half_window[w]
    x, y = project_kernel(camera, point[0], point[1], point[2])
    rows, columns = instants.grey.shape
    count = 0
    for down in range(-half, half + 1):
        for right in range(-half, half + 1):
            i, k = int(np.rint(y)) + down, int(np.rint(x)) + right
            if not (0 <= i < rows and 0 <= k < columns and instants.interior[i, k] > 0.0):
                continue
            shown = instants.surface[i, k]
            xi = eta = 0.0
            for a in range(3):
                xi += (shown[a] - point[a]) * tangent[0, a] * scale
                eta += (shown[a] - point[a]) * tangent[1, a] * scale
            column[count], row[count] = project_kernel(
                camera,
                shown[0] + q[0, 0] + xi * q[1, 0] + eta * q[2, 0],
                shown[1] + q[0, 1] + xi * q[1, 1] + eta * q[2, 1],
                shown[2] + q[0, 2] + xi * q[1, 2] + eta * q[2, 2],
            )
            ours[count] = instants.laplacian[i, k]
            basis[0, count], basis[1, count] = 1.0, instants.grey[i, k]
            basis[2, count], basis[3, count] = right, down
            count += 1
    return count


@njit(cache=True, error_model="numpy")
def _product(a, b):
    total = 0.0
    for p in range(len(a)):
        total += a[p] * b[p]
    return total


@njit(cache=True, error_model="numpy")
def _remove(direction, values):
    """Subtract the component along a direction; nothing where that has vanished."""
    square = _product(direction, direction)
    if square > 0.0:
        share = _product(direction, values) / square
        for p in range(len(values)):
            values[p] -= share * direction[p]
