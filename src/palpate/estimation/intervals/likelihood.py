"""The likelihood over (nu, G), for a plot with its 50 and 95 % regions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import chdtri

from palpate.estimation.intervals.uncertainty import IntervalSet, Uncertainty
from palpate.estimation.search import best_compliance, deviance_of

_SIZE = 51
# Fraction of the intervals' width that is added on either side.
_MARGIN = 0.75
# Largest factor on the best modulus that the map covers, where an interval is unbounded.
_LARGEST_FACTOR = 30.0


@dataclass(frozen=True, slots=True, eq=False)
class LikelihoodMap:
    """Minus twice the log likelihood ratio over the constants, 0 at the best.

    Calibrated as the intervals are: `height(0.5)` and `height(0.95)` bound the joint regions.

    Parameters
    ----------
    poisson_ratio : (k,) float [-]      ascending
    shear_modulus : (l,) float [Pa]     ascending, evenly spaced in the logarithm
    deviance : (k, l) float
    """

    poisson_ratio: Float[np.ndarray, " k"]
    shear_modulus: Float[np.ndarray, " l"]
    deviance: Float[np.ndarray, "k l"]

    @staticmethod
    def height(probability: float) -> float:
        """Deviance at the edge of the joint confidence region of a given probability.

        Parameters
        ----------
        probability : float [-]     between 0 and 1

        Returns
        -------
        float [-]                   quantile of chi-squared with two degrees of freedom
        """
        return float(chdtri(2, 1 - probability))


def likelihood_map(uncertainty: Uncertainty, intervals: IntervalSet) -> LikelihoodMap:
    """Tabulate the deviance about the reported intervals.

    Parameters
    ----------
    uncertainty : Uncertainty
    intervals : IntervalSet         the map covers them with a margin

    Returns
    -------
    LikelihoodMap                   51 x 51
    """
    weights = uncertainty.weights
    low, high = intervals.poisson_ratio.ci95
    margin = _MARGIN * (high - low)
    low = max(weights.poisson_range[0], low - margin)
    high = min(weights.poisson_range[1], high + margin)
    best = intervals.shear_modulus.value
    soft, stiff = intervals.shear_modulus.ci95
    soft, stiff = max(soft, best / _LARGEST_FACTOR), min(stiff, best * _LARGEST_FACTOR)
    log_margin = _MARGIN * np.log(stiff / soft)
    nu = np.linspace(low, high, _SIZE)
    modulus = np.exp(np.linspace(np.log(soft) - log_margin, np.log(stiff) + log_margin, _SIZE))
    compliance = np.repeat(1.0 / modulus[:, None], _SIZE, axis=1)
    value, _, _ = deviance_of(weights.at(nu), compliance)
    centre = weights.at(np.array([intervals.poisson_ratio.value]))
    lowest = min(float(best_compliance(centre)[1][0]), float(value.min()))
    calibration = np.sqrt(
        uncertainty.calibration("poisson_ratio") * uncertainty.calibration("shear_modulus")
    )
    return LikelihoodMap(nu, modulus, np.maximum(value.T - lowest, 0.0) / calibration)
