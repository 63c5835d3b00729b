"""Sub-pixel displacement of windows between two pictures.

Inverse-compositional Gauss-Newton on a square subset with a constant, affine or quadratic shape
function; gain and offset of the second picture are further unknowns, eliminated in closed form.

Source: Baker and Matthews, Lucas-Kanade 20 years on, International Journal of Computer Vision 56
(2004); Gao et al., High-efficiency and high-accuracy digital image correlation, Optics and Lasers
in Engineering 65 (2015).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.errors import InputError
from palpate.shapes import Flags, PointScalars
from palpate.threads import in_threads
from palpate.vision.images.spline import SplinePicture, noise_fraction_kernel, sample_kernel
from palpate.vision.matching.window_sums import (
    BASES,
    EXPONENTS,
    load_window_kernel,
    window_residual_kernel,
    window_right_kernel,
    window_system_kernel,
)
from palpate.vision.small_systems.cholesky import (
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
)

# The iteration ends when a step is shorter than this [px]; far below the noise.
_TOLERANCE_PX = 5e-4
# Gauss-Newton steps at most.
_MAX_ITERATIONS = 30
# A window that moves farther than this from its start is lost [px].
_MAX_MOVE_PX = 8.0
# Minimum number of windows per thread: each takes about 0.03 ms.
_MIN_WINDOWS_PER_THREAD = 32


@dataclass(frozen=True, slots=True, eq=False)
class PlanarMatch:
    """Displacements of windows from one picture to another.

    Attributes
    ----------
    displacement : (n, 2) float [px]        column, row
    gradient : (n, 2, 2) float [-]          [i, j]: d(component i) / d(coordinate j)
    covariance : (n, 2, 2) float [px^2]     from residual variance and picture gradients
    score : (n,) float [-]                  normalised cross-correlation, at most 1
    converged : (n,) bool                   where False, the other attributes are NaN
    """

    displacement: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    score: PointScalars
    converged: Flags


def refine_planar(
    reference: SplinePicture,
    moved: SplinePicture,
    points: Float[np.ndarray, "n 2"],
    start: Float[np.ndarray, "n 2"],
    *,
    subset: int = 21,
    shape: Literal["shift", "affine", "quadratic"] = "affine",
    start_gradient: Float[np.ndarray, "n 2 2"] | None = None,
) -> PlanarMatch:
    """Refine the displacement of windows between two pictures to about a hundredth of a pixel.

    Parameters
    ----------
    reference, moved : SplinePicture
    points : (n, 2) float [px]      centres of the windows in `reference`, whole pixels
    start : (n, 2) float [px]       initial displacements, accurate to about two pixels
    subset : int [px]               side of a window, odd, at least 5
    shape : "shift", "affine" or "quadratic"    shape function: how the displacement may vary within
                                    the window, in addition to `start_gradient`
    start_gradient : (n, 2, 2) float [-]    initial displacement gradient; zero by default

    Returns
    -------
    PlanarMatch                     not converged where a window lies outside a picture, has no
                                    contrast, or is lost

    Raises
    ------
    InputError                      the subset is even or below 5

    Source
    ------
    Baker and Matthews (2004), inverse-compositional algorithm; Gao et al. (2015), its use in
    digital image correlation.
    """
    if subset < 5 or subset % 2 == 0:
        raise InputError(f"subset is {subset}; must be an odd number of pixels, 5 or more")
    count = len(points)
    if start_gradient is None:
        start_gradient = np.zeros((count, 2, 2))
    found = PlanarMatch(
        np.full((count, 2), np.nan),
        np.full((count, 2, 2), np.nan),
        np.full((count, 2, 2), np.nan),
        np.full(count, np.nan),
        np.zeros(count, dtype=bool),
    )
    in_threads(
        _refine_range, count, reference.grey, reference.along_column, reference.along_row,
        moved.coefficients, _polynomials(subset // 2, BASES[shape]),
        np.ascontiguousarray(np.rint(points), dtype=np.int64),
        np.ascontiguousarray(start, dtype=np.float64),
        np.ascontiguousarray(start_gradient, dtype=np.float64), subset // 2,
        found.displacement, found.gradient, found.covariance, found.score, found.converged,
        min_items=_MIN_WINDOWS_PER_THREAD,
    )  # fmt: skip
    return found


def _polynomials(half: int, bases: int) -> Float[np.ndarray, "_ _"]:
    """Monomials of the distance from the centre in half sides, (bases, pixels) float32."""
    eta, xi = (np.mgrid[-half : half + 1, -half : half + 1] / half).reshape(2, -1)
    return np.stack([xi**i * eta**j for i, j in EXPONENTS[:bases]]).astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _refine_range(
    begin, end, grey, along_column, along_row, moved, basis, points, start, start_gradient, half,
    displacement, gradient, covariance, score, converged,
):  # fmt: skip
    bases, pixels = basis.shape
    window = np.ones((6, pixels), dtype=np.float32)
    sampled = np.empty(pixels, dtype=np.float32)
    hessian = np.empty((2 * bases, 2 * bases))
    inverse = np.empty((2 * bases, 2 * bases))
    right = np.empty(2 * bases)
    warp = np.empty((2, 6))
    sums = np.empty((2 * bases, 4))
    illumination = np.empty(4)
    for i in range(begin, end):
        column, row = points[i, 0], points[i, 1]
        if not (
            half <= column < grey.shape[1] - half
            and half <= row < grey.shape[0] - half
            and np.isfinite(start[i, 0] + start[i, 1])
        ):
            continue
        pixel_count, mean, square = load_window_kernel(
            grey, along_column, along_row, column, row, half, False, 0.0, window
        )
        if square <= 0.0:
            continue
        window_system_kernel(window, basis, pixel_count, square, sampled, sums, hessian)
        if not cholesky_kernel(hessian):
            continue
        warp[:] = 0.0
        for a in range(2):
            warp[a, 0] = start[i, a]
            warp[a, 1] = start_gradient[i, a, 0] * half
            warp[a, 2] = start_gradient[i, a, 1] * half
        done = False
        for _ in range(_MAX_ITERATIONS):
            _sample_window_kernel(moved, warp, column, row, half, sampled)
            gain = window_right_kernel(
                window, basis, sampled, pixel_count, mean, square, sums, right, illumination
            )
            if not gain > 0.0:
                break
            cholesky_solve_kernel(hessian, right)
            step = _update_kernel(warp, right, half)
            move = max(abs(warp[0, 0] - start[i, 0]), abs(warp[1, 0] - start[i, 1]))
            if not move <= _MAX_MOVE_PX:
                break
            if step < _TOLERANCE_PX:
                done = True
                break
        if not done or not _stays_inside_kernel(warp, column, row, half, grey.shape):
            continue
        noise_fraction = _sample_window_kernel(moved, warp, column, row, half, sampled)
        gain = window_right_kernel(
            window, basis, sampled, pixel_count, mean, square, sums, right, illumination
        )
        if not gain > 0.0:
            continue
        converged[i] = True
        squares = window_residual_kernel(window, sampled, illumination)
        score[i] = np.sqrt(square / (square + squares))
        variance = 2.0 / (1.0 + noise_fraction) * squares / (pixel_count - 2.0 * bases - 2.0)
        cholesky_inverse_kernel(hessian, inverse)
        for a in range(2):
            displacement[i, a] = warp[a, 0]
            gradient[i, a, 0] = warp[a, 1] / half
            gradient[i, a, 1] = warp[a, 2] / half
            for b in range(2):
                covariance[i, a, b] = variance * inverse[a, b]


@njit(cache=True, fastmath=True, error_model="numpy")
def _sample_window_kernel(moved, warp, column, row, half, sampled):
    """Sample the moved picture at the warped pixels.

    Returns the mean fraction of the noise variance that interpolation leaves.
    """
    scale = np.float32(1.0 / half)
    c3 = np.float32(warp[0, 3])
    r3 = np.float32(warp[1, 3])
    columns, rows = np.empty(len(sampled), np.float32), np.empty(len(sampled), np.float32)
    fractions = np.float32(0.0)
    for r in range(2 * half + 1):
        eta = (r - half) / half
        c0 = np.float32(column + warp[0, 0] + eta * (warp[0, 2] + eta * warp[0, 5]))
        c1 = np.float32(warp[0, 1] + eta * warp[0, 4])
        r0 = np.float32(row + r - half + warp[1, 0] + eta * (warp[1, 2] + eta * warp[1, 5]))
        r1 = np.float32(warp[1, 1] + eta * warp[1, 4])
        first = r * (2 * half + 1)
        for k in range(2 * half + 1):
            along = np.float32(k - half)
            xi = along * scale
            columns[first + k] = c0 + along + xi * (c1 + xi * c3)
            rows[first + k] = r0 + xi * (r1 + xi * r3)
    sample_kernel(moved, columns, rows, sampled)
    for p in range(len(sampled)):
        fractions += noise_fraction_kernel(columns[p], rows[p])
    return fractions / (2 * half + 1) ** 2


@njit(cache=True, error_model="numpy")
def _update_kernel(warp, step, half):
    """Compose the warp with the inverse of the step; returns the step's length at the centre [px].

    To first order in the step the composition is u - (1 + grad u) step, with the gradient at the
    centre. The neglected terms vanish with the step, so they cost iterations but no accuracy.
    """
    a00 = 1.0 + warp[0, 1] / half
    a01 = warp[0, 2] / half
    a10 = warp[1, 1] / half
    a11 = 1.0 + warp[1, 2] / half
    for k in range(len(step) // 2):
        x, y = step[2 * k], step[2 * k + 1]
        warp[0, k] -= a00 * x + a01 * y
        warp[1, k] -= a10 * x + a11 * y
    return np.hypot(step[0], step[1])


@njit(cache=True, error_model="numpy")
def _stays_inside_kernel(warp, column, row, half, shape):
    """True where the four corners of the moved window lie within the picture."""
    for xi in (-1.0, 1.0):
        for eta in (-1.0, 1.0):
            x = column + xi * half
            y = row + eta * half
            for k in range(6):
                value = xi ** EXPONENTS[k, 0] * eta ** EXPONENTS[k, 1]
                x += warp[0, k] * value
                y += warp[1, k] * value
            if not (0.0 <= x <= shape[1] - 1.0 and 0.0 <= y <= shape[0] - 1.0):
                return False
    return True
