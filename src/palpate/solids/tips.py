"""Rigid tips of the arm's rod: each shape of tip is a class here and an entry in `TIPS`."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float

from palpate.arrays import fix_fields, fixed_array, tangents_of
from palpate.errors import InputError
from palpate.records import FlatFace, Sphere as Ball
from palpate.shapes import Points, PointScalars, Vector3

TipName = Literal["sphere", "punch"]
# Largest radius of the shaft behind a ball, so that the rod occludes little [m].
_SHAFT = 4e-3
# A thin supported layer is indented less than a half space, by at most about this factor.
_STIFFER = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Tip(ABC):
    """Rigid tip that moves along its axis towards the body.

    The place of a tip is its reference point on the axis: the centre of a sphere or of a punch's
    face.

    Parameters
    ----------
    radius : float [m]              > 0
    point : (3,) float [m]          a point of the axis; travel is counted from it
    direction : (3,) float [-]      of the motion, towards the body; normalised to unit length

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
        fix_fields(self, point=(3,))
        unit = fixed_array(np.asarray(self.direction) / length, name="direction", shape=(3,))
        object.__setattr__(self, "direction", unit)

    def travel(self, points: Points) -> PointScalars:
        """Travel from `point` at which the tip would touch each point.

        Parameters
        ----------
        points : (n, 3) float [m]

        Returns
        -------
        (n,) float [m]                  infinite for points that it misses
        """
        along = (points - self.point) @ self.direction
        return along - self.surface_offset(self.radial_distance(points))

    def radial_distance(self, points: Points) -> PointScalars:
        """Distance of points from the axis, (n,) [m]."""
        return np.linalg.norm(np.cross(points - self.point, self.direction), axis=1)

    @property
    def max_depth(self) -> float:
        """Upper bound of the depth, itself excluded [m]; infinite if unlimited."""
        return np.inf

    def check_depth(self, depth: float) -> None:
        """Refuse a depth that is not below `max_depth`.

        Parameters
        ----------
        depth : float [m]

        Raises
        ------
        InputError                      depth too large
        """
        if not depth < self.max_depth:
            raise InputError(
                f"depth is {1e3 * depth:.3g} mm, the tip's radius {1e3 * self.radius:.3g} mm; a"
                " sphere goes in by less than its radius: press less, or take a larger one"
            )

    def check_force(self, force: float, modulus: float) -> None:
        """Refuse a force that would exceed `max_depth` even in a thin, supported layer.

        Parameters
        ----------
        force : float [N]
        modulus : float [Pa]            plane strain modulus E / (1 - nu^2) of the body

        Raises
        ------
        InputError                      force too large
        """
        depth = self.half_space_depth(force, modulus)
        if not depth < _STIFFER * self.max_depth:
            raise InputError(
                f"force is {force:g} N, which presses a half space of this material in by"
                f" {1e3 * depth:.3g} mm, the tip's radius is {1e3 * self.radius:.3g} mm; a sphere"
                " goes in by less than its radius: press less, or take a larger one"
            )

    @abstractmethod
    def surface_offset(self, radial_distance: PointScalars) -> PointScalars:
        """Distance, along the motion, of the tip's surface ahead of its place.

        Parameters
        ----------
        radial_distance : (n,) float [m]    distance from the axis

        Returns
        -------
        (n,) float [m]                  -inf beyond the tip's radius
        """

    @abstractmethod
    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Signed distance of points from the tip's surface.

        Parameters
        ----------
        travel : float [m]              of the tip, from `point`
        points : (n, 3) float [m]

        Returns
        -------
        distance : (n,) float [m]       negative inside the tip
        normal : (n, 3) float [-]       outward unit normal at the closest point of the surface
        """

    @abstractmethod
    def half_space_depth(self, force: float, modulus: float) -> float:
        """Indentation depth in an elastic half space under a force, without friction.

        Parameters
        ----------
        force : float [N]
        modulus : float [Pa]            plane strain modulus E / (1 - nu^2) of the half space

        Returns
        -------
        float [m]
        """

    @abstractmethod
    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """Contact radius on an elastic half space, at a depth or under a force.

        Parameters
        ----------
        depth : float [m] or None
        force : float [N] or None       used if there is no depth
        modulus : float [Pa]            plane strain modulus E / (1 - nu^2) of the half space

        Returns
        -------
        float [m]                       at most the tip's radius
        """

    def rim(self, apart: float) -> Float[np.ndarray, "k 3"]:
        """Points on the sharp rim of the tip, if it has one, with the tip at `point`.

        Parameters
        ----------
        apart : float [m]               largest distance between neighbours, > 0

        Returns
        -------
        (k, 3) float [m]                empty for a round tip
        """
        return np.zeros((0, 3))

    @abstractmethod
    def outline(self) -> Float[np.ndarray, "k 2"]:
        """Contour of the rod's end, from its axis to the shaft.

        Returns
        -------
        (k, 2) float [m]                radius, and height above the tip's place
        """


class Sphere(Tip):
    """A ball on a shaft of at most 4 mm radius."""

    __slots__ = ()
    tool = Ball.shape

    @property
    def max_depth(self) -> float:
        """The radius: a sphere is pressed in by less than that [m]."""
        return self.radius

    def surface_offset(self, radial_distance: PointScalars) -> PointScalars:
        """Distance of the sphere's surface ahead of its centre [m]."""
        rise = np.sqrt(np.clip(self.radius**2 - radial_distance**2, 0.0, None))
        return np.where(radial_distance < self.radius, rise, -np.inf)

    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Signed distance, with radial normals."""
        offset = points - (self.point + travel * self.direction)
        length = np.linalg.norm(offset, axis=1)
        return length - self.radius, offset / length[:, None]

    def half_space_depth(self, force: float, modulus: float) -> float:
        """Hertz' depth; source: Johnson, Contact Mechanics (1985), equation 4.23."""
        return float(np.cbrt((0.75 * force / modulus) ** 2 / self.radius))

    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """Hertz' radius; source: Johnson, Contact Mechanics (1985), equations 4.22 and 4.23."""
        if depth is not None:
            radius = np.sqrt(self.radius * depth)
        else:
            radius = np.cbrt(0.75 * float(force or 0.0) * self.radius / modulus)
        return min(float(radius), self.radius)

    def outline(self) -> Float[np.ndarray, "k 2"]:
        """Contour from the pole past the equator to the shaft."""
        shaft = min(self.radius, _SHAFT)
        angle = np.linspace(-0.5 * np.pi, np.arccos(shaft / self.radius), 13)
        end = self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        end[0, 0] = 0.0
        return end


class Punch(Tip):
    """A flat round face, perpendicular to its motion, as wide as its shaft."""

    __slots__ = ()
    tool = FlatFace.shape

    def surface_offset(self, radial_distance: PointScalars) -> PointScalars:
        """Zero up to the rim."""
        return np.where(radial_distance <= self.radius * (1.0 + 1e-9), 0.0, -np.inf)

    def distance(self, travel: float, points: Points) -> tuple[PointScalars, Points]:
        """Signed distance from the plane of the face, which is taken as unbounded."""
        offset = points - (self.point + travel * self.direction)
        return offset @ self.direction, np.broadcast_to(self.direction, points.shape)

    def half_space_depth(self, force: float, modulus: float) -> float:
        """Depth of a flat punch; source: Johnson, Contact Mechanics (1985), equation 3.36."""
        return force / (2.0 * self.radius * modulus)

    def half_space_radius(self, depth: float | None, force: float | None, modulus: float) -> float:
        """The radius of the face, at any depth."""
        return self.radius

    def rim(self, apart: float) -> Float[np.ndarray, "k 3"]:
        """Points around the face, (k, 3) [m], at most `apart` [m] from one another."""
        count = int(np.ceil(2.0 * np.pi * self.radius / apart))
        angle = 2.0 * np.pi * np.arange(count) / count
        across = tangents_of(self.direction)
        return self.point + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across

    def outline(self) -> Float[np.ndarray, "k 2"]:
        """Contour of the face."""
        return np.array([[0.0, 0.0], [self.radius, 0.0]])


TIPS: dict[TipName, type[Tip]] = {"sphere": Sphere, "punch": Punch}
