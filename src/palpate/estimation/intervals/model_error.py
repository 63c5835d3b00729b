"""What the model and the measured lengths are off by as a whole, as a part of the intervals.

The discretised model is slightly too stiff or too soft as a whole. Every probing shares that
error, so no residual and no scatter shows it; without a term of its own, precise data would promise
what the model cannot keep. It scales all displacements, so it belongs to both moduli and not to nu.

Displacements read from pictures may be too long or too short as a whole, differently along and
across the view. That reaches nu too.
"""

from dataclasses import replace

import numpy as np

from palpate.estimation.intervals.uncertainty import IntervalSet
from palpate.records import Constant

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


def with_displacement_error(intervals: IntervalSet, relative: float) -> IntervalSet:
    """The same constants, widened by a relative error of all displacements of a direction.

    Parameters
    ----------
    intervals : IntervalSet
    relative : float [-]            standard deviation of the displacements' scale, >= 0, each
                                    direction for itself

    Returns
    -------
    IntervalSet                     G and E widened by `relative`; nu by relative (1 - nu)
                                    (1 - 2 nu), what it takes in an elastic half-space to change the
                                    ratio of the displacement along the surface to that across it
                                    by `relative` (Johnson, Contact Mechanics, eq. 3.18)
    """
    ratio = intervals.poisson_ratio
    if relative > 0.0 and np.isfinite(ratio.std):
        extra = relative * (1.0 - ratio.value) * (1.0 - 2.0 * ratio.value)
        low, high = ratio.ci95
        down = float(np.hypot(ratio.value - low, _NORMAL * extra))
        up = float(np.hypot(high - ratio.value, _NORMAL * extra))
        wider = Constant(
            ratio.value,
            float(np.hypot(ratio.std, extra)),
            (ratio.value - down, min(ratio.value + up, 0.5)),
        )
        intervals = replace(intervals, poisson_ratio=wider)
    return with_model_error(intervals, relative)


def _widened(constant: Constant, relative: float) -> Constant:
    extra = relative * constant.value
    if not np.isfinite(constant.std) or not extra > 0:
        return constant
    low, high = constant.ci95
    down = float(np.hypot(constant.value - low, _NORMAL * extra))
    up = float(np.hypot(high - constant.value, _NORMAL * extra))
    interval = (max(constant.value - down, 0.0), constant.value + up)
    return Constant(constant.value, float(np.hypot(constant.std, extra)), interval)
