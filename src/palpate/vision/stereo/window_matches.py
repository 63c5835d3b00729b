"""Matching windows between two cameras, each window as large as the surface allows.

A large window gives a precise match where the surface is smooth, but a wrong one across an edge of
the object. Of windows of increasing size, the largest one consistent with all smaller ones is used.

Source: Katkovnik, A new method for varying adaptive bandwidth selection, IEEE Transactions on
Signal Processing 47 (1999): the intersection of confidence intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from palpate.shapes import PointIndices, PointScalars
from palpate.vision.images.normalisation import moments
from palpate.vision.images.spline import SplinePicture
from palpate.vision.matching.outliers import neighbours_median
from palpate.vision.matching.planar_match import PlanarMatch, refine_planar
from palpate.vision.range_flow.flow import Outcome
from palpate.vision.stereo.pair_disparity import StereoStart

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
_AROUND = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


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
class _Attempt:
    """Windows of one size: matches, rms residuals, and minimum variance beside the centre."""

    match: PlanarMatch
    residual: PointScalars
    beside: PointScalars


def window_matches(
    first: SplinePicture,
    second: SplinePicture,
    pixel: Float[np.ndarray, "n 2"],
    start: StereoStart,
    *,
    subset: int,
) -> WindowMatches:
    """Match windows around points of one picture in another, to a hundredth of a pixel.

    Parameters
    ----------
    first, second : SplinePicture
    pixel : (n, 2) float [px]       column and row in the first, whole numbers
    start : StereoStart             of the points, accurate to one or two pixels
    subset : int [px]               side of the largest window, odd

    Returns
    -------
    WindowMatches
    """
    rows = np.flatnonzero(np.isfinite(start.displacement).all(axis=1))
    attempts = []
    for side in _sides(subset):
        match = refine_planar(
            first,
            second,
            pixel[rows],
            start.displacement[rows],
            start_gradient=start.gradient[rows],
            subset=side,
            shape="quadratic",
        )
        attempts.append(_Attempt(match, *_contrast(first, pixel[rows], match, side)))
    largest = attempts[-1]
    decent = largest.match.converged & (largest.match.score > _MIN_SCORE)
    residual = largest.residual[decent]
    noise = float(np.percentile(residual, _NOISE_PERCENTILE)) if len(residual) else np.inf
    outcomes = [_outcomes(attempt, noise) for attempt in attempts]
    choice = _largest_consistent(attempts, outcomes, noise)
    found = np.flatnonzero(choice >= 0)
    # The reason for failure of the largest window is the one reported.
    outcome = np.full(len(pixel), int(Outcome.HIDDEN))
    outcome[rows] = np.where(outcomes[-1] == Outcome.VALID, int(Outcome.SCORE), outcomes[-1])
    outcome[rows[found]] = Outcome.VALID

    def chosen(name: str) -> np.ndarray:
        values = np.stack([getattr(attempt.match, name) for attempt in attempts])
        result = np.full((len(pixel), *values.shape[2:]), np.nan)
        result[rows[found]] = values[choice[found], found]
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
        there = (near >= 0) & good[near]
        median = neighbours_median(expected, there)
        scatter = neighbours_median(np.linalg.norm(expected - median[:, None], axis=2), there)
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
    n = len(attempts[0].residual)
    choice = np.full(n, -1)
    low, high = np.full((n, 2), -np.inf), np.full((n, 2), np.inf)
    contradicted = np.zeros(n, dtype=bool)
    for k, (attempt, outcome) in enumerate(zip(attempts, outcomes, strict=True)):
        good = outcome == Outcome.VALID
        variance = np.einsum("nii->ni", attempt.match.covariance)
        # An excess residual must not widen the interval and so hide a contradiction.
        factor = np.minimum(1.0, noise / np.maximum(attempt.residual, 1e-9))[:, None]
        half = _INTERVAL * np.sqrt(factor**2 * variance + _BIAS_PX**2)
        new_low = np.fmax(low, attempt.match.displacement - half)
        new_high = np.fmin(high, attempt.match.displacement + half)
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
    match = attempt.match
    outcome = np.full(len(match.score), int(Outcome.VALID))
    sigma = np.sqrt(np.trace(match.covariance, axis1=1, axis2=2))
    with np.errstate(invalid="ignore"):
        untextured = ~(attempt.beside > 2.0 * noise**2)
        outcome[untextured | (sigma > _MAX_SIGMA_PX)] = Outcome.TEXTURE
        excessive = attempt.residual > _MAX_EXCESS * noise
        outcome[(match.score < _MIN_SCORE) | excessive] = Outcome.SCORE
    outcome[~match.converged] = Outcome.LOST
    return outcome
