"""Survey of a folder that is to become a session: meshes, rigs, pictures, videos, tables."""

import os
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palpate.errors import InputError, MeshError, PalpateError, RecordError
from palpate.geometry import MESH_SUFFIXES, TriangleMesh, read_mesh, triangle_areas
from palpate.records import Rig, read_rig, read_text_table
from palpate.shapes import Vector3
from palpate.vision import VIDEO_SUFFIXES

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_RIG_SUFFIXES = (".toml", ".yml", ".yaml", ".xml", ".json", ".mat", ".caldat")
_TABLE_SUFFIXES = (".csv", ".txt", ".tsv")
# TOML files of Palpate that are not rigs.
_OWN_FILES = ("session.toml", "recording.toml", "truth.toml")
# Largest number of files in the folder and its direct subfolders.
_MAX_FILES = 20_000
# Triangles of a flat side lie within this fraction of the object's size of its extreme plane.
_FLATNESS = 1e-3
_SIDES = {"x-": (0, -1.0), "x+": (0, 1.0), "y-": (1, -1.0), "y+": (1, 1.0), "z-": (2, -1.0),
          "z+": (2, 1.0)}  # fmt: skip
SIDES = tuple(_SIDES)
# Most likely unit of a mesh for its largest extent: probed objects measure 5 mm to 2 m.
_UNITS = (("m", 2.0), ("cm", 20.0), ("mm", np.inf))


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """A flat side of an object, along an axis.

    Attributes
    ----------
    name : str                      one of `SIDES`
    point : (3,) float              a point of its plane, in the mesh's unit
    normal : (3,) float             outward unit normal
    tolerance : float               distance from the plane, in the mesh's unit
    area_fraction : float [-]       fraction of the whole surface
    """

    name: str
    point: Vector3
    normal: Vector3
    tolerance: float
    area_fraction: float


@dataclass(frozen=True, slots=True, eq=False)
class FolderSurvey:
    """Files found in a folder, with names relative to it.

    Attributes
    ----------
    folder : Path
    meshes, rigs, videos, pictures : tuple of str
    displacements, forces, poses, times : tuple of str      tables, classified by their columns
    rig : Rig or None               from the first file that holds one
    """

    folder: Path
    meshes: tuple[str, ...]
    rigs: tuple[str, ...]
    videos: tuple[str, ...]
    pictures: tuple[str, ...]
    displacements: tuple[str, ...]
    forces: tuple[str, ...]
    poses: tuple[str, ...]
    times: tuple[str, ...]
    rig: Rig | None


def survey_folder(folder: Path) -> FolderSurvey:
    """Survey a folder and its direct subfolders, without changing anything.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    FolderSurvey

    Raises
    ------
    RecordError                     no such folder, not readable, the root of a disk, too many files
    """
    if not folder.is_dir():
        raise RecordError(f"{folder}: no such folder; make it, and put the mesh into it")
    if not os.access(folder, os.R_OK | os.X_OK):
        raise RecordError(f"{folder}: the folder cannot be read (Permission denied)")
    if folder.resolve() == Path(folder.resolve().anchor):
        raise RecordError(f"{folder}: is the whole disk; name the folder of one measurement")
    files = sorted(_list_files(folder))
    if len(files) > _MAX_FILES:
        raise RecordError(f"{folder}: has {len(files)} files; name the folder of one measurement")

    def named(suffixes: Iterable[str]) -> tuple[str, ...]:
        chosen = (path for path in files if path.suffix.lower() in tuple(suffixes))
        return tuple(path.relative_to(folder).as_posix() for path in chosen)

    rigs: list[str] = []
    first: Rig | None = None
    for name in named(_RIG_SUFFIXES):
        if Path(name).name in _OWN_FILES:
            continue
        with suppress(PalpateError):
            rig = read_rig(folder / name)
            rigs.append(name)
            first = first or rig
    kinds: dict[str, list[str]] = {"displacement": [], "force": [], "pose": [], "time": []}
    for name in named(_TABLE_SUFFIXES):
        if kind := _table_kind(folder / name):
            kinds[kind].append(name)
    return FolderSurvey(
        folder, named(MESH_SUFFIXES), tuple(rigs), named(VIDEO_SUFFIXES), named(PICTURE_SUFFIXES),
        tuple(kinds["displacement"]), tuple(kinds["force"]), tuple(kinds["pose"]),
        tuple(kinds["time"]), first,
    )  # fmt: skip


def _list_files(folder: Path) -> list[Path]:
    """All files, each once, even if several links lead to its folder."""
    within = [path for path in folder.glob("*") if path.is_dir()]
    # The folder itself first, then real subfolders, then links.
    folders = [folder, *sorted(within, key=lambda path: (path.is_symlink(), path))]
    unique = {path.resolve(): path for path in reversed(folders)}
    return [file for path in unique.values() for file in path.glob("*") if os.path.isfile(file)]


def _table_kind(path: Path) -> str:
    """Kind of a table according to its columns; empty if none of those sought."""
    try:
        table = read_text_table(path, cure="")
    except PalpateError:
        return ""
    words = {column.name.partition("(")[0].strip().lower() for column in table.columns}
    if {"ux", "uy", "uz"} <= words:
        return "displacement"
    timed = words & {"t", "time", "timestamp", "elapsed"}
    if timed and {"x", "y", "z"} <= words:
        return "pose"
    # Lists of the times of frames may number the frames, too.
    others = words - timed - {"frame"}
    if timed and any(word.startswith(("f", "load")) for word in others):
        return "force"
    return "time" if timed and not others else ""


def read_surface(survey: FolderSurvey, name: str) -> TriangleMesh:
    """Surface from a mesh file, in the file's own unit.

    Parameters
    ----------
    survey : FolderSurvey
    name : str                      of the file, relative to the folder

    Returns
    -------
    TriangleMesh

    Raises
    ------
    MeshError                       the file cannot be read
    InputError                      the optional package for its format is missing
    """
    try:
        return read_mesh(survey.folder / name, metres_per_unit=1.0)
    except MeshError as error:
        raise MeshError(f"{error}; mend it, or name another with --mesh") from error


def likely_unit(mesh: TriangleMesh) -> str:
    """Most likely unit of a mesh, if the object is one that can be probed on a bench.

    Parameters
    ----------
    mesh : TriangleMesh             in its own unit

    Returns
    -------
    str                             m, cm or mm
    """
    extent = float(np.ptp(mesh.vertices, axis=0).max())
    return next(unit for unit, largest in _UNITS if extent <= largest)


def default_radius(mesh: TriangleMesh) -> float:
    """Default contact radius: a twentieth of the object's largest extent, to one digit.

    Parameters
    ----------
    mesh : TriangleMesh             in its own unit

    Returns
    -------
    float                           in that unit
    """
    return float(f"{0.05 * np.ptp(mesh.vertices, axis=0).max():.1g}")


def flat_sides(mesh: TriangleMesh) -> tuple[Side, ...]:
    """Flat sides perpendicular to the axes, the largest first; among equals the lower one first.

    Parameters
    ----------
    mesh : TriangleMesh             in its own unit

    Returns
    -------
    tuple of Side                   empty if there is none
    """
    areas = triangle_areas(mesh)
    size = float(np.ptp(mesh.vertices, axis=0).max())
    found = []
    for name, (axis, sign) in _SIDES.items():
        height = sign * mesh.vertices[:, axis]
        on_side = (height[mesh.triangles] > height.max() - _FLATNESS * size).all(axis=1)
        if on_side.any():
            point, normal = np.zeros(3), np.zeros(3)
            point[axis], normal[axis] = sign * height.max(), sign
            area_fraction = float(areas[on_side].sum() / areas.sum())
            found.append(Side(name, point, normal, _FLATNESS * size, area_fraction))
    return tuple(sorted(found, key=lambda side: (-round(side.area_fraction, 3), side.name != "z-")))


def chosen_side(sides: tuple[Side, ...], name: str | None) -> Side | None:
    """The requested flat side, or the largest.

    Parameters
    ----------
    sides : tuple of Side
    name : str or None              one of `SIDES`; None: the largest

    Returns
    -------
    Side or None                    None if there is no flat side and no name was given

    Raises
    ------
    InputError                      the object has no flat side of that name
    """
    if name is None:
        return sides[0] if sides else None
    for side in sides:
        if side.name == name:
            return side
    there = ", ".join(side.name for side in sides) or "none"
    raise InputError(f"the object has no flat side at {name}; it has: {there}")
