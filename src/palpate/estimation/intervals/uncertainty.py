"""Intervals of the constants: the calibrated profile of the misfit.

Coverage is measured in seeded repeats (benchmarks/coverage.py) and on bodies that were not used for
tuning (benchmarks/coverage_of_bodies.py). Far from the bounds of Poisson's ratio the profile is a
parabola, and the interval follows from the variance alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from palpate.estimation.intervals.budget import uncertainty_budget
from palpate.estimation.intervals.profile_likelihood import profile_curve, profile_intervals
from palpate.estimation.intervals.sandwich import (
    DIRECTIONS,
    Scores,
    directions,
    scores_of,
)
from palpate.estimation.intervals.scatter import Scatter, Variance
from palpate.estimation.intervals.score_noise import ScoreNoise
from palpate.estimation.search import FixedWeights, Minimum, Misfit
from palpate.records import BudgetEntry, Constant

# Below this standard error of nu, and this many of them from the bounds, the profile is a parabola.
_SMALL_ERROR = 1e-3
_FAR_FROM_BOUND = 8.0
# Standard errors: chance alone leads farther beyond the range in one session of forty.
_CLEARLY = 2.0
# Exponents beyond this overflow.
_MAX_EXPONENT = 600.0

Ends = tuple[float, float]


@dataclass(frozen=True, slots=True)
class IntervalSet:
    """The three constants with their intervals.

    Parameters
    ----------
    poisson_ratio, shear_modulus, young_modulus : Constant      [-], [Pa], [Pa]
    """

    poisson_ratio: Constant
    shear_modulus: Constant
    young_modulus: Constant


@dataclass(frozen=True, slots=True, eq=False)
class Uncertainty:
    """Uncertainty of the constants from a set of probings, at its minimum.

    Parameters
    ----------
    minimum : Minimum
    scores : Scores                 at the minimum
    noise : ScoreNoise
    scatters : constant's name -> Scatter    disagreement of all probings of the session
    weights : FixedWeights          of the same probings, less the displacement that errors explain
    """

    minimum: Minimum
    scores: Scores
    noise: ScoreNoise
    scatters: Mapping[str, Scatter]
    weights: FixedWeights

    def variance(self, name: str) -> Variance:
        """Variance of nu, log G or log E."""
        direction = directions(self.minimum.poisson_ratio)[name]
        variance = self.scores.variance(direction, self.scatters[name])
        of_noise = min(self.noise.degrees, self.noise.blocks.total_degrees)
        return replace(variance, degrees=min(variance.degrees, of_noise))

    def error(self, name: str) -> float:
        """Standard error of nu, log G or log E."""
        return float(np.sqrt(self.variance(name).total))

    def budget(self, identifiable: Mapping[str, bool]) -> tuple[BudgetEntry, ...]:
        """Contribution of each source to the standard errors of the identifiable constants
        (`uncertainty_budget`)."""
        factors = {
            name: scatter.factor for name, scatter in self.scatters.items() if identifiable[name]
        }
        return uncertainty_budget(
            self.scores, poisson_ratio=self.minimum.poisson_ratio, factors=factors
        )

    def is_beyond_range(self) -> bool:
        """Whether the misfit's unbounded minimum lies clearly beyond the range of nu."""
        return bool(abs(self.scores.step()[0]) > _CLEARLY * self.error("poisson_ratio"))

    def calibration(self, name: str) -> float:
        """Variance of nu, log G or log E over that from the curvature of the misfit alone."""
        direction = directions(self.minimum.poisson_ratio)[name]
        return self.variance(name).total / self.scores.curvature_variance(direction)


def uncertainty_of(misfit: Misfit, minimum: Minimum, weights: FixedWeights) -> Uncertainty:
    """Uncertainty of the joint estimate from all probings of a session.

    Parameters
    ----------
    misfit : Misfit
    minimum : Minimum               of that misfit
    weights : FixedWeights          at that minimum

    Returns
    -------
    Uncertainty                     with the scatter of these probings
    """
    scores, noise = scores_of(misfit, minimum.probes)
    scatters = {
        name: scores.scatter(direction)
        for name, direction in directions(minimum.poisson_ratio).items()
    }
    return Uncertainty(minimum, scores, noise, scatters, weights)


def interval_set(uncertainty: Uncertainty) -> IntervalSet:
    """The constants with their 95 % intervals.

    Parameters
    ----------
    uncertainty : Uncertainty

    Returns
    -------
    IntervalSet                     std is the half-width over the quantile; every interval contains
                                    its estimate
    """
    minimum = uncertainty.minimum
    young = 2 * minimum.shear_modulus * (1 + minimum.poisson_ratio)
    values = (minimum.poisson_ratio, minimum.shear_modulus, young)
    centre = dict(zip(DIRECTIONS, values, strict=True))
    quantile = {name: uncertainty.variance(name).quantile for name in DIRECTIONS}
    narrow = _is_narrow(uncertainty)
    ends = _parabola(uncertainty, centre, quantile) if narrow else _profile(uncertainty, quantile)
    constants = {}
    for name in DIRECTIONS:
        low, high = min(ends[name][0], centre[name]), max(ends[name][1], centre[name])
        constants[name] = Constant(centre[name], (high - low) / (2 * quantile[name]), (low, high))
    return IntervalSet(**constants)


def _is_narrow(uncertainty: Uncertainty) -> bool:
    """Whether the misfit is a parabola over the interval, and the bounds are far."""
    low, high = uncertainty.weights.poisson_range
    nu = uncertainty.minimum.poisson_ratio
    distance = min(nu - low, high - nu)
    return uncertainty.error("poisson_ratio") < min(_SMALL_ERROR, distance / _FAR_FROM_BOUND)


def _parabola(
    uncertainty: Uncertainty, centre: Mapping[str, float], quantile: Mapping[str, float]
) -> dict[str, Ends]:
    """Symmetric intervals of nu, cut at its range, and of the logarithms of the moduli."""
    ends = {}
    for name, value in centre.items():
        reach = quantile[name] * uncertainty.error(name)
        if name == "poisson_ratio":
            low, high = np.clip([value - reach, value + reach], *uncertainty.weights.poisson_range)
        else:
            low, high = value * np.exp(np.clip([-reach, reach], -_MAX_EXPONENT, _MAX_EXPONENT))
        ends[name] = (float(low), float(high))
    return ends


def _profile(uncertainty: Uncertainty, quantile: Mapping[str, float]) -> dict[str, Ends]:
    """Where the calibrated profile of the misfit stays below the square of the quantile."""
    allowed = {name: quantile[name] ** 2 * uncertainty.calibration(name) for name in DIRECTIONS}
    curve = profile_curve(
        uncertainty.weights,
        centre=uncertainty.minimum.poisson_ratio,
        half_width=2 * quantile["poisson_ratio"] * uncertainty.error("poisson_ratio"),
        enough=max(allowed.values()),
    )
    return profile_intervals(curve, allowed)
