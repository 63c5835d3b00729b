"""Which constants are identifiable, and what is reported for those that are not."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from palpate.estimation.intervals.uncertainty import IntervalSet
from palpate.estimation.search import FixedWeights, best_compliance
from palpate.records import Constant

# nu is identifiable where its interval leaves out at least a fifth of its prior range.
_MAX_SHARE_OF_RANGE = 0.8
# Without nu, a modulus is identifiable where it changes by less than this factor along the valley.
_MAX_VALLEY_FACTOR = 1.25
_VALLEY_POINTS = 33


def identifiable_constants(intervals: IntervalSet, weights: FixedWeights) -> dict[str, bool]:
    """Whether the data identify each constant.

    Poisson's ratio is not identifiable where its interval covers four fifths of its range or more.
    Then a modulus is identifiable only where it hardly changes along the valley of the misfit. A
    modulus whose interval has no upper end (no signal above the noise) never is.

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
    identifiable = {"poisson_ratio": high - low < _MAX_SHARE_OF_RANGE * span}
    nu, modulus = _valley_line(weights, (low, high))
    for name, line in (("shear_modulus", modulus), ("young_modulus", modulus * (1 + nu))):
        bounded = bool(np.isfinite(getattr(intervals, name).ci95[1]))
        along = np.exp(np.ptp(np.log(line))) < _MAX_VALLEY_FACTOR
        identifiable[name] = bounded and bool(identifiable["poisson_ratio"] or along)
    identifiable["poisson_ratio"] &= bool(np.isfinite(intervals.shear_modulus.ci95[1]))
    return identifiable


def with_undetermined_ratio(intervals: IntervalSet, weights: FixedWeights) -> IntervalSet:
    """Intervals where the data point beyond the range of nu, which then counts as undetermined.

    An estimate at the end of the range is no measurement. The intervals of the moduli are extended
    to hold the valley of the misfit over the whole range.

    Parameters
    ----------
    intervals : IntervalSet
    weights : FixedWeights          for the valley

    Returns
    -------
    IntervalSet
    """
    nu, modulus = _valley_line(weights)
    return IntervalSet(
        replace(intervals.poisson_ratio, ci95=weights.poisson_range),
        _extended(intervals.shear_modulus, modulus),
        _extended(intervals.young_modulus, 2 * modulus * (1 + nu)),
    )


def _extended(constant: Constant, line: np.ndarray) -> Constant:
    """The same value, its interval extended to hold a whole line of values."""
    low, high = constant.ci95
    return replace(constant, ci95=(min(low, float(line.min())), max(high, float(line.max()))))


def with_prior_ranges(
    intervals: IntervalSet, identifiable: Mapping[str, bool], weights: FixedWeights
) -> IntervalSet:
    """Intervals with the prior range for constants that the data do not identify.

    Where nu is not identifiable, its best value depends on the noise alone: the middle of its range
    is reported instead, with the moduli in the valley of the misfit there. A modulus bounded only
    through the range of nu keeps its interval; without any signal it is (0, infinity).

    Parameters
    ----------
    intervals : IntervalSet
    identifiable : constant's name -> bool
    weights : FixedWeights          for the valley

    Returns
    -------
    IntervalSet
    """
    ratio, shear = intervals.poisson_ratio, _modulus_in_range(intervals.shear_modulus)
    young = _modulus_in_range(intervals.young_modulus)
    if not identifiable["poisson_ratio"]:
        middle = float(np.mean(weights.poisson_range))
        uniform = float(np.ptp(weights.poisson_range) / np.sqrt(12.0))
        ratio = Constant(middle, uniform, weights.poisson_range)
        if np.isfinite(shear.ci95[1]):
            compliance, _ = best_compliance(weights.at(np.array([middle])))
            modulus = 1.0 / float(compliance[0])
            shear = _with_value(shear, modulus)
            young = _with_value(young, 2 * modulus * (1 + middle))
    return IntervalSet(ratio, shear, young)


def _with_value(constant: Constant, value: float) -> Constant:
    """The same interval with another value, clipped to it."""
    return replace(constant, value=float(np.clip(value, *constant.ci95)))


def _modulus_in_range(modulus: Constant) -> Constant:
    """The modulus itself, or all positive values where its interval has no upper end."""
    if np.isfinite(modulus.ci95[1]):
        return modulus
    return Constant(modulus.value, np.inf, (0.0, np.inf))


def identifiable_combination(weights: FixedWeights) -> str:
    """The combination of G and nu that the valley of the misfit keeps constant, in words.

    Parameters
    ----------
    weights : FixedWeights          for the valley

    Returns
    -------
    str                             formula, and by how much it changes over the range of nu
    """
    nu, modulus = _valley_line(weights)
    combinations = {
        "E = 2 G (1 + nu)": modulus * (1 + nu),
        "G": modulus,
        "G / (1 - nu)": modulus / (1 - nu),
        "G / (1 - 2 nu)": modulus / (1 - 2 * nu),
    }
    change = {name: float(np.ptp(np.log(values))) for name, values in combinations.items()}
    best = min(change, key=lambda name: change[name])
    return f"{best} (it changes by {100 * change[best]:.1f} % over all of nu)"


def _valley_line(
    weights: FixedWeights, ends: tuple[float, float] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Best shear modulus for every Poisson's ratio."""
    low, high = ends or weights.poisson_range
    nu = np.linspace(low, high, _VALLEY_POINTS)
    return nu, 1.0 / best_compliance(weights.at(nu))[0]
