"""Sessions from folders in the format `palpate-session/1`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from palpate.errors import InputError, MeshError, RecordError
from palpate.geometry import TriangleMesh, checked_mesh, read_mesh
from palpate.records.files.displacement import read_displacement
from palpate.records.probing import Contact, ContactProfile, DisplacementField, Images, Probing
from palpate.records.session import Session
from palpate.records.session_checks import check_contact, check_observed_points, plausibility_notes
from palpate.records.step import Step
from palpate.records.support import read_support
from palpate.records.text import TomlTable, nearest_word, read_toml
from palpate.shapes import Indices, Vector3

SESSION_FORMAT = "palpate-session/1"
_CAMERA_FIELD = "{camera}"
_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
_ROOT_KEYS = ("format", "name", "object", "support", "gravity", "rig", "probe", "step")
_STEP_KEYS = ("name", "images")
_NO_RIG = (
    "the pictures need their cameras: add a [rig] table with the camera file, e.g."
    ' cameras = "rig.toml"'
)
_PROBE_KEYS = (
    "name",
    "contact",
    "force",
    "force_std",
    "tip_displacement",
    "tip_displacement_std",
    "displacement",
    "images",
)


def read_session(path: Path | str, *, probes: Sequence[str] | None = None) -> Session:
    """Read and check a whole session; everything is in SI units afterwards.

    Parameters
    ----------
    path : path                     the session's folder (with a session.toml), or a session file
    probes : names or None          read these probings only; None: all

    Returns
    -------
    Session                         mesh closed and outward, every observed point on the surface;
                                    with probings, or with the steps of a rigid-motion sequence

    Raises
    ------
    RecordError                     anything wrong in session.toml or a displacement file; the text
                                    names file, table and key
    MeshError                       a mesh that cannot be read or is not closed
    """
    root = read_toml(_session_file(Path(path)))
    _check_root(root)
    body = root.table("object", "[object]")
    body.check_keys(("mesh", "length_unit", "density"))
    metres_per_unit = _METRES[body.choice("length_unit", tuple(_METRES))]
    mesh, notes = _mesh(body, metres_per_unit)
    density = _density(body)
    rig = _rig(root)
    held: Indices = np.zeros(0, dtype=np.int64)
    if "support" in root.values or root.values.get("probe"):
        support = root.table("support", "[support]")
        held = read_support(support, mesh, metres_per_unit=metres_per_unit)
    probings: list[Probing] = []
    for table in _chosen(root, probes):
        probing, probing_notes = _probing(table, mesh, held, metres_per_unit)
        if probing.displacement is None and rig is None:
            table.fail("images", _NO_RIG)
        probings.append(probing)
        notes += probing_notes
    return Session(
        name=root.text("name") if "name" in root.values else root.file.parent.name,
        path=root.file,
        mesh=mesh,
        held_triangles=held,
        probings=tuple(probings),
        density=density,
        gravity=_gravity(root, density),
        rig=rig,
        notes=notes + plausibility_notes(mesh, tuple(probings)),
        steps=_steps(root, rig),
        metres_per_unit=metres_per_unit,
    )


def _session_file(path: Path) -> Path:
    """The session file that a folder or a file name means."""
    if path.is_dir():
        file = path / "session.toml"
        if not file.is_file():
            others = sorted(p.name for p in path.glob("*.toml"))
            hint = f"; it has {others}: name one of them" if others else ""
            raise RecordError(f"{path}: the folder has no session.toml{hint}")
        return file
    if not path.is_file():
        beside = sorted(p.name for p in path.parent.glob("*")) if path.parent.is_dir() else []
        raise RecordError(
            f"{path}: no such file or folder{nearest_word(path.name, beside)};"
            " give a session's folder or its session.toml"
        )
    return path


def _check_root(root: TomlTable) -> None:
    """Refuse another format, unknown tables, and sessions of nothing or of two kinds."""
    root.check_keys(_ROOT_KEYS)
    found = root.get("format")
    if found != SESSION_FORMAT:
        root.fail("format", f"is {found!r}; this version reads '{SESSION_FORMAT}'")
    if root.values.get("probe") and root.values.get("step"):
        root.fail(
            "",
            "has [[probe]] and [[step]] tables; a session is either of probings or a rigid-motion"
            " sequence: make two files of it (both may use the same mesh, rig and images)",
        )
    if not (root.values.get("probe") or root.values.get("step")):
        root.fail(
            "",
            "has no [[probe]] table; at least one probing is needed (or two [[step]] tables of a"
            " rigid motion)",
        )


def _mesh(body: TomlTable, metres_per_unit: float) -> tuple[TriangleMesh, tuple[str, ...]]:
    """The object's surface in metres, checked."""
    path = body.existing_file("mesh")
    try:
        mesh, notes = checked_mesh(read_mesh(path, metres_per_unit=metres_per_unit))
    except MeshError as error:
        text = str(error)
        raise MeshError(text if text.startswith(str(path)) else f"{path}: {text}") from error
    return mesh, tuple(f"{path.name}: {note}" for note in notes)


def _density(body: TomlTable) -> float | None:
    if "density" not in body.values:
        return None
    density = body.number("density")
    if density <= 0.0:
        body.fail("density", f"is {density}; must be positive, in kg/m^3")
    return density


def _gravity(root: TomlTable, density: float | None) -> Vector3 | None:
    if "gravity" not in root.values:
        return None
    table = root.table("gravity", "[gravity]")
    table.check_keys(("acceleration",))
    acceleration = table.vector("acceleration")
    if density is None:
        table.fail(
            "acceleration",
            "gravity needs the object's density: add density (kg/m^3) to [object]; or leave"
            " [gravity] out if the rest state was measured under gravity too",
        )
    return acceleration


def _rig(root: TomlTable) -> Path | None:
    if "rig" not in root.values:
        return None
    table = root.table("rig", "[rig]")
    table.check_keys(("cameras",))
    return table.existing_file("cameras")


def _chosen(root: TomlTable, probes: Sequence[str] | None) -> list[TomlTable]:
    """The probe tables that were asked for, under distinct names; none in a session of steps."""
    tables, names = _named_tables(root, "probe", "probing", _PROBE_KEYS)
    if probes is None:
        return tables
    if not names:
        root.fail("[[step]]", f"a rigid-motion sequence has no probings; asked for: {list(probes)}")
    for name in probes:
        if name not in names:
            raise RecordError(
                f"{root.file}: there is no probing '{name}'{nearest_word(name, names)}"
                f" (there are: {', '.join(names)})"
            )
    return [table for table, name in zip(tables, names, strict=True) if name in probes]


def _named_tables(
    root: TomlTable, key: str, kind: str, allowed: Sequence[str]
) -> tuple[list[TomlTable], list[str]]:
    """Tables of one kind, known to the reader by their distinct names."""
    tables: list[TomlTable] = []
    names: list[str] = []
    if key not in root.values:
        return tables, names
    for number, table in enumerate(root.tables(key, f"[[{key}]]"), start=1):
        plain = TomlTable(table.file, f"[[{key}]] number {number}", table.values)
        plain.check_keys(allowed)
        name = plain.text("name")
        if name in names:
            plain.fail("name", f"'{name}' is taken by an earlier {kind}; names must be distinct")
        names.append(name)
        tables.append(TomlTable(table.file, f"[[{key}]] '{name}'", table.values))
    return tables, names


def _steps(root: TomlTable, rig: Path | None) -> tuple[Step, ...]:
    """The steps of a rigid-motion sequence, if it is one."""
    tables, names = _named_tables(root, "step", "step", _STEP_KEYS)
    if not tables:
        return ()
    if rig is None:
        root.fail("[[step]]", _NO_RIG)
    if len(tables) == 1:
        tables[0].fail("", "is the only step; motion needs at least two, the first is the initial")
    patterns: list[str] = []
    for table in tables:
        patterns.append(_pattern(table, "images", patterns))
    return tuple(Step(name, pattern) for name, pattern in zip(names, patterns, strict=True))


def _probing(
    table: TomlTable, mesh: TriangleMesh, held: Indices, metres_per_unit: float
) -> tuple[Probing, tuple[str, ...]]:
    """One probing, in SI units, checked against the surface and the support."""
    images = _images(table)
    field, notes = _displacement(table, images, mesh, metres_per_unit)
    tip = _scaled(table, "tip_displacement", metres_per_unit)
    tip_std = _positive(table, "tip_displacement_std", metres_per_unit)
    if tip is None and tip_std is not None:
        table.fail("tip_displacement_std", "is given without tip_displacement; give both or none")
    try:
        probing = Probing(
            name=table.text("name"),
            contact=_contact(table, metres_per_unit),
            force=table.vector("force"),
            force_std=_positive(table, "force_std", 1.0, zero_allowed=True),
            tip_displacement=tip,
            tip_displacement_std=tip_std,
            displacement=field,
            images=images,
        )
        check_contact(mesh, held, probing.contact)
        if field is not None:
            check_observed_points(mesh, held, field)
    except RecordError:
        raise
    except InputError as error:
        raise RecordError(f"{table.file}: {table.name}: {error}") from error
    return probing, notes


def _displacement(
    table: TomlTable, images: Images | None, mesh: TriangleMesh, metres_per_unit: float
) -> tuple[DisplacementField | None, tuple[str, ...]]:
    """What was measured of the surface; None where pictures are to tell it."""
    if "displacement" in table.values:
        file = table.existing_file("displacement")
        return read_displacement(file, mesh, metres_per_unit=metres_per_unit)
    if images is None:
        table.fail(
            "displacement",
            "the key is missing: give the measured displacements as a CSV file, or the pictures"
            " they are to come from as images",
        )
    return None, ()


def _contact(table: TomlTable, metres_per_unit: float) -> Contact:
    contact = table.table("contact", f"{table.name} contact")
    contact.check_keys(("point", "radius", "profile"))
    profile = contact.choice("profile", tuple(member.value for member in ContactProfile))
    radius = metres_per_unit * contact.number("radius") if "radius" in contact.values else None
    return Contact(
        point=metres_per_unit * contact.vector("point"),
        radius=radius,
        profile=ContactProfile(profile),
    )


def _scaled(table: TomlTable, key: str, factor: float) -> Vector3 | None:
    return factor * table.vector(key) if key in table.values else None


def _positive(
    table: TomlTable, key: str, factor: float, *, zero_allowed: bool = False
) -> Vector3 | None:
    """A standard deviation, one number or three."""
    if key not in table.values:
        return None
    value = table.number_or_vector(key)
    if np.any(value < 0.0) or (not zero_allowed and np.any(value == 0.0)):
        least = "must not be negative" if zero_allowed else "must be positive"
        table.fail(key, f"is {table.values[key]!r}; {least}")
    return factor * value


def _images(table: TomlTable) -> Images | None:
    if "images" not in table.values:
        return None
    images = table.table("images", f"{table.name} images")
    images.check_keys(("rest", "loaded"))
    loaded = images.get("loaded")
    if not (isinstance(loaded, list) and loaded and all(isinstance(x, str) for x in loaded)):
        images.fail("loaded", f"is {loaded!r}; must be a list of file patterns in quotes")
    patterns = [_pattern(images, "rest", ())]
    for number in range(len(loaded)):
        single = TomlTable(images.file, images.name, {"loaded": loaded[number]})
        patterns.append(_pattern(single, "loaded", patterns))
    return Images(rest=patterns[0], loaded=tuple(patterns[1:]))


def _pattern(table: TomlTable, key: str, earlier: Sequence[str]) -> str:
    """A file pattern that has a place for the camera's name and was not used before."""
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
