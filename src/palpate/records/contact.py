"""Contacts: the tool, where it presses, and how its pressure is distributed over the patch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, convex_planes
from palpate.shapes import Indices, Matrix3, Points, PointScalars, Vector3

# Shapes of tools, and friction between tool and surface.
SPHERE, FLAT, CONE, CYLINDER, MESH = TOOL_SHAPES = ("sphere", "flat", "cone", "cylinder", "mesh")
SLIDES, STICKS = FRICTIONS = ("slides", "sticks")
# Initial contact radius of a search: this fraction of the tool's radius, but at most this fraction
# of the object's size.
_TOUCHED, _TOUCHED_OF_OBJECT = 0.5, 0.05
# Least half opening angle of a cone [rad].
_SHARPEST = 0.5
Pressure = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


@dataclass(frozen=True, slots=True)
class Tool:
    """A rigid tool; its contact patch follows from force and constants.

    Parameters
    ----------
    shape : str                     `SPHERE`; `FLAT` or `CYLINDER`, synonyms for a flat circular
                                    face; `CONE`, apex first; `MESH`, made by `mesh_tool`
    radius : float [m]              of the sphere, of the flat face, or of the cone's base, > 0;
                                    half the smallest side of a mesh's bounding box
    friction : str                  the surface `SLIDES` freely under the tool, or `STICKS` to it
    angle : float [rad] or None     only for a cone: between its axis and its side, from 0.5
                                    (29 degrees) to below pi / 2
    planes : (p, 4) float or None   only for a mesh: outward unit normals in the object's frame, and
                                    their offsets from the tool's centre point [m]

    Raises
    ------
    InputError                      unknown shape or friction; a radius that is not positive; an
                                    angle that is missing, out of range, or given without a cone;
                                    planes missing, or given without a mesh
    """

    shape: str
    radius: float
    friction: str = SLIDES
    angle: float | None = None
    planes: Float[np.ndarray, "p 4"] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        for name, value, known in (
            ("tool", self.shape, TOOL_SHAPES),
            ("friction", self.friction, FRICTIONS),
        ):
            if value not in known:
                raise InputError(f"{name} is '{value}'; must be one of {', '.join(known)}")
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"tool_radius is {self.radius}; must be a positive length")
        if (self.angle is None) == (self.shape == CONE):
            raise InputError(
                f"tool '{self.shape}' has {'no' if self.angle is None else 'a'} tool_angle; a cone"
                " needs one, between its axis and its side, and no other tool has one"
            )
        if self.angle is not None and not _SHARPEST <= self.angle < 0.5 * np.pi:
            raise InputError(
                f"tool_angle is {np.degrees(self.angle):.3g} degrees; must be from"
                f" {np.degrees(_SHARPEST):.0f} to below 90, between the cone's axis and its side: a"
                " sharper cone cuts, and does not press"
            )
        if (self.planes is None) == (self.shape == MESH):
            raise InputError("planes are those of a mesh's faces: give them by `mesh_tool`")

    @property
    def is_flat(self) -> bool:
        """Whether the contact face is a flat disc."""
        return self.shape in (FLAT, CYLINDER)

    def contact(self, point: Vector3, size: float = np.inf) -> "Contact":
        """Initial contact for the search of the contact radius: half the tool's radius, at most 5 %
        of the object's `size` [m]; the whole face of a flat tool."""
        if self.is_flat:
            return Contact(point, self.radius, "flat", tool=self)
        radius = min(_TOUCHED * self.radius, _TOUCHED_OF_OBJECT * size)
        profile = "cone" if self.shape == CONE else "hertz"
        return Contact(point, radius, profile, tool=self)


@dataclass(frozen=True, slots=True, eq=False)
class PressureMap:
    """Pressure that is not a function of the distance from the contact point alone.

    The grids cover a square about the contact point in the tangent plane; their values are those at
    the centres of g x g equal cells, index [i, j] along the first and second axis.

    Attributes
    ----------
    axes : (2, 3) float [-]         orthonormal tangents
    half_side : float [-]           of the square, in contact radii
    reach : float [-]               farthest point of the contact from its centre, in contact radii
    pressure : (g, g) float         >= 0, of any scale
    outward : (g, g) float          radial component, away from the contact point, of the traction;
                                    the same scale
    """

    axes: Float[np.ndarray, "2 3"]
    half_side: float
    reach: float
    pressure: Float[np.ndarray, "g g"]
    outward: Float[np.ndarray, "g g"]

    def at(self, offset: Points) -> PointScalars:
        """Pressure at points, interpolated bilinearly.

        Parameters
        ----------
        offset : (p, 3) float [-]       from the contact point, in contact radii

        Returns
        -------
        (p,) float                      0 outside the square
        """
        return self._interpolated(self.pressure, offset)

    def mean(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Pressure averaged over all directions, at a distance `s` over the reach."""
        return self._averaged(self.pressure, s)

    def mean_outward(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Outward traction averaged over all directions, at a distance `s` over the reach; 0 where
        it points inward."""
        return np.clip(self._averaged(self.outward, s), 0.0, None)

    def _interpolated(self, grid: Float[np.ndarray, "g g"], offset: Points) -> PointScalars:
        place = 0.5 * (offset @ self.axes.T / self.half_side + 1.0) * len(grid) - 0.5
        return np.asarray(map_coordinates(grid, place.T, order=1, mode="grid-constant"))

    def _averaged(
        self, grid: Float[np.ndarray, "g g"], s: Float[np.ndarray, "*n"]
    ) -> Float[np.ndarray, "*n"]:
        angle = 2.0 * np.pi * np.arange(_ANGLES) / _ANGLES
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1) @ self.axes
        offset = (self.reach * np.ravel(s)[:, None, None] * around).reshape(-1, 3)
        return self._interpolated(grid, offset).reshape(*np.shape(s), _ANGLES).mean(axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Circular patch over which the tool presses, or a set of triangles that is loaded as a whole.

    Parameters
    ----------
    point : (3,) float [m]          centre of the patch, on the surface or close to it; for a tool:
                                    where it touches first
    radius : float [m] or None      contact radius, > 0; None only for the profile `_VERTEX` and for
                                    triangles
    profile : str                   one of `contact_profiles`; with triangles `UNIFORM` or `RIGID`;
                                    not used where there is a pressure map
    triangles : (k,) int or None    loaded triangles, in place of a circular patch
    tool : Tool or None             the tool, from which radius and profile are computed; those
                                    given here are only initial values. None: they are known
    pressure_map : PressureMap or None      pressure under a mesh, in place of the profile
    first_point : (3,) float [m] or None    where the tool touched first; None: at `point`, on an
                                    object that does not move sideways under it
    outward : float [-]             integral of the traction away from the centre times the distance
                                    from it, over radius and pressing force; 0 where there is none,
                                    and under a mesh, whose map has it

    Raises
    ------
    InputError                      an unknown profile; radius missing, not positive, or given for
                                    `_VERTEX` or triangles; no triangles
    """

    point: Vector3
    radius: float | None
    profile: str
    triangles: Indices | None = None
    tool: Tool | None = None
    pressure_map: PressureMap | None = None
    first_point: Vector3 | None = None
    outward: float = 0.0

    def __post_init__(self) -> None:
        fix_fields(self, point=(3,))
        fix_fields(self, none_allowed=True, first_point=(3,))
        if self.triangles is not None:
            fix_fields(self, integer=True, triangles=(None,))
            object.__setattr__(self, "triangles", np.unique(self.triangles))
            if not self.triangles.size or self.radius is not None:
                raise InputError("a load over triangles needs at least one, and has no radius")
            if self.profile not in (UNIFORM, RIGID):
                raise InputError(
                    f"traction is '{self.profile}'; over triangles it must be {UNIFORM} or {RIGID}"
                )
            return
        if self.profile == _VERTEX:
            if self.radius is not None:
                raise InputError(
                    f"radius is {self.radius} with profile 'vertex'; that profile has no radius:"
                    f" leave it out, or choose one of {', '.join(PRESSURES)}"
                )
            return
        if self.profile not in PRESSURES:
            known = ", ".join(contact_profiles())
            raise InputError(f"profile is '{self.profile}'; must be one of {known}")
        if self.radius is None:
            raise InputError(
                f"radius is missing; profile '{self.profile}' needs one"
                " (only profile 'vertex' has none)"
            )
        if not (np.isfinite(self.radius) and self.radius > 0.0):
            raise InputError(f"radius is {self.radius}; must be a positive length")

    @property
    def start(self) -> Vector3:
        """Where the tool touched first [m]."""
        return self.point if self.first_point is None else self.first_point

    @property
    def reach(self) -> float:
        """Farthest distance of the patch from its centre [m]: the radius, except under a mesh; 0
        where there is no radius."""
        radius = self.radius or 0.0
        return radius if self.pressure_map is None else radius * self.pressure_map.reach

    @property
    def pressure(self) -> Pressure:
        """Pressure at a distance over the reach, up to a factor, averaged over all directions; zero
        from 1 on."""
        return PRESSURES[self.profile] if self.pressure_map is None else self.pressure_map.mean

    def pressure_at(self, offset: Points) -> PointScalars:
        """Pressure at points of the surface, up to a factor; `offset`, (p, 3), is the distance from
        the contact point in contact radii."""
        if self.pressure_map is not None:
            return self.pressure_map.at(offset)
        return self.pressure(np.linalg.norm(offset, axis=1))


def mesh_tool(mesh: TriangleMesh, rotation: Matrix3, friction: str = SLIDES) -> Tool:
    """A rigid tool of the shape of a convex mesh.

    Parameters
    ----------
    mesh : TriangleMesh             closed, convex; the origin of its frame is the tool's centre
                                    point, which a contact places on the surface
    rotation : (3, 3) float [-]     from the mesh's frame to the object's
    friction : str                  the surface `SLIDES` freely under the tool, or `STICKS` to it

    Returns
    -------
    Tool

    Raises
    ------
    InputError                      a mesh that is flat, open or not convex
    """
    planes = convex_planes(mesh)
    turned = np.column_stack([planes[:, :3] @ rotation.T, planes[:, 3]])
    radius = 0.5 * float(np.ptp(mesh.vertices, axis=0).min())
    return Tool(MESH, radius, friction, planes=turned)


def smooth_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """(1 - s^2)^2: decreases smoothly to zero at the rim, as under a soft tool.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on; callers normalise it
    """
    return np.clip(1 - s**2, 0, None) ** 2


def _uniform_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 inside the radius, 0 outside, as under a flat tool on a soft layer.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on
    """
    return (s < 1).astype(np.float64)


def _hertz_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """sqrt(1 - s^2), under a frictionless sphere (Hertz 1881).

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on

    Source
    ------
    Hertz, J. reine angew. Math. 92 (1881) 156-171
    """
    return np.sqrt(np.clip(1 - s**2, 0, None))


def _flat_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 / sqrt(1 - s^2), under a frictionless rigid flat punch.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, singular at the rim, 0 from there on

    Source
    ------
    Johnson, Contact Mechanics (1985), eq. 3.34
    """
    return np.where(s < 1, 1.0 / np.sqrt(np.clip(1 - s**2, 1e-12, None)), 0.0)


def cone_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """arcosh(1 / s), under a frictionless rigid cone.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       logarithmically singular at the centre; 0 from the rim on

    Source
    ------
    Johnson, Contact Mechanics (1985), section 5.2; Love, Q. J. Math. 10 (1939) 161
    """
    return np.arccosh(1.0 / np.clip(s, 1e-9, 1.0))


# To add a tool shape, add its pressure function and one line here. Only the shape of the curve
# matters: it is scaled so that its integral is the force.
PRESSURES: Mapping[str, Pressure] = {
    "smooth": smooth_pressure,
    "uniform": _uniform_pressure,
    "hertz": _hertz_pressure,
    "flat": _flat_pressure,
    "cone": cone_pressure,
}


# Linear hat function of the vertex nearest to the contact point; a contact without a radius.
_VERTEX = "vertex"


# Loads over given triangles: uniform traction, or a grip that moves them rigidly.
UNIFORM, RIGID = "uniform", "rigid"


# Angles over which a pressure map is averaged.
_ANGLES = 32


def contact_profiles() -> tuple[str, ...]:
    """Permitted names of a contact's pressure profile."""
    return (*PRESSURES, _VERTEX)
