"""A probing over time: the force, and the motion at some of the instants."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.shapes import Indices, Points

# Force at the first instant over the largest: the contact lies before it.
_UNDER_LOAD = 0.1
# The force has risen when it reaches this share of its largest.
_RISEN = 0.95
# Share of the largest force above which the tool touches.
_TOUCHES = 0.02
# A step so many times as long as both its neighbours is a gap.
_GAP = 5.0
# So many equal largest readings in a row, after readings that scatter, are the end of a range.
_EQUAL, _SCATTER = 10, 1e-6
# Durations of a push [s] outside which the clock has probably another unit.
_SHORTEST, _LONGEST = 0.05, 10800.0


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """Force and motion of one probing at successive instants, from before the contact.

    Parameters
    ----------
    time : (n,) float [s]           increasing, any origin
    force : (n,) float [N]          along the force of the probing; straight in between
    reference : int                 instant of the probing's own displacement
    tip : (n, 3) float [m] or None  displacement of the contact point; NaN where not measured
    instant : (k,) int              instants whose displacement was measured
    frames : (k, p, 3) float [m]    displacement of the probing's own points there, NaN where not
                                    measured
    source : str                    file it came from, for messages

    Raises
    ------
    InputError                      times that do not increase, a series that begins under load, or
                                    one without motion
    """

    time: Float[np.ndarray, " n"]
    force: Float[np.ndarray, " n"]
    reference: int
    tip: Points | None
    instant: Indices
    frames: Float[np.ndarray, "k p 3"]
    source: str

    def __post_init__(self) -> None:
        fix_fields(self, time=(None,))
        fix_fields(self, force=(len(self.time),))
        fix_fields(self, nan_allowed=True, none_allowed=True, tip=(len(self.time), 3))
        fix_fields(self, integer=True, instant=(None,))
        fix_fields(self, nan_allowed=True, frames=(len(self.instant), None, 3))
        late = np.flatnonzero(np.diff(self.time) <= 0.0)
        if late.size:
            raise InputError(
                f"{self.source}: row {late[0] + 2} is at {self.time[late[0] + 1]:g} s, after"
                f" {self.time[late[0]]:g} s: the times must increase; sort the rows, and leave"
                " repeated ones out"
            )
        size = float(np.abs(self.force).max())
        if abs(self.force[0]) > _UNDER_LOAD * size:
            raise InputError(
                f"{self.source}: begins at {self.force[0]:.3g} N of {size:.3g} N; how the body"
                " creeps depends on when it was first touched: let the series begin before that"
            )
        if self.tip is None and not len(self.instant):
            raise InputError(
                f"{self.source}: has forces and no motion; give the columns tx, ty, tz of the tip,"
                " or displacement with the names of files"
            )

    @property
    def contact(self) -> float:
        """Time of the first contact [s]."""
        touching = np.abs(self.force) > _TOUCHES * np.abs(self.force).max()
        return float(self.time[max(int(touching.argmax()) - 1, 0)])

    @property
    def rise(self) -> float:
        """Time from the first contact until the force is reached [s]."""
        risen = np.abs(self.force) >= _RISEN * np.abs(self.force).max()
        return float(self.time[int(risen.argmax())] - self.contact)

    @property
    def hold(self) -> float:
        """Time from the end of the rise to the last instant [s]."""
        return float(self.time[-1] - self.contact) - self.rise

    @property
    def age(self) -> float:
        """Time from the first contact to the probing's own displacement [s]."""
        return float(self.time[self.reference]) - self.contact

    @property
    def notes(self) -> tuple[str, ...]:
        """What is doubtful about it, in sentences."""
        step, size, length = np.diff(self.time), np.abs(self.force).max(), np.ptp(self.time)
        beside = np.maximum(np.append(step[1:], 0.0), np.append(0.0, step[:-1]))
        changes = np.abs(np.diff(self.force)) > _TOUCHES * size
        notes = [
            f"{self.source}: no force was read from {self.time[k]:.4g} to {self.time[k + 1]:.4g} s,"
            " where it changed; it is taken as straight in between."
            for k in np.flatnonzero((step > _GAP * beside) & changes & (len(step) > 2))[:1]
        ]
        if (count := _at_the_end(self.force)) >= _EQUAL:
            notes.append(
                f"{self.source}: {count} readings in a row are exactly {size:.4g} N: if that is the"
                " end of the gauge's range, the force was larger, and so is the modulus."
            )
        if not _SHORTEST <= length <= _LONGEST:
            notes.append(
                f"{self.source}: lasts {length:.3g} s, so time constants are of that size; if that"
                " is absurd, say the unit of the clock in the heading, as in t [ms]."
            )
        return tuple(notes)


def _at_the_end(force: Float[np.ndarray, " n"]) -> int:
    """Number of equal largest readings in a row, where the others scatter; else 0."""
    size = np.abs(force)
    equal = size == size.max()
    others = size[~equal]
    if len(others) < _EQUAL or np.median(np.abs(np.diff(others, 2))) < _SCATTER * size.max():
        return 0
    ends: Int[np.ndarray, " _"] = np.flatnonzero(np.diff(np.pad(equal.astype(np.int8), 1)))
    return int((ends[1::2] - ends[::2]).max())
