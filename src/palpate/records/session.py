"""A session: one object with its supports and probings, or an object that moves rigidly.

Supports, their motions and the forces on them must be consistent with each other.
"""

import html
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from palpate.arrays import fix_fields
from palpate.errors import InputError, counted, quoted
from palpate.geometry import TriangleMesh
from palpate.records.contact import RIGID
from palpate.records.error_priors import ErrorPriors
from palpate.records.probing import Probing
from palpate.records.region import Region
from palpate.records.support import FIXED, FREE, GIVEN, Support
from palpate.records.text.text_file import check_file_names
from palpate.records.tools import RoundTool
from palpate.shapes import Indices, Vector3

# Density of osmium [kg/m^3], and ten times the earth's gravity [m/s^2]: larger values mean a wrong
# unit.
_LARGEST_DENSITY = 22600.0
_LARGEST_GRAVITY = 100.0
# Number of probings that `repr` names.
_MAX_NAMED = 6
# Longest name of a session, in characters, that tables have room for.
_LONGEST_NAME = 200
# Largest fraction of a force perpendicular to a roller's held directions, for its small friction.
_MAX_PERPENDICULAR = 0.05
# A direction counts as held by other supports if the squared sine of its angle to their free
# directions exceeds this, that of half a degree.
_MIN_HELD_SINE_SQUARED = 1e-4


@dataclass(frozen=True, slots=True)
class Step:
    """One instant of a rigid-motion sequence.

    Parameters
    ----------
    name : str                      unique within its session; files are named after it
    images : str                    file pattern of its pictures, with `{camera}` in place of the
                                    camera's name

    Raises
    ------
    InputError                      a blank name or pattern
    """

    name: str
    images: str

    def __post_init__(self) -> None:
        for name in ("name", "images"):
            if not getattr(self, name).strip():
                raise InputError(f"{name} of a step is blank; must be a text")


@dataclass(frozen=True, slots=True, eq=False)
class Session:
    """All input of an estimation, in SI units.

    Parameters
    ----------
    name : str
    path : Path                     the session.toml it was read from
    mesh : TriangleMesh             closed, outward normals
    held_triangles : (k,) int       sorted, distinct indices of all supports' triangles; with steps
                                    it is ignored and may be empty
    probings : tuple of Probing     at least one, names distinct; empty if there are steps
    density : float [kg/m^3] or None
    gravity : (3,) float [m/s^2] or None
    rig : Path or None              the camera file, if there are pictures
    notes : tuple of str            what was repaired, converted or looks implausible, in sentences
    steps : tuple of Step           of a rigid-motion sequence, in order of time, at least two,
                                    names distinct; empty if there are probings
    metres_per_unit : float [m]     length unit of the session's files; lengths here are in metres
    supports : tuple of Support     supports that make up `held_triangles`; by default one that is
                                    fixed
    errors : ErrorPriors            prior standard deviations of systematic errors
    smooth : bool                   True: the mesh samples a smooth object, with edges where its
                                    triangles meet at more than 40 degrees; False: the object has
                                    exactly the flat facets of the mesh
    regions : tuple of Region       parts with a modulus of their own; by default none
    gravity_at_rest : bool          True: gravity acts before the push, too, on an object whose mesh
                                    is its shape without weight; it counts at finite strain alone

    Raises
    ------
    InputError                      neither probings nor steps, or both; names that are not distinct
                                    or that files cannot have; a single step; a support that is
                                    empty, one triangle or the whole surface; supports that overlap;
                                    a support's motion that is missing or not expected; pictures
                                    without a rig; gravity without density, or values out of range
    """

    name: str
    path: Path
    mesh: TriangleMesh
    held_triangles: Indices
    probings: tuple[Probing, ...]
    density: float | None
    gravity: Vector3 | None
    rig: Path | None
    notes: tuple[str, ...]
    steps: tuple[Step, ...] = ()
    metres_per_unit: float = 1.0
    supports: tuple[Support, ...] = ()
    errors: ErrorPriors = field(default_factory=ErrorPriors)
    smooth: bool = True
    regions: tuple[Region, ...] = ()
    gravity_at_rest: bool = False

    def __post_init__(self) -> None:
        fix_fields(self, integer=True, held_triangles=(None,))
        _check_contents(self)
        held = np.unique(self.held_triangles)
        if self.probings or len(held):
            _check_support(held, len(self.mesh.triangles))
        held.setflags(write=False)
        object.__setattr__(self, "held_triangles", held)
        if not self.supports and len(held):
            object.__setattr__(self, "supports", (Support(held),))
        _check_supports(self.mesh, self.supports, self.probings)
        fix_fields(self, none_allowed=True, gravity=(3,))
        _check_gravity(self)

    @property
    def added_gravity(self) -> Vector3 | None:
        """Gravity that begins to act with the push, a load of every model [m/s^2]."""
        return None if self.gravity_at_rest else self.gravity

    def force_std(self, probing: Probing) -> Vector3:
        """Standard deviation of a probing's force, each component [N]: its own, or the prior's."""
        if probing.force_std is not None:
            return probing.force_std
        return np.full(3, self.errors.force * float(np.linalg.norm(probing.force)))

    def __repr__(self) -> str:
        names = [item.name for item in self.probings] or [item.name for item in self.steps]
        count = counted(len(names), "step" if self.steps else "probing")
        more = f" and {len(names) - _MAX_NAMED} more" if len(names) > _MAX_NAMED else ""
        return (
            f"Session {self.name!r}: {count} ({', '.join(names[:_MAX_NAMED])}{more}),"
            f" {len(self.mesh.vertices)} vertices, {len(self.held_triangles)} of"
            f" {len(self.mesh.triangles)} triangles held"
        )

    def _repr_html_(self) -> str:
        rows = "".join(f"<li>{html.escape(repr(probing))}</li>" for probing in self.probings)
        return f"<p>{html.escape(repr(self))}</p><ul>{rows}</ul>"


def require_probings(session: Session) -> None:
    """Refuse a rigid-motion sequence where probings are needed.

    Parameters
    ----------
    session : Session

    Raises
    ------
    InputError                      the session has steps in place of probings
    """
    if not session.probings:
        raise InputError(
            f"{session.path}: this is a rigid-motion sequence ([[step]] tables): no force, no"
            " probing, so nothing about stiffness; give a session with [[probe]] tables"
        )


def without_pictures(session: Session) -> bool:
    """Whether a session is of pokes without pictures: all that was observed of any push is how far
    a ball or a flat face went in.

    Parameters
    ----------
    session : Session
    """
    return bool(session.probings) and all(
        probing.displacement is None
        and probing.images is None
        and probing.tip_displacement is not None
        and isinstance(probing.contact.tool, RoundTool)
        and probing.contact.tool.growth is not None
        for probing in session.probings
    )


def _check_contents(session: Session) -> None:
    """Refuse a session without content, with both probings and steps, with names that no files can
    have, or with pictures but no rig."""
    probings, steps = session.probings, session.steps
    if probings and steps:
        raise InputError(
            f"the session has {len(probings)} probings and {len(steps)} steps ([[probe]] and"
            " [[step]] tables); it must have one kind only: make two sessions of it (both may use"
            " the same mesh, rig and images)"
        )
    if not (probings or steps):
        raise InputError(
            "the session has no probings ([[probe]] tables); at least one is needed, or two steps"
            " ([[step]] tables) of a rigid motion"
        )
    if len(steps) == 1:
        raise InputError(
            f"the session has one step, '{steps[0].name}', alone; motion needs at least two"
        )
    names = [item.name for item in probings] or [item.name for item in steps]
    if len(session.name) > _LONGEST_NAME:
        raise InputError(
            f"the name {quoted(session.name)} has {len(session.name)} characters; must have at most"
            f" {_LONGEST_NAME}: it stands in tables and pictures"
        )
    check_file_names(names, what="probing" if probings else "step")
    unmeasured = [item.name for item in probings if item.images and item.displacement is None]
    if session.rig is None and (steps or unmeasured):
        whose = f"probing '{unmeasured[0]}' has" if unmeasured else "the steps have"
        raise InputError(
            f"{whose} images, but no rig is given: the cameras must be known; name their file in a"
            ' [rig] table, e.g. cameras = "rig.toml"'
        )


def _check_gravity(session: Session) -> None:
    """Refuse an impossible density or gravity, and gravity whose share is not known."""
    density, gravity = session.density, session.gravity
    if density is not None and not 0.0 < density <= _LARGEST_DENSITY:
        raise InputError(
            f"density is {density}; must be positive and at most {_LARGEST_DENSITY:g} kg/m^3, the"
            " densest metal's"
        )
    if gravity is None:
        return
    if density is None:
        raise InputError(
            "gravity is given without a density; give it in kg/m^3, or leave gravity out if the"
            " rest state was measured under gravity too"
        )
    if np.linalg.norm(gravity) > _LARGEST_GRAVITY:
        raise InputError(
            f"gravity is {np.linalg.norm(gravity):.4g} m/s^2; the earth's is 9.81, at most"
            f" {_LARGEST_GRAVITY:g} is taken: is it in mm/s^2?"
        )
    pulled = [probing.name for probing in session.probings if probing.contact.profile == RIGID]
    if pulled and session.added_gravity is not None:
        raise InputError(
            f"probing '{pulled[0]}' has its force on a support, and there is gravity: its share of"
            " the weight is not known; measure the rest state under gravity too, and leave"
            " [gravity] out"
        )


def _check_support(held: Indices, triangle_count: int) -> None:
    """Refuse a support that is empty, out of range, a single triangle, or the whole surface; its
    triangles are sorted and distinct."""
    if len(held) == 0:
        raise InputError(
            "the support is empty: no triangle is held, and the object would float away;"
            " choose the triangles that do not move"
        )
    if held[0] < 0 or held[-1] >= triangle_count:
        raise InputError(
            f"the support names triangles {held[0]} to {held[-1]}, but the mesh has"
            f" {triangle_count} (0 to {triangle_count - 1})"
        )
    if len(held) == 1:
        raise InputError(
            f"the support is one triangle (number {held[0]}): how it is held cannot be resolved"
            " there; select all that is held, or refine the mesh there"
        )
    if len(held) == triangle_count:
        raise InputError(
            f"the support is the whole surface (all {triangle_count} triangles); nothing could"
            " move: choose only the part that is held"
        )


def _check_supports(
    mesh: TriangleMesh, supports: Sequence[Support], probings: Sequence[Probing]
) -> None:
    """Refuse supports that touch, and motions or forces that are inconsistent with them.

    Parameters
    ----------
    mesh : TriangleMesh
    supports : sequence of Support
    probings : sequence of Probing

    Raises
    ------
    InputError                      the text names supports by their number from 1, and the probing
    """
    for second in range(len(supports)):
        for first in range(second):
            _check_disjoint(mesh, supports, first, second)
    given = [number for number, support in enumerate(supports, start=1) if support.motion == GIVEN]
    for probing in probings:
        _check_motion(probing, given)
        if probing.contact.profile == RIGID and probing.contact.triangles is not None:
            _check_pulled_support(probing, probing.contact.triangles, supports)


def _check_disjoint(mesh: TriangleMesh, supports: Sequence[Support], i: int, j: int) -> None:
    """Refuse supports that share a triangle, or, unless both are fixed, a vertex."""
    first, second = supports[i], supports[j]
    shared_triangles = np.intersect1d(first.triangles, second.triangles).size
    if shared_triangles:
        raise InputError(
            f"supports {i + 1} and {j + 1} share {shared_triangles} triangles; a triangle belongs"
            " to one of them: correct the selectors"
        )
    corners, others = (np.unique(mesh.triangles[x.triangles]) for x in (first, second))
    shared_vertices = np.intersect1d(corners, others).size
    if shared_vertices and (first.motion != FIXED or second.motion != FIXED):
        raise InputError(
            f"supports {i + 1} and {j + 1} share {shared_vertices} vertices, which cannot"
            " follow both; leave a row of free triangles between them"
        )


def _check_motion(probing: Probing, given: Sequence[int]) -> None:
    """Refuse a support motion that is missing, or that no support expects."""
    prefix = f"probing '{probing.name}'"
    has_motion = probing.support_motion is not None
    if given and not has_motion and probing.support_displacement is None:
        raise InputError(
            f"{prefix}: the motion of support {given[0]} is to be given; name the file of its"
            " displacements as support_displacement, or a rigid motion as support_motion"
        )
    if not given and (has_motion or probing.support_displacement is not None):
        raise InputError(
            f'{prefix}: gives a motion of the support, but no support has motion = "given"; say so'
            " in [support], or leave it out"
        )
    if has_motion and len(given) > 1:
        raise InputError(
            f"{prefix}: support_motion is one motion, but that of {len(given)} supports is to be"
            " given; give support_displacement, with points on each of them"
        )


def _check_pulled_support(
    probing: Probing, triangles: Indices, supports: Sequence[Support]
) -> None:
    """Refuse a force on a support that is not free to move, or without another support to react."""
    prefix = f"probing '{probing.name}'"
    pulled = [
        number
        for number, support in enumerate(supports, start=1)
        if np.array_equal(support.triangles, triangles)
    ]
    if not pulled or len(supports) < 2:
        raise InputError(
            f"{prefix}: its force acts on a support, but no other support is there to react against"
            " it; select the other grip in a [[support]] of its own"
        )
    if supports[pulled[0] - 1].motion != FREE:
        raise InputError(
            f"{prefix}: its force acts on support {pulled[0]}, whose motion is"
            f" '{supports[pulled[0] - 1].motion}'; a support that is pulled moves as the force"
            ' makes it: say motion = "free", and give its measured points in the displacement file'
        )
    _check_pull_direction(probing, supports, pulled[0])
    if probing.tip_displacement is not None:
        raise InputError(
            f"{prefix}: tip_displacement is of a tool's contact point, but the force acts on a"
            " support; give the displacement of the grip in the displacement file"
        )


def _check_pull_direction(probing: Probing, supports: Sequence[Support], number: int) -> None:
    """Refuse a force outside the pulled support's held directions, or in a direction along which no
    other support reacts."""
    prefix = f"probing '{probing.name}': its force acts on support {number}"
    holding = supports[number - 1].holding
    perpendicular = float(np.linalg.norm(probing.force - holding @ probing.force))
    if perpendicular > _MAX_PERPENDICULAR * float(np.linalg.norm(probing.force)):
        raise InputError(
            f"{prefix}, a roller, and {perpendicular:.3g} N of it are across its directions, along"
            " which it slides: give the part along them, or hold those directions too (directions"
            " in [[support]])"
        )
    others = sum(support.holding for k, support in enumerate(supports, start=1) if k != number)
    value, vector = np.linalg.eigh(holding @ others @ holding + np.eye(3) - holding)
    if value[0] < _MIN_HELD_SINE_SQUARED:
        axis = ", ".join(f"{x:.3g}" for x in np.round(vector[:, 0], 3) + 0.0)
        raise InputError(
            f"{prefix}, and along ({axis}) no other support holds the object, which would follow:"
            " hold that direction elsewhere, or make support"
            f" {number} a roller that does not hold it (directions in [[support]])"
        )
