"""Lens distortion, its derivative and its inverse, as kernels.

OpenCV's rational model in the plane z = 1 of the camera (formulas in `camera.py`). Far from the
axis such polynomials fold over: two rays reach one pixel. Only the branch that holds the axis is
the lens; `lens_reach` says how far it goes.

No `fastmath` here: NaN means "not seen" and has to come through.
"""

import numpy as np
from jaxtyping import Float
from numba import njit

# What the inverse may leave, in the plane z = 1: 1e-13 is 7e-10 px at a focal length of 7000 px,
# and far above rounding.
_LEFT_OVER = 1e-13
# Roots whose imaginary part is below this share are real; numpy's are good to about 1e-12.
_REAL = 1e-9
# Rays farther from the axis than this (89.94 degrees) are of no camera.
_FARTHEST = 1e3


def lens_reach(distortion: Float[np.ndarray, "8"]) -> float:
    """Distance from the axis, in the plane z = 1, at which the radial distortion folds over.

    Parameters
    ----------
    distortion : (8,) float [-]     k1 k2 p1 p2 k3 k4 k5 k6

    Returns
    -------
    float [-]                       smallest r > 0 where r radial(r^2) stops to rise or has a pole;
                                    infinite where it always rises
    """
    k1, k2, _, _, k3, k4, k5, k6 = (float(term) for term in distortion)
    if not any((k1, k2, k3, k4, k5, k6)):
        return float("inf")
    over, under = np.poly1d([k3, k2, k1, 1.0]), np.poly1d([k6, k5, k4, 1.0])
    # With u = r^2 the slope of r over / under is this polynomial, over under^2.
    u = np.poly1d([1.0, 0.0])
    slope = over * under + 2.0 * u * (over.deriv() * under - over * under.deriv())
    roots = np.concatenate([slope.roots, under.roots])
    real = roots.real[np.abs(roots.imag) <= _REAL * np.abs(roots)]
    positive = real[real > 0.0]
    return float(np.sqrt(positive.min())) if len(positive) else float("inf")


@njit(cache=True, error_model="numpy")
def distort_kernel(c, a, b):
    """Distorted place of (a, b) and its derivatives: x by a, x by b (= y by a), y by b."""
    r2 = a * a + b * b
    over = 1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[9]))
    under = 1.0 + r2 * (c[10] + r2 * (c[11] + r2 * c[12]))
    over_slope = c[5] + r2 * (2.0 * c[6] + 3.0 * r2 * c[9])
    under_slope = c[10] + r2 * (2.0 * c[11] + 3.0 * r2 * c[12])
    radial = over / under
    slope = 2.0 * (over_slope - radial * under_slope) / under
    p1, p2 = c[7], c[8]
    x = a * radial + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    y = b * radial + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    xa = radial + a * a * slope + 2.0 * p1 * b + 6.0 * p2 * a
    xb = a * b * slope + 2.0 * p1 * a + 2.0 * p2 * b
    yb = radial + b * b * slope + 6.0 * p1 * b + 2.0 * p2 * a
    return x, y, xa, xb, yb


@njit(cache=True, error_model="numpy")
def jacobian_kernel(c, x, y, z, out):
    """Pixel of an object point and its depth; the pixel's derivative goes into `out` (2, 3)."""
    zc = c[19] * x + c[20] * y + c[21] * z + c[24]
    a = (c[13] * x + c[14] * y + c[15] * z + c[22]) / zc
    b = (c[16] * x + c[17] * y + c[18] * z + c[23]) / zc
    xd, yd, xa, xb, yb = distort_kernel(c, a, b)
    column_a, column_b = c[0] * xa + c[4] * xb, c[0] * xb + c[4] * yb
    row_a, row_b = c[1] * xb, c[1] * yb
    for k in range(3):
        along_a = (c[13 + k] - a * c[19 + k]) / zc
        along_b = (c[16 + k] - b * c[19 + k]) / zc
        out[0, k] = column_a * along_a + column_b * along_b
        out[1, k] = row_a * along_a + row_b * along_b
    return c[0] * xd + c[4] * yd + c[2], c[1] * yd + c[3], zc


@njit(cache=True, error_model="numpy")
def _is_seen(c, reach, x, y, z):
    """True for a point before the camera and on the lens's branch that holds the axis."""
    zc = c[19] * x + c[20] * y + c[21] * z + c[24]
    if not zc > 0.0:
        return False
    a = (c[13] * x + c[14] * y + c[15] * z + c[22]) / zc
    b = (c[16] * x + c[17] * y + c[18] * z + c[23]) / zc
    _, _, xa, xb, yb = distort_kernel(c, a, b)
    return a * a + b * b < reach * reach and xa * yb - xb * xb > 0.0


@njit(cache=True, error_model="numpy")
def projections_kernel(c, reach, points, pixels):
    """Pixels (n, 2) of points (n, 3); NaN where the camera cannot see a point."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not _is_seen(c, reach, x, y, z):
            pixels[i, :] = np.nan
            continue
        zc = c[19] * x + c[20] * y + c[21] * z + c[24]
        a = (c[13] * x + c[14] * y + c[15] * z + c[22]) / zc
        b = (c[16] * x + c[17] * y + c[18] * z + c[23]) / zc
        xd, yd, _, _, _ = distort_kernel(c, a, b)
        pixels[i, 0] = c[0] * xd + c[4] * yd + c[2]
        pixels[i, 1] = c[1] * yd + c[3]


@njit(cache=True, error_model="numpy")
def jacobians_kernel(c, reach, points, pixels, jacobians):
    """As `projections_kernel`, with the derivatives (n, 2, 3) too."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if _is_seen(c, reach, x, y, z):
            pixels[i, 0], pixels[i, 1], _ = jacobian_kernel(c, x, y, z, jacobians[i])
        else:
            pixels[i, :] = np.nan
            jacobians[i, :, :] = np.nan


@njit(cache=True, error_model="numpy")
def _radial_start(c, distorted, reach):
    """Radius that the radial terms alone take to `distorted`, on the branch that holds the axis.

    Newton within a bracket, so that no start is too far off. Where nothing gets so far out, the
    last radius before the fold.
    """
    low, high = 0.0, min(reach, 2.0 * distorted)
    while high < reach and high < _FARTHEST:
        r2 = high * high
        over = 1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[9]))
        if high * over / (1.0 + r2 * (c[10] + r2 * (c[11] + r2 * c[12]))) >= distorted:
            break
        high = min(2.0 * high, reach)
    radius = min(distorted, 0.5 * high)
    for _ in range(100):
        r2 = radius * radius
        over = 1.0 + r2 * (c[5] + r2 * (c[6] + r2 * c[9]))
        under = 1.0 + r2 * (c[10] + r2 * (c[11] + r2 * c[12]))
        over_slope = c[5] + r2 * (2.0 * c[6] + 3.0 * r2 * c[9])
        under_slope = c[10] + r2 * (2.0 * c[11] + 3.0 * r2 * c[12])
        excess = radius * over / under - distorted
        slope = (over + 2.0 * r2 * (over_slope - over / under * under_slope)) / under
        if excess > 0.0:
            high = radius
        else:
            low = radius
        step = radius - excess / slope
        if not low < step < high:
            step = 0.5 * (low + high)
        if abs(step - radius) <= 1e-15 * radius:
            break
        radius = step
    return radius


@njit(cache=True, error_model="numpy")
def _undistort(c, reach, x, y):
    """Place whose distorted place is (x, y), by Newton; NaN where the lens has none."""
    distorted = np.hypot(x, y)
    if distorted == 0.0 and c[7] == 0.0 and c[8] == 0.0:
        return x, y
    scale = _radial_start(c, distorted, reach) / distorted if distorted > 0.0 else 0.0
    a, b = x * scale, y * scale
    limit = reach * reach
    for _ in range(50):
        u, v, xa, xb, yb = distort_kernel(c, a, b)
        determinant = xa * yb - xb * xb
        step_a = (yb * (x - u) - xb * (y - v)) / determinant
        step_b = (xa * (y - v) - xb * (x - u)) / determinant
        # A step across the fold would end on another branch.
        for _ in range(50):
            if (a + step_a) ** 2 + (b + step_b) ** 2 < limit:
                break
            step_a, step_b = 0.5 * step_a, 0.5 * step_b
        a, b = a + step_a, b + step_b
        if abs(step_a) + abs(step_b) <= 1e-15 * (abs(a) + abs(b)):
            break
    u, v, xa, xb, yb = distort_kernel(c, a, b)
    left = np.hypot(x - u, y - v)
    if left <= _LEFT_OVER * (1.0 + distorted) and xa * yb > xb * xb:
        return a, b
    return np.nan, np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def normalised_kernel(begin, end, c, reach, pixels, out):
    """x / z and y / z (n, 2) of the rays that reach pixels (n, 2); NaN where none does."""
    plain = True
    for k in range(5, 13):
        plain = plain and c[k] == 0.0
    for i in range(begin, end):
        y = (pixels[i, 1] - c[3]) / c[1]
        x = (pixels[i, 0] - c[2] - c[4] * y) / c[0]
        if plain:
            out[i, 0], out[i, 1] = x, y
        else:
            out[i, 0], out[i, 1] = _undistort(c, reach, x, y)
