"""What one of the threads that share a window's pixels does, without waiting for the others.

A thread's share are the pixels, or the entries of a matrix, from `thread` on in steps of `threads`.
"""

import math

import numpy as np
from numba import njit

from palpate.vision.images import PADDING, TAPS, noise_fraction_kernel, spline_weights_kernel
from palpate.vision.refinement.sampling import constants_kernel, moved_pixel_kernel
from palpate.vision.refinement.window import surface_coordinates_kernel
from palpate.vision.refinement.window_match import BLOCKS

# Planes of a window: weight, grey level, two of shading, then the derivative of the grey level with
# respect to each unknown.
WEIGHT, GREY, SHADING, SLOPES = 0, 1, 2, 4


@njit(cache=True, error_model="numpy")
def load_share_kernel(thread, threads, first, c, corner, point, frame, scale, planes, places):
    """Planes of weight, grey level and derivatives of one camera's window.

    `first` is a `FirstInstant`, `c` the camera, `corner` the row and column of the window's first
    pixel; `point` (3,) [m], `frame` and `scale` [1/m] as in `surface_coordinates_kernel`.
    `planes` (4 + 2 terms, pixels) is filled but for the shading, which is set to zero, and `places`
    (3, pixels) with xi, eta and zeta.
    """
    side = int(math.sqrt(planes.shape[1]))
    functions, surface = (len(planes) - SLOPES) // 2, first.surface[c]
    for p in range(thread, side * side, threads):
        i, j = corner[0] + p // side, corner[1] + p % side
        weight, xi, eta, zeta = surface_coordinates_kernel(
            (surface[i, j, 0] - point[0]) * scale, (surface[i, j, 1] - point[1]) * scale,
            (surface[i, j, 2] - point[2]) * scale, first.interior[c][i, j], frame,
        )  # fmt: skip
        places[0, p], places[1, p], places[2, p] = xi, eta, zeta
        planes[WEIGHT, p], planes[GREY, p] = weight, weight * first.grey[c][i, j]
        planes[SHADING, p] = planes[SHADING + 1, p] = 0.0
        right = weight * first.along_column[c][i, j]
        down = weight * first.along_row[c][i, j]
        for n in range(functions):
            value = _function(n, functions, places[0, p], places[1, p], places[2, p])
            planes[SLOPES + 2 * n, p] = right * value
            planes[SLOPES + 2 * n + 1, p] = down * value


@njit(cache=True, error_model="numpy")
def _function(n, functions, xi, eta, zeta):
    """Function of the surface coordinates that a pair of unknowns multiplies; zeta comes last."""
    if n == 0:
        return np.float32(1.0)
    if n == functions - 1:
        return zeta
    if n == 1:
        return xi
    if n == 2:
        return eta
    if n == 3:
        return xi * xi
    return xi * eta if n == 4 else eta * eta


@njit(cache=True, error_model="numpy")
def shading_share_kernel(thread, threads, mean, blur_variance, planes):
    """Planes of shading along columns and rows, not yet orthogonal.

    `mean` [grey levels], `blur_variance` [px^2] and the result are as in `load_window_kernel`.
    """
    side = int(math.sqrt(planes.shape[1]))
    half = side // 2
    level, scale = np.float32(mean), np.float32(1.0 / half)
    slope = np.float32(blur_variance / half)
    for p in range(thread, side * side, threads):
        value = planes[GREY, p] + level * planes[WEIGHT, p]
        xi, eta = np.float32(p % side - half) * scale, np.float32(p // side - half) * scale
        planes[SHADING, p] = value * xi + slope * planes[SLOPES, p]
        planes[SHADING + 1, p] = value * eta + slope * planes[SLOPES + 1, p]


@njit(cache=True, fastmath=True, error_model="numpy")
def product_share_kernel(thread, threads, plane, planes, begin, end, partial):
    """Parts of the inner products of a plane with those from `begin` to `end`.

    `plane` (pixels,), `planes` (k, pixels); `partial` (k, parts) is filled, from its first row on.
    """
    parts = partial.shape[1]
    for entry in range(thread, (end - begin) * parts, threads):
        k, part = entry // parts, entry % parts
        total = np.float32(0.0)
        for p in range(part, len(plane), parts):
            total += plane[p] * planes[begin + k, p]
        partial[k, part] = total


@njit(cache=True, error_model="numpy")
def sum_share_kernel(thread, threads, partial, count, products):
    """Sums of the first `count` rows of `partial`, written into `products`."""
    for k in range(thread, count, threads):
        total = 0.0
        for part in range(partial.shape[1]):
            total += partial[k, part]
        products[k] = total


@njit(cache=True, error_model="numpy")
def subtract_share_kernel(thread, threads, first, second, factor):
    """first -= factor * second, for planes (pixels,)."""
    amount = np.float32(factor)
    for p in range(thread, len(first), threads):
        first[p] -= amount * second[p]


@njit(cache=True, error_model="numpy")
def scale_share_kernel(thread, threads, plane, factor):
    """plane *= factor, for a plane (pixels,)."""
    amount = np.float32(factor)
    for p in range(thread, len(plane), threads):
        plane[p] *= amount


@njit(cache=True, error_model="numpy")
def system_share_kernel(thread, threads, i, products, statistics, sums, normal):
    """One row of a window's Gauss-Newton matrix, as in `window_system_kernel`.

    `products` (4 + i + 1,) are the inner products of the derivative with respect to unknown `i`
    with the planes up to itself, `statistics` (3,) count, mean and square, `sums` (2 terms, 4) of
    the rows before. Filled are `normal` (2 terms, 2 terms) in row and column `i`.
    """
    for j in range(thread, i + 1, threads):
        value = products[SLOPES + j]
        for k in range(SLOPES):
            size = statistics[0] if k == WEIGHT else statistics[2] if k == GREY else 1.0
            other = products[k] if j == i else sums[j, k]
            value -= products[k] * other / size
        normal[i, j] = normal[j, i] = value


@njit(cache=True, error_model="numpy")
def congruence_share_kernel(thread, threads, inner, matrix, factor, total):
    """Add factor * matrix^T inner matrix to `total`, (m, m), as `add_congruence_kernel` does."""
    size = len(total)
    for entry in range(thread, size * size, threads):
        n, m = entry // size, entry % size
        value = 0.0
        for k in range(len(inner)):
            product = 0.0
            for h in range(len(inner)):
                product += inner[k, h] * matrix[h, m]
            value += matrix[k, n] * product
        total[n, m] += factor * value


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_share_kernel(thread, threads, camera, moved, polynomial, places, weight, mean, sampled):
    """The later picture where the points of a window appear, minus the mean, and its noise.

    `camera` (25,) packed, `moved` spline coefficients, `polynomial` (7, 3) from
    `camera_polynomial_kernel`, `places` (3, pixels), `weight` (pixels,). `sampled` (2, pixels) is
    filled: grey levels, zero outside, and the fraction of the variance of noise left.
    """
    lens, polynomials = constants_kernel(camera, polynomial)
    level = np.float32(mean)
    for p in range(thread, len(weight), threads):
        x, y = moved_pixel_kernel(lens, polynomials, places[0, p], places[1, p], places[2, p])
        column, row = np.float32(x), np.float32(y)
        sampled[0, p] = (_interpolated(moved, column, row) - level) * weight[p]
        sampled[1, p] = noise_fraction_kernel(column, row)


@njit(cache=True, fastmath=True, error_model="numpy")
def _interpolated(coefficients, column, row):
    """`sample_kernel` for one position."""
    zero, lead = np.float32(0.0), np.float32(PADDING + 1 - TAPS // 2)
    x = min(max(column + lead, zero), np.float32(coefficients.shape[1] - TAPS))
    y = min(max(row + lead, zero), np.float32(coefficients.shape[0] - TAPS))
    ix, iy = int(x), int(y)
    across = spline_weights_kernel(x - np.float32(ix))
    down = spline_weights_kernel(y - np.float32(iy))
    return (
        down[0] * _line(coefficients[iy], ix, across)
        + down[1] * _line(coefficients[iy + 1], ix, across)
        + down[2] * _line(coefficients[iy + 2], ix, across)
        + down[3] * _line(coefficients[iy + 3], ix, across)
        + down[4] * _line(coefficients[iy + 4], ix, across)
        + down[5] * _line(coefficients[iy + 5], ix, across)
    )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _line(line, x, weight):
    """A row of coefficients, interpolated."""
    return (
        weight[0] * line[x]
        + weight[1] * line[x + 1]
        + weight[2] * line[x + 2]
        + weight[3] * line[x + 3]
        + weight[4] * line[x + 4]
        + weight[5] * line[x + 5]
    )


@njit(cache=True, error_model="numpy")
def advance_share_kernel(thread, threads, step, planes, difference):
    """`window_advance_kernel`: `step` (2 terms,) [px], `difference` (pixels,) [grey levels]."""
    for p in range(thread, len(difference), threads):
        for n in range(len(step)):
            difference[p] -= np.float32(step[n]) * planes[SLOPES + n, p]


@njit(cache=True, error_model="numpy")
def residual_share_kernel(thread, threads, planes, illumination, difference):
    """`window_residual_kernel`: `illumination` (4,), `difference` (pixels,) [grey levels]."""
    offset, inverse = np.float32(illumination[0]), np.float32(1.0 / illumination[1])
    first, second = np.float32(illumination[2]), np.float32(illumination[3])
    for p in range(thread, len(difference), threads):
        value = difference[p] - offset * planes[WEIGHT, p]
        value -= first * planes[SHADING, p] + second * planes[SHADING + 1, p]
        difference[p] = value * inverse - planes[GREY, p]


@njit(cache=True, error_model="numpy")
def blocks_share_kernel(thread, threads, residual, planes, blocks):
    """`window_blocks_kernel`: `residual` (pixels,), `blocks` (cells, 2 terms) is filled."""
    side, unknowns = int(math.sqrt(len(residual))), blocks.shape[1]
    for entry in range(thread, BLOCKS * BLOCKS * unknowns, threads):
        cell, n = entry // unknowns, entry % unknowns
        i, j = cell // BLOCKS, cell % BLOCKS
        total = np.float32(0.0)
        for r in range(-(-i * side // BLOCKS), -(-(i + 1) * side // BLOCKS)):
            for k in range(-(-j * side // BLOCKS), -(-(j + 1) * side // BLOCKS)):
                p = r * side + k
                total += residual[p] * planes[SLOPES + n, p]
        blocks[cell, n] = total
