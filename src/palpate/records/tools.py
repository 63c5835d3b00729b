"""Rigid tools, each shape a class here and an entry in `TOOLS`.

A tool has a frame: its axis is z, and it presses towards -z. The origin is the centre of a sphere,
the middle of a flat face, the apex of a cone. `probe.tool_contact` finds the pressure of a tool on
a half space, `contact` what it does to any object whose compliance is known.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.errors import InputError
from palpate.geometry import TriangleMesh, convex_planes
from palpate.shapes import Matrix3, Vector3

SPHERE, FLAT, CONE, CYLINDER, RING, MESH = "sphere", "flat", "cone", "cylinder", "ring", "mesh"
# Coefficients of friction between tool and surface, and their words in a session.
SLIDES, STICKS = 0.0, np.inf
FRICTIONS: Mapping[str, float] = {"slides": SLIDES, "sticks": STICKS}
# Least half opening angle of a cone [rad].
_SHARPEST = 0.5
# Faces whose normals are within this of perpendicular to the half space's are upright.
_UPRIGHT = 1e-6
# Faces of a tool whose heights are computed at once.
_AT_ONCE = 256
# Length of the rod behind a face, in radii, of a tool that may be approached from any side.
_ROD = 4.0
Grid = Float[np.ndarray, "n n"]


@dataclass(frozen=True, slots=True)
class Tool(ABC):
    """A rigid tool; its contact patch follows from force and constants.

    Parameters
    ----------
    radius : float [m]              as far as the tool reaches from its axis, > 0
    friction : float [-]            Coulomb's coefficient: the surface `SLIDES` freely under the
                                    tool, or `STICKS` to it; one in between only where a tool is
                                    moved tick by tick (`contact`)

    Attributes
    ----------
    shape : str                     its name, a key of `TOOLS`
    is_flat : bool                  its face is flat and ends in a sharp rim
    growth : float or None          q, where it dents a half space by a depth in proportion to
                                    force^(1 - q); None: it follows no power

    Raises
    ------
    InputError                      a negative friction; a radius that is not positive
    """

    radius: float
    friction: float = field(default=SLIDES, kw_only=True)
    shape: ClassVar[str]
    is_flat: ClassVar[bool] = False
    growth: ClassVar[float | None] = None

    def __post_init__(self) -> None:
        if not (isinstance(self.friction, float | int) and self.friction >= 0.0):
            raise InputError(
                f"friction is {self.friction!r}; must be 0 (slides), a coefficient, or infinite"
                " (sticks)"
            )
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"tool_radius is {self.radius}; must be a positive length")

    @property
    def friction_name(self) -> str:
        """Its friction as a session says it."""
        return next(name for name, size in FRICTIONS.items() if size == self.friction)

    @property
    def faces(self) -> Float[np.ndarray, "p 4"]:
        """What bounds it in its frame: outward unit normals, and the offset along each [m].

        Planes; of a `RoundTool` lines in the half plane of radius and z, whose normals are
        (radial, 0, axial). A sphere has none.

        Raises
        ------
        InputError                  a tool that is not convex
        """
        raise InputError(f"a {self.shape} is not convex; only convex tools can be moved about")

    @property
    def reach(self) -> float:
        """Radius of a ball about its origin that contains it [m]."""
        return float(np.hypot(self.radius, _ROD * self.radius))


@dataclass(frozen=True, slots=True)
class RoundTool(Tool):
    """A convex tool that is round about its axis."""

    @abstractmethod
    def slope(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Rise of the face per distance from the axis, which does not fall.

        Parameters
        ----------
        distance : array [m]        from the axis, below the radius
        """


class Sphere(RoundTool):
    """A ball of a radius [m]."""

    __slots__ = ()
    shape, growth = SPHERE, 1.0 / 3.0
    faces = np.zeros((0, 4))

    @property
    def reach(self) -> float:
        """Its radius [m]."""
        return self.radius

    def slope(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Slope of the ball itself, not of a paraboloid."""
        return np.asarray(distance / np.sqrt(self.radius**2 - distance**2))

    def lead(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """How far the face is ahead of the origin, towards -z [m]; -inf beyond the radius.

        Parameters
        ----------
        distance : array [m]        from the axis
        """
        rise = np.sqrt(np.clip(self.radius**2 - distance**2, 0.0, None))
        return np.where(distance < self.radius, rise, -np.inf)

    def dent(self, load: float) -> float:
        """Depth to which it dents a half space [m], as a paraboloid: up to half its radius.

        Parameters
        ----------
        load : float [m^2]          force over the reduced modulus, > 0

        Source
        ------
        Hertz; Johnson, Contact Mechanics (1985), equation 4.23
        """
        return float(np.cbrt((0.75 * load) ** 2 / self.radius))


class FlatFace(RoundTool):
    """A flat circular face of a radius [m]."""

    __slots__ = ()
    shape, growth, is_flat = FLAT, 0.0, True

    def slope(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Zero everywhere."""
        return np.zeros_like(distance)

    def lead(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """As of a `Sphere`: none, up to the rim."""
        return np.where(distance <= self.radius * (1.0 + 1e-9), 0.0, -np.inf)

    def dent(self, load: float) -> float:
        """As of a `Sphere`; Johnson, Contact Mechanics (1985), equation 3.36."""
        return load / (2.0 * self.radius)

    @property
    def faces(self) -> Float[np.ndarray, "p 4"]:
        """A rod."""
        return _rod(self.radius, [0.0, 0.0, -1.0, 0.0])


@dataclass(frozen=True, slots=True)
class Cone(RoundTool):
    """A cone, apex first.

    Parameters
    ----------
    radius : float [m]              of its base
    angle : float [rad]             between its axis and its side, from 0.5 (29 degrees) to below
                                    pi / 2
    friction : float                as of every `Tool`

    Raises
    ------
    InputError                      as of every `Tool`; an angle out of range
    """

    angle: float
    shape: ClassVar[str] = CONE

    def __post_init__(self) -> None:
        Tool.__post_init__(self)
        if not _SHARPEST <= self.angle < 0.5 * np.pi:
            raise InputError(
                f"tool_angle is {np.degrees(self.angle):.3g} degrees; must be from"
                f" {np.degrees(_SHARPEST):.0f} to below 90, between the cone's axis and its side: a"
                " sharper cone cuts, and does not press"
            )

    def slope(self, distance: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Slope of its side."""
        return np.full_like(distance, 1.0 / np.tan(self.angle))

    @property
    def faces(self) -> Float[np.ndarray, "p 4"]:
        """A pointed rod."""
        return _rod(self.radius, [np.cos(self.angle), 0.0, -np.sin(self.angle), 0.0])


@dataclass(frozen=True, slots=True)
class Face:
    """The part of a tool that faces a half space, on a square in its tangent plane.

    Attributes
    ----------
    height : (n, n) float [m]       over the tool's centre point
    slope : (2, n, n) float [-]     of the height along both axes
    inside : (n, n) bool            where the tool is; height and slope are 0 elsewhere
    """

    height: Grid
    slope: Float[np.ndarray, "2 n n"]
    inside: Bool[np.ndarray, "n n"]


@dataclass(frozen=True, slots=True)
class ShapedTool(Tool):
    """A tool of a shape of its own, whose contact is found on a grid."""

    @abstractmethod
    def face(self, axes: Float[np.ndarray, "2 3"], normal: Vector3, x: Grid, y: Grid) -> Face:
        """Its face over a square.

        Parameters
        ----------
        axes : (2, 3) float [-]     two unit tangents of the half space, at right angles
        normal : (3,) float [-]     outward, of the half space
        x, y : (n, n) float [m]     places along the axes, from the tool's centre point
        """


@dataclass(frozen=True, slots=True)
class Ring(ShapedTool):
    """The flat end of a tube.

    Parameters
    ----------
    radius : float [m]              outer
    inner_radius : float [m]        above 0 and below the outer one
    friction : float                as of every `Tool`

    Raises
    ------
    InputError                      as of every `Tool`; an inner radius out of range
    """

    inner_radius: float
    shape: ClassVar[str] = RING
    growth: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        Tool.__post_init__(self)
        if not 0.0 < self.inner_radius < self.radius:
            raise InputError(
                f"tool_inner_radius is {1e3 * self.inner_radius:.4g} mm; must be above 0 and below"
                f" tool_radius, {1e3 * self.radius:.4g} mm"
            )

    def face(self, axes: Float[np.ndarray, "2 3"], normal: Vector3, x: Grid, y: Grid) -> Face:
        """Level between its two rims."""
        distance = np.hypot(x, y)
        inside = (distance > self.inner_radius) & (distance < self.radius)
        return Face(np.zeros_like(x), np.zeros((2, *x.shape)), inside)


@dataclass(frozen=True, slots=True)
class ConvexMesh(ShapedTool):
    """A convex mesh, made by `mesh_tool`.

    Parameters
    ----------
    radius : float [m]              half the smallest side of its bounding box
    faces : (p, 4) float            planes: outward unit normals in the object's frame, and their
                                    offsets from the tool's centre point [m]
    reach : float [m]               radius of a ball about the centre point that contains it
    friction : float                as of every `Tool`
    """

    faces: Float[np.ndarray, "p 4"] = field(compare=False)
    reach: float = field(compare=False)
    shape: ClassVar[str] = MESH

    def face(self, axes: Float[np.ndarray, "2 3"], normal: Vector3, x: Grid, y: Grid) -> Face:
        """The lower side of its hull."""
        a, b, c = (self.faces[:, :3] @ np.vstack([axes, normal]).T).T
        lower_side, covers, upright = c < -_UPRIGHT, c > _UPRIGHT, abs(c) <= _UPRIGHT
        places = np.stack([np.ones(x.size), x.ravel(), y.ravel()])

        def terms(chosen: Bool[np.ndarray, " p"]) -> Float[np.ndarray, "k 3"]:
            """Height of planes as a function of 1, x and y; of upright ones, distance to them."""
            scale = np.where(upright, 1.0, c)[chosen, None]
            return np.stack([self.faces[:, 3], -a, -b], axis=1)[chosen] / scale

        lower = terms(lower_side)
        height, lowest = _highest(lower, places)
        top = -_highest(-terms(covers), places)[0]
        inside = (height <= top) & (terms(upright) @ places >= 0.0).all(axis=0)
        slope = np.where(inside, lower[lowest, 1:].T, 0.0)
        height = np.where(inside, height, 0.0)
        return Face(height.reshape(x.shape), slope.reshape(2, *x.shape), inside.reshape(x.shape))


# By the name in a session; to add a shape, add its class and a line here.
TOOLS: Mapping[str, type[Tool]] = {
    SPHERE: Sphere, FLAT: FlatFace, CONE: Cone, CYLINDER: FlatFace, RING: Ring, MESH: ConvexMesh,
}  # fmt: skip


def mesh_tool(mesh: TriangleMesh, rotation: Matrix3, *, friction: float = SLIDES) -> ConvexMesh:
    """A rigid tool of the shape of a convex mesh.

    Parameters
    ----------
    mesh : TriangleMesh             closed, convex; the origin of its frame is the tool's centre
                                    point, which a contact places on the surface
    rotation : (3, 3) float [-]     from the mesh's frame to the object's
    friction : float                as of every `Tool`

    Returns
    -------
    ConvexMesh                      coplanar triangles are one face

    Raises
    ------
    InputError                      a mesh that is flat, open or not convex
    """
    planes = convex_planes(mesh)
    turned = np.column_stack([planes[:, :3] @ rotation.T, planes[:, 3]])
    radius = 0.5 * float(np.ptp(mesh.vertices, axis=0).min())
    reach = float(np.linalg.norm(mesh.vertices, axis=1).max())
    return ConvexMesh(radius, turned, reach, friction=friction)


def _rod(radius: float, end: Sequence[float]) -> Float[np.ndarray, "3 4"]:
    """The faces of a rod: its end, its side and its far end."""
    return np.array([end, [1.0, 0.0, 0.0, radius], [0.0, 0.0, 1.0, _ROD * radius]])


def _highest(
    planes: Float[np.ndarray, "p 3"], places: Float[np.ndarray, "3 m"]
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Height of the highest plane at every place of a square, and which it is."""
    side = int(np.sqrt(places.shape[1]))
    at_corners = planes @ places[:, [0, side - 1, -side, -1]]
    # A plane that lies below another one at all corners is the highest nowhere.
    candidates = np.flatnonzero(
        at_corners.max(axis=1) >= at_corners.min(axis=1).max(initial=-np.inf)
    )
    height, highest = np.full(places.shape[1], -np.inf), np.zeros(places.shape[1], dtype=np.int64)
    for first in range(0, candidates.size, _AT_ONCE):
        chosen = candidates[first : first + _AT_ONCE]
        heights = places.T @ planes[chosen].T
        best = heights.argmax(axis=1)
        reached = heights[np.arange(best.size), best]
        highest = np.where(reached > height, chosen[best], highest)
        height = np.maximum(reached, height)
    return height, highest
