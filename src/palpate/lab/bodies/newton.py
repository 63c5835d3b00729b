"""Where a body comes to rest in a potential: Newton's method with shortened steps, the load put on
in parts where it is too much at once."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

_MAX_STEPS = 40
_MAX_HALVINGS = 10
# The load, put on in parts that are halved where one is too large, is not cut finer than this.
_LEAST_PART = 1e-3

Unknowns = Float[np.ndarray, " unknowns"]


@runtime_checkable
class Potential(Protocol):
    """An energy of some unknowns, less the work of the loads on them."""

    def value(self, at: Unknowns) -> float:
        """Potential [J]; infinite where the unknowns cannot be."""

    def forces(self, at: Unknowns) -> Unknowns:
        """Minus its slope [N]; zero for what cannot move."""

    def step(self, at: Unknowns, forces: Unknowns) -> Unknowns | None:
        """Newton's step [m]; None where the tangent is not stable."""


def find_rest(potential: Potential, at: Unknowns, *, balanced: float) -> Unknowns | None:
    """Rest near a place.

    Parameters
    ----------
    potential : Potential
    at : (u,) float [m]             where to begin
    balanced : float [N]            norm of the forces that are left, > 0

    Returns
    -------
    (u,) float [m] or None          None where Newton's method does not find it

    Source
    ------
    Nocedal and Wright, Numerical optimization (2nd ed. 2006), section 3.1: steps halved until the
    potential does not rise.
    """
    for _ in range(_MAX_STEPS):
        forces = potential.forces(at)
        if np.linalg.norm(forces) <= balanced:
            return at
        step = potential.step(at, forces)
        moved = None if step is None else _shortened(potential, at, step)
        if moved is None:
            return None
        at = moved
    return None


def find_in_parts(
    find: Callable[[float, Unknowns], Unknowns | None], start: Unknowns
) -> tuple[Unknowns, float]:
    """Rest under a whole load, by way of parts of it where it is not found at once.

    Parameters
    ----------
    find : function                 share of the load, where to begin -> rest, or None
    start : (u,) float [m]          rest without load

    Returns
    -------
    found : (u,) float [m]          the last rest that was found
    done : float [-]                the share of the load there: 1 if all went well
    """
    now, done, part = start, 0.0, 1.0
    while done < 1.0 and part >= _LEAST_PART:
        share = min(1.0, done + part)
        found = find(share, now)
        if found is None:
            part *= 0.5
        else:
            now, done = found, share
    return now, done


def _shortened(potential: Potential, at: Unknowns, step: Unknowns) -> Unknowns | None:
    """The end of a step, halved until the potential falls (rounding apart); None: it never does."""
    before = potential.value(at)
    for _ in range(_MAX_HALVINGS):
        after = potential.value(at + step)
        if after <= before + 1e-12 * abs(before):
            return at + step
        step = 0.5 * step
    return None
