"""Regions of an object that have a modulus of their own, and their tables in session.toml."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from palpate.errors import InputError, MeshError
from palpate.geometry import (
    TriangleMesh,
    checked_mesh,
    closest_points,
    enclosed_volume,
    read_mesh,
    triangle_areas,
)
from palpate.records.quantities import LENGTH_UNITS, MODULUS_RANGE, MODULUS_UNITS
from palpate.records.support import HeldObject, read_box, selected_triangles, unit_normal
from palpate.records.text.toml_table import TomlTable
from palpate.shapes import Points, Vector3

_SHAPES = ("surface", "box", "plane", "skin")
# What may be known of a region's modulus: itself, or its ratio to that of the rest.
YOUNG, SHEAR, RATIO = KNOWN = ("young_modulus", "shear_modulus", "ratio")
_LARGEST_RATIO = 1e6
# Longest name that stands in tables.
_LONGEST_NAME = 200


# Triangles of a box whose corners come in the order of x, then y, then z.
_SIDES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 5, 1], [0, 4, 5], [2, 3, 7], [2, 7, 6],
     [0, 2, 6], [0, 6, 4], [1, 7, 3], [1, 5, 7]]
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """The part of an object in a box along the axes.

    Attributes
    ----------
    low, high : (3,) float [m]
    """

    low: Vector3
    high: Vector3

    @property
    def bounds(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner [m]."""
        return self.low, self.high

    @property
    def surface(self) -> TriangleMesh:
        """Its faces, two triangles each."""
        corners = np.stack(np.meshgrid(*np.stack(self.bounds, axis=1), indexing="ij"), axis=-1)
        return TriangleMesh(corners.reshape(-1, 3), _SIDES)

    def contains(self, points: Points) -> Bool[np.ndarray, " n"]:
        """Which points lie in it."""
        return np.all((points >= self.low) & (points <= self.high), axis=1)

    @property
    def thickness(self) -> float:
        """Twice its volume over its area [m]: of a thin one, the shortest side."""
        return 1.0 / float((1.0 / (self.high - self.low)).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """The part of an object on that side of a plane to which its normal points.

    Attributes
    ----------
    point, normal : (3,) float [m]      of the plane; the normal has length 1
    thickness : float [m]               how far it reaches; infinite: to the end
    """

    point: Vector3
    normal: Vector3
    thickness: float

    def contains(self, points: Points) -> Bool[np.ndarray, " n"]:
        """Which points lie in it."""
        height = (points - self.point) @ self.normal
        return (height >= 0.0) & (height <= self.thickness)


@dataclass(frozen=True, slots=True, eq=False)
class Skin:
    """The part of an object that is close to some of its faces.

    Attributes
    ----------
    faces : TriangleMesh
    thickness : float [m]
    """

    faces: TriangleMesh
    thickness: float

    def contains(self, points: Points) -> Bool[np.ndarray, " n"]:
        """Which points lie in it."""
        return closest_points(self.faces, points).distance <= self.thickness


@dataclass(frozen=True, slots=True, eq=False)
class Insert:
    """The part of an object inside a closed surface.

    Attributes
    ----------
    surface : TriangleMesh              closed, outward normals
    """

    surface: TriangleMesh

    @property
    def bounds(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box around it [m]."""
        return self.surface.vertices.min(axis=0), self.surface.vertices.max(axis=0)

    @property
    def thickness(self) -> float:
        """Twice its volume over its area [m]: of a thin one, how thin it is."""
        return 2.0 * enclosed_volume(self.surface) / float(triangle_areas(self.surface).sum())


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """A part of an object with a modulus of its own; Poisson's ratio is that of the rest.

    Parameters
    ----------
    name : str
    shape : Insert, Box, Layer or Skin      what of it lies in the object
    known : str                     "young_modulus", "shear_modulus" or "ratio", to the shear
                                    modulus of the rest; empty: to be estimated
    value : float [Pa] or [-]       > 0, of what is known
    std : float                     of the value; 0: exact

    Raises
    ------
    InputError                      an unknown kind of knowledge, a value out of range
    """

    name: str
    shape: Insert | Box | Layer | Skin
    known: str = ""
    value: float = 1.0
    std: float = 0.0

    def __post_init__(self) -> None:
        if self.known not in ("", *KNOWN):
            raise InputError(f"known is '{self.known}'; must be one of {', '.join(KNOWN)}")
        limits = (1.0 / _LARGEST_RATIO, _LARGEST_RATIO) if self.known == RATIO else MODULUS_RANGE
        if self.known and not limits[0] <= self.value <= limits[1]:
            raise InputError(
                f"{self.known} is {self.value:g}; must be {limits[0]:g} to {limits[1]:g}"
            )
        if not 0.0 <= self.std < self.value:
            raise InputError(
                f"{self.known}_std is {self.std:g}; must be 0 to less than the value, or leave"
                f" {self.known} out to have it estimated"
            )


def read_regions(root: TomlTable, body: HeldObject) -> tuple[Region, ...]:
    """The regions of a session, its tables `[[region]]`.

    Parameters
    ----------
    root : TomlTable                whole session.toml
    body : HeldObject

    Returns
    -------
    tuple of Region                 empty if there are none

    Raises
    ------
    RecordError                     an invalid table; names that are not distinct
    MeshError                       a surface that is not closed
    """
    regions: list[Region] = []
    for table in root.optional("region", root.tables) or ():
        table.check_keys(("name", *_SHAPES, "thickness", "faces", *_knowledge_keys()))
        regions.append(_region(table, body))
        if regions[-1].name in [region.name for region in regions[:-1]]:
            table.fail("name", f"'{regions[-1].name}' is that of another region; each its own")
    return tuple(regions)


def _knowledge_keys() -> list[str]:
    return [key for name in KNOWN for key in (name, f"{name}_std")]


def _region(table: TomlTable, body: HeldObject) -> Region:
    name = table.label("name")
    if len(name) > _LONGEST_NAME:
        table.fail("name", f"has {len(name)} characters; must have at most {_LONGEST_NAME}")
    keys = table.values.keys()
    given = [key for key in _SHAPES if key in keys]
    if len(given) != 1:
        has = " and ".join(given) or "none"
        table.fail("", f"says where it is by {has}; give one of {', '.join(_SHAPES)}")
    for key, required in (("thickness", "plane"), ("faces", "skin")):
        if key in keys and given != [required]:
            table.fail(key, f"belongs to {required}, but the region is given by {given[0]}")
    known = [key for key in KNOWN if key in keys]
    for key in KNOWN:
        if f"{key}_std" in keys and key not in known:
            table.fail(f"{key}_std", f"is given without {key}; give both or none")
    if len(known) > 1:
        table.fail(known[1], f"is given beside {known[0]}; give one of them")
    with table.error_context():
        shape = _shape(table, given[0], body)
        if not known:
            return Region(name, shape)
        value = _modulus(table, known[0])
        std = _modulus(table, f"{known[0]}_std") if f"{known[0]}_std" in keys else 0.0
        return Region(name, shape, known[0], value, std)


def _modulus(table: TomlTable, key: str) -> float:
    if key.startswith(RATIO):
        return table.number(key)
    return table.quantity(key, MODULUS_UNITS, 1.0)


def _shape(table: TomlTable, key: str, body: HeldObject) -> Insert | Box | Layer | Skin:
    metres = body.metres_per_unit
    if key == "surface":
        return Insert(_surface(table, metres))
    if key == "box":
        low, high = read_box(table.table("box", f"{table.name} box"), metres)
        if not (low < high).all():
            table.fail("box", "has no volume: its corners agree in a component")
        return Box(low, high)
    if key == "plane":
        plane = table.table("plane", f"{table.name} plane")
        plane.check_keys(("point", "normal"))
        return Layer(metres * plane.vector("point"), unit_normal(plane), _thickness(table, metres))
    return Skin(_faces(table, body), _positive(table, "skin", metres))


def _thickness(table: TomlTable, metres: float) -> float:
    return _positive(table, "thickness", metres) if "thickness" in table.values else np.inf


def _positive(table: TomlTable, key: str, metres: float) -> float:
    value = table.quantity(key, LENGTH_UNITS, metres)
    if not value > 0.0:
        table.fail(key, f"is {value:g} m; must be positive")
    return value


def _faces(table: TomlTable, body: HeldObject) -> TriangleMesh:
    """The faces that have a skin; all that are free where none are named."""
    mesh = body.mesh
    chosen = np.ones(len(mesh.triangles), dtype=bool)
    chosen[body.held_triangles()] = False
    if "faces" in table.values:
        faces = table.table("faces", f"{table.name} faces")
        chosen, _ = selected_triangles(faces, mesh, metres_per_unit=body.metres_per_unit)
    if not chosen.any():
        table.fail("faces", "has no triangle with all its vertices inside a selector")
    return TriangleMesh(mesh.vertices, mesh.triangles[chosen])


def _surface(table: TomlTable, metres: float) -> TriangleMesh:
    path = table.existing_file("surface")
    try:
        return checked_mesh(read_mesh(path, metres_per_unit=metres))[0]
    except MeshError as error:
        text = str(error)
        raise MeshError(text if text.startswith(str(path)) else f"{path}: {text}") from error
