"""Noise levels: estimated where none was claimed, raised where residuals exceed the claim."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from palpate.estimation.observed_rows import FIRST_CLAIMED, GROUP_COUNT, TIP_GROUP, ObservedRows

_MAD_TO_SIGMA = 1.482602218505602
# Relative standard error of a sigma from the median absolute deviation of n Gaussian values.
_MAD_ERROR = 1.166
_SIGNIFICANT = 2.5
# Gross outliers at a tenth of the points raise the median by about this fraction.
_OUTLIER_LIFT = 0.12
# Of the largest displacement: no field is measured better, and exact data need a level above zero.
_FLOOR_OVER_SIGNAL = 1e-5
_TIP_PRIOR_ROWS = 3.0


def noise_levels(
    probes: Sequence[ObservedRows],
    residuals: Sequence[Float[np.ndarray, " _"]],
    *,
    parameters: int,
) -> Float[np.ndarray, " 8"]:
    """Robust noise level of each group, pooled over all probings.

    Where no standard deviation was claimed: the scaled median absolute residual of the component
    [m]. With a claim: 1, or the factor by which the residuals exceed the claim where the excess is
    significant; never less than 1.

    Parameters
    ----------
    probes : sequence of ObservedRows
    residuals : one (r,) float [m] for each     measured minus predicted
    parameters : int                            number of fitted parameters: lost degrees of freedom

    Returns
    -------
    (8,) float                                  to be multiplied by `ObservedRows.unit`
    """
    group = np.concatenate([probe.group for probe in probes])
    unit = np.concatenate([probe.unit for probe in probes])
    measured = np.concatenate([probe.measured for probe in probes]) / unit
    scaled = np.abs(np.concatenate(residuals)) / unit
    lost = min(parameters, len(group) // 2)
    lift = np.sqrt(len(group) / (len(group) - lost)) if lost else 1.0
    level, count, floor = np.ones(GROUP_COUNT), np.zeros(GROUP_COUNT), np.zeros(GROUP_COUNT)
    for index in range(GROUP_COUNT):
        chosen = group == index
        count[index] = chosen.sum()
        if count[index]:
            floor[index] = _FLOOR_OVER_SIGNAL * np.abs(measured[chosen]).max()
            median = _MAD_TO_SIGMA * lift * float(np.median(scaled[chosen]))
            level[index] = max(median, floor[index], np.finfo(float).tiny ** 0.5)
    _settle_tip(level, count)
    return _settle_claims(level, count, floor)


def _settle_tip(level: np.ndarray, count: np.ndarray) -> None:
    """Shrink the estimated level of the tip, which has few rows, towards that of the field."""
    field = count[:TIP_GROUP] > 0
    if count[TIP_GROUP] and field.any():
        prior = np.mean(level[:TIP_GROUP][field] ** 2) * _TIP_PRIOR_ROWS
        total = prior + count[TIP_GROUP] * level[TIP_GROUP] ** 2
        level[TIP_GROUP] = np.sqrt(total / (count[TIP_GROUP] + _TIP_PRIOR_ROWS))


def _settle_claims(level: np.ndarray, count: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Keep claimed levels unless residuals exceed them by more than chance allows."""
    limit = 1 + _OUTLIER_LIFT + _SIGNIFICANT * _MAD_ERROR / np.sqrt(np.maximum(count, 1.0))
    claimed = np.arange(GROUP_COUNT) >= FIRST_CLAIMED
    return np.where(claimed & (level < limit), np.maximum(floor, 1.0), level)
