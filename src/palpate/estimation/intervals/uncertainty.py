"""Intervals of the constants by three methods; the one that covers is the default.

Coverage in seeded repeats (benchmarks/coverage.py) decides: the calibrated profile likelihood. The
Fisher interval agrees with it away from the bounds of Poisson's ratio and is wrong at them; the
percentile bootstrap over few probings is too narrow.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtri

from palpate.estimation.intervals.profile_likelihood import profile_curve, profile_intervals
from palpate.estimation.intervals.sandwich import (
    DIRECTIONS,
    Scatter,
    ScoreNoise,
    Scores,
    directions,
    quantile_of,
    scores_of,
)
from palpate.estimation.search import FixedWeights, Minimum, Misfit
from palpate.estimation.settings import IntervalMethod
from palpate.records import Constant

# Below this standard error of nu, and this far from the bounds, profile and Fisher are one.
_SMALL_ERROR = 1e-3
_FAR_FROM_BOUND = 8.0
_RESAMPLES = 500
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
    """What a set of probings says about the constants near its minimum.

    Parameters
    ----------
    minimum : Minimum
    scores : Scores                 at the minimum
    noise : ScoreNoise
    scatters : constant's name -> Scatter    disagreement of all probings of the session
    weights : FixedWeights          of the same probings
    """

    minimum: Minimum
    scores: Scores
    noise: ScoreNoise
    scatters: Mapping[str, Scatter]
    weights: FixedWeights

    def variance(self, name: str) -> float:
        """Variance of nu, log G or log E, raised where the probings disagree."""
        turn = directions(self.minimum.poisson_ratio)[name]
        return float(turn @ self.scores.covariance() @ turn) * self.scatters[name].factor

    def is_beyond_range(self) -> bool:
        """Whether the misfit's unbounded minimum lies clearly beyond the range of nu."""
        # At a minimum inside the range the score vanishes.
        information, score = self.scores.information.sum(0), self.scores.score.sum(0)
        step = np.linalg.lstsq(information, score, rcond=1e-11)[0]
        return bool(abs(step[0]) > _CLEARLY * np.sqrt(self.variance("poisson_ratio")))

    def calibration(self, name: str) -> float:
        """That variance over the one that the bare curvature of the misfit claims."""
        turn = directions(self.minimum.poisson_ratio)[name]
        return self.variance(name) / self.scores.curvature_variance(turn)


def uncertainty_of(misfit: Misfit, minimum: Minimum, weights: FixedWeights) -> Uncertainty:
    """What all probings of a session say together.

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
    turns = directions(minimum.poisson_ratio)
    scatters = {name: scores.scatter(turn) for name, turn in turns.items()}
    return Uncertainty(minimum, scores, noise, scatters, weights)


def interval_set(uncertainty: Uncertainty, method: str) -> IntervalSet:
    """The constants with their 95 % intervals.

    Parameters
    ----------
    uncertainty : Uncertainty
    method : IntervalMethod, or its name

    Returns
    -------
    IntervalSet                     std is the half-width over the quantile; every interval holds
                                    its estimate
    """
    minimum = uncertainty.minimum
    young = 2 * minimum.shear_modulus * (1 + minimum.poisson_ratio)
    values = (minimum.poisson_ratio, minimum.shear_modulus, young)
    centre = dict(zip(DIRECTIONS, values, strict=True))
    if method == IntervalMethod.BOOTSTRAP:
        quantile = dict.fromkeys(DIRECTIONS, float(ndtri(0.975)))
        ends = _percentiles(uncertainty, centre)
    else:
        quantile = {
            name: quantile_of(uncertainty.noise, scatter)
            for name, scatter in uncertainty.scatters.items()
        }
        ends = _fisher(uncertainty, centre, quantile)
        if method == IntervalMethod.PROFILE and not _is_narrow(uncertainty):
            ends = _profile(uncertainty, quantile)
    constants = {}
    for name in DIRECTIONS:
        low, high = min(ends[name][0], centre[name]), max(ends[name][1], centre[name])
        constants[name] = Constant(centre[name], (high - low) / (2 * quantile[name]), (low, high))
    return IntervalSet(**constants)


def _is_narrow(uncertainty: Uncertainty) -> bool:
    """Whether the misfit is a parabola over the interval, and the bounds are far."""
    low, high = uncertainty.weights.poisson_range
    nu = uncertainty.minimum.poisson_ratio
    room = min(nu - low, high - nu)
    error = np.sqrt(uncertainty.variance("poisson_ratio"))
    return bool(error < min(_SMALL_ERROR, room / _FAR_FROM_BOUND))


def _fisher(
    uncertainty: Uncertainty, centre: Mapping[str, float], quantile: Mapping[str, float]
) -> dict[str, Ends]:
    """Symmetric intervals of nu, cut at its range, and of the logarithms of the moduli."""
    ends = {}
    for name, value in centre.items():
        half_width = quantile[name] * float(np.sqrt(uncertainty.variance(name)))
        ends[name] = _about(uncertainty, name, value, (-half_width, half_width))
    return ends


def _profile(uncertainty: Uncertainty, quantile: Mapping[str, float]) -> dict[str, Ends]:
    """Where the calibrated profile of the misfit stays below the square of the quantile."""
    allowed = {name: quantile[name] ** 2 * uncertainty.calibration(name) for name in DIRECTIONS}
    error = float(np.sqrt(uncertainty.variance("poisson_ratio")))
    curve = profile_curve(
        uncertainty.weights,
        centre=uncertainty.minimum.poisson_ratio,
        half_width=2 * quantile["poisson_ratio"] * error,
        enough=max(allowed.values()),
    )
    return profile_intervals(curve, allowed)


def _percentiles(uncertainty: Uncertainty, centre: Mapping[str, float]) -> dict[str, Ends]:
    """Central 95 % of the resampled constants; the same seed always, so that a fit repeats."""
    drawn = bootstrap_constants(uncertainty.scores, count=_RESAMPLES, rng=np.random.default_rng(0))
    ends = {}
    for name, turn in directions(uncertainty.minimum.poisson_ratio).items():
        low, high = np.percentile(drawn @ turn, [2.5, 97.5]).tolist()
        ends[name] = _about(uncertainty, name, centre[name], (low, high))
    return ends


def _about(uncertainty: Uncertainty, name: str, value: float, deviation: Ends) -> Ends:
    """Interval of a constant from the deviations of nu or of the logarithm of a modulus."""
    if name == "poisson_ratio":
        low, high = np.clip(value + np.array(deviation), *uncertainty.weights.poisson_range)
    else:
        low, high = value * np.exp(np.clip(deviation, -_MAX_EXPONENT, _MAX_EXPONENT))
    return float(low), float(high)


def bootstrap_constants(
    scores: Scores, *, count: int, rng: np.random.Generator
) -> Float[np.ndarray, "b 2"]:
    """Deviations of (nu, log G) from the estimate, one for each resampled set of probings.

    Refits are one scoring step each from the scores of the probings, so a thousand of them cost a
    few milliseconds. For small spreads that is the refit itself; towards a bound or along a flat
    valley it is not, and the profile is to be preferred.

    Parameters
    ----------
    scores : Scores
    count : int                     number of resamples, b
    rng : numpy Generator

    Returns
    -------
    (b, 2) float                    drawn from the model where there is one probing only
    """
    k = len(scores.score)
    if k < 2:
        value, vector = np.linalg.eigh(scores.covariance())
        root = vector * np.sqrt(np.maximum(value, 0.0))
        return rng.normal(size=(count, 2)) @ root.T
    times = rng.multinomial(k, np.full(k, 1.0 / k), size=count).astype(np.float64)
    centred = scores.score - scores.score.mean(0)
    total = np.einsum("bk,kij->bij", times, scores.information)
    size = np.sqrt(np.maximum(np.einsum("bii->bi", total), np.finfo(float).tiny))
    unit = total / (size[:, :, None] * size[:, None, :]) + 1e-10 * np.eye(2)
    step = np.linalg.solve(unit, ((times @ centred) / size)[..., None])[..., 0] / size
    # k resampled probings scatter by (k - 1) / k of what they stand for.
    return step * np.sqrt(k / (k - 1))
