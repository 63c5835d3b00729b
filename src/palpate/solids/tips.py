"""The tip of the arm's rod: a rigid tool that moves along its axis towards the body."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from palpate.arrays import fix_fields, fixed_array, tangents_of
from palpate.contact import PlacedTool, gaps
from palpate.errors import InputError
from palpate.records import ConvexMesh, FlatFace, Sphere, Tool
from palpate.shapes import Points, PointScalars, Vector3

# A thin supported layer is indented less than a half space, by at most about this factor.
_STIFFER = 10.0


@dataclass(frozen=True, slots=True, eq=False)
class Tip:
    """A ball or a flat round face that moves along its axis towards the body.

    Parameters
    ----------
    tool : Sphere or FlatFace
    point : (3,) float [m]          a place of its origin; travel is counted from it
    direction : (3,) float [-]      of the motion, towards the body; normalised to unit length

    Raises
    ------
    InputError                      direction without length
    """

    tool: Sphere | FlatFace
    point: Vector3
    direction: Vector3
    # What touches: the plane of a flat face is unbounded here. Which nodes lie within its rim is
    # decided where they are chosen.
    _face: Tool = field(init=False, repr=False)

    def __post_init__(self) -> None:
        length = float(np.linalg.norm(self.direction))
        if length == 0.0:
            raise InputError("the tip's direction is the zero vector; it must point to the body")
        fix_fields(self, point=(3,))
        unit = fixed_array(np.asarray(self.direction) / length, name="direction", shape=(3,))
        object.__setattr__(self, "direction", unit)
        plane, friction = np.array([[0.0, 0.0, -1.0, 0.0]]), self.tool.friction
        face = ConvexMesh(self.radius, plane, self.tool.reach, friction=friction)
        object.__setattr__(self, "_face", face if self.tool.is_flat else self.tool)

    @property
    def radius(self) -> float:
        """Of its tool [m]."""
        return self.tool.radius

    @property
    def max_depth(self) -> float:
        """Upper bound of the depth, itself excluded [m]: the radius of a ball, else infinite."""
        return np.inf if self.tool.is_flat else self.radius

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
        return along - self.tool.lead(self.radial_distance(points))

    def radial_distance(self, points: Points) -> PointScalars:
        """Distance of points from the axis, (n,) [m]."""
        return np.linalg.norm(np.cross(points - self.point, self.direction), axis=1)

    def moved(self, travel: float) -> PlacedTool:
        """What touches the body, after a travel [m] from `point`."""
        axis = -self.direction
        across = tangents_of(axis)[0]
        rotation = np.column_stack([across, np.cross(axis, across), axis])
        return PlacedTool(self._face, self.point + travel * self.direction, rotation)

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
        return gaps(self.moved(travel), points)

    def rim(self, apart: float) -> Float[np.ndarray, "k 3"]:
        """Points around the rim of a flat face, with the tip at `point`.

        Parameters
        ----------
        apart : float [m]               largest distance between neighbours, > 0

        Returns
        -------
        (k, 3) float [m]                empty for a ball
        """
        count = int(np.ceil(2.0 * np.pi * self.radius / apart)) if self.tool.is_flat else 0
        angle = 2.0 * np.pi * np.arange(count) / count if count else np.zeros(0)
        across = tangents_of(self.direction)
        return self.point + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1) @ across

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
        depth = self.tool.dent(force / modulus)
        if not depth < _STIFFER * self.max_depth:
            raise InputError(
                f"force is {force:g} N, which presses a half space of this material in by"
                f" {1e3 * depth:.3g} mm, the tip's radius is {1e3 * self.radius:.3g} mm; a sphere"
                " goes in by less than its radius: press less, or take a larger one"
            )
