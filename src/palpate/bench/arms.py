"""Limits of an arm, without which no arm is driven, and the guard that keeps them.

They are checked twice: before a push, over all of its way (`check_push`), and in front of the
driver in every single move (`GuardedArm`).
"""

from dataclasses import dataclass

import numpy as np

from palpate.arrays import fixed_array
from palpate.bench.devices import Arm, DeviceError
from palpate.errors import InputError
from palpate.shapes import Vector3

# A depth that is beyond its limit by this share is not: it was computed from positions.
_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class ArmLimits:
    """What an arm may do.

    Parameters
    ----------
    force : float [N]               largest force of the tool
    depth : float [m]               largest travel beyond the undeformed surface
    speed : float [m/s]             largest speed
    low, high : (3,) float [m]      corners of the box in which the tool's end stays, object frame

    Raises
    ------
    InputError                      a limit that is not positive, an empty box
    """

    force: float
    depth: float
    speed: float
    low: Vector3
    high: Vector3

    def __post_init__(self) -> None:
        for name in ("force", "depth", "speed"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"{name} is {getattr(self, name):g}; must be positive")
        for name in ("low", "high"):
            corner = fixed_array(getattr(self, name), name=name, shape=(3,))
            object.__setattr__(self, name, corner)
        if not (self.low < self.high).all():
            raise InputError(
                f"low is {self.low.tolist()}, high {self.high.tolist()}; every number of low must"
                " be below that of high: they are corners of the box in which the tool's end stays"
            )

    def contain(self, position: Vector3) -> bool:
        """Whether a position of the tool's end is inside the box."""
        return bool(((position >= self.low) & (position <= self.high)).all())


def check_push(
    limits: ArmLimits, point: Vector3, inward: Vector3, *, clearance: float, force: float
) -> None:
    """Refuse a push that would leave the limits on its way, before anything moves.

    Parameters
    ----------
    limits : ArmLimits
    point : (3,) float [m]          on the surface
    inward : (3,) float [-]         unit normal into the object
    clearance : float [m]           height above the place at which the approach begins
    force : float [N]               to press with

    Raises
    ------
    InputError                      too large a force; a way out of the box
    """
    if force > limits.force:
        raise InputError(
            f"a push of {force:g} N is asked for; the arm may press with {limits.force:g} N at"
            " most: lower [push] force, or raise [arm.limits] force if arm and object bear it"
        )
    for end in (point - clearance * inward, point + limits.depth * inward):
        if not limits.contain(end):
            raise InputError(
                f"the push at {_millimetres(point)} mm leads to {_millimetres(end)} mm, out of the"
                f" box from {_millimetres(limits.low)} to {_millimetres(limits.high)} mm: widen"
                " [arm.limits] if the way is free, or measure elsewhere"
            )


def _millimetres(position: Vector3) -> str:
    return str(np.round(1e3 * position, 1).tolist())


class GuardedArm:
    """An arm behind its limits: no move leaves them, and none goes deeper while the tool presses
    too hard. Every arm of a bench is inside one; `asks`: before its first push it is drawn, and a
    person asked."""

    def __init__(self, arm: Arm, limits: ArmLimits, *, asks: bool = True) -> None:
        self.limits, self.asks = limits, asks
        self._arm = arm
        self._force = 0.0
        self._place: tuple[Vector3, Vector3] | None = None

    def start(self) -> None:
        """As the arm's own."""
        self._arm.start()

    def pose(self) -> Vector3:
        """As the arm's own."""
        return self._arm.pose()

    def stop(self) -> None:
        """As the arm's own."""
        self._arm.stop()

    def close(self) -> None:
        """As the arm's own."""
        self._arm.close()

    def press_at(self, point: Vector3, inward: Vector3) -> None:
        """Say where depth counts from: a place on the surface and the unit normal into it."""
        self._place, self._force = (point, inward), 0.0

    def leave(self) -> None:
        """Switch off the depth limit, for moves round the object."""
        self._place, self._force = None, 0.0

    def felt(self, force: float) -> None:
        """Say what the gauge reads, without the weight of the tool [N]; the next move knows it."""
        self._force = force

    def move(self, position: Vector3, direction: Vector3, speed: float) -> None:
        """As the arm's own, within the limits.

        Raises
        ------
        DeviceError                 the arm has stopped instead
        """
        point, inward = self._place or (position, direction)
        depth, before = ((x - point) @ inward for x in (position, self._arm.pose()))
        reason = ""
        if not self.limits.contain(position):
            reason = f"{_millimetres(position)} mm is out of the box of [arm.limits]"
        elif speed > self.limits.speed:
            reason = f"{1e3 * speed:g} mm/s is faster than {1e3 * self.limits.speed:g} mm/s"
        elif depth > before and depth > (1.0 + _ROUNDING) * self.limits.depth:
            reason = f"{1e3 * depth:.3g} mm is deeper than {1e3 * self.limits.depth:g} mm"
        elif depth > before and self._force > self.limits.force:
            reason = f"the tool presses with {self._force:.3g} N of {self.limits.force:g} at most"
        if reason:
            self._arm.stop()
            raise DeviceError(
                f"the arm was stopped: {reason}; see that all is well before going on"
            )
        self._arm.move(position, direction, speed)
