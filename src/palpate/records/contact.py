"""Contacts: the tool, where it presses, and how its pressure is distributed over the patch."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from palpate.arrays import fix_fields
from palpate.errors import InputError
from palpate.records.tools import FRICTIONS, Tool
from palpate.shapes import Indices, Points, PointScalars, Vector3

# Initial contact radius of a search: this fraction of the tool's radius, but at most this fraction
# of the object's size.
_TOUCHED, _TOUCHED_OF_OBJECT = 0.5, 0.05
# Where tractions about an axis are tabulated, as angles whose sine is the distance over the reach:
# dense at the rim, where they may vary as the cosine or its inverse. They are kept times it.
_ANGLE = 0.5 * np.pi * np.linspace(0.0, 1.0, 257)
SPREAD = np.sin(_ANGLE)
# Least square of the cosine, for a pressure that is singular at the rim.
_LEAST = 1e-12

Pressure = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


@dataclass(frozen=True, slots=True, eq=False)
class ToolTraction:
    """Traction under a tool, about the axis through the contact point.

    Attributes
    ----------
    pressure : (k,) float           at the distances `SPREAD` over the reach, times the root of 1
                                    minus their square; >= 0, of any scale
    outward : (k,) float            away from the axis, >= 0, likewise, of the same scale
    reach : float [-]               farthest point of the contact from its centre, in contact radii
    """

    pressure: Float[np.ndarray, " k"]
    outward: Float[np.ndarray, " k"]
    reach: float = 1.0

    def mean(self, s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Pressure averaged over all directions, at a distance `s` over the reach; 0 from 1 on."""
        root = np.sqrt(np.clip(1.0 - np.square(s), _LEAST, None))
        within = np.interp(np.arcsin(np.minimum(s, 1.0)), _ANGLE, self.pressure)
        return np.where(np.less(s, 1.0), within / root, 0.0)

    def at(self, offset: Points) -> PointScalars:
        """Pressure at points.

        Parameters
        ----------
        offset : (p, 3) float [-]       from the contact point, in contact radii

        Returns
        -------
        (p,) float
        """
        return self.mean(np.linalg.norm(offset, axis=1) / self.reach)

    @property
    def has_sharp_rim(self) -> bool:
        """Whether the pressure is singular at the rim."""
        return bool(self.pressure[-1] > 0.0)

    @property
    def potential(self) -> Float[np.ndarray, " k"]:
        """Integral of the outward traction from the distances `SPREAD` to the rim."""
        steps = 0.5 * (self.outward[1:] + self.outward[:-1]) * np.diff(_ANGLE)
        return np.append(np.cumsum(steps[::-1])[::-1], 0.0)

    @property
    def spread(self) -> float:
        """Root mean square distance of the pressure from the axis, in contact radii."""
        weight = self.pressure * SPREAD
        square = np.trapezoid(weight * SPREAD**2, _ANGLE) / np.trapezoid(weight, _ANGLE)
        return float(self.reach * np.sqrt(square))

    @property
    def lever(self) -> float:
        """Integral of the outward traction times the distance from the axis, over the reach and
        over the integral of the pressure [-]."""
        pulled, weight = self.outward * SPREAD**2, self.pressure * SPREAD
        return float(np.trapezoid(pulled, _ANGLE) / np.trapezoid(weight, _ANGLE))


@dataclass(frozen=True, slots=True, eq=False)
class GridTraction(ToolTraction):
    """Traction that is no function of the distance from the axis alone, made by `grid_traction`:
    `pressure` and `outward` are averages over all directions.

    The grid covers a square about the contact point in the tangent plane; its values are those at
    the centres of g x g equal cells, index [i, j] along the first and second axis.

    Attributes
    ----------
    axes : (2, 3) float [-]         orthonormal tangents
    half_side : float [-]           of the square, in contact radii
    grid : (g, g) float             pressure, >= 0, of any scale
    """

    axes: Float[np.ndarray, "2 3"] = field(kw_only=True)
    half_side: float = field(kw_only=True)
    grid: Float[np.ndarray, "g g"] = field(kw_only=True)

    @property
    def has_sharp_rim(self) -> bool:
        """A grid shows no rim so sharp that a mesh would have to follow it."""
        return False

    def at(self, offset: Points) -> PointScalars:
        """As of every `ToolTraction`, interpolated bilinearly; 0 outside the square."""
        return _interpolated(self.grid, offset @ self.axes.T / self.half_side)


def grid_traction(
    axes: Float[np.ndarray, "2 3"],
    half_side: float,
    reach: float,
    pressure: Float[np.ndarray, "g g"],
    outward: Float[np.ndarray, "g g"],
) -> GridTraction:
    """The traction of a grid, with its averages.

    Parameters
    ----------
    axes, half_side, reach          as `GridTraction`
    pressure : (g, g) float         >= 0, of any scale
    outward : (g, g) float          radial component, away from the contact point, of the traction;
                                    the same scale

    Returns
    -------
    GridTraction                    where it points inward in the mean, none is outward
    """
    turn = 2.0 * np.pi * np.arange(_TURNS) / _TURNS
    around = np.stack([np.cos(turn), np.sin(turn)], axis=1) * reach / half_side
    places = (SPREAD[:, None, None] * around).reshape(-1, 2)
    means = np.stack([_interpolated(values, places) for values in (pressure, outward)])
    means = means.reshape(2, -1, _TURNS).mean(axis=2) * np.cos(_ANGLE)
    table = np.clip(means, 0.0, None)
    return GridTraction(table[0], table[1], reach, axes=axes, half_side=half_side, grid=pressure)


def _interpolated(grid: Float[np.ndarray, "g g"], point: Float[np.ndarray, "p 2"]) -> PointScalars:
    """Values of a grid at places, over half its side from its middle; 0 outside."""
    cell = 0.5 * (point + 1.0) * len(grid) - 0.5
    return np.asarray(map_coordinates(grid, cell.T, order=1, mode="grid-constant"))


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
                                    not used where there is a traction
    triangles : (k,) int or None    loaded triangles, in place of a circular patch
    tool : Tool or None             the tool, from which radius and profile are computed; those
                                    given here are only initial values. None: they are known
    traction : ToolTraction or None         that of the tool, in place of the profile
    first_point : (3,) float [m] or None    where the tool touched first; None: at `point`, on an
                                    object that does not move sideways under it

    Raises
    ------
    InputError                      a tool whose friction is neither none nor without bound; an
                                    unknown profile; radius missing, not positive, or given for
                                    `_VERTEX` or triangles; no triangles
    """

    point: Vector3
    radius: float | None
    profile: str
    triangles: Indices | None = None
    tool: Tool | None = None
    traction: ToolTraction | None = None
    first_point: Vector3 | None = None

    def __post_init__(self) -> None:
        fix_fields(self, point=(3,))
        fix_fields(self, none_allowed=True, first_point=(3,))
        if self.tool is not None and self.tool.friction not in FRICTIONS.values():
            raise InputError(
                f"friction is {self.tool.friction:g}; under a measured force a tool slides (0) or"
                " sticks (infinite): how far a coefficient in between lets it slide depends on a"
                " path that is not known"
            )
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

    @classmethod
    def under(cls, tool: Tool, point: Vector3, size: float = np.inf) -> "Contact":
        """Initial contact for the search of the contact radius: half the tool's radius, at most 5 %
        of the object's `size` [m]; the whole of a flat face."""
        if tool.is_flat:
            return cls(point, tool.radius, "flat", tool=tool)
        return cls(
            point, min(_TOUCHED * tool.radius, _TOUCHED_OF_OBJECT * size), "hertz", tool=tool
        )

    @property
    def start(self) -> Vector3:
        """Where the tool touched first [m]."""
        return self.point if self.first_point is None else self.first_point

    @property
    def reach(self) -> float:
        """Farthest distance of the patch from its centre [m]: the radius, except under a tool that
        is not round; 0 where there is no radius."""
        radius = self.radius or 0.0
        return radius if self.traction is None else radius * self.traction.reach

    @property
    def has_sharp_rim(self) -> bool:
        """Whether the pressure is singular at the rim of a round patch."""
        if self.traction is None:
            return self.profile == "flat" and self.radius is not None
        return self.traction.has_sharp_rim

    @property
    def pressure(self) -> Pressure:
        """Pressure at a distance over the reach, up to a factor, averaged over all directions; zero
        from 1 on."""
        return PRESSURES[self.profile] if self.traction is None else self.traction.mean

    def pressure_at(self, offset: Points) -> PointScalars:
        """Pressure at points of the surface, up to a factor; `offset`, (p, 3), is the distance from
        the contact point in contact radii."""
        if self.traction is not None:
            return self.traction.at(offset)
        return self.pressure(np.linalg.norm(offset, axis=1))


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


# To add a pressure, add its function and one line here. Only the shape of the curve matters: it is
# scaled so that its integral is the force.
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


# Directions over which a grid is averaged.
_TURNS = 32


def contact_profiles() -> tuple[str, ...]:
    """Permitted names of a contact's pressure profile."""
    return (*PRESSURES, _VERTEX)
