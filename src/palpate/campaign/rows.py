"""A campaign's table: a row for every session, and the rows that stand out of their group."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.records import CONSTANT_NAMES, Estimate

WAITING, DONE, FAILED = "waiting", "done", "failed"
# Iglewicz and Hoaglin (1993), How to detect and handle outliers, section 3.3: a modified z-score
# beyond this, the median's absolute deviation standing for the spread.
_FAR = 3.5
# A median's absolute deviation times this is a normal distribution's standard deviation.
_NORMAL = 1.4826
# In a small group the median's deviation is a guess, and 3.5 of it are nothing rare: of 12 normal
# values one in 80 lies beyond. With the second number over the group's size it is one in 370, of 5
# values one in 90 (simulated).
_SMALL_GROUP = 5.0
_FEWEST = 5


@dataclass(frozen=True, slots=True)
class Row:
    """What is known of one session; None where that is nothing.

    Attributes
    ----------
    session, group : str            as in `CampaignItem`
    state : "waiting", "done" or "failed"
    status : str or None            of the estimate, as in estimate.json
    shear_modulus, young_modulus : float or None [Pa]       None where the data do not determine it
    shear_modulus_low, shear_modulus_high, ... : float or None      95 % interval
    poisson_ratio : float or None
    message : str                   why it failed, or the notes of the estimate
    seconds : float or None         that the work took
    address : str                   digest of files, options and version; names the result
    finished : str                  when, UTC
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
    """The constants of an estimate as a row has them.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    dict                            value, `_low` and `_high` of every constant
    """
    found: dict[str, float | None] = {}
    for name in CONSTANT_NAMES:
        constant = getattr(estimate, name)
        known = estimate.identifiable[name]
        found[name] = _finite(constant.value) if known else None
        found[f"{name}_low"], found[f"{name}_high"] = map(_finite, constant.ci95)
    return found


def outliers(rows: Sequence[Row]) -> dict[str, tuple[str, ...]]:
    """Sessions with a constant that lies far out of its group, measured by the group's scatter and
    by the constant's own interval together.

    Parameters
    ----------
    rows : sequence of Row

    Returns
    -------
    dict of str to tuple of str     session -> the constants, `young_modulus` or `poisson_ratio`;
                                    none in groups with fewer than five sessions

    Source
    ------
    Iglewicz and Hoaglin (1993), How to detect and handle outliers, section 3.3
    """
    found: dict[str, list[str]] = {}
    for group in groups_of(rows):
        for name in ("young_modulus", "poisson_ratio"):
            known = [row for row in rows if row.group == group and _is_whole(row, name)]
            if len(known) >= _FEWEST:
                for row, far in zip(known, _far(known, name), strict=True):
                    if far:
                        found.setdefault(row.session, []).append(name)
    return {session: tuple(names) for session, names in found.items()}


def groups_of(rows: Sequence[Row]) -> tuple[str, ...]:
    """Groups in the order of their first sessions.

    Parameters
    ----------
    rows : sequence of Row
    """
    return tuple(dict.fromkeys(row.group for row in rows))


def _is_whole(row: Row, name: str) -> bool:
    return all(getattr(row, f"{name}{end}") is not None for end in ("", "_low", "_high"))


def _far(rows: Sequence[Row], name: str) -> list[bool]:
    """Whether each of some values lies far out; moduli by their ratios."""
    value, low, high = (
        np.array([getattr(row, f"{name}{end}") for row in rows]) for end in ("", "_low", "_high")
    )
    if name != "poisson_ratio":
        value, low, high = np.log(value), np.log(low), np.log(high)
    off = value - np.median(value)
    spread = _NORMAL * np.median(np.abs(off))
    # An interval of 95 % is about four standard deviations wide; of a skew one the nearer side.
    own: Float[np.ndarray, " n"] = np.where(off > 0, value - low, high - value) / 1.96
    bound = _FAR * (1.0 + _SMALL_GROUP / len(rows))
    return (np.abs(off) > bound * np.hypot(spread, own)).tolist()


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
