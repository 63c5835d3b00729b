"""Which constants the data tell, and what to say where they do not."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from palpate.estimation.profile_likelihood import FixedWeights
from palpate.estimation.uncertainty import IntervalSet
from palpate.estimation.variable_projection import best_compliance
from palpate.records import Constant

__all__ = ["identifiable_constants", "told_combination", "with_prior_ranges"]

# nu is told where its interval leaves out at least a fifth of its prior range.
_SHARE_OF_RANGE = 0.8
# A modulus is told without nu where all nu change it by less than this factor.
_VALLEY_FACTOR = 1.25
_VALLEY_POINTS = 33


def identifiable_constants(intervals: IntervalSet, weights: FixedWeights) -> dict[str, bool]:
    """Whether the data tell each constant.

    Poisson's ratio is not told where its interval covers four fifths of its range or more. Then a
    modulus is told only where it hardly changes along the valley of the misfit. A modulus whose
    interval has no upper end (no signal above the noise) is never told.

    Parameters
    ----------
    intervals : IntervalSet         the reported one
    weights : FixedWeights          for the valley

    Returns
    -------
    constant's name -> bool
    """
    low, high = intervals.poisson_ratio.ci95
    span = weights.poisson_range[1] - weights.poisson_range[0]
    told = {"poisson_ratio": high - low < _SHARE_OF_RANGE * span}
    for name in ("shear_modulus", "young_modulus"):
        bounded = bool(np.isfinite(getattr(intervals, name).ci95[1]))
        along = told["poisson_ratio"] or _valley(intervals, weights)[name] < _VALLEY_FACTOR
        told[name] = bounded and along
    if not (told["shear_modulus"] or np.isfinite(intervals.shear_modulus.ci95[1])):
        told["poisson_ratio"] = False
    return told


def with_prior_ranges(
    intervals: IntervalSet,
    identifiable: Mapping[str, bool],
    poisson_range: tuple[float, float],
) -> IntervalSet:
    """Intervals as wide as the prior range for what the data cannot tell.

    For a modulus that is bounded by the data only through the range of nu, that range is its
    interval already and stays; without any signal it is (0, infinity).
    """
    ratio = intervals.poisson_ratio
    if not identifiable["poisson_ratio"]:
        uniform = float(np.ptp(poisson_range) / np.sqrt(12.0))
        ratio = Constant(ratio.value, uniform, poisson_range)
    return replace(
        intervals,
        poisson_ratio=ratio,
        shear_modulus=_modulus_in_range(intervals.shear_modulus),
        young_modulus=_modulus_in_range(intervals.young_modulus),
    )


def _modulus_in_range(modulus: Constant) -> Constant:
    """The modulus itself, or all positive values where its interval has no upper end."""
    if np.isfinite(modulus.ci95[1]):
        return modulus
    return Constant(modulus.value, np.inf, (0.0, np.inf))


def told_combination(weights: FixedWeights) -> str:
    """The combination of G and nu that the valley of the misfit keeps constant, in words."""
    nu, modulus = _valley_line(weights)
    shapes = {
        "E = 2 G (1 + nu)": modulus * (1 + nu),
        "G": modulus,
        "G / (1 - nu)": modulus / (1 - nu),
        "G / (1 - 2 nu)": modulus / (1 - 2 * nu),
    }
    change = {name: float(np.ptp(np.log(shape))) for name, shape in shapes.items()}
    best = min(change, key=lambda name: change[name])
    return f"{best} (it changes by {100 * change[best]:.1f} % over all of nu)"


def _valley(intervals: IntervalSet, weights: FixedWeights) -> dict[str, float]:
    """Factor by which each modulus changes along the valley inside the interval of nu."""
    nu, modulus = _valley_line(weights, intervals.poisson_ratio.ci95)
    lines = {"shear_modulus": modulus, "young_modulus": modulus * (1 + nu)}
    return {name: float(np.exp(np.ptp(np.log(line)))) for name, line in lines.items()}


def _valley_line(
    weights: FixedWeights, ends: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Best shear modulus for every Poisson's ratio."""
    low, high = ends or weights.poisson_range
    nu = np.linspace(low, high, _VALLEY_POINTS)
    return nu, 1.0 / best_compliance(weights.at(nu))[0][0]
