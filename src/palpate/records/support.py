"""Supports: what is held, and how; their rigid motions; and their tables in session.toml."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.arrays import fix_fields, fixed_array
from palpate.errors import InputError, RecordError, quoted
from palpate.geometry import TriangleMesh
from palpate.records.quantities import STIFFNESS_UNITS
from palpate.records.text.text_file import read_text
from palpate.records.text.toml_table import TomlTable, is_list_of
from palpate.shapes import Indices, Vector3

# How a support moves.
FIXED, GIVEN, FREE = _MOTIONS = ("fixed", "given", "free")
# Smallest singular value of the directions over the largest, below which they are dependent.
_SAME_DIRECTION = 1e-3
# Range of foundation moduli [N/m^3]: a metre of the softest gel to a tenth of a millimetre of
# diamond.
_SOFTEST, _STIFFEST = 1.0, 1e16
# Largest rotation for which rigid displacements count as linear in it [rad]: cos is 1e-3 below 1.
_LARGEST_TURN = 0.05
_SELECTORS = ("plane", "box", "triangles")
# More digits than any triangle's number has; Python refuses to convert some thousands.
_MAX_DIGITS = 18


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
        fix_fields(self, integer=True, triangles=(None,))
        object.__setattr__(self, "triangles", np.unique(self.triangles))
        if self.motion not in _MOTIONS:
            raise InputError(f"motion is '{self.motion}'; must be one of {', '.join(_MOTIONS)}")
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
    _, size, rotation = np.linalg.svd(given / length, full_matrices=False)
    if len(given) > 3 or size[-1] < _SAME_DIRECTION:
        raise InputError(
            "directions holds one direction twice, or one that follows from the others; give each"
            " once"
        )
    return None if len(given) == 3 else fixed_array(rotation, name="directions", shape=(None, 3))


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
        fix_fields(self, translation=(3,), rotation=(3,))
        turn = float(np.linalg.norm(self.rotation))
        if turn > _LARGEST_TURN:
            raise InputError(
                f"rotation is {turn:.3g} rad; must be at most {_LARGEST_TURN} rad (3 degrees), as"
                " displacements are taken to be small; give radians, or turn the measured"
                " displacements back first"
            )


@dataclass(frozen=True, slots=True, eq=False)
class HeldObject:
    """The object of a session, and what holds it: all that a probing's table is read against.

    Parameters
    ----------
    mesh : TriangleMesh
    supports : tuple of Support
    metres_per_unit : float [m]     length unit of the session's files
    """

    mesh: TriangleMesh
    supports: tuple[Support, ...]
    metres_per_unit: float

    def held_triangles(self, *, still: bool = False) -> Indices:
        """Triangles of all supports together, (k,) int; `still`: only of those whose points do not
        move, which are fixed and no rollers."""
        parts = [
            support.triangles
            for support in self.supports
            if not still or (support.motion == FIXED and support.directions is None)
        ]
        return np.concatenate([np.zeros(0, dtype=np.int64), *parts])


def read_supports(
    root: TomlTable, mesh: TriangleMesh, *, metres_per_unit: float
) -> tuple[Support, ...]:
    """The supports of a session: its table `[support]`, or several `[[support]]`.

    Parameters
    ----------
    root : TomlTable                whole session.toml
    mesh : TriangleMesh
    metres_per_unit : float         length unit of the session

    Returns
    -------
    tuple of Support                at least one

    Raises
    ------
    RecordError                     no such table, or an invalid one
    """
    name = None if isinstance(root.get("support"), list) else "[support]"
    supports = []
    for table in root.tables("support", name):
        table.check_keys((*_SELECTORS, "motion", "directions", "stiffness"))
        motion = table.choice("motion", _MOTIONS) if "motion" in table.values else FIXED
        directions = _directions(table) if "directions" in table.values else None
        stiffness = None
        if "stiffness" in table.values:
            stiffness = table.quantity("stiffness", STIFFNESS_UNITS, 1.0)
        selectors = {key: value for key, value in table.values.items() if key in _SELECTORS}
        held = read_support(replace(table, values=selectors), mesh, metres_per_unit=metres_per_unit)
        with table.error_context():
            supports.append(Support(held, motion, directions, stiffness))
    if not supports:
        root.fail("support", "has no table; say what is held")
    return tuple(supports)


def _directions(table: TomlTable) -> Float[np.ndarray, "d 3"]:
    """The directions that a support holds."""
    must = "be a list of vectors, e.g. [[0, 0, 1]], in two pairs of brackets"
    table.checked(is_list_of(list), "directions", must)
    return np.array(table.each(TomlTable.vector, "directions")).reshape(-1, 3)


def read_support(support: TomlTable, mesh: TriangleMesh, *, metres_per_unit: float) -> Indices:
    """Triangles selected by any of the selectors of one support.

    Parameters
    ----------
    support : TomlTable             keys plane, box (a table each, or a list of them), triangles
    mesh : TriangleMesh
    metres_per_unit : float         unit of the coordinates and tolerances in the table

    Returns
    -------
    (k,) int                        sorted, distinct; neither empty nor the whole surface

    Raises
    ------
    RecordError                     an invalid selector, an empty support, or the whole surface
    """
    held, nearest = selected_triangles(support, mesh, metres_per_unit=metres_per_unit)
    if not held.any():
        support.fail(
            "",
            f"the support is empty: no triangle has all its vertices inside a selector{nearest};"
            f" without a support the object would float away; {_extent_text(mesh)}: check position,"
            " tolerance and length_unit",
        )
    if held.all():
        support.fail(
            "",
            f"the support is the whole surface (all {len(held)} triangles): nothing could move;"
            f" {_extent_text(mesh)}: check position, tolerance and length_unit, and select only the"
            " part that is held",
        )
    return np.flatnonzero(held)


def selected_triangles(
    table: TomlTable, mesh: TriangleMesh, *, metres_per_unit: float
) -> tuple[Bool[np.ndarray, " m"], str]:
    """Triangles selected by any of the selectors of a table.

    Parameters
    ----------
    table : TomlTable               keys plane, box (a table each, or a list of them), triangles
    mesh : TriangleMesh
    metres_per_unit : float         unit of the coordinates and tolerances in the table

    Returns
    -------
    (m,) bool
    str                             how far off a plane is, for a message that nothing is selected

    Raises
    ------
    RecordError                     no selector, or an invalid one
    """
    table.check_keys(_SELECTORS)
    if not table.values:
        table.fail("", f"is empty; give at least one of {', '.join(_SELECTORS)}")
    held = np.zeros(len(mesh.triangles), dtype=bool)
    nearest = ""
    for key in ("plane", "box"):
        if table.values.get(key) == []:
            table.fail(key, "is an empty list; give a table, or leave the key out")
    if "plane" in table.values:
        for plane in table.tables("plane", f"{table.name} plane"):
            off_plane, tolerance = _plane_distance(plane, mesh, metres_per_unit)
            held |= off_plane <= tolerance
            nearest = (
                f" (the triangle nearest to the plane is {off_plane.min():.3g} m off,"
                f" its tolerance is {tolerance:.3g} m)"
            )
    if "box" in table.values:
        for box in table.tables("box", f"{table.name} box"):
            held |= _inside_box(box, mesh, metres_per_unit)
    if "triangles" in table.values:
        held[listed_triangles(table, len(mesh.triangles))] = True
    return held, nearest


def _extent_text(mesh: TriangleMesh) -> str:
    """Size and position of the object, by which a wrong unit is recognised."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    size = " x ".join(f"{1e3 * side:.4g}" for side in high - low)
    ends = (", ".join(f"{x:.3g}" for x in corner + 0.0) for corner in (low, high))
    return "the object is {} mm, from ({}) to ({}) m".format(size, *ends)


def _plane_distance(
    plane: TomlTable, mesh: TriangleMesh, metres_per_unit: float
) -> tuple[np.ndarray, float]:
    """Distance of every triangle's farthest vertex from the plane, and the tolerance [m]."""
    plane.check_keys(("point", "normal", "tolerance"))
    normal = unit_normal(plane)
    tolerance = plane.number("tolerance")
    if tolerance < 0.0:
        plane.fail("tolerance", f"is {tolerance}; must not be negative")
    height = np.dot(mesh.vertices - metres_per_unit * plane.vector("point"), normal)
    return np.abs(height)[mesh.triangles].max(axis=1), metres_per_unit * tolerance


def unit_normal(plane: TomlTable) -> Vector3:
    """Normal of a plane, its key `normal`, of length 1.

    Parameters
    ----------
    plane : TomlTable

    Returns
    -------
    (3,) float

    Raises
    ------
    RecordError                     missing, no vector, or zero
    """
    normal = plane.vector("normal")
    length = float(np.linalg.norm(normal))
    if length == 0.0:
        plane.fail("normal", "is the zero vector; must have a direction")
    return normal / length


def read_box(box: TomlTable, metres_per_unit: float) -> tuple[Vector3, Vector3]:
    """Lowest and highest corner of a box along the axes, its keys `min` and `max`.

    Parameters
    ----------
    box : TomlTable
    metres_per_unit : float         unit of the coordinates

    Returns
    -------
    (3,) float [m]
    (3,) float [m]

    Raises
    ------
    RecordError                     a corner is missing, or min exceeds max
    """
    box.check_keys(("min", "max"))
    low, high = metres_per_unit * box.vector("min"), metres_per_unit * box.vector("max")
    if np.any(low > high):
        box.fail("min", "exceeds max in a component; swap them")
    return low, high


def _inside_box(box: TomlTable, mesh: TriangleMesh, metres_per_unit: float) -> np.ndarray:
    """True for triangles with all three vertices inside or on the box."""
    low, high = read_box(box, metres_per_unit)
    corner = mesh.vertices[mesh.triangles]
    return ((corner >= low) & (corner <= high)).all(axis=(1, 2))


def listed_triangles(table: TomlTable, count: int) -> Indices:
    """Triangle indices from a text file, one per line, from 0; `#` starts a comment.

    Parameters
    ----------
    table : TomlTable               its key `triangles` names the file
    count : int                     number of triangles of the mesh

    Returns
    -------
    (k,) int                        in the order of the file

    Raises
    ------
    RecordError                     no such file, or a line that is not an index; names file, line
    """
    path = table.existing_file("triangles")
    triangles = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        word = line.partition("#")[0].strip()
        if not word:
            continue
        if not word.isdecimal() or len(word) > _MAX_DIGITS or int(word) >= count:
            raise RecordError(
                f"{path}: line {number}: {quoted(word)} is not a triangle of the mesh;"
                f" must be a whole number from 0 to {count - 1}"
            )
        triangles.append(int(word))
    return np.array(triangles, dtype=np.int64)
