"""Contacts and supports: where a tool presses and its pressure profile; what is held, and how."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.shapes import Indices, Vector3

Pressure = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]


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


def uniform_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 inside the radius, 0 outside, as under a flat tool on a soft layer.

    Parameters
    ----------
    s : array [-]                   distance from the contact point over the radius, >= 0

    Returns
    -------
    array [-]                       1 at the centre, 0 from the rim on
    """
    return (s < 1).astype(np.float64)


def hertz_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
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


def flat_pressure(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
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
    "uniform": uniform_pressure,
    "hertz": hertz_pressure,
    "flat": flat_pressure,
    "cone": cone_pressure,
}
# Linear hat function of the vertex nearest to the contact point; a contact without a radius.
VERTEX = "vertex"
# Loads over given triangles: uniform traction, or a grip that moves them rigidly.
UNIFORM, RIGID = "uniform", "rigid"
# Shapes of tools, and friction between tool and surface.
SPHERE, FLAT, CONE, CYLINDER = TOOL_SHAPES = ("sphere", "flat", "cone", "cylinder")
SLIDES, STICKS = FRICTIONS = ("slides", "sticks")
# Initial contact radius of a search: this fraction of the tool's radius, but at most this fraction
# of the object's size.
_TOUCHED, _TOUCHED_OF_OBJECT = 0.5, 0.05
# Least half opening angle of a cone [rad].
_SHARPEST = 0.5
# How a support moves.
FIXED, GIVEN, FREE = MOTIONS = ("fixed", "given", "free")
# Smallest singular value of the directions over the largest, below which they are dependent.
_SAME_DIRECTION = 1e-3
# Range of foundation moduli [N/m^3]: a metre of the softest gel to a tenth of a millimetre of
# diamond.
_SOFTEST, _STIFFEST = 1.0, 1e16
# Largest rotation for which rigid displacements count as linear in it [rad]: cos is 1e-3 below 1.
_LARGEST_TURN = 0.05


def contact_profiles() -> tuple[str, ...]:
    """Permitted names of a contact's pressure profile."""
    return (*PRESSURES, VERTEX)


@dataclass(frozen=True, slots=True)
class Tool:
    """A rigid tool; its contact patch follows from force and constants.

    Parameters
    ----------
    shape : str                     `SPHERE`; `FLAT` or `CYLINDER`, synonyms for a flat circular
                                    face; `CONE`, apex first
    radius : float [m]              of the sphere, of the flat face, or of the cone's base, > 0
    friction : str                  the surface `SLIDES` freely under the tool, or `STICKS` to it
    angle : float [rad] or None     only for a cone: between its axis and its side, from 0.5
                                    (29 degrees) to below pi / 2

    Raises
    ------
    InputError                      unknown shape or friction; a radius that is not positive; an
                                    angle that is missing, out of range, or given without a cone
    """

    shape: str
    radius: float
    friction: str = SLIDES
    angle: float | None = None

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
class Contact:
    """Circular patch over which the tool presses, or a set of triangles that is loaded as a whole.

    Parameters
    ----------
    point : (3,) float [m]          centre of the patch, on the surface or close to it
    radius : float [m] or None      contact radius, > 0; None only for the profile `VERTEX` and for
                                    triangles
    profile : str                   one of `contact_profiles`; with triangles `UNIFORM` or `RIGID`
    triangles : (k,) int or None    loaded triangles, in place of a circular patch
    tool : Tool or None             the tool, from which radius and profile are computed; those
                                    given here are only initial values. None: they are known

    Raises
    ------
    InputError                      an unknown profile; radius missing, not positive, or given for
                                    `VERTEX` or triangles; no triangles
    """

    point: Vector3
    radius: float | None
    profile: str
    triangles: Indices | None = None
    tool: Tool | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", fixed_array(self.point, name="point", shape=(3,)))
        if self.triangles is not None:
            triangles = fixed_array(self.triangles, name="triangles", shape=(None,), integer=True)
            object.__setattr__(self, "triangles", np.unique(triangles))
            if not triangles.size or self.radius is not None:
                raise InputError("a load over triangles needs at least one, and has no radius")
            if self.profile not in (UNIFORM, RIGID):
                raise InputError(
                    f"traction is '{self.profile}'; over triangles it must be {UNIFORM} or {RIGID}"
                )
            return
        if self.profile == VERTEX:
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


@dataclass(frozen=True, slots=True, eq=False)
class Support:
    """A part of the surface that is held and, if it moves, moves rigidly.

    Parameters
    ----------
    triangles : (k,) int            sorted, distinct
    motion : str                    `FIXED`; `GIVEN` for every probing; or `FREE`: a rigid motion
                                    that is estimated for every probing along with the constants
    directions : (d, 3) float or None    of a roller: only these directions are held, along the
                                    others the surface slides without friction; orthonormalised;
                                    None: all are held
    stiffness : float [N/m^3] or None    modulus of an elastic foundation, traction over
                                    displacement, 1 to 1e16; None: rigid

    Raises
    ------
    InputError                      unknown motion; a direction that is zero, or depends on others;
                                    a stiffness out of range
    """

    triangles: Indices
    motion: str = FIXED
    directions: Float[np.ndarray, "d 3"] | None = None
    stiffness: float | None = None

    def __post_init__(self) -> None:
        triangles = fixed_array(self.triangles, name="triangles", shape=(None,), integer=True)
        object.__setattr__(self, "triangles", np.unique(triangles))
        if self.motion not in MOTIONS:
            raise InputError(f"motion is '{self.motion}'; must be one of {', '.join(MOTIONS)}")
        if self.directions is not None:
            object.__setattr__(self, "directions", _orthonormal(self.directions))
        if self.stiffness is not None and not (_SOFTEST <= self.stiffness <= _STIFFEST):
            raise InputError(
                f"stiffness is {self.stiffness:g} N/m^3; must be a traction over a displacement"
                f" from {_SOFTEST:g} to {_STIFFEST:g} N/m^3 (a foam 1 cm thick has about 5e6): for"
                " a rigid support leave it out"
            )

    @property
    def compliance(self) -> float:
        """Displacement over traction [m/Pa]; 0 if rigid."""
        return 0.0 if self.stiffness is None else 1.0 / self.stiffness

    @property
    def holding(self) -> Float[np.ndarray, "3 3"]:
        """Projector onto the span of the held directions, (3, 3)."""
        return np.eye(3) if self.directions is None else self.directions.T @ self.directions


def _orthonormal(directions: Float[np.ndarray, "d 3"]) -> Float[np.ndarray, "d 3"] | None:
    """Orthonormal basis of the same span; None if that is the whole space."""
    given = fixed_array(directions, name="directions", shape=(None, 3))
    length = np.linalg.norm(given, axis=1, keepdims=True)
    if not len(given) or not length.all():
        raise InputError(
            "directions has no direction, or one that is zero; give one or two that are held, e.g."
            " [[0, 0, 1]], or leave the key out: then all are"
        )
    _, size, found = np.linalg.svd(given / length, full_matrices=False)
    if len(given) > 3 or size[-1] < _SAME_DIRECTION:
        raise InputError(
            "directions holds one direction twice, or one that follows from the others; give each"
            " once"
        )
    return None if len(given) == 3 else fixed_array(found, name="directions", shape=(None, 3))


@dataclass(frozen=True, slots=True, eq=False)
class RigidMotion:
    """A small rigid motion of a support.

    Parameters
    ----------
    translation : (3,) float [m]    of the middle of the support
    rotation : (3,) float [rad]     rotation vector about the middle: axis times angle,
                                    right-handed, at most 0.05 rad

    Raises
    ------
    InputError                      a rotation that is not small
    """

    translation: Vector3
    rotation: Vector3

    def __post_init__(self) -> None:
        for name in ("translation", "rotation"):
            value = fixed_array(getattr(self, name), name=name, shape=(3,))
            object.__setattr__(self, name, value)
        turn = float(np.linalg.norm(self.rotation))
        if turn > _LARGEST_TURN:
            raise InputError(
                f"rotation is {turn:.3g} rad; must be at most {_LARGEST_TURN} rad (3 degrees), as"
                " displacements are taken to be small; give radians, or turn the measured"
                " displacements back first"
            )
