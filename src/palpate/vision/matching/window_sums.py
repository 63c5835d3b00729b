"""Sums over one window: the Gauss-Newton system with changes of illumination eliminated.

Between two pictures the illumination of a window may change by an offset, a gain, and (shading) a
gain that varies linearly over the window. These are eliminated in closed form, by projection onto
the orthogonal complement of what they span. Illumination acts before lens, sensor and low-pass blur
the picture: blurring (x times the scene) with a Gaussian of variance s gives x times the blurred
picture plus s times its derivative. Without that term a window at the edge of a shadow is drawn
towards the dark side.

A window holds six planes, `(6, side, side)` float32: grey level minus its mean, its derivatives
along columns and rows, weight (1 inside, 0 outside), and two planes of unit norm that with the
first and a constant span the illumination changes; all but the weight are zero outside. The
displacement varies over it as a polynomial in (xi, eta), the distance from the centre in half
sides: 1, xi, eta, xi^2, xi eta, eta^2. Unknown k of component a has index a * bases + k.
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
    count = 0.0
    total = 0.0
    for r in range(side):
        line = grey[row - half + r, column - half : column + half + 1]
        weight = window[3, r]
        a = np.float32(0.0)
        b = np.float32(0.0)
        for k in range(side):
            a += weight[k]
            b += weight[k] * line[k]
        count += a
        total += b
    mean = total / max(count, 1.0)
    level = np.float32(mean)
    square = 0.0
    for r in range(side):
        line = grey[row - half + r, column - half : column + half + 1]
        right = along_column[row - half + r, column - half : column + half + 1]
        down = along_row[row - half + r, column - half : column + half + 1]
        weight = window[3, r]
        about, by_column, by_row = window[0, r], window[1, r], window[2, r]
        a = np.float32(0.0)
        for k in range(side):
            value = weight[k] * (line[k] - level)
            about[k] = value
            by_column[k] = weight[k] * right[k]
            by_row[k] = weight[k] * down[k]
            a += value * value
        square += a
    window[4] = 0.0
    window[5] = 0.0
    if shading and square > 0.0:
        _fill_shading_kernel(window, half, count, level, square, blur_variance)
    return count, mean, square


@njit(cache=True, error_model="numpy", fastmath=True)
def _fill_shading_kernel(window, half, count, level, square, blur_variance):
    """Fill the last two planes: shading along columns and rows, orthogonal to the other planes."""
    scale = np.float32(1.0 / half)
    slope = np.float32(blur_variance / half)
    for r in range(2 * half + 1):
        eta = np.float32(r - half) * scale
        for k in range(2 * half + 1):
            value = window[0, r, k] + level * window[3, r, k]
            window[4, r, k] = value * np.float32(k - half) * scale + slope * window[1, r, k]
            window[5, r, k] = value * eta + slope * window[2, r, k]
    for plane in (4, 5):
        mean = _dot_kernel(window[plane], window[3]) / count
        gain = _dot_kernel(window[plane], window[0]) / square
        _subtract_kernel(window[plane], window[3], mean)
        _subtract_kernel(window[plane], window[0], gain)
        if plane == 5:
            _subtract_kernel(window[5], window[4], _dot_kernel(window[5], window[4]))
        length = np.sqrt(_dot_kernel(window[plane], window[plane]))
        inverse = np.float32(1.0 / length) if length > 0.0 else np.float32(0.0)
        for r in range(2 * half + 1):
            for k in range(2 * half + 1):
                window[plane, r, k] *= inverse


@njit(cache=True, error_model="numpy", fastmath=True)
def _dot_kernel(first, second):
    """Inner product of two planes."""
    total = 0.0
    for r in range(len(first)):
        part = np.float32(0.0)
        for k in range(first.shape[1]):
            part += first[r, k] * second[r, k]
        total += part
    return total


@njit(cache=True, error_model="numpy", fastmath=True)
def _subtract_kernel(first, second, factor):
    """first -= factor * second."""
    amount = np.float32(factor)
    for r in range(len(first)):
        for k in range(first.shape[1]):
            first[r, k] -= amount * second[r, k]


@njit(cache=True, error_model="numpy", fastmath=True)
def _row_moments_kernel(first, second, half):
    """Sums of first * second * xi^i over one row, i = 0 to 4."""
    a = b = c = d = e = np.float32(0.0)
    scale = np.float32(1.0 / half)
    for k in range(len(first)):
        xi = np.float32(k - half) * scale
        value = first[k] * second[k]
        a += value
        value *= xi
        b += value
        value *= xi
        c += value
        value *= xi
        d += value
        e += value * xi
    return a, b, c, d, e


@njit(cache=True, error_model="numpy")
def _moments_kernel(first, second, half, moments):
    """moments[i, j]: sum of first * second * xi^i * eta^j over the window, i, j = 0 to 4."""
    moments[:] = 0.0
    for r in range(2 * half + 1):
        line = _row_moments_kernel(first[r], second[r], half)
        eta = (r - half) / half
        power = 1.0
        for j in range(5):
            for i in range(5 - j):
                moments[i, j] += line[i] * power
            power *= eta


@njit(cache=True, error_model="numpy")
def window_coupling_sums_kernel(window, half, sums, moments):
    """Inner products that couple displacement and illumination, written into `sums` (8, 6).

    Rows 2 n and 2 n + 1: the two derivatives times each polynomial, times the weight (n = 0), the
    grey level (n = 1) and the two shading planes (n = 2, 3). `moments` (5, 5) is scratch.
    """
    for n in range(4):
        plane = window[3] if n == 0 else window[0] if n == 1 else window[2 + n]
        for a in range(2):
            _moments_kernel(window[1 + a], plane, half, moments)
            for k in range(6):
                sums[2 * n + a, k] = moments[EXPONENTS[k, 0], EXPONENTS[k, 1]]


@njit(cache=True, error_model="numpy")
def window_hessian_kernel(window, half, bases, count, square, sums, moments, hessian):
    """Gauss-Newton matrix of one window, (2 bases, 2 bases), with illumination eliminated.

    Its unit is grey levels^2/px^2; its inverse times the noise variance is the covariance of the
    displacement coefficients. `sums` (8, 6) is from `window_coupling_sums_kernel`, `count` and
    `square` are from `load_window_kernel`; `moments` (5, 5) is scratch.
    """
    for a in range(2):
        for b in range(a + 1):
            _moments_kernel(window[1 + a], window[1 + b], half, moments)
            for k in range(bases):
                for m in range(bases):
                    i = EXPONENTS[k, 0] + EXPONENTS[m, 0]
                    j = EXPONENTS[k, 1] + EXPONENTS[m, 1]
                    value = moments[i, j]
                    value -= sums[a, k] * sums[b, m] / count
                    value -= sums[2 + a, k] * sums[2 + b, m] / square
                    value -= sums[4 + a, k] * sums[4 + b, m]
                    value -= sums[6 + a, k] * sums[6 + b, m]
                    hessian[a * bases + k, b * bases + m] = value
                    hessian[b * bases + m, a * bases + k] = value


@njit(cache=True, error_model="numpy", fastmath=True)
def _row_right_kernel(sampled, level, window, r, half):
    """Contribution of one row to the inner products of the moved picture with the planes."""
    grey, by_column, by_row, weight = window[0, r], window[1, r], window[2, r], window[3, r]
    first, second = window[4, r], window[5, r]
    s = s2 = sf = sp = sq = np.float32(0.0)
    c0 = c1 = c2 = r0 = r1 = r2 = np.float32(0.0)
    scale = np.float32(1.0 / half)
    for k in range(len(sampled)):
        xi = np.float32(k - half) * scale
        value = (sampled[k] - level) * weight[k]
        s += value
        s2 += value * value
        sf += value * grey[k]
        sp += value * first[k]
        sq += value * second[k]
        x = by_column[k] * value
        y = by_row[k] * value
        c0 += x
        r0 += y
        x *= xi
        y *= xi
        c1 += x
        r1 += y
        c2 += x * xi
        r2 += y * xi
    return s, s2, sf, sp, sq, c0, c1, c2, r0, r1, r2


@njit(cache=True, error_model="numpy")
def window_right_kernel(
    window, sampled, half, bases, count, mean, square, sums, right, illumination
):
    """Right-hand side of one window for the sampled moved picture, with illumination eliminated.

    `illumination` (5,) is filled with offset, gain and the two shading amplitudes of the moved
    picture, and the residual sum of squares [grey levels^2 of the first picture]. Returns the gain,
    or 0 where the pictures are not positively correlated.
    """
    total = np.zeros(5)
    right[:] = 0.0
    for r in range(2 * half + 1):
        line = _row_right_kernel(sampled[r], np.float32(mean), window, r, half)
        for n in range(5):
            total[n] += line[n]
        eta = (r - half) / half
        for a in range(2):
            m0, m1, m2 = line[5 + 3 * a], line[6 + 3 * a], line[7 + 3 * a]
            right[a * bases] += m0
            if bases >= 3:
                right[a * bases + 1] += m1
                right[a * bases + 2] += m0 * eta
            if bases == 6:
                right[a * bases + 3] += m2
                right[a * bases + 4] += m1 * eta
                right[a * bases + 5] += m0 * eta * eta
    offset, gain, first, second = total[0] / count, total[2] / square, total[3], total[4]
    illumination[0], illumination[1] = offset, gain
    illumination[2], illumination[3], illumination[4] = first, second, np.inf
    if not gain > 0.0:
        return 0.0
    residual = total[1] - total[0] * offset - gain * gain * square - first**2 - second**2
    illumination[4] = max(residual, 0.0) / (gain * gain)
    for a in range(2):
        for k in range(bases):
            explained = sums[a, k] * offset + sums[2 + a, k] * gain
            explained += sums[4 + a, k] * first + sums[6 + a, k] * second
            right[a * bases + k] = (right[a * bases + k] - explained) / gain
    return gain


@njit(cache=True, error_model="numpy", fastmath=True)
def window_blocks_kernel(window, sampled, half, bases, mean, illumination, blocks):
    """Contribution of each block of a window to the right-hand side, illumination removed.

    Blocks are the cells of a square subdivision of the window; `blocks`, (cells, 2 bases), is
    filled [grey levels^2/px]. `illumination` is from `window_right_kernel`.
    """
    side = 2 * half + 1
    cells = int(np.sqrt(len(blocks)))
    offset, gain, first, second = illumination[0], illumination[1], illumination[2], illumination[3]
    blocks[:] = 0.0
    for r in range(side):
        eta = (r - half) / half
        for k in range(side):
            xi = (k - half) / half
            block = blocks[(r * cells // side) * cells + k * cells // side]
            residual = window[3, r, k] * (sampled[r, k] - mean - offset)
            residual -= gain * window[0, r, k]
            residual -= first * window[4, r, k] + second * window[5, r, k]
            residual /= gain
            for a in range(2):
                value = window[1 + a, r, k] * residual
                block[a * bases] += value
                if bases >= 3:
                    block[a * bases + 1] += value * xi
                    block[a * bases + 2] += value * eta
                if bases == 6:
                    block[a * bases + 3] += value * xi * xi
                    block[a * bases + 4] += value * xi * eta
                    block[a * bases + 5] += value * eta * eta
