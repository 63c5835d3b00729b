"""Sums over one window: the Gauss-Newton system with changes of illumination eliminated.

Between two pictures the illumination of a window may change by an offset, a gain, and (shading) a
gain that varies linearly over the window. These are eliminated in closed form, by projection onto
the orthogonal complement of what they span. Illumination acts before lens, sensor and low-pass blur
the picture: blurring (x times the scene) with a Gaussian of variance s gives x times the blurred
picture plus s times its derivative. Without that term a window at the edge of a shadow is drawn
towards the dark side.

A window holds six planes of its pixels, row by row, `(6, pixels)` float32: grey level minus its
mean, its derivatives along columns and rows, weight (1 inside, 0 outside), and two planes of unit
norm that with the first and a constant span the illumination changes; all but the weight are zero
outside. The displacement varies over it as a sum of given functions, `basis` (terms, pixels)
float32. The unknown of function k along axis a (0 columns, 1 rows) has index 2 k + a.
"""

import numpy as np
from numba import njit

BASES = {"shift": 1, "affine": 3, "quadratic": 6}
EXPONENTS = np.array([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]])


@njit(cache=True, error_model="numpy", fastmath=True)
def load_window_kernel(
    grey, along_column, along_row, column, row, half, shading, blur_variance, window
):  # fmt: skip
    """Fill the window's planes around a pixel; the fourth, the weights, is input.

    `grey`, `along_column`, `along_row` (rows, columns) float32 [grey levels, grey levels/px]; the
    window must lie within them. `blur_variance` [px^2] is that of their blur, for the shading.
    Returns the number of pixels inside, their mean [grey levels], and the sum of squared deviations
    from it.
    """
    side = 2 * half + 1
    for r in range(side):
        line = grey[row - half + r, column - half : column + half + 1]
        right = along_column[row - half + r, column - half : column + half + 1]
        down = along_row[row - half + r, column - half : column + half + 1]
        place = r * side
        for k in range(side):
            weight = window[3, place + k]
            window[0, place + k] = weight * line[k]
            window[1, place + k] = weight * right[k]
            window[2, place + k] = weight * down[k]
    count = _sum_kernel(window[3])
    mean = _sum_kernel(window[0]) / max(count, 1.0)
    _subtract_kernel(window[0], window[3], mean)
    square = _dot_kernel(window[0], window[0])
    window[4] = 0.0
    window[5] = 0.0
    if shading and square > 0.0:
        _fill_shading_kernel(window, half, count, mean, square, blur_variance)
    return count, mean, square


@njit(cache=True, error_model="numpy", fastmath=True)
def _fill_shading_kernel(window, half, count, mean, square, blur_variance):
    """Fill the last two planes: shading along columns and rows, orthogonal to the other planes."""
    side = 2 * half + 1
    level, scale = np.float32(mean), np.float32(1.0 / half)
    slope = np.float32(blur_variance / half)
    for r in range(side):
        eta = np.float32(r - half) * scale
        for k in range(side):
            p = r * side + k
            value = window[0, p] + level * window[3, p]
            window[4, p] = value * np.float32(k - half) * scale + slope * window[1, p]
            window[5, p] = value * eta + slope * window[2, p]
    for plane in (4, 5):
        _subtract_kernel(window[plane], window[3], _sum_kernel(window[plane]) / count)
        gain = _dot_kernel(window[plane], window[0]) / square
        _subtract_kernel(window[plane], window[0], gain)
        if plane == 5:
            _subtract_kernel(window[5], window[4], _dot_kernel(window[5], window[4]))
        length = np.sqrt(_dot_kernel(window[plane], window[plane]))
        inverse = np.float32(1.0 / length) if length > 0.0 else np.float32(0.0)
        for p in range(side * side):
            window[plane, p] *= inverse


@njit(cache=True, error_model="numpy", fastmath=True)
def _sum_kernel(plane):
    """Sum of a plane; single precision in parallel lanes, like all sums here."""
    total = np.float32(0.0)
    for p in range(len(plane)):
        total += plane[p]
    return float(total)


@njit(cache=True, error_model="numpy", fastmath=True)
def _dot_kernel(first, second):
    """Inner product of two planes."""
    total = np.float32(0.0)
    for p in range(len(first)):
        total += first[p] * second[p]
    return float(total)


@njit(cache=True, error_model="numpy", fastmath=True)
def _subtract_kernel(first, second, factor):
    """first -= factor * second."""
    amount = np.float32(factor)
    for p in range(len(first)):
        first[p] -= amount * second[p]


@njit(cache=True, error_model="numpy", fastmath=True)
def window_system_kernel(window, basis, count, square, scratch, sums, hessian):
    """Gauss-Newton matrix of one window, with illumination eliminated.

    `hessian` (2 terms, 2 terms) [grey levels^2/px^2] is filled; its inverse times the noise
    variance is the covariance of the unknowns. So is `sums` (2 terms, 4): inner products of each
    unknown's derivative with the weight, the grey level and the two shading planes. `count` and
    `square` are from `load_window_kernel`; `scratch` (pixels,) float32.
    """
    for i in range(len(hessian)):
        for p in range(len(scratch)):
            scratch[p] = window[1 + i % 2, p] * basis[i // 2, p]
        sums[i, 0] = _sum_kernel(scratch)
        sums[i, 1] = _dot_kernel(scratch, window[0])
        sums[i, 2] = _dot_kernel(scratch, window[4])
        sums[i, 3] = _dot_kernel(scratch, window[5])
        for j in range(i + 1):
            function, slope = basis[j // 2], window[1 + j % 2]
            product = np.float32(0.0)
            for p in range(len(scratch)):
                product += scratch[p] * function[p] * slope[p]
            value = product - sums[i, 0] * sums[j, 0] / count - sums[i, 1] * sums[j, 1] / square
            value -= sums[i, 2] * sums[j, 2] + sums[i, 3] * sums[j, 3]
            hessian[i, j] = hessian[j, i] = value


@njit(cache=True, error_model="numpy", fastmath=True)
def window_right_kernel(
    window, basis, sampled, count, mean, square, sums, right, illumination
):  # fmt: skip
    """Right-hand side of one window for the sampled moved picture, with illumination eliminated.

    `sampled` (pixels,) is overwritten with its difference from the mean, zero outside. `right`
    (2 terms,) is filled, and `illumination` (4,) with offset, gain and the two shading amplitudes
    of the moved picture. Returns the gain, or 0 where the pictures are not positively correlated.
    """
    level = np.float32(mean)
    s = sf = sp = sq = np.float32(0.0)
    for p in range(len(sampled)):
        value = (sampled[p] - level) * window[3, p]
        sampled[p] = value
        s += value
        sf += value * window[0, p]
        sp += value * window[4, p]
        sq += value * window[5, p]
    offset, gain, first, second = s / count, sf / square, float(sp), float(sq)
    illumination[0], illumination[1] = offset, gain
    illumination[2], illumination[3] = first, second
    if not gain > 0.0:
        return 0.0
    for k in range(len(basis)):
        x = y = np.float32(0.0)
        for p in range(len(sampled)):
            value = sampled[p] * basis[k, p]
            x += value * window[1, p]
            y += value * window[2, p]
        right[2 * k] = x
        right[2 * k + 1] = y
    for i in range(len(right)):
        explained = sums[i, 0] * offset + sums[i, 1] * gain + sums[i, 2] * first
        right[i] = (right[i] - explained - sums[i, 3] * second) / gain
    return gain


@njit(cache=True, error_model="numpy", fastmath=True)
def window_advance_kernel(window, basis, step, difference):
    """Change the difference of the moved picture as a small step does, to first order.

    `difference` (pixels,) [grey levels] is as `window_right_kernel` leaves it; `step` (2 terms,) is
    in pixels times the gain.
    """
    for n in range(len(step)):
        amount, slope, function = np.float32(step[n]), window[1 + n % 2], basis[n // 2]
        for p in range(len(difference)):
            difference[p] -= amount * slope[p] * function[p]


@njit(cache=True, error_model="numpy", fastmath=True)
def window_residual_kernel(window, difference, illumination):
    """Overwrite the difference of the moved picture with its residuals; their sum of squares.

    Both are in grey levels of the first picture. `difference` (pixels,) and `illumination` are as
    `window_right_kernel` leaves them, with a positive gain.
    """
    offset, inverse = np.float32(illumination[0]), np.float32(1.0 / illumination[1])
    first, second = np.float32(illumination[2]), np.float32(illumination[3])
    for p in range(len(difference)):
        value = difference[p] - offset * window[3, p]
        value -= first * window[4, p] + second * window[5, p]
        difference[p] = value * inverse - window[0, p]
    return _dot_kernel(difference, difference)


@njit(cache=True, error_model="numpy", fastmath=True)
def window_blocks_kernel(window, basis, residual, blocks):
    """Contribution of each block of a window to the right-hand side.

    Blocks are the cells of a square subdivision of the window; `blocks`, (cells, 2 terms), is
    filled [grey levels^2/px]. `residual` (pixels,) is from `window_residual_kernel`.
    """
    side, cells = int(np.sqrt(len(residual))), int(np.sqrt(len(blocks)))
    # 1 in one of the vertical strips, 0 in the others: so the sums below are vectorised.
    strips = np.zeros((cells, len(residual)), dtype=np.float32)
    for k in range(side):
        strips[k * cells // side, k::side] = 1.0
    for i in range(cells):
        rows = slice(-(-i * side // cells) * side, -(-(i + 1) * side // cells) * side)
        for n in range(blocks.shape[1]):
            slope, function, rest = window[1 + n % 2, rows], basis[n // 2, rows], residual[rows]
            for j in range(cells):
                strip, total = strips[j, rows], np.float32(0.0)
                for p in range(len(strip)):
                    total += strip[p] * rest[p] * function[p] * slope[p]
                blocks[i * cells + j, n] = total
