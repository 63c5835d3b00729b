"""The likelihood over (nu, G), for a plot with its 50 and 95 % regions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from palpate.estimation.intervals.profile_likelihood import FixedWeights
from palpate.estimation.intervals.uncertainty import IntervalSet
from palpate.estimation.search import best_compliance, deviance_of

_MARGIN = 0.75
_LARGEST_FACTOR = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodMap:
    """Minus twice the log likelihood ratio over the constants, 0 at the best.

    Calibrated as the intervals are: `height(0.5)` and `height(0.95)` bound the joint regions.

    Parameters
    ----------
    poisson_ratio : (k,) float [-]      rising
    shear_modulus : (l,) float [Pa]     rising, evenly spaced in the logarithm
    deviance : (k, l) float
    """

    poisson_ratio: Float[np.ndarray, " k"]
    shear_modulus: Float[np.ndarray, " l"]
    deviance: Float[np.ndarray, "k l"]

    @staticmethod
    def height(share: float) -> float:
        """Deviance at the edge of the joint region that holds a share of the probability."""
        return float(chdtri(2, 1 - share))


def likelihood_map(
    weights: FixedWeights, intervals: IntervalSet, *, calibration: float, size: int
) -> LikelihoodMap:
    """Tabulate the deviance about the reported intervals.

    Parameters
    ----------
    weights : FixedWeights
    intervals : IntervalSet         the map covers them with a margin
    calibration : float             mean variance over the variance that the bare curvature claims
    size : int                      grid points along each constant, >= 2
    """
    low, high = intervals.poisson_ratio.ci95
    margin = _MARGIN * (high - low)
    low = max(weights.poisson_range[0], low - margin)
    high = min(weights.poisson_range[1], high + margin)
    best = intervals.shear_modulus.value
    soft, stiff = intervals.shear_modulus.ci95
    soft, stiff = max(soft, best / _LARGEST_FACTOR), min(stiff, best * _LARGEST_FACTOR)
    room = _MARGIN * np.log(stiff / soft)
    nu = np.linspace(low, high, size)
    modulus = np.exp(np.linspace(np.log(soft) - room, np.log(stiff) + room, size))
    probes = weights.at(nu)
    compliance = np.repeat(1.0 / modulus[:, None], size, axis=1)
    value, _, _ = deviance_of(probes, compliance)
    centre = weights.at(np.array([intervals.poisson_ratio.value]))
    floor = min(float(best_compliance(centre)[1][0, 0]), float(value.min()))
    return LikelihoodMap(nu, modulus, np.maximum(value.T - floor, 0.0) / calibration)
