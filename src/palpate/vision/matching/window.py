"""Kernels for one window: its pixels in a camera, their later projections, its normal equations.

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

import math

import numpy as np
from numba import njit

from palpate.vision.projection import distort_kernel, jacobian_kernel, project_kernel
from palpate.vision.spline import PADDING, noise_fraction_kernel, sample_kernel

# Total padding of the spline coefficients [px].
_SPLINE_MARGIN_PX = 2 * PADDING
BASES = {"shift": 1, "affine": 3, "quadratic": 6}
EXPONENTS = np.array([[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]])


@njit(cache=True, error_model="numpy")
def _normal_kernel(t, s):
    """Cross product of two tangents, (3,) each: the normal, as a tuple."""
    return (
        t[1] * s[2] - t[2] * s[1],
        t[2] * s[0] - t[0] * s[2],
        t[0] * s[1] - t[1] * s[0],
    )


@njit(cache=True, error_model="numpy")
def load_camera_kernel(
    camera, grey, along_column, along_row, surface, interior, point, tangent, half_window, half,
    min_fraction, shading, blur_variance, window, basis, statistics,
):  # fmt: skip
    """Load one camera's window with the surface points of its pixels; False if too few are seen.

    Filled are `window` (6, pixels), see `load_window_kernel`; `basis`, (4, pixels) or, with the
    second-order terms, (7, pixels): the monomials 1, xi, eta, xi^2, xi eta, eta^2 of each pixel's
    point in its two tangential coordinates, and last its height along the normal, in units of
    `half_window`; `statistics` (3,): number of pixels inside, their mean, sum of squared
    deviations. `tangent` (2, 3) is orthonormal, `half_window` [m] half the side of a window on the
    surface, `min_fraction` (0 to 1) the visible fraction required, `blur_variance` [px^2] that of
    the pictures.
    """
    x, y = project_kernel(camera, point[0], point[1], point[2])
    if not _fits_kernel(x, y, grey.shape, half):
        return False
    column = int(np.rint(x))
    row = int(np.rint(y))
    scale = 1.0 / half_window
    frame = _rest_frame_kernel(tangent)
    count = 0.0
    height = len(basis) - 1
    basis[0] = 1.0
    for r in range(2 * half + 1):
        for k in range(2 * half + 1):
            p = r * (2 * half + 1) + k
            i, j = row - half + r, column - half + k
            weight, xi, eta, zeta = _surface_coordinates_kernel(
                (surface[i, j, 0] - point[0]) * scale, (surface[i, j, 1] - point[1]) * scale,
                (surface[i, j, 2] - point[2]) * scale, interior[i, j], frame,
            )  # fmt: skip
            window[3, p] = weight
            count += weight
            basis[1, p], basis[2, p], basis[height, p] = xi, eta, zeta
            if height == 6:
                basis[3, p], basis[4, p], basis[5, p] = xi * xi, xi * eta, eta * eta
    if count < min_fraction * (2 * half + 1) ** 2:
        return False
    count, mean, square = load_window_kernel(
        grey, along_column, along_row, column, row, half, shading, blur_variance, window
    )
    statistics[0] = count
    statistics[1] = mean
    statistics[2] = square
    return square > 0.0


@njit(cache=True, error_model="numpy")
def _fits_kernel(x, y, shape, half):
    """True where the window around the pixel nearest to (x, y) [px] lies within the picture.

    `shape` is the picture's (rows, columns), `half` half the side of the window [px]. A point of
    the grid lies on a pixel's centre, but for rounding, which must not decide.
    """
    return half - 0.5 < x < shape[1] - half - 0.5 and half - 0.5 < y < shape[0] - half - 0.5


@njit(cache=True, error_model="numpy", inline="always")
def _rest_frame_kernel(tangent):
    """Two orthonormal tangents (2, 3) and their normal as tuples."""
    t, s = tangent[0], tangent[1]
    return (t[0], t[1], t[2]), (s[0], s[1], s[2]), _normal_kernel(t, s)


@njit(cache=True, error_model="numpy", inline="always")
def _surface_coordinates_kernel(x, y, z, weight, frame):
    """Weight of a pixel in a window, and its point in the window's coordinates xi, eta, zeta.

    `x`, `y`, `z` is the offset of the point behind the pixel from the window's, in half sides,
    `weight` 1 where it may be used, `frame` from `_rest_frame_kernel`.
    """
    # Beyond three extents (squared) a pixel shows another part of the object, behind a silhouette.
    far = 9.0
    xi = eta = zeta = 0.0
    if weight > 0.0:
        if x * x + y * y + z * z > far:
            weight = np.float32(0.0)
        else:
            t, s, n = frame
            xi = x * t[0] + y * t[1] + z * t[2]
            eta = x * s[0] + y * s[1] + z * s[2]
            zeta = x * n[0] + y * n[1] + z * n[2]
    return weight, xi, eta, zeta


@njit(cache=True, error_model="numpy")
def mapping_kernel(camera, point, tangent, bases, jacobian, mapping):
    """Matrix from coefficients of the surface motion to those of the pixel motion in a window.

    `mapping`, (2 terms, 3 bases) [px/m], is filled; its rows are those of `window_system_kernel`
    for the functions of `load_camera_kernel`. A tilt of the tangent plane turns the normal, so it
    moves a pixel's point along the surface by minus its height. The camera is linearised at the
    point. `camera` (25,) packed, `point` (3,) [m], `tangent` (2, 3); `jacobian` (2, 3) is scratch.

    Source: the derivative of `sample_surface_kernel`'s motion at rest.
    """
    jacobian_kernel(camera, point[0], point[1], point[2], jacobian)
    normal = _normal_kernel(tangent[0], tangent[1])
    mapping[:] = 0.0
    for a in range(2):
        for b in range(3):
            for k in range(bases):
                mapping[2 * k + a, b * bases + k] = jacobian[a, b]
        if bases == 1:
            continue
        for k in range(2):
            along = 0.0
            for b in range(3):
                along += jacobian[a, b] * tangent[k, b]
            for b in range(3):
                mapping[2 * bases + a, b * bases + 1 + k] = -along * normal[b]


@njit(cache=True, error_model="numpy")
def deformed_frame_kernel(q, tangent, half_window, frame):
    """Deformed tangents and unit normal as rows, (3, 3), written into `frame`.

    The deformed tangents are the images of the orthonormal `tangent` (2, 3) under the motion `q`
    (6, 3) [m], whose derivatives are multiplied by `half_window` [m]; stretch makes them longer
    than 1.
    """
    for a in range(3):
        frame[0, a] = tangent[0, a] + q[1, a] / half_window
        frame[1, a] = tangent[1, a] + q[2, a] / half_window
    frame[2, 0] = frame[0, 1] * frame[1, 2] - frame[0, 2] * frame[1, 1]
    frame[2, 1] = frame[0, 2] * frame[1, 0] - frame[0, 0] * frame[1, 2]
    frame[2, 2] = frame[0, 0] * frame[1, 1] - frame[0, 1] * frame[1, 0]
    length = math.sqrt(frame[2, 0] ** 2 + frame[2, 1] ** 2 + frame[2, 2] ** 2)
    for a in range(3):
        frame[2, a] /= length


@njit(cache=True, error_model="numpy")
def update_kernel(q, frame, tangent, step, bases):
    """Compose the motion with the inverse of the step: u - F step, F the deformation gradient.

    `q` (6, 3) [m] is updated; `frame` (3, 3) holds the deformed tangents and normal, `tangent`
    (2, 3) those at rest, `step` (3 bases,) [m] the coefficients component by component.
    """
    t, s = tangent[0], tangent[1]
    normal = _normal_kernel(t, s)
    for k in range(bases):
        d0, d1, d2 = step[k], step[bases + k], step[2 * bases + k]
        along = d0 * t[0] + d1 * t[1] + d2 * t[2]
        across = d0 * s[0] + d1 * s[1] + d2 * s[2]
        out = d0 * normal[0] + d1 * normal[1] + d2 * normal[2]
        for a in range(3):
            q[k, a] -= along * frame[0, a] + across * frame[1, a] + out * frame[2, a]


@njit(cache=True, error_model="numpy")
def pixel_lengths_kernel(cameras, point, active, step, q, start):
    """Length of the last step and distance from the start, the maximum over cameras [px].

    `cameras` (c, 25) packed, `point` (3,) [m], `active` (c,) bool, `step` (3 bases,) [m], `q` and
    `start` (6, 3) [m].
    """
    bases = len(step) // 3
    longest = 0.0
    farthest = 0.0
    for c in range(len(active)):
        if not active[c]:
            continue
        x, y = project_kernel(
            cameras[c], point[0] + q[0, 0], point[1] + q[0, 1], point[2] + q[0, 2]
        )
        x1, y1 = project_kernel(
            cameras[c],
            point[0] + q[0, 0] + step[0],
            point[1] + q[0, 1] + step[bases],
            point[2] + q[0, 2] + step[2 * bases],
        )
        x0, y0 = project_kernel(
            cameras[c], point[0] + start[0, 0], point[1] + start[0, 1], point[2] + start[0, 2]
        )
        longest = max(longest, np.hypot(x1 - x, y1 - y))
        farthest = max(farthest, np.hypot(x0 - x, y0 - y))
    return longest, farthest


@njit(cache=True, error_model="numpy")
def in_picture_kernel(cameras, moved, point, q, active, half):
    """True if the moved windows lie within the later pictures of all active cameras.

    `cameras` (c, 25) packed, `moved` tuple of c spline coefficients, `point` (3,) [m], `q` (6, 3)
    [m], `active` (c,) bool, `half` side of the window [px].
    """
    for c in range(len(active)):
        if active[c]:
            x, y = project_kernel(
                cameras[c], point[0] + q[0, 0], point[1] + q[0, 1], point[2] + q[0, 2]
            )
            rows, columns = moved[c].shape
            if not (
                half <= x < columns - _SPLINE_MARGIN_PX - half
                and half <= y < rows - _SPLINE_MARGIN_PX - half
            ):
                return False
    return True


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_surface_kernel(camera, moved, basis, weight, point, q, frame, half_window, sampled):
    """Sample the later picture at the projections of the moved surface points.

    `moved` are spline coefficients, `basis` and `weight` those of the window's pixels, `point` (3,)
    [m], `q` (6, 3) [m] the motion, `frame` (3, 3) the deformed tangents and normal. `sampled`
    (pixels,) [grey levels] is filled. Returns the mean fraction of noise variance left.
    """
    c = np.empty((7, 3))
    _camera_polynomial_kernel(camera, point, q, frame, half_window, c)
    columns = np.empty(len(sampled), dtype=np.float32)
    rows = np.empty(len(sampled), dtype=np.float32)
    _project_plane_kernel(camera, c, basis, columns, rows)
    sample_kernel(moved, columns, rows, sampled)
    fractions = np.float32(0.0)
    count = np.float32(0.0)
    for p in range(len(sampled)):
        fractions += weight[p] * noise_fraction_kernel(columns[p], rows[p])
        count += weight[p]
    return fractions / count


@njit(cache=True, fastmath=True, error_model="numpy")
def _camera_polynomial_kernel(camera, point, q, frame, half_window, c):
    """Camera coordinates of a moved window's points as polynomials in their surface coordinates.

    `camera` (25,) packed, `point` (3,) [m], `q` (6, 3) [m], `frame` (3, 3) from
    `deformed_frame_kernel`, `half_window` [m]. `c` (7, 3) [m] is filled with the coefficients of 1,
    xi, eta, zeta, xi^2, xi eta and eta^2.
    """
    for a in range(3):
        i = 13 + 3 * a
        r0, r1, r2 = camera[i], camera[i + 1], camera[i + 2]
        c[0, a] = (
            r0 * (point[0] + q[0, 0]) + r1 * (point[1] + q[0, 1]) + r2 * (point[2] + q[0, 2])
            + camera[22 + a]
        )  # fmt: skip
        for k in range(3):
            c[1 + k, a] = half_window * (r0 * frame[k, 0] + r1 * frame[k, 1] + r2 * frame[k, 2])
            c[4 + k, a] = r0 * q[3 + k, 0] + r1 * q[3 + k, 1] + r2 * q[3 + k, 2]


@njit(cache=True, fastmath=True, error_model="numpy")
def _project_plane_kernel(camera, c, basis, columns, rows):
    """Project the points of a window, with the polynomials `c` (7, 3) as camera coordinates."""
    # Copied from the arrays, which might overlap the results: the loop is vectorised.
    lens, polynomials = _constants_kernel(camera, c)
    height = basis[len(basis) - 1]
    for p in range(len(columns)):
        columns[p], rows[p] = _moved_pixel_kernel(
            lens, polynomials, basis[1, p], basis[2, p], height[p]
        )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _constants_kernel(camera, c):
    """Lens and pinhole of a camera, and its polynomials, as tuples for `_moved_pixel_kernel`.

    `camera` (25,) packed, `c` (7, 3) from `_camera_polynomial_kernel`.
    """
    xs = (c[0, 0], c[1, 0], c[2, 0], c[3, 0], c[4, 0], c[5, 0], c[6, 0])
    ys = (c[0, 1], c[1, 1], c[2, 1], c[3, 1], c[4, 1], c[5, 1], c[6, 1])
    zs = (c[0, 2], c[1, 2], c[2, 2], c[3, 2], c[4, 2], c[5, 2], c[6, 2])
    lens = (
        camera[0], camera[1], camera[2], camera[3], camera[4], camera[5], camera[6], camera[7],
        camera[8], camera[9], camera[10], camera[11], camera[12],
    )  # fmt: skip
    return lens, (xs, ys, zs)


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _moved_pixel_kernel(lens, polynomials, xi, eta, zeta):
    """Column and row [px] at which a point of the window, in surface coordinates, appears later."""
    xs, ys, zs = polynomials
    z = _polynomial_kernel(zs, xi, eta, zeta)
    x, y = _polynomial_kernel(xs, xi, eta, zeta) / z, _polynomial_kernel(ys, xi, eta, zeta) / z
    x, y, _, _, _ = distort_kernel(lens, x, y)
    return lens[0] * x + lens[4] * y + lens[2], lens[1] * y + lens[3]


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def _polynomial_kernel(c, xi, eta, zeta):
    """A camera coordinate as a polynomial in the surface coordinates."""
    linear = c[0] + xi * c[1] + eta * c[2] + zeta * c[3]
    return linear + xi * xi * c[4] + xi * eta * c[5] + eta * eta * c[6]


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
        first = r * side
        for k in range(side):
            weight = window[3, first + k]
            window[0, first + k] = weight * line[k]
            window[1, first + k] = weight * right[k]
            window[2, first + k] = weight * down[k]
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
