"""Survey of a folder that is to become a session, and the template that it leads to.

The survey lists meshes, rigs, pictures, videos and tables; the template is a session.toml,
recording.toml or bench.toml with comments on what to fill in.
"""

import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from palpate.errors import InputError, MeshError, PalpateError, RecordError, quoted
from palpate.geometry import MESH_SUFFIXES, TriangleMesh, read_mesh, triangle_areas
from palpate.recording.recording_file import RECORDING_FORMAT
from palpate.records import FILE_LENGTH_UNITS, SESSION_FORMAT, Rig, read_rig, read_text_table
from palpate.shapes import Vector3
from palpate.vision import VIDEO_SUFFIXES

# Of the file that `palpate measure` reads.
BENCH_FORMAT = "palpate-bench/1"
Template = Literal["lab", "dic", "tension", "robot", "gauge", "webcams"]
# Purpose of each template, and the file that it makes.
TEMPLATES: dict[str, tuple[str, str]] = {
    "lab": ("sorted pictures of calibrated cameras", "session.toml"),
    "dic": ("displacements from image correlation or another program", "session.toml"),
    "tension": ("displacements of a specimen between grips that pull it", "session.toml"),
    "robot": ("videos, a force log and a log of the tool's pose", "recording.toml"),
    "gauge": ("videos and the log of a force gauge; the contact is found", "recording.toml"),
    "webcams": ("two webcams and a kitchen scale, measured live", "bench.toml"),
}
# What reads each of these files, and their formats.
_NEXT = {
    "session.toml": ("check", SESSION_FORMAT), "recording.toml": ("record", RECORDING_FORMAT),
    "bench.toml": ("measure", BENCH_FORMAT),
}  # fmt: skip
# Marks what is still to be filled in; `palpate init` counts these marks.
_FILL_MARK = "# <- fill in"
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
_RIG_SUFFIXES = (".toml", ".yml", ".yaml", ".xml", ".json", ".mat", ".caldat")
_TABLE_SUFFIXES = (".csv", ".txt", ".tsv")
# TOML files of Palpate that are not rigs.
_OWN_FILES = (*_NEXT, "truth.toml")
# Largest number of files in the folder and its direct subfolders.
_MAX_FILES = 20_000
# Triangles of a flat side lie within this fraction of the object's size of its extreme plane.
_FLATNESS = 1e-3
# A flat side of a smaller share of the surface may be a facet of a round one.
_SMALL_SIDE = 0.02
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


@dataclass(frozen=True, slots=True)
class Outline:
    """What is known of a new session.

    Parameters
    ----------
    template : str                  one of `TEMPLATES`
    name : str
    mesh : str                      mesh file
    unit : str                      of all lengths
    side : Side or None             flat side that is held
    radius : float                  contact radius, in that unit
    radius_known : bool             the radius was given, not guessed
    tool_radius : float or None     radius of a ball that presses, in that unit; the contact radius
                                    is then computed from it
    pulled : Side or None           flat side that the other grip holds
    """

    template: Template
    name: str
    mesh: str
    unit: str
    side: Side | None
    radius: float
    radius_known: bool
    tool_radius: float | None = None
    pulled: Side | None = None


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


def likely_template(survey: FolderSurvey) -> Template:
    """The template that suits the files of a folder.

    Parameters
    ----------
    survey : FolderSurvey

    Returns
    -------
    str                             one of `TEMPLATES`
    """
    if survey.videos or survey.forces:
        return "robot" if survey.poses else "gauge"
    return "dic" if survey.displacements and not survey.pictures else "lab"


def outline_text(survey: FolderSurvey, outline: Outline) -> str:
    """Text of the session.toml, recording.toml or bench.toml.

    Parameters
    ----------
    survey : FolderSurvey
    outline : Outline

    Returns
    -------
    str                             TOML with comments

    Raises
    ------
    InputError                      the mesh is not in the folder
    """
    if outline.mesh not in survey.meshes:
        raise InputError(
            f"the folder has no mesh {quoted(outline.mesh)}; it has: {_listed(survey.meshes)}"
        )
    held = _support("[support]", outline.side)
    if outline.template == "tension":
        held = (
            _support("[[support]]", outline.side) + "\n" + _support("[[support]]", outline.pulled)
        )
        held += _line('motion = "free"', "this grip moves, and nobody need know how")
    file = TEMPLATES[outline.template][1]
    parts = [_head(outline), _object(outline), held]
    if file == "bench.toml":
        parts += [_rig(survey) if survey.rigs else _board(), *_webcams(survey), _scale()]
        parts.append(_contact(survey, outline))
    elif file == "recording.toml":
        parts += [_rig(survey), _force(survey), _cameras(survey)]
        parts.append(_contact(survey, outline))
    elif outline.template == "lab":
        parts += [_rig(survey), *_pictured_probes(survey, outline)]
    else:
        parts += _measured_probes(survey, outline)
    return "\n".join(parts)


def _line(text: str, comment: str, *, fill: bool = False) -> str:
    """A line with a comment, marked if something is to be filled in."""
    mark = f"{_FILL_MARK}: " if fill else "# "
    return f"{text:<29} {mark}{comment}".rstrip(": ") + "\n"


def next_command(template: Template) -> str:
    """The command that reads what a template makes."""
    return f"palpate {_NEXT[TEMPLATES[template][1]][0]}"


def _head(outline: Outline) -> str:
    what, file = TEMPLATES[outline.template]
    form = _NEXT[file][1]
    return (
        f"# {what[0].upper()}{what[1:]}.\n"
        f"# Look through it, fill in what is marked, then {next_command(outline.template)}\n"
        f'format = "{form}"\nname = {_quoted(outline.name)}\n'
    )


def _object(outline: Outline) -> str:
    return (
        "[object]\n"
        + _line(f"mesh = {_quoted(outline.mesh)}", "closed surface, outward normals")
        + _line(f'length_unit = "{outline.unit}"', "of the mesh and all lengths: m, cm, mm, in")
        + _line("# density = 30.0", "kg/m^3; only with [gravity]")
    )


def _support(table: str, side: Side | None) -> str:
    head = _line(table, "a part of the surface that is held")
    if side is None:
        plane = "plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 0 }"
        what = "no side is flat along an axis: a plane, a box or triangles"
        return head + _line(f"{plane}   ", what, fill=True)
    small = side.area_fraction < _SMALL_SIDE
    point, normal = (
        "[" + ", ".join(f"{x:.6g}" for x in vector) + "]" for vector in (side.point, side.normal)
    )
    return (
        f"{head}# the flat side at {side.name}, {100 * side.area_fraction:.2g} % of the surface:"
        " all triangles this close to the plane\n"
        f"plane = {{ point = {point}, normal = {normal}, tolerance = {side.tolerance:.3g} }}"
        + (f"   {_FILL_MARK}: is this all that is held?\n" if small else "\n")
    )


def _rig(survey: FolderSurvey) -> str:
    if survey.rigs:
        others = f"also here: {_listed(survey.rigs[1:])}" if survey.rigs[1:] else ""
        line = f"cameras = {_quoted(survey.rigs[0])}"
        return "[rig]\n" + (_line(line, others) if others else f"{line}\n")
    return "[rig]\n" + _line('cameras = "rig.toml"', "palpate calibrate makes it", fill=True)


def _force(survey: FolderSurvey) -> str:
    file = survey.forces[0] if survey.forces else "force.csv"
    what = "a column of times, one to three of forces"
    return (
        "[force]\n"
        + _line(f"file = {_quoted(file)}", what, fill=not survey.forces)
        + _line('# columns = ["Fx"]', "headings, where they are not force, fx, fy, fz")
        + _line('# unit = "N"', "mN, N, kN, gf, kgf, lbf; default: as the headings say")
        + _line("# limit = 10.0", "end of the gauge's range, N")
        + "# The direction of each column's positive reading, in the mesh's frame:\n"
        + _line("axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]   ", "", fill=True)
        + _line('sign = "on object"', 'or "on tool": whose force the gauge reads')
    )


def _cameras(survey: FolderSurvey) -> str:
    names = [camera.name for camera in survey.rig.cameras] if survey.rig else ["c0", "c1"]
    parts = []
    for name in names:
        matching = [video for video in survey.videos if name in Path(video).stem]
        video = matching[0] if len(matching) == 1 else f"{name}.mp4"
        mark = "" if len(matching) == 1 else f"   {_FILL_MARK}"
        times = [table for table in survey.times if name in Path(table).stem]
        line = f"times = {_quoted(times[0])}\n" if len(times) == 1 else ""
        parts.append(f"[[camera]]\nname = {_quoted(name)}\nvideo = {_quoted(video)}{mark}\n{line}")
    parts.append(
        '# pictures = "c0/*.png" and times = "c0.csv" in place of a video; offset = 0.4 where the\n'
        "# clocks are known: what to add to the camera's times for the force log's\n"
    )
    return "\n".join(parts)


def _board() -> str:
    return (
        _line("[board]", "held before the cameras, which are calibrated first")
        + _line('target = "charuco"', "palpate calibrate board prints it")
        + "columns = 7\nrows = 5\n"
        + _line('square = "16 mm"', "as printed", fill=True)
        + _line('marker = "12 mm"', "as printed", fill=True)
    )


def _webcams(survey: FolderSurvey) -> list[str]:
    names = [camera.name for camera in survey.rig.cameras] if survey.rig else ["c0", "c1"]
    return [
        f'[[camera]]\nname = {_quoted(name)}\ndriver = "opencv"\n'
        + _line(f"source = {number}", "its number; or http://... or rtsp://...")
        + _line("size = [640, 480]", "as calibrated")
        for number, name in enumerate(names)
    ]


def _scale() -> str:
    return (
        "[force]\n"
        + _line('driver = "typed"', "you type what the scale shows")
        + _line('unit = "gf"', "grams")
        + _line("direction = [0, 0, -1]", "the scale is under the object, in the mesh's frame")
    )


def _contact(survey: FolderSurvey, outline: Outline) -> str:
    text = "[contact]\n"
    if outline.template == "webcams":
        radius = outline.tool_radius or outline.radius
        return (
            text
            + _line('tool = "sphere"', 'or "flat"; where it pressed is found')
            + _line(f"tool_radius = {radius:g}", outline.unit, fill=outline.tool_radius is None)
        )
    if outline.tool_radius is None:
        text += _line(
            f"radius = {outline.radius:g}",
            f"of the touched patch, {outline.unit}",
            fill=not outline.radius_known,
        )
        text += _line('profile = "hertz"', 'a sphere; "uniform": a flat tool; "smooth": a soft one')
    else:
        text += _line('tool = "sphere"', 'or "flat"; what it touches follows from the contact')
        text += _line(f"tool_radius = {outline.tool_radius:g}", outline.unit)
    if outline.template == "robot":
        poses = survey.poses[0] if survey.poses else "poses.csv"
        what = "time, x, y, z of the tip, in the mesh's frame"
        return text + _line(f"poses = {_quoted(poses)}", what, fill=not survey.poses)
    example = 0.04 / FILE_LENGTH_UNITS[outline.unit]
    return text + _line(f"# points = [[0, 0, {example:g}]]", "one a press; else they are found")


def _pictured_probes(survey: FolderSurvey, outline: Outline) -> list[str]:
    """One probing for each loaded picture that all cameras have."""
    names = [camera.name for camera in survey.rig.cameras] if survey.rig else []
    patterns = _patterns(survey.pictures, names)
    rests = [pattern for pattern in patterns if "rest" in Path(pattern).name]
    loaded = [pattern for pattern in patterns if pattern not in rests]
    if not (rests and loaded):
        rests, loaded = ["images/rest_{camera}.png"], ["images/n01_{camera}.png"]
    probes = []
    for pattern in loaded:
        stem = re.sub(r"[_\-. ]*\{camera\}[_\-. ]*", "", Path(pattern).stem)
        rest = next(
            (candidate for candidate in rests if stem and stem in Path(candidate).name), rests[0]
        )
        images = f"images = {{ rest = {_quoted(rest)}, loaded = [{_quoted(pattern)}] }}\n"
        probes.append(_probe(stem or "n01", outline) + images)
    return probes


def _patterns(pictures: Sequence[str], cameras: Sequence[str]) -> list[str]:
    """File patterns with `{camera}` for the camera's name, where every camera has a picture."""
    patterns: dict[str, set[str]] = {}
    for picture in pictures:
        path = Path(picture)
        for camera in cameras:
            expression = rf"(?<![A-Za-z0-9]){re.escape(camera)}(?![A-Za-z0-9])"
            if re.search(expression, path.name):
                name = re.sub(expression, "{camera}", path.name)
                patterns.setdefault(path.with_name(name).as_posix(), set()).add(camera)
    return sorted(
        name for name, found_cameras in patterns.items() if len(found_cameras) == len(cameras)
    )


def _measured_probes(survey: FolderSurvey, outline: Outline) -> list[str]:
    """One probing for each table of displacements."""
    files = survey.displacements or ("n01.csv",)
    missing = not survey.displacements
    what = "x,y,z,ux,uy,uz; palpate import writes it" if missing else "x,y,z,ux,uy,uz"
    return [
        _probe(Path(file).stem, outline)
        + _line(f"displacement = {_quoted(file)}", what, fill=missing)
        for file in files
    ]


def _probe(name: str, outline: Outline) -> str:
    patch = f'radius = {outline.radius:g}, profile = "hertz"'
    if outline.tool_radius is not None:
        patch = f'tool = "sphere", tool_radius = {outline.tool_radius:g}'
    contact = _line(f"contact = {{ point = [0, 0, 0], {patch} }}", "", fill=True)
    if outline.template == "tension":
        contact = _line("contact = { support = 2 }", "the grip that pulls")
    newtons = "N, what the tool exerts on the object; 100 g on a scale are 0.981 N"
    return (
        f"[[probe]]\nname = {_quoted(name)}\n{contact}"
        + _line("force = [0, 0, 0]", newtons, fill=True)
        + _line("# force_std = 0.01", "N, 1 sigma")
    )


def _quoted(text: str) -> str:
    """A TOML string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - 8} more" if len(names) > 8 else ""
    return (", ".join(names[:8]) or "none") + more


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
    sides = []
    for name, (axis, sign) in _SIDES.items():
        height = sign * mesh.vertices[:, axis]
        on_side = (height[mesh.triangles] > height.max() - _FLATNESS * size).all(axis=1)
        if on_side.any():
            point, normal = np.zeros(3), np.zeros(3)
            point[axis], normal[axis] = sign * height.max(), sign
            area_fraction = float(areas[on_side].sum() / areas.sum())
            sides.append(Side(name, point, normal, _FLATNESS * size, area_fraction))
    return tuple(sorted(sides, key=lambda side: (-round(side.area_fraction, 3), side.name != "z-")))


def opposite_side(sides: tuple[Side, ...], side: Side | None) -> Side | None:
    """The flat side across the object from another.

    Parameters
    ----------
    sides : tuple of Side
    side : Side or None

    Returns
    -------
    Side or None                    None: there is none
    """
    return next((s for s in sides if side and np.array_equal(s.normal, -side.normal)), None)


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
    names = ", ".join(side.name for side in sides) or "none"
    raise InputError(f"the object has no flat side at {name}; it has: {names}")
