"""Kernels for one camera's window: surface points of its pixels, and their later projections."""

import math

import numpy as np
from numba import njit

from palpate.vision.cameras.lens import jacobian_kernel, project_kernel
from palpate.vision.images.spline import PADDING
from palpate.vision.matching.window_sums import load_window_kernel

# Total padding of the spline coefficients [px].
_SPLINE_MARGIN_PX = 2 * PADDING


@njit(cache=True, error_model="numpy")
def normal_kernel(t, s):
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
    if not fits_kernel(x, y, grey.shape, half):
        return False
    column = int(np.rint(x))
    row = int(np.rint(y))
    scale = 1.0 / half_window
    frame = rest_frame_kernel(tangent)
    count = 0.0
    height = len(basis) - 1
    basis[0] = 1.0
    for r in range(2 * half + 1):
        for k in range(2 * half + 1):
            p = r * (2 * half + 1) + k
            i, j = row - half + r, column - half + k
            weight, xi, eta, zeta = surface_coordinates_kernel(
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
def fits_kernel(x, y, shape, half):
    """True where the window around the pixel nearest to (x, y) [px] lies within the picture.

    `shape` is the picture's (rows, columns), `half` half the side of the window [px]. A point of
    the grid lies on a pixel's centre, but for rounding, which must not decide.
    """
    return half - 0.5 < x < shape[1] - half - 0.5 and half - 0.5 < y < shape[0] - half - 0.5


@njit(cache=True, error_model="numpy", inline="always")
def rest_frame_kernel(tangent):
    """Two orthonormal tangents (2, 3) and their normal as tuples."""
    t, s = tangent[0], tangent[1]
    return (t[0], t[1], t[2]), (s[0], s[1], s[2]), normal_kernel(t, s)


@njit(cache=True, error_model="numpy", inline="always")
def surface_coordinates_kernel(x, y, z, weight, frame):
    """Weight of a pixel in a window, and its point in the window's coordinates xi, eta, zeta.

    `x`, `y`, `z` is the offset of the point behind the pixel from the window's, in half sides,
    `weight` 1 where it may be used, `frame` from `rest_frame_kernel`.
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
    normal = normal_kernel(tangent[0], tangent[1])
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
    normal = normal_kernel(t, s)
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
