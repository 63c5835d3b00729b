"""Rigid tips of the arm's rod: every shape of tip is one class here and one entry of `TIPS`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.records import FLAT, SPHERE
from palpate.shapes import Points, PointScalars, Vector3

TipName = Literal["sphere", "punch"]
# A round end larger than this sits on a thinner shaft, so that it hides less [m].
_SHAFT = 4e-3
# A thin layer on its support gives less than a half space does, by this factor or less.
_STIFFER = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Tip(ABC):
    """Rigid end of a probe on its way to the body.

    Its place is a point of its axis: the middle of a sphere, or of a punch's face.

    Parameters
    ----------
    radius : float [m]              > 0
    point : (3,) float [m]          the axis of its motion goes through it
    direction : (3,) float [-]      of its motion, towards the body; made a unit vector

    Raises
    ------
    InputError                      radius not positive, direction without length
    """

    radius: float
    point: Vector3
    direction: Vector3
    tool: ClassVar[str]

    def __post_init__(self) -> None:
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"the tip's radius is {self.radius}; must be positive, in metres")
        length = float(np.linalg.norm(self.direction))
        if length == 0.0:
            raise InputError("the tip's direction is the zero vector; it must point to the body")
        object.__setattr__(self, "point", fixed_array(self.point, name="point", shape=(3,)))
        unit = fixed_array(np.asarray(self.direction) / length, name="direction", shape=(3,))
        object.__setattr__(self, "direction", unit)

    def travel(self, points: Points) -> PointScalars:
        """How far from `point` the tip goes until it touches each point, were it alone.

        Parameters
        ----------
        points : (n, 3) float [m]

        Returns
        -------
        (n,) float [m]                  infinite where it passes
        """
        offset = points - self.point
        along = offset @ self.direction
        beside = np.linalg.norm(offset - along[:, None] * self.direction, axis=1)
        return along - self.lead(beside)

    @property
    def max_depth(self) -> float:
        """Depth that it must stay below [m]; infinite for a tip that may go as deep as it likes."""
        return np.inf

    def check_depth(self, depth: float) -> None:
        """Refuse a depth that it must stay below.

        Parameters
        ----------
        depth : float [m]

        Raises
        ------
        InputError
        """
        if not depth < self.max_depth:
            raise InputError(
                f"depth is {1e3 * depth:.3g} mm, the tip's radius {1e3 * self.radius:.3g} mm; a"
                " sphere goes in by less than its radius: press less, or take a larger one"
            )

    def check_force(self, force: float, modulus: float) -> None:
        """Refuse a force that presses it deeper than it may go, however thin the body is.

        Parameters
        ----------
        force : float [N]
        modulus : float [Pa]            E / (1 - nu^2) of the body

        Raises
        ------
        InputError
        """
        depth = self.half_space_depth(force, modulus)
        if not depth < _STIFFER * self.max_depth:
            raise InputError(
                f"force is {force:g} N, which presses a half space of this material in by"
                f" {1e3 * depth:.3g} mm, the tip's radius is {1e3 * self.radius:.3g} mm; a sphere"
                " goes in by less than its radius: press less, or take a larger one"
            )

    @abstractmethod
    def lead(self, beside: PointScalars) -> PointScalars:
        """How far its surface is ahead of its place.

        Parameters
        ----------
        beside : (n,) float [m]         distance from its axis

        Returns
        -------
        (n,) float [m]                  -inf where the tip does not reach
        """

    @abstractmethod
    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Distance of points from its surface.

        Parameters
        ----------
        travel : float [m]              how far the tip went from `point`
        points : (n, 3) float [m]

        Returns
        -------
        distance : (n,) float [m]       negative inside
        normal : (n, 3) float [-]       outward, of the surface nearest to each point
        """

    @abstractmethod
    def half_space_depth(self, force: float, modulus: float) -> float:
        """How deep a force presses it into a half space.

        Parameters
        ----------
        force : float [N]
        modulus : float [Pa]            E / (1 - nu^2) of the half space

        Returns
        -------
        float [m]
        """

    @abstractmethod
    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """Radius of the circle that it touches on a half space, at a depth or under a force.

        Parameters
        ----------
        depth : float [m] or None
        force : float [N] or None       where there is no depth
        modulus : float [Pa]            E / (1 - nu^2) of the half space

        Returns
        -------
        float [m]                       at most the tip's
        """

    def rim(self, apart: float) -> Float[np.ndarray, "k 3"]:
        """Points of a sharp rim that the body is pressed with, at its first touch.

        Parameters
        ----------
        apart : float [m]               largest distance between neighbours, > 0

        Returns
        -------
        (k, 3) float [m]                none where the tip is round
        """
        return np.zeros((0, 3))

    @abstractmethod
    def outline(self) -> Float[np.ndarray, "k 2"]:
        """The rod's end, from its axis to the shaft.

        Returns
        -------
        (k, 2) float [m]                radius, and height over the tip's place
        """


class Sphere(Tip):
    """A ball on a shaft of at most 4 mm radius."""

    __slots__ = ()
    tool = SPHERE

    @property
    def max_depth(self) -> float:
        """A sphere goes in by less than its radius [m]."""
        return self.radius

    def lead(self, beside: PointScalars) -> PointScalars:
        """Height of the sphere over its centre [m]."""
        rise = np.sqrt(np.clip(self.radius**2 - beside**2, 0.0, None))
        return np.where(beside < self.radius, rise, -np.inf)

    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Along the radius."""
        offset = points - (self.point + travel * self.direction)
        length = np.linalg.norm(offset, axis=1)
        return length - self.radius, offset / length[:, None]

    def half_space_depth(self, force: float, modulus: float) -> float:
        """Source: Johnson, Contact Mechanics (1985), equation 4.23."""
        return float(np.cbrt((0.75 * force / modulus) ** 2 / self.radius))

    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """Source: Johnson, Contact Mechanics (1985), equations 4.22 and 4.23."""
        if depth is not None:
            radius = np.sqrt(self.radius * depth)
        else:
            radius = np.cbrt(0.75 * float(force or 0.0) * self.radius / modulus)
        return min(float(radius), self.radius)

    def outline(self) -> Float[np.ndarray, "k 2"]:
        """From the pole past the equator to the shaft."""
        shaft = min(self.radius, _SHAFT)
        angle = np.linspace(-0.5 * np.pi, np.arccos(shaft / self.radius), 13)
        end = self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        end[0, 0] = 0.0
        return end


class Punch(Tip):
    """A flat round face, perpendicular to its motion, as wide as its shaft."""

    __slots__ = ()
    tool = FLAT

    def lead(self, beside: PointScalars) -> PointScalars:
        """Level up to its rim."""
        return np.where(beside <= self.radius * (1.0 + 1e-9), 0.0, -np.inf)

    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Along its motion, as if its face had no end."""
        offset = points - (self.point + travel * self.direction)
        return offset @ self.direction, np.broadcast_to(self.direction, points.shape)

    def half_space_depth(self, force: float, modulus: float) -> float:
        """Source: Johnson, Contact Mechanics (1985), equation 3.36."""
        return force / (2.0 * self.radius * modulus)

    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """Its whole face, however deep."""
        return self.radius

    def rim(self, apart: float) -> Float[np.ndarray, "k 3"]:
        """Round the face."""
        count = int(np.ceil(2.0 * np.pi * self.radius / apart))
        angle = 2.0 * np.pi * np.arange(count) / count
        across = np.linalg.svd(self.direction[None])[2][1:]
        return self.point + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across

    def outline(self) -> Float[np.ndarray, "k 2"]:
        """The face."""
        return np.array([[0.0, 0.0], [self.radius, 0.0]])


TIPS: dict[TipName, type[Tip]] = {"sphere": Sphere, "punch": Punch}
