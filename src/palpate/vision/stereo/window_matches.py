"""Windows of one camera's picture in another's, each as large as the surface allows.

A large window knows its match well where the surface is smooth, and is wrong where it lies across
an edge of the object. Of windows of growing size the largest is taken whose match no smaller one
contradicts.

Source: Katkovnik, A new method for varying adaptive bandwidth selection, IEEE Transactions on
Signal Processing 47 (1999): the intersection of confidence intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float, Int

from palpate.shapes import PointIndices, PointScalars
from palpate.vision.images import SplinePicture
from palpate.vision.matching import PlanarMatch, refine_planar
from palpate.vision.range_flow import Outcome
from palpate.vision.stereo.pair_disparity import StereoStart

# Fewer pixels a side do not fix six coefficients a component.
SMALLEST_WINDOW = 9
# Sides of the windows as shares of the largest, each with half the pixels of the next.
_SHARES = (0.43, 0.53, 0.7, 1.0)
# A match known no better than this is not known: sub-pixel matching is ten times better [px].
_TEXTURE_LIMIT = 0.1
# Below this correlation a window shows as much noise, or something else, as texture.
_LEAST_SCORE = 0.7
# What is left of the best quarter of the windows is noise alone; it differs little among them.
_BEST = 25.0
# Half widths of the confidence intervals, in standard deviations: Katkovnik's figure.
_INTERVAL = 2.0
# Systematic error of a match from interpolation and the pixels' response, at best [px].
_BIAS = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class WindowMatches:
    """Points of one picture in another.

    Attributes
    ----------
    displacement : (n, 2) float [px]        NaN, as the rest, where the outcome is not VALID
    gradient : (n, 2, 2) float [-]          [i, j]: derivative of component i by coordinate j
    covariance : (n, 2, 2) float [px^2]
    score : (n,) float [-]                  normalised cross-correlation
    window : (n,) int [px]                  side of the window, 0 where there is none
    outcome : (n,) int                      an `Outcome`
    """

    displacement: Float[np.ndarray, "n 2"]
    gradient: Float[np.ndarray, "n 2 2"]
    covariance: Float[np.ndarray, "n 2 2"]
    score: PointScalars
    window: PointIndices
    outcome: PointIndices


@dataclass(frozen=True, slots=True, eq=False)
class _Try:
    """Windows of one size: their matches, what these leave, and the contrast beside the middle."""

    side: int
    match: PlanarMatch
    left: PointScalars
    beside: PointScalars


def window_matches(
    first: SplinePicture,
    second: SplinePicture,
    pixel: Float[np.ndarray, "n 2"],
    start: StereoStart,
    *,
    subset: int,
    shape: Literal["affine", "quadratic"],
    excess: float,
) -> WindowMatches:
    """Match windows around points of one picture in another, to a hundredth of a pixel.

    Parameters
    ----------
    first, second : SplinePicture
    pixel : (n, 2) float [px]       whole column and row in the first
    start : StereoStart             of the points, good to a pixel or two
    subset : int [px]               side of the largest window, odd
    shape : "affine" or "quadratic" how the match may vary within a window
    excess : float                  a window is rejected where it leaves more than so many times
                                    what good ones leave

    Returns
    -------
    WindowMatches
    """
    rows = np.flatnonzero(np.isfinite(start.displacement).all(axis=1))
    tries = []
    for side in _windows(subset):
        match = refine_planar(
            first,
            second,
            pixel[rows],
            start.displacement[rows],
            start_gradient=start.gradient[rows],
            subset=side,
            shape=shape,
        )
        tries.append(_Try(side, match, *_contrast(first, pixel[rows], match, side)))
    last = tries[-1]
    decent = last.match.converged & (last.match.score > _LEAST_SCORE)
    noise = float(np.percentile(last.left[decent], _BEST)) if decent.any() else np.inf
    outcomes = [_outcomes(one, noise, excess) for one in tries]
    choice = _largest(tries, outcomes, noise)
    found = choice >= 0
    # A smaller window has other reasons to fail; that of the largest one is told.
    outcome = np.full(len(pixel), int(Outcome.HIDDEN))
    outcome[rows] = np.where(outcomes[-1] == Outcome.VALID, int(Outcome.SCORE), outcomes[-1])
    outcome[rows[found]] = Outcome.VALID

    def chosen(name: str) -> np.ndarray:
        values = np.stack([getattr(one.match, name)[found] for one in tries])
        result = np.full((len(pixel), *values.shape[2:]), np.nan)
        result[rows[found]] = values[choice[found], np.arange(values.shape[1])]
        return result

    window = np.zeros(len(pixel), dtype=np.int64)
    window[rows[found]] = np.array([one.side for one in tries])[choice[found]]
    return WindowMatches(
        displacement=chosen("displacement"),
        gradient=chosen("gradient"),
        covariance=chosen("covariance"),
        score=chosen("score"),
        window=window,
        outcome=outcome,
    )


def _largest(
    tries: Sequence[_Try], outcomes: Sequence[Int[np.ndarray, " n"]], noise: float
) -> Int[np.ndarray, " n"]:
    """Index of the largest window that no smaller one contradicts; -1 where none is good."""
    n = len(tries[0].left)
    choice = np.full(n, -1)
    low, high = np.full((n, 2), -np.inf), np.full((n, 2), np.inf)
    contradicted = np.zeros(n, dtype=bool)
    for k, (one, outcome) in enumerate(zip(tries, outcomes, strict=True)):
        good = outcome == Outcome.VALID
        variance = np.einsum("nii->ni", one.match.covariance)
        # What a window leaves beyond the noise must not excuse its contradiction.
        share = np.minimum(1.0, noise / np.maximum(one.left, 1e-9))[:, None]
        reach = _INTERVAL * np.sqrt(share**2 * variance + _BIAS**2)
        new_low = np.fmax(low, one.match.displacement - reach)
        new_high = np.fmin(high, one.match.displacement + reach)
        contradicted |= good & ~(new_low <= new_high).all(axis=1)
        take = good & ~contradicted
        choice[take] = k
        low[take], high[take] = new_low[take], new_high[take]
    return choice


def _windows(subset: int) -> list[int]:
    """Sides of the windows that are tried, smallest first."""
    sides = [2 * round(0.5 * share * subset - 0.5) + 1 for share in _SHARES]
    return sorted({max(side, SMALLEST_WINDOW) for side in sides})


def _contrast(
    picture: SplinePicture, pixel: Float[np.ndarray, "n 2"], match: PlanarMatch, side: int
) -> tuple[PointScalars, PointScalars]:
    """What each match leaves [grey levels], and the least variance beside the window's middle.

    The latter over windows of a third of the side to the left, right, above and below: where one of
    them is blank, the point may lie beyond an outline.
    """
    size = np.array(picture.grey.shape[::-1]) - 1
    column, row = pixel.astype(np.int64).T
    share = np.maximum(match.score, 1e-6) ** -2 - 1.0
    left = np.sqrt(share * _variance(picture, side)[row, column])
    third = side // 3 - 1 + (side // 3) % 2
    small = _variance(picture, third)
    away = third // 2 + 1
    beside = [
        small[np.clip(row + i, 0, size[1]), np.clip(column + j, 0, size[0])]
        for i, j in ((-away, 0), (away, 0), (0, -away), (0, away))
    ]
    return left, np.min(beside, axis=0)


def _variance(picture: SplinePicture, side: int) -> Float[np.ndarray, "rows columns"]:
    """Variance of the grey levels in the window around every pixel [grey levels^2]."""
    mean = cv2.blur(picture.grey, (side, side)).astype(np.float64)
    square = cv2.sqrBoxFilter(picture.grey, cv2.CV_64F, (side, side))
    return np.maximum(square - mean**2, 0.0)


def _outcomes(one: _Try, noise: float, excess: float) -> Int[np.ndarray, " n"]:
    """What became of windows of one size."""
    match = one.match
    outcome = np.full(len(one.left), int(Outcome.VALID))
    sigma = np.sqrt(np.trace(match.covariance, axis1=1, axis2=2))
    with np.errstate(invalid="ignore"):
        blank = ~(one.beside > 2.0 * noise**2)
        outcome[blank | (sigma > _TEXTURE_LIMIT)] = Outcome.TEXTURE
        outcome[(match.score < _LEAST_SCORE) | (one.left > excess * noise)] = Outcome.SCORE
    outcome[~match.converged] = Outcome.LOST
    return outcome
