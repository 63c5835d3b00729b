"""A campaign's table: a row for every session, and the outliers of each group."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.arrays import STD_OVER_MEDIAN
from palpate.records import CONSTANT_NAMES, Estimate

WAITING, DONE, FAILED = "waiting", "done", "failed"
# Bound on the modified z-score, which uses the median absolute deviation: Iglewicz and Hoaglin
# (1993), How to detect and handle outliers, section 3.3.
_OUTLIER_BOUND = 3.5
# In small groups the median absolute deviation is inaccurate, and z-scores above 3.5 are not rare:
# one in 80 of 12 normal values. With the bound raised by a factor of 1 + this over the group's size
# it is one in 370, and one in 90 for groups of 5 (simulated).
_SMALL_GROUP = 5.0
_MIN_GROUP_SIZE = 5


@dataclass(frozen=True, slots=True)
class Row:
    """One session's row of the table; None means unknown.

    Attributes
    ----------
    session, group : str            as in `CampaignItem`
    state : "waiting", "done" or "failed"
    status : str or None            of the estimate, as in estimate.json
    shear_modulus, young_modulus : float or None [Pa]       None if the data do not determine it
    shear_modulus_low, shear_modulus_high, ... : float or None      ends of the 95 % interval
    poisson_ratio : float or None
    message : str                   why it failed, or the notes of the estimate
    seconds : float or None [s]     duration of the work
    address : str                   digest of files, options and version, which names the result
    finished : str                  time of completion, UTC, ISO format
    """

    session: str
    group: str
    state: Literal["waiting", "done", "failed"] = "waiting"
    status: str | None = None
    shear_modulus: float | None = None
    shear_modulus_low: float | None = None
    shear_modulus_high: float | None = None
    poisson_ratio: float | None = None
    poisson_ratio_low: float | None = None
    poisson_ratio_high: float | None = None
    young_modulus: float | None = None
    young_modulus_low: float | None = None
    young_modulus_high: float | None = None
    message: str = ""
    seconds: float | None = None
    address: str = ""
    finished: str = ""


COLUMNS = tuple(field.name for field in fields(Row))


def constants_of(estimate: Estimate) -> dict[str, float | None]:
    """The constants of an estimate as fields of a row.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    dict                            value, `_low` and `_high` of every constant; None if unknown
    """
    found: dict[str, float | None] = {}
    for name in CONSTANT_NAMES:
        constant = getattr(estimate, name)
        known = estimate.identifiable[name]
        found[name] = _finite(constant.value) if known else None
        found[f"{name}_low"], found[f"{name}_high"] = map(_finite, constant.ci95)
    return found


def outliers(rows: Sequence[Row]) -> dict[str, tuple[str, ...]]:
    """Sessions with a constant that is an outlier of its group, relative to the group's scatter
    combined with the constant's own interval.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    dict of str to tuple of str     session -> its outlying constants, `young_modulus` or
                                    `poisson_ratio`; groups of fewer than five have no outliers

    Source
    ------
    Iglewicz and Hoaglin (1993), How to detect and handle outliers, section 3.3
    """
    found: dict[str, list[str]] = {}
    for group in groups_of(rows):
        for name in ("young_modulus", "poisson_ratio"):
            complete = [row for row in rows if row.group == group and _is_complete(row, name)]
            if len(complete) >= _MIN_GROUP_SIZE:
                for row, is_outlier in zip(complete, _are_outliers(complete, name), strict=True):
                    if is_outlier:
                        found.setdefault(row.session, []).append(name)
    return {session: tuple(names) for session, names in found.items()}


def groups_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """Names of the groups, in the order of their first sessions.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    tuple of str
    """
    return tuple(dict.fromkeys(row.group for row in rows))


def _is_complete(row: Row, name: str) -> bool:
    return all(getattr(row, f"{name}{end}") is not None for end in ("", "_low", "_high"))


def _are_outliers(rows: Sequence[Row], name: str) -> list[bool]:
    """Whether each value of a constant is an outlier; moduli are compared by their logarithms."""
    value, low, high = (
        np.array([getattr(row, f"{name}{end}") for row in rows]) for end in ("", "_low", "_high")
    )
    if name != "poisson_ratio":
        value, low, high = np.log(value), np.log(low), np.log(high)
    deviation = value - np.median(value)
    spread = STD_OVER_MEDIAN * np.median(np.abs(deviation))
    # Half of a 95 % interval is 1.96 standard deviations; of a skewed one take the side that faces
    # the median.
    own_std: Float[np.ndarray, " n"] = np.where(deviation > 0, value - low, high - value) / 1.96
    bound = _OUTLIER_BOUND * (1.0 + _SMALL_GROUP / len(rows))
    return (np.abs(deviation) > bound * np.hypot(spread, own_std)).tolist()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
