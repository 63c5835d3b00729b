"""The stiffening of a material at finite strain: its estimate, and whether it is shown."""

import numpy as np
from scipy.special import ndtri

from palpate.estimation import FALSE_ALARM, FitResult
from palpate.records import HALF_95, Constant

# Its prior standard deviation: 1.8 times as stiff at 20 % shear; and its name among the errors.
STIFFENING_STD, STIFFENS = 10.0, "stiffening of the material"
# Standard deviations from which it counts as shown.
_SHOWN = -float(ndtri(0.5 * FALSE_ALARM))


def estimated_stiffening(result: FitResult) -> Constant:
    """The stiffening that a result says; 0 before it was looked for."""
    minimum = result.minimum
    names = [each.name for each in minimum.problem.shared]
    if STIFFENS not in names:
        return Constant(0.0, 0.0, (0.0, 0.0))
    place = minimum.problem.layout.errors.start + names.index(STIFFENS)
    value, std = (
        STIFFENING_STD * float(each[place]) for each in (minimum.theta, minimum.normal.std)
    )
    return _interval(value, std)


def _interval(value: float, std: float) -> Constant:
    low, high = value - HALF_95 * std, value + HALF_95 * std
    return Constant(value, std, (min(max(low, 0.0), value), max(high, 0.0)))


def with_error_of_elements(stiffening: Constant, change: float) -> Constant:
    """An estimate with the error of its finite elements.

    Parameters
    ----------
    stiffening : Constant [-]
    change : float [-]              of its value from coarser to finer elements: about its error, of
                                    second order
    """
    return _interval(stiffening.value, float(np.hypot(stiffening.std, change)))


def is_stiffening(stiffening: Constant) -> bool:
    """Whether an estimate shows it.

    Parameters
    ----------
    stiffening : Constant [-]       with the error of its elements
    """
    return stiffening.value > _SHOWN * stiffening.std
