"""Intervals of the constants by three methods; the one that covers is reported.

Coverage in seeded repeats (benchmarks/coverage.py) decides: the calibrated profile likelihood is
reported. The Fisher interval agrees with it away from the bounds of Poisson's ratio and is wrong at
them; the percentile bootstrap over few probings is too narrow.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from palpate.estimation.intervals.bootstrap import bootstrap_constants
from palpate.estimation.intervals.profile_likelihood import (
    FixedWeights,
    profile_curve,
    profile_intervals,
)
from palpate.estimation.intervals.sandwich import (
    DIRECTIONS,
    Scatter,
    ScoreNoise,
    Scores,
    directions,
    quantile_of,
)
from palpate.records import Constant

# Below this standard error of nu, and this far from the bounds, profile and Fisher are one.
_SMALL_ERROR = 1e-3
_FAR_FROM_BOUND = 8.0
_NORMAL = 1.959963984540054


@dataclass(frozen=True, slots=True)
class IntervalSet:
    """The three constants with their intervals by one method.

    Parameters
    ----------
    method : str                    "fisher", "profile" or "bootstrap"
    poisson_ratio, shear_modulus, young_modulus : Constant
    reaches_bounds : bool           the interval of nu ends at both ends of its range
    """

    method: str
    poisson_ratio: Constant
    shear_modulus: Constant
    young_modulus: Constant
    reaches_bounds: bool


def constants_at(poisson_ratio: float, shear_modulus: float) -> dict[str, float]:
    """Values of the three constants by name; moduli in Pa."""
    young = 2 * shear_modulus * (1 + poisson_ratio)
    values = (poisson_ratio, shear_modulus, young)
    return dict(zip(DIRECTIONS, values, strict=True))


def scatters_of(scores: Scores, poisson_ratio: float) -> dict[str, Scatter]:
    """Disagreement of the probings about each constant."""
    return {name: scores.scatter(turn) for name, turn in directions(poisson_ratio).items()}


def interval_sets(
    poisson_ratio: float,
    shear_modulus: float,
    scores: Scores,
    noise: ScoreNoise,
    weights: FixedWeights,
    *,
    scatters: Mapping[str, Scatter],
    bootstrap_count: int,
    rng: np.random.Generator,
) -> dict[str, IntervalSet]:
    """Intervals by Fisher information, profile likelihood and bootstrap.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    scores : Scores                 at the minimum
    noise : ScoreNoise
    weights : FixedWeights          of the same probings
    scatters : constant's name -> Scatter    from the joint fit
    bootstrap_count : int           0 leaves the bootstrap out
    rng : numpy Generator

    Returns
    -------
    method -> IntervalSet
    """
    centre = constants_at(poisson_ratio, shear_modulus)
    covariance = scores.covariance()
    turns = directions(poisson_ratio)
    error, quantile, allowed = {}, {}, {}
    for name, turn in turns.items():
        error[name] = float(np.sqrt(turn @ covariance @ turn * scatters[name].factor))
        quantile[name] = quantile_of(noise, scatters[name])
        bare = scores.curvature_variance(turn)
        allowed[name] = quantile[name] ** 2 * error[name] ** 2 / bare
    fisher = {
        name: _spread(name, centre[name], quantile[name] * error[name]) for name in DIRECTIONS
    }
    low, high = weights.poisson_range
    fisher["poisson_ratio"] = tuple(np.clip(fisher["poisson_ratio"], low, high).tolist())
    found = {"fisher": _interval_set("fisher", centre, fisher, quantile, weights)}
    room = min(poisson_ratio - low, high - poisson_ratio)
    if error["poisson_ratio"] < min(_SMALL_ERROR, room / _FAR_FROM_BOUND):
        profile = fisher
    else:
        curve = profile_curve(
            weights,
            centre=poisson_ratio,
            half_width=2 * quantile["poisson_ratio"] * error["poisson_ratio"],
            enough=max(allowed.values()),
        )
        profile = profile_intervals(curve, allowed)
    found["profile"] = _interval_set("profile", centre, profile, quantile, weights)
    if bootstrap_count:
        drawn = bootstrap_constants(scores, count=bootstrap_count, rng=rng)
        resampled = _percentiles(centre, drawn, turns, weights.poisson_range)
        normal = dict.fromkeys(DIRECTIONS, _NORMAL)
        found["bootstrap"] = _interval_set("bootstrap", centre, resampled, normal, weights)
    return found


def _spread(name: str, value: float, half_width: float) -> tuple[float, float]:
    """Symmetric interval of nu, or of the logarithm of a modulus."""
    if name == "poisson_ratio":
        return value - half_width, value + half_width
    factor = float(np.exp(min(half_width, 600.0)))
    return value / factor, value * factor


def _percentiles(
    centre: Mapping[str, float],
    drawn: np.ndarray,
    turns: Mapping[str, np.ndarray],
    poisson_range: tuple[float, float],
) -> dict[str, tuple[float, float]]:
    """Central 95 % of the resampled constants."""
    intervals = {}
    for name, turn in turns.items():
        low, high = np.percentile(drawn @ turn, [2.5, 97.5]).tolist()
        if name == "poisson_ratio":
            pair = np.clip([centre[name] + low, centre[name] + high], *poisson_range)
            intervals[name] = (float(pair[0]), float(pair[1]))
        else:
            intervals[name] = tuple(
                (centre[name] * np.exp(np.clip([low, high], -600, 600))).tolist()
            )
    return intervals


def _interval_set(
    method: str,
    centre: Mapping[str, float],
    intervals: Mapping[str, tuple[float, float]],
    quantile: Mapping[str, float],
    weights: FixedWeights,
) -> IntervalSet:
    """Constants with intervals that hold the estimate; std is the half-width over the quantile."""
    constants = {}
    for name in DIRECTIONS:
        low, high = intervals[name]
        low, high = min(low, centre[name]), max(high, centre[name])
        std = (high - low) / (2 * quantile[name])
        constants[name] = Constant(centre[name], std, (low, high))
    low, high = constants["poisson_ratio"].ci95
    reaches = low <= weights.poisson_range[0] and high >= weights.poisson_range[1]
    return IntervalSet(method, **constants, reaches_bounds=reaches)
