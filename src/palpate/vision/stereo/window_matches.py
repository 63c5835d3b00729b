"""Matching windows between two cameras, each window as large as the surface allows.

A large window gives a precise match where the surface is smooth, but a wrong one across an edge of
the object. Of windows of increasing size, the largest one consistent with all smaller ones is used.
Each is matched by inverse-compositional Gauss-Newton on a square subset with a constant, affine or
quadratic shape function; gain and offset of the second picture are further unknowns, eliminated in
closed form.

Source: Katkovnik, A new method for varying adaptive bandwidth selection, IEEE Transactions on
Signal Processing 47 (1999): the intersection of confidence intervals. Baker and Matthews,
Lucas-Kanade 20 years on, International Journal of Computer Vision 56 (2004); Gao et al.,
High-efficiency and high-accuracy digital image correlation, Optics and Lasers in Engineering 65
(2015): the match of a window.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from palpate.errors import InputError
from palpate.shapes import Flags, PointIndices, PointScalars
from palpate.threads import in_threads
from palpate.vision.cholesky import (
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
)
from palpate.vision.matching.outliers import neighbours_median
from palpate.vision.matching.window import (
    BASES,
    EXPONENTS,
    load_window_kernel,
    window_residual_kernel,
    window_right_kernel,
    window_system_kernel,
)
from palpate.vision.normalisation import moments
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import SplinePicture, noise_fraction_kernel, sample_kernel

# Smaller windows do not determine six coefficients per component.
MIN_WINDOW_PX = 9
# Sides of the windows relative to the largest.
_RELATIVE_SIDES = (0.43, 0.53, 0.7, 1.0)
# Largest standard deviation of a match [px]: good sub-pixel matching is ten times better.
_MAX_SIGMA_PX = 0.1
# Below this correlation a window shows as much noise, or something else, as texture.
_MIN_SCORE = 0.7
# Percentile of the residuals taken as noise: the best quarter of the windows leave little else.
_NOISE_PERCENTILE = 25.0
# A window is rejected if its residual exceeds this many times that noise.
_MAX_EXCESS = 2.0
# Half widths of the confidence intervals, in standard deviations: Katkovnik's value.
_INTERVAL = 2.0
# Minimum systematic error of a match, from interpolation and pixel response.
_BIAS_PX = 0.005
# A match is rejected if its neighbours contradict it by more than this many standard deviations.
_MAX_DEVIATIONS = 5.0
# Rounds of the neighbour test, because removing wrong matches changes those of the others.
_ROUNDS = 2
# Windows of one size: matches, rms residuals, and minimum variance beside the centre.
_Attempt = tuple["PlanarMatch", PointScalars, PointScalars]
_AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
# The iteration ends when a step is shorter than this [px]; far below the noise.
_TOLERANCE_PX = 5e-4
# Gauss-Newton steps at most.
_MAX_ITERATIONS = 30
# A window that moves farther than this from its start is lost [px].
_MAX_MOVE_PX = 8.0
# Minimum number of windows per thread: each takes about 0.03 ms.
_MIN_WINDOWS_PER_THREAD = 32


@dataclass(frozen=True, slots=True, eq=False)
class WindowMatches:
    """Matches of points of one picture in another.

    Attributes
    ----------
    displacement : (n, 2) float [px]        NaN where the outcome is not VALID
    gradient : (n, 2, 2) float [-]          [i, j]: d(component i) / d(coordinate j)
    covariance : (n, 2, 2) float [px^2]
    outcome : (n,) int                      an `Outcome`
    """

    displacement: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    outcome: PointIndices


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


def window_matches(
    first: SplinePicture,
    second: SplinePicture,
    pixel: Float[np.ndarray, "n 2"],
    start: tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2 2"]],
    *,
    subset: int,
) -> WindowMatches:
    """Match windows around points of one picture in another, to a hundredth of a pixel.

    Parameters
    ----------
    first, second : SplinePicture
    pixel : (n, 2) float [px]       column and row in the first, whole numbers
    start : (n, 2) float [px], (n, 2, 2) float [-]  displacement of the points, accurate to one or
                                    two pixels, and its gradient
    subset : int [px]               side of the largest window, odd

    Returns
    -------
    WindowMatches
    """
    displacement, gradient = start
    rows = np.flatnonzero(np.isfinite(displacement).all(axis=1))
    attempts = []
    for side in _sides(subset):
        match = refine_planar(
            first,
            second,
            pixel[rows],
            displacement[rows],
            start_gradient=gradient[rows],
            subset=side,
            shape="quadratic",
        )
        attempts.append((match, *_contrast(first, pixel[rows], match, side)))
    largest, residual, _ = attempts[-1]
    residual = residual[largest.converged & (largest.score > _MIN_SCORE)]
    noise = float(np.percentile(residual, _NOISE_PERCENTILE)) if len(residual) else np.inf
    outcomes = [_outcomes(attempt, noise) for attempt in attempts]
    choice = _largest_consistent(attempts, outcomes, noise)
    matched = np.flatnonzero(choice >= 0)
    # The reason for failure of the largest window is the one reported.
    outcome = np.full(len(pixel), int(Outcome.HIDDEN))
    outcome[rows] = np.where(outcomes[-1] == Outcome.VALID, int(Outcome.SCORE), outcomes[-1])
    outcome[rows[matched]] = Outcome.VALID

    def chosen(name: str) -> np.ndarray:
        values = np.stack([getattr(match, name) for match, *_ in attempts])
        result = np.full((len(pixel), *values.shape[2:]), np.nan)
        result[rows[matched]] = values[choice[matched], matched]
        return result

    return WindowMatches(chosen("displacement"), chosen("gradient"), chosen("covariance"), outcome)


def confirmed_matches(
    matches: WindowMatches, cell: Int[np.ndarray, "n 2"], pixel: Float[np.ndarray, "n 2"]
) -> WindowMatches:
    """Reject matches that their neighbours on the grid do not confirm.

    Each neighbour's match is extrapolated to the point with its own gradient. The median of these
    is compared with the point's match, in units of their scatter combined with the match's noise.
    A point with fewer than three valid neighbours is rejected.

    Parameters
    ----------
    matches : WindowMatches         n
    cell : (n, 2) int               row and column of each point on the grid
    pixel : (n, 2) float [px]

    Returns
    -------
    WindowMatches                   outcome NEIGHBOURS and displacement NaN for rejected ones

    Source
    ------
    Westerweel and Scarano, Universal outlier detection for PIV data, Experiments in Fluids 39
    (2005), to first order.
    """
    valid = matches.outcome == Outcome.VALID
    sigma = np.sqrt(np.trace(matches.covariance, axis1=1, axis2=2))
    number = np.full(cell.max(axis=0, initial=0) + 3, -1)
    number[cell[:, 0] + 1, cell[:, 1] + 1] = np.arange(len(cell))
    near = np.stack([number[cell[:, 0] + 1 + i, cell[:, 1] + 1 + j] for i, j in _AROUND], axis=1)
    offset = pixel[:, None] - pixel[near]
    carried = np.einsum("nkab,nkb->nka", matches.gradient[near], offset)
    expected = matches.displacement[near] + carried
    good = valid
    for _ in range(_ROUNDS):
        is_good = (near >= 0) & good[near]
        median = neighbours_median(expected, is_good)
        scatter = neighbours_median(np.linalg.norm(expected - median[:, None], axis=2), is_good)
        gap = np.linalg.norm(matches.displacement - median, axis=1)
        with np.errstate(invalid="ignore"):
            good = valid & (gap <= _MAX_DEVIATIONS * np.hypot(scatter, sigma))
    wrong = valid & ~good
    return replace(
        matches,
        displacement=np.where(wrong[:, None], np.nan, matches.displacement),
        outcome=np.where(wrong, int(Outcome.NEIGHBOURS), matches.outcome),
    )


def _largest_consistent(
    attempts: Sequence[_Attempt], outcomes: Sequence[Int[np.ndarray, " n"]], noise: float
) -> Int[np.ndarray, " n"]:
    """Index of the largest window consistent with all smaller ones; -1 where none is valid."""
    n = len(attempts[0][1])
    choice = np.full(n, -1)
    low, high = np.full((n, 2), -np.inf), np.full((n, 2), np.inf)
    contradicted = np.zeros(n, dtype=bool)
    for k, ((match, residual, _), outcome) in enumerate(zip(attempts, outcomes, strict=True)):
        good = outcome == Outcome.VALID
        variance = np.einsum("nii->ni", match.covariance)
        # An excess residual must not widen the interval and so hide a contradiction.
        factor = np.minimum(1.0, noise / np.maximum(residual, 1e-9))[:, None]
        half = _INTERVAL * np.sqrt(factor**2 * variance + _BIAS_PX**2)
        new_low = np.fmax(low, match.displacement - half)
        new_high = np.fmin(high, match.displacement + half)
        contradicted |= good & ~(new_low <= new_high).all(axis=1)
        take = good & ~contradicted
        choice[take] = k
        low[take], high[take] = new_low[take], new_high[take]
    return choice


def _sides(subset: int) -> list[int]:
    """Sides of the windows to try [px], smallest first."""
    sides = [2 * round(0.5 * ratio * subset - 0.5) + 1 for ratio in _RELATIVE_SIDES]
    return sorted({max(side, MIN_WINDOW_PX) for side in sides})


def _contrast(
    picture: SplinePicture, pixel: Float[np.ndarray, "n 2"], match: PlanarMatch, side: int
) -> tuple[PointScalars, PointScalars]:
    """Rms residual of each match [grey levels], and minimum variance beside the window's centre.

    The latter is the minimum over windows of a third of the side to the left and right, above and
    below [grey levels^2]: where one of them is blank, the point may lie beyond an outline.
    """
    rows, columns = picture.grey.shape
    column, row = pixel.astype(np.int64).T
    ratio = np.maximum(match.score, 1e-6) ** -2 - 1.0
    grey = picture.grey.astype(np.float64)
    residual = np.sqrt(ratio * moments(grey, side)[1][row, column])
    third = side // 3 - 1 + (side // 3) % 2
    _, small = moments(grey, third)
    away = third // 2 + 1
    beside = [
        small[np.clip(row + i, 0, rows - 1), np.clip(column + j, 0, columns - 1)]
        for i, j in ((-away, 0), (away, 0), (0, -away), (0, away))
    ]
    return residual, np.min(beside, axis=0)


def _outcomes(attempt: _Attempt, noise: float) -> Int[np.ndarray, " n"]:
    """Outcomes of the windows of one size."""
    match, residual, beside = attempt
    outcome = np.full(len(match.score), int(Outcome.VALID))
    sigma = np.sqrt(np.trace(match.covariance, axis1=1, axis2=2))
    with np.errstate(invalid="ignore"):
        untextured = ~(beside > 2.0 * noise**2)
        outcome[untextured | (sigma > _MAX_SIGMA_PX)] = Outcome.TEXTURE
        excessive = residual > _MAX_EXCESS * noise
        outcome[(match.score < _MIN_SCORE) | excessive] = Outcome.SCORE
    outcome[~match.converged] = Outcome.LOST
    return outcome


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
    match = PlanarMatch(
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
        match.displacement, match.gradient, match.covariance, match.score, match.converged,
        min_items=_MIN_WINDOWS_PER_THREAD,
    )  # fmt: skip
    return match


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
