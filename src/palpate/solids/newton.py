"""Stable equilibrium as the minimum of a potential: Newton's method with step halving, and load
increments where the full load does not converge at once."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

_MAX_STEPS = 40
_MAX_HALVINGS = 10
# Smallest load increment, as a fraction of the load; increments that fail are halved.
_MIN_INCREMENT = 1e-3

Unknowns = Float[np.ndarray, " unknowns"]


@runtime_checkable
class Potential(Protocol):
    """Total potential energy: stored energy minus the work of the loads.

    Unknowns, forces and steps are (u,) arrays.
    """

    def value(self, at: Unknowns) -> float:
        """Potential [J]; infinite for inadmissible unknowns."""

    def forces(self, at: Unknowns) -> Unknowns:
        """Residual forces, the negative gradient [N]; zero for fixed unknowns."""

    def step(self, at: Unknowns, forces: Unknowns) -> Unknowns | None:
        """Newton's step [m]; None where the tangent is not positive definite."""


def find_equilibrium(potential: Potential, at: Unknowns, *, tolerance: float) -> Unknowns | None:
    """Equilibrium near an initial guess.

    Parameters
    ----------
    potential : Potential
    at : (u,) float [m]             initial guess
    tolerance : float [N]           on the norm of the residual forces, > 0

    Returns
    -------
    (u,) float [m] or None          None if Newton's method does not converge

    Source
    ------
    Nocedal and Wright, Numerical optimization (2nd ed. 2006), section 3.1: backtracking, here by
    halving the step until the potential does not increase.
    """
    for _ in range(_MAX_STEPS):
        forces = potential.forces(at)
        if np.linalg.norm(forces) <= tolerance:
            return at
        step = potential.step(at, forces)
        improved = None if step is None else _shortened(potential, at, step)
        if improved is None:
            return None
        at = improved
    return None


def find_in_increments(
    find: Callable[[float, Unknowns], Unknowns | None], start: Unknowns
) -> tuple[Unknowns, float]:
    """Equilibrium under the full load, in load increments where it is not found at once.

    Parameters
    ----------
    find : function                 fraction of the load, initial guess -> equilibrium, or None
    start : (u,) float [m]          equilibrium without load

    Returns
    -------
    found : (u,) float [m]          the last equilibrium found
    done : float [-]                fraction of the load there; 1 on success
    """
    now, done, increment = start, 0.0, 1.0
    while done < 1.0 and increment >= _MIN_INCREMENT:
        target = min(1.0, done + increment)
        found = find(target, now)
        if found is None:
            increment *= 0.5
        else:
            now, done = found, target
    return now, done


def _shortened(potential: Potential, at: Unknowns, step: Unknowns) -> Unknowns | None:
    """End of a step, halved until the potential does not rise (within rounding); None: fails."""
    before = potential.value(at)
    for _ in range(_MAX_HALVINGS):
        after = potential.value(at + step)
        if after <= before + 1e-12 * abs(before):
            return at + step
        step = 0.5 * step
    return None
