"""Reads sessions from folders in the format `palpate-session/1`; adds other programs' displacements
to them.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import AoT, Table

from palpate.disk import put_back_interrupted
from palpate.errors import MeshError, RecordError, quoted
from palpate.files import is_file
from palpate.geometry import TriangleMesh, checked_mesh, read_mesh
from palpate.records.error_priors import read_error_priors
from palpate.records.files.displacement import read_displacement
from palpate.records.files.loads import read_loads, read_push, read_support_motion
from palpate.records.files.series import read_series
from palpate.records.load_checks import (
    check_contact,
    check_copies,
    check_load,
    check_observed_points,
)
from palpate.records.plausibility import check_error_lengths, plausibility_notes
from palpate.records.probing import DisplacementField, Images, Probing
from palpate.records.quantities import FILE_LENGTH_UNITS, LENGTH_UNITS
from palpate.records.region import read_regions
from palpate.records.rig import covariance_file
from palpate.records.session import Session, Step
from palpate.records.support import HeldObject, Support, read_supports
from palpate.records.text.text_file import read_text
from palpate.records.text.toml_table import (
    TomlTable,
    is_list_of,
    nearest_file,
    nearest_word,
    read_toml,
)
from palpate.shapes import Vector3

SESSION_FORMAT = "palpate-session/1"
_CAMERA_FIELD = "{camera}"
# Files with other suffixes are meshes, tables or results. Files in ".partial" are session files
# that are checked before they are renamed.
_SESSION_SUFFIXES = (".toml", ".txt", "", ".partial")
# File in a folder of videos and a force log, in place of a session file.
_RECORDING_FILE = "recording.toml"
_ROOT_KEYS = (
    "format", "name", "object", "support", "region", "gravity", "rig", "errors", "probe",
    "step",
)  # fmt: skip
# The keys of these tables are the fields of their records.
_STEP_KEYS = [field.name for field in fields(Step)]
_PROBE_KEYS = [
    *("load" if field.name == "loads" else field.name for field in fields(Probing)),
    "tip_displacement_offset_std", "measured_at",
]  # fmt: skip


def _allow_any_size(*counts: int) -> None:
    """Accepts sessions of any size."""


def read_session(
    path: Path | str | TomlTable,
    *,
    probes: Sequence[str] | None = None,
    observations: bool = True,
    allow: Callable[[int, int], object] = _allow_any_size,
) -> Session:
    """Read and validate a session; all quantities are converted to SI units.

    Parameters
    ----------
    path : path or TomlTable        the session's folder (with a session.toml), or a session file;
                                    or its content, with the file that it is to be
    probes : names or None          read these probings only; None: all
    observations : bool             False: ignore displacements and pictures of the probings, which
                                    may still be missing, and do not check that contacts lie on the
                                    surface
    allow : callable                called with the numbers of vertices and of probings, if there
                                    are probings, before anything slow is done; raises an
                                    `InputError` if they are too many

    Returns
    -------
    Session                         closed mesh with outward normals; observed points located on the
                                    surface; with probings, or with steps of a rigid motion

    Raises
    ------
    RecordError                     any mistake in session.toml or a displacement file; the text
                                    names file, table and key
    MeshError                       a mesh that cannot be read or is not closed
    """
    root = path if isinstance(path, TomlTable) else read_toml(session_file(Path(path)))
    root.check_keys(_ROOT_KEYS)
    root.check_format(SESSION_FORMAT)
    body = root.table("object")
    body.check_keys(("mesh", "length_unit", "density"))
    metres = FILE_LENGTH_UNITS[body.choice("length_unit", tuple(FILE_LENGTH_UNITS))]
    requested = _requested_probes(root, probes)
    mesh, notes = read_object_mesh(
        body, metres, lambda count: requested and allow(count, len(requested))
    )
    supports: tuple[Support, ...] = ()
    if "support" in root.values or root.values.get("probe"):
        supports = read_supports(root, mesh, metres_per_unit=metres)
    held_object = HeldObject(mesh, supports, metres)
    probings: list[Probing] = []
    for table in requested:
        probing, probing_notes = _probing(table, held_object, observations=observations)
        probings.append(probing)
        notes += probing_notes
    gravity, at_rest = _gravity(root)
    cameras = _cameras(root)
    with root.error_context():
        check_copies(tuple(probings))
        session = Session(
            name=root.optional("name", root.label) or root.file.parent.name,
            path=root.file,
            mesh=mesh,
            held_triangles=held_object.held_triangles(),
            probings=tuple(probings),
            density=body.optional("density", body.number),
            gravity=gravity,
            gravity_at_rest=at_rest,
            rig=cameras,
            notes=notes,
            steps=_steps(root),
            metres_per_unit=metres,
            supports=supports,
            regions=read_regions(root, held_object),
            errors=read_error_priors(
                root, metres_per_unit=metres, calibrated=bool(cameras and covariance_file(cameras))
            ),
        )
        check_error_lengths(session)
    return replace(session, notes=notes + plausibility_notes(session))


def session_file(path: Path) -> Path:
    """Session file of a folder, or the file itself; a folder whose replacement was
    interrupted is put back first.

    Parameters
    ----------
    path : Path                     folder or file

    Returns
    -------
    Path                            the session file

    Raises
    ------
    RecordError                     there is no session file
    InUseError                      another process is changing it
    """
    put_back_interrupted(path)
    folder = os.path.isdir(path)
    if folder:
        file = path / "session.toml"
        if not os.access(path, os.R_OK | os.X_OK):
            raise RecordError(f"{path}: the folder cannot be read (Permission denied)")
        if not is_file(file):
            others = sorted(map(quoted, (p.name for p in path.glob("*.toml") if is_file(p))))[:5]
            hint = f"; it has {', '.join(others)}: name one of them" if others else ""
            if is_file(path / _RECORDING_FILE):
                hint = f"; {_RECORDING_FILE} becomes one by `palpate record {path}`"
            raise RecordError(f"{path}: the folder has no session file session.toml{hint}")
        return file
    if not is_file(path):
        raise RecordError(
            f"{path}: no such file or folder; give a session's folder or its session.toml"
            f"{nearest_file(path)}"
        )
    if path.suffix.lower() not in _SESSION_SUFFIXES:
        raise RecordError(
            f"{path}: is no session file; give a session's folder or its session.toml"
            " (`palpate init FOLDER` begins one)"
        )
    return path


def read_object_mesh(
    body: TomlTable, metres_per_unit: float, allow: Callable[[int], object] = _allow_any_size
) -> tuple[TriangleMesh, tuple[str, ...]]:
    """The validated surface of the object, from the table [object] of a session or a recording.

    Parameters
    ----------
    body : TomlTable
    metres_per_unit : float [m]     length unit of the mesh
    allow : callable                as in `read_session`, with the number of vertices only

    Returns
    -------
    mesh : TriangleMesh             in metres, closed, outward normals
    notes : tuple of str            what was repaired

    Raises
    ------
    RecordError                     no such file
    MeshError                       a mesh that cannot be read or is not closed; the text names it
    """
    path = body.existing_file("mesh")
    try:
        mesh = read_mesh(path, metres_per_unit=metres_per_unit)
        with replace(body, file=path, name="").error_context():
            allow(len(mesh.vertices))
        mesh, notes = checked_mesh(mesh)
    except MeshError as error:
        text = str(error)
        raise MeshError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    return mesh, tuple(f"{path.name}: {note}" for note in notes)


def _gravity(root: TomlTable) -> tuple[Vector3 | None, bool]:
    """Gravity [m/s^2], and whether it acts at rest, too."""
    table = root.optional("gravity", root.table)
    if table is None:
        return None, False
    table.check_keys(("acceleration", "at_rest"))
    return table.vector("acceleration"), bool(table.optional("at_rest", table.boolean))


def _cameras(root: TomlTable) -> Path | None:
    """The file of the cameras."""
    table = root.optional("rig", root.table)
    if table is None:
        return None
    table.check_keys(("cameras",))
    return table.existing_file("cameras")


def _requested_probes(root: TomlTable, probes: Sequence[str] | None) -> list[TomlTable]:
    """The requested probe tables."""
    tables = _named_tables(root, "probe", _PROBE_KEYS)
    names = [table.text("name") for table in tables]
    for name in probes or ():
        if name not in names:
            known = ", ".join(names) or "none, it is a rigid-motion sequence"
            near = nearest_word(name, names)
            raise RecordError(
                f"{root.file}: there is no probing '{name}'{near} (there are: {known})"
            )
    return [t for t, name in zip(tables, names, strict=True) if probes is None or name in probes]


def _named_tables(root: TomlTable, key: str, allowed: Sequence[str]) -> list[TomlTable]:
    """Tables of one kind; messages call them by their names."""
    tables = []
    for table in root.optional(key, root.tables) or ():
        table.check_keys(allowed)
        tables.append(replace(table, name=f"[[{key}]] '{table.label('name')}'"))
    return tables


def _steps(root: TomlTable) -> tuple[Step, ...]:
    """The steps of a rigid-motion sequence; empty if it is none."""
    patterns: list[str] = []
    steps = []
    for table in _named_tables(root, "step", _STEP_KEYS):
        patterns.append(_pattern(table, "images", patterns))
        steps.append(Step(table.text("name"), patterns[-1]))
    return tuple(steps)


def _field(file: Path | None, body: HeldObject) -> tuple[DisplacementField | None, tuple[str, ...]]:
    """Displacements in a file, if there is one, with notes."""
    if file is None:
        return None, ()
    return read_displacement(file, body.mesh, metres_per_unit=body.metres_per_unit)


def _probing(
    table: TomlTable, body: HeldObject, *, observations: bool
) -> tuple[Probing, tuple[str, ...]]:
    """One probing, in SI units, checked against surface and supports, with notes."""
    mesh, held, still = body.mesh, body.held_triangles(), body.held_triangles(still=True)
    images = _images(table) if observations else None
    file = table.optional("displacement", table.existing_file) if observations else None
    field, notes = _field(file, body)
    tip, tip_std = _tip(table, body.metres_per_unit)
    if observations and field is None and images is None and tip is None:
        table.fail(
            "displacement",
            "the key is missing: give the measured displacements as a CSV file, the pictures they"
            " are to come from as images, or of a poke without pictures its tip_displacement",
        )
    support_field, support_notes = _field(
        table.optional("support_displacement", table.existing_file), body
    )
    with table.error_context():
        loads = read_loads(table, body)
        contact, force = read_push(table, body, loads)
        series, doubts = read_series(table, body, force, field) if observations else (None, ())
        probing = Probing(
            name=table.text("name"),
            contact=contact,
            force=force,
            force_std=table.optional("force_std", table.number_or_vector),
            tip_displacement=tip,
            tip_displacement_std=tip_std,
            displacement=field,
            images=images,
            loads=loads,
            support_displacement=support_field,
            support_motion=read_support_motion(table, metres_per_unit=body.metres_per_unit),
            force_sensor=table.optional("force_sensor", table.label) or "",
            series=series,
        )
        if observations:
            for touched in (contact, *(load.contact for load in loads)):
                check_contact(mesh, held, touched)
            # With moving supports or additional loads the displacement is not due to this force.
            if not loads and len(still) == len(held):
                check_load(mesh, probing)
        if field is not None:
            check_observed_points(mesh, still, field)
    return probing, notes + support_notes + doubts


def _tip(table: TomlTable, metres: float) -> tuple[Vector3 | None, Vector3 | None]:
    """Displacement of the contact point and its standard deviation [m], which includes that of the
    point of first contact."""
    tip = table.optional("tip_displacement", table.vector)
    std = table.optional("tip_displacement_std", table.number_or_vector)
    if "tip_displacement_offset_std" in table.values:
        if tip is None:
            table.fail(
                "tip_displacement_offset_std",
                "is given without tip_displacement; give both or none",
            )
        offset = table.quantity("tip_displacement_offset_std", LENGTH_UNITS, metres)
        if not offset > 0.0:
            table.fail(
                "tip_displacement_offset_std", "must be positive; leave it out where it is exact"
            )
        std = np.hypot(np.zeros(3) if std is None else std, offset / metres)
    return None if tip is None else metres * tip, None if std is None else metres * std


def _images(table: TomlTable) -> Images | None:
    if "images" not in table.values:
        return None
    images = table.table("images", f"{table.name} images")
    images.check_keys(("rest", "loaded"))
    loaded = images.checked(
        lambda value: value and is_list_of(str)(value),
        "loaded",
        "be a list of file patterns in quotes",
    )
    patterns = [_pattern(images, "rest", ())]
    for pattern in loaded:
        single = replace(images, values={"loaded": pattern})
        patterns.append(_pattern(single, "loaded", patterns))
    return Images(rest=patterns[0], loaded=tuple(patterns[1:]))


def _pattern(table: TomlTable, key: str, earlier: Sequence[str]) -> str:
    """A file pattern that contains `{camera}` and is not among the earlier ones."""
    pattern = table.text(key)
    if _CAMERA_FIELD not in pattern:
        table.fail(
            key,
            f"'{pattern}' has no {_CAMERA_FIELD}, so all cameras would read the same file; write it"
            f" in place of the camera's name, e.g. 'images/s0_{_CAMERA_FIELD}.png'",
        )
    if pattern in earlier:
        table.fail(
            key,
            f"'{pattern}' is named before; the same pictures again would show that nothing moved",
        )
    return pattern


@dataclass(frozen=True, slots=True)
class ImportItem:
    """One result that is to be imported as the displacement of one probing.

    Parameters
    ----------
    file : Path
    probe : str                     name of the probing
    frame : int or None             state in the file, from 0; None: the last one
    """

    file: Path
    probe: str
    frame: int | None


def import_plan(
    session: Session,
    files: Sequence[Path],
    *,
    probes: Sequence[str] | None,
    frames: Sequence[int] | None,
) -> tuple[ImportItem, ...]:
    """Assign each file to a probing: as requested, else by equal name, else to the only one.

    A file with several states can serve several probings, with one frame for each.

    Parameters
    ----------
    session : Session               with probings
    files : sequence of Path        at least one
    probes : names or None          in the order of the files, or of the frames
    frames : numbers or None        one for all, or one for each

    Returns
    -------
    tuple of ImportItem             one for each probing

    Raises
    ------
    RecordError                     an unknown name, wrong counts, two files for one probing
    """
    known = [probing.name for probing in session.probings]
    names = [file.stem for file in files] if probes is None else list(probes)
    if probes is None and len(files) == len(known) == 1:
        names = known
    sources = list(files)
    states: list[int | None] = list(frames or [])
    if len(sources) == 1 and len(names) == len(states) > 1:
        sources *= len(names)
    if len(names) != len(sources):
        raise RecordError(
            f"--probe names {len(names)} probings for {len(sources)} files; name one for each file,"
            " in their order (for several states of one file, with one --frame for each)"
        )
    if len(states) not in (0, 1, len(names)):
        raise RecordError(
            f"--frame gives {len(states)} numbers for {len(names)} probings; give one for all, or"
            " one for each"
        )
    _check_names(session, names, sources, requested=probes is not None)
    if len(states) == 1:
        states *= len(names)
    numbers = states or [None] * len(names)
    return tuple(
        ImportItem(file, name, frame)
        for file, name, frame in zip(sources, names, numbers, strict=True)
    )


def _check_names(
    session: Session, names: Sequence[str], files: Sequence[Path], *, requested: bool
) -> None:
    """Refuse unknown and repeated names of probings."""
    known = [probing.name for probing in session.probings]
    known_text = f"(there are: {', '.join(known)})"
    for name, file in zip(names, files, strict=True):
        if name in known:
            continue
        if not requested:
            raise RecordError(
                f"{file}: no probing of {session.path} is named '{name}' {known_text}; say whose it"
                f" is, e.g. --probe {known[0]}"
            )
        near = nearest_word(name, known)
        raise RecordError(f"{session.path}: there is no probing '{name}'{near} {known_text}")
    if len(set(names)) < len(names):
        repeated = next(name for name in names if names.count(name) > 1)
        raise RecordError(f"two results are given for the probing '{repeated}'; give one")


def displacement_line(file: str) -> str:
    """The line of a [[probe]] table that names its displacement file.

    Parameters
    ----------
    file : str                      relative to the session

    Returns
    -------
    str                             TOML, without a line end
    """
    return f"displacement = {tomlkit.item(file).as_string()}"


def named_displacements(path: Path) -> dict[str, str]:
    """Displacement files that a session names at present, by probing.

    Parameters
    ----------
    path : Path                     a session.toml that `read_session` accepts

    Returns
    -------
    dict of str to str              name of the probing -> file

    Raises
    ------
    RecordError                     not readable
    """
    probes = _probes(tomlkit.parse(read_text(path)))
    return {p["name"]: p["displacement"] for p in probes if "displacement" in p}


def with_displacements(text: str, files: Mapping[str, str]) -> str:
    """Text of a session file with the displacement files of some probings set.

    For each probing one key is added after its last one, or its value replaced; everything else is
    preserved: comments, order, blanks, line endings.

    Parameters
    ----------
    text : str                      valid TOML
    files : mapping                 name of the probing -> file, relative to the session

    Returns
    -------
    str
    """
    document = tomlkit.parse(text)
    for probe in _probes(document):
        if probe["name"] not in files:
            continue
        file = files[probe["name"]]
        if "displacement" in probe or not isinstance(probe, Table):
            probe["displacement"] = file
        else:
            _add_after_last_key(probe, "displacement", file)
    return tomlkit.dumps(document)


def _probes(document: Mapping[str, Any]) -> Sequence[Any]:
    """The probe tables; a single table counts as an array of one."""
    probes = document["probe"]
    return probes if isinstance(probes, list) else [probes]


def _add_after_last_key(table: Table, key: str, value: str) -> None:
    """Add a key before the blank lines, comments and tables at the end of a table.

    `Table.append` alone would put it after the comment that introduces the next table.
    """
    body = table.value.body
    keys = [i for i, (name, item) in enumerate(body) if name and not isinstance(item, (AoT, Table))]
    rest = body[keys[-1] + 1 :]
    del body[keys[-1] + 1 :]
    added = tomlkit.item(value)
    if body[-1][1].trivia.trail.endswith("\r\n"):
        added.trivia.trail = "\r\n"
    table.append(key, added)
    body.extend(rest)
