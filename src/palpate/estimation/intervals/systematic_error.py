"""What the model and the measured lengths are off by as a whole, as a part of the intervals.

The discretised model is slightly too stiff or too soft as a whole. Every probing shares that
error, so no residual and no scatter shows it; without a term of its own, precise data would promise
what the model cannot keep. It scales all displacements, so it belongs to both moduli and not to nu.

Displacements read from pictures may be too long or too short as a whole, differently along and
across the view. That reaches nu too.
"""

import numpy as np
from scipy.special import ndtri

from palpate.estimation.intervals.uncertainty import IntervalSet
from palpate.records import Constant


def poisson_ratio_error(poisson_ratio: float, displacement_error: float) -> float:
    """Standard deviation of Poisson's ratio from a relative error of all displacements.

    Error (1 - nu) (1 - 2 nu): what it takes in an elastic half-space to change the ratio of the
    displacement along the surface to that across it, which is (1 - 2 nu) / (2 (1 - nu)).

    Parameters
    ----------
    poisson_ratio : float [-]       in (-1, 0.5]
    displacement_error : float [-]  standard deviation of the displacements' scale, >= 0, each
                                    direction for itself

    Source
    ------
    Johnson, Contact Mechanics, eq. 3.18.
    """
    return displacement_error * (1.0 - poisson_ratio) * (1.0 - 2.0 * poisson_ratio)


def with_systematic_errors(
    intervals: IntervalSet, *, model_error: float, displacement_error: float
) -> IntervalSet:
    """The same constants, widened by the independent errors that all probings share.

    Parameters
    ----------
    intervals : IntervalSet
    model_error : float [-]         standard deviation of the model's stiffness, >= 0
    displacement_error : float [-]  of the displacements' scale, >= 0, see `poisson_ratio_error`

    Returns
    -------
    IntervalSet                     standard deviations, and both sides of the 95 % intervals, added
                                    in quadrature; moduli stay positive, nu at most 0.5
    """
    nu, shear, young = (
        intervals.poisson_ratio,
        intervals.shear_modulus,
        intervals.young_modulus,
    )
    relative = float(np.hypot(model_error, displacement_error))
    return IntervalSet(
        _widened(nu, poisson_ratio_error(nu.value, displacement_error), -np.inf, 0.5),
        _widened(shear, relative * shear.value, 0.0, np.inf),
        _widened(young, relative * young.value, 0.0, np.inf),
    )


def _widened(constant: Constant, extra: float, lowest: float, highest: float) -> Constant:
    """A constant with an independent error added, its interval inside what is possible."""
    if not (np.isfinite(constant.std) and extra > 0):
        return constant
    low, high = constant.ci95
    reach = float(ndtri(0.975)) * extra
    down = float(np.hypot(constant.value - low, reach))
    up = float(np.hypot(high - constant.value, reach))
    interval = (max(constant.value - down, lowest), min(constant.value + up, highest))
    return Constant(constant.value, float(np.hypot(constant.std, extra)), interval)
