"""Sampling of a camera's later picture where the moved surface points of a window appear."""

import numpy as np
from numba import njit

from palpate.vision.cameras.lens import distort_kernel
from palpate.vision.images.spline import noise_fraction_kernel, sample_kernel


@njit(cache=True, fastmath=True, error_model="numpy")
def sample_surface_kernel(camera, moved, basis, weight, point, q, frame, half_window, sampled):
    """Sample the later picture at the projections of the moved surface points.

    `moved` are spline coefficients, `basis` and `weight` those of the window's pixels, `point` (3,)
    [m], `q` (6, 3) [m] the motion, `frame` (3, 3) the deformed tangents and normal. `sampled`
    (pixels,) [grey levels] is filled. Returns the mean fraction of noise variance left.
    """
    c = np.empty((7, 3))
    camera_polynomial_kernel(camera, point, q, frame, half_window, c)
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
def camera_polynomial_kernel(camera, point, q, frame, half_window, c):
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
    lens, polynomials = constants_kernel(camera, c)
    height = basis[len(basis) - 1]
    for p in range(len(columns)):
        columns[p], rows[p] = moved_pixel_kernel(
            lens, polynomials, basis[1, p], basis[2, p], height[p]
        )


@njit(cache=True, fastmath=True, error_model="numpy", inline="always")
def constants_kernel(camera, c):
    """Lens and pinhole of a camera, and its polynomials, as tuples for `moved_pixel_kernel`.

    `camera` (25,) packed, `c` (7, 3) from `camera_polynomial_kernel`.
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
def moved_pixel_kernel(lens, polynomials, xi, eta, zeta):
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
