"""What the model itself is off by, as a part of the interval.

The discretised model is slightly too stiff or too soft as a whole. Every probing shares that
error, so no residual and no scatter shows it; without a term of its own, precise data would promise
what the model cannot keep. It scales all displacements, so it belongs to both moduli and not to nu.
"""

from dataclasses import replace

import numpy as np

from palpate.estimation.uncertainty import IntervalSet
from palpate.records import Constant

__all__ = ["with_model_error"]

_NORMAL = 1.959964


def with_model_error(intervals: IntervalSet, relative: float) -> IntervalSet:
    """The same constants, their moduli widened by an independent relative error.

    Parameters
    ----------
    intervals : IntervalSet
    relative : float [-]            standard deviation of the model's scale, >= 0

    Returns
    -------
    IntervalSet                     standard deviations and both sides of the 95 % intervals of G
                                    and E added in quadrature with it
    """
    return replace(
        intervals,
        shear_modulus=_widened(intervals.shear_modulus, relative),
        young_modulus=_widened(intervals.young_modulus, relative),
    )


def _widened(constant: Constant, relative: float) -> Constant:
    extra = relative * constant.value
    if not np.isfinite(constant.std) or not extra > 0:
        return constant
    low, high = constant.ci95
    down = float(np.hypot(constant.value - low, _NORMAL * extra))
    up = float(np.hypot(high - constant.value, _NORMAL * extra))
    interval = (max(constant.value - down, 0.0), constant.value + up)
    return Constant(constant.value, float(np.hypot(constant.std, extra)), interval)
