"""A session before its displacements are there, and which result file is for which probing."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from palpate.errors import MeshError, RecordError
from palpate.geometry import TriangleMesh, checked_mesh, read_mesh
from palpate.records.text import nearest_word, read_toml

_METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}


@dataclass(frozen=True, slots=True)
class ProbeOutline:
    """One probing by name.

    Parameters
    ----------
    name : str
    displacement : str or None      the displacement file it names
    """

    name: str
    displacement: str | None


@dataclass(frozen=True, slots=True, eq=False)
class SessionOutline:
    """What an import must know of a session.

    Parameters
    ----------
    path : Path                     its TOML file
    mesh : TriangleMesh             in metres, closed, outward
    metres_per_unit : float [m]     of its displacement files
    probes : tuple of ProbeOutline
    notes : tuple of str            what was mended of the mesh
    """

    path: Path
    mesh: TriangleMesh
    metres_per_unit: float
    probes: tuple[ProbeOutline, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ImportItem:
    """One result that is to become the displacement of one probing.

    Parameters
    ----------
    file : Path
    probe : ProbeOutline
    frame : int or None             state of the file, from 0; None: the last one
    """

    file: Path
    probe: ProbeOutline
    frame: int | None


def read_session_outline(path: Path | str) -> SessionOutline:
    """Mesh and probings of a session whose displacements may be missing.

    Parameters
    ----------
    path : path                     the session's folder (with a session.toml), or a session file

    Raises
    ------
    RecordError                     no session there, no probings, twin names
    MeshError                       a mesh that cannot be read or is not closed
    """
    root = read_toml(_session_file(Path(path)))
    body = root.table("object", "[object]")
    metres = _METRES[body.choice("length_unit", tuple(_METRES))]
    file = body.existing_file("mesh")
    try:
        mesh, notes = checked_mesh(read_mesh(file, metres_per_unit=metres))
    except MeshError as error:
        text = str(error)
        raise MeshError(text if text.startswith(str(file)) else f"{file}: {text}") from error
    if not root.values.get("probe"):
        root.fail("", "has no [[probe]] table; displacements belong to a probing: add one")
    probes = tuple(
        ProbeOutline(
            table.text("name"),
            table.text("displacement") if "displacement" in table.values else None,
        )
        for table in root.tables("probe", "[[probe]]")
    )
    names = [probe.name for probe in probes]
    if len(set(names)) < len(names):
        twins = sorted({name for name in names if names.count(name) > 1})
        root.fail("[[probe]]", f"probings share the names {twins}; names must be distinct")
    return SessionOutline(
        root.file, mesh, metres, probes, tuple(f"{file.name}: {note}" for note in notes)
    )


def import_plan(
    outline: SessionOutline,
    files: Sequence[Path],
    *,
    probes: Sequence[str] | None,
    frames: Sequence[int] | None,
) -> tuple[ImportItem, ...]:
    """The probing of each file: as asked, else of the same name, else the only one.

    One file that holds several states serves several probings, with one frame for each.

    Parameters
    ----------
    outline : SessionOutline
    files : sequence of Path        at least one
    probes : names or None          in the order of the files, or of the frames
    frames : numbers or None        one for all, or one for each

    Raises
    ------
    RecordError                     an unknown name, too many or few, two files for one probing
    """
    known = {probe.name: probe for probe in outline.probes}
    names = [file.stem for file in files] if probes is None else list(probes)
    if probes is None and len(files) == len(known) == 1:
        names = list(known)
    sources, states = list(files), list(frames or [])
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
    _check_names(outline, names, sources, asked=probes is not None)
    numbers: list[int | None] = [None] * len(names)
    if states:
        numbers = [*states] if len(states) == len(names) else [*states] * len(names)
    return tuple(
        ImportItem(file, known[name], frame)
        for file, name, frame in zip(sources, names, numbers, strict=True)
    )


def _check_names(
    outline: SessionOutline, names: Sequence[str], files: Sequence[Path], *, asked: bool
) -> None:
    """Refuse probings that are not there, or there twice."""
    known = [probe.name for probe in outline.probes]
    there = f"(there are: {', '.join(known)})"
    for name, file in zip(names, files, strict=True):
        if name in known:
            continue
        if not asked:
            raise RecordError(
                f"{file}: no probing of {outline.path} is named '{name}' {there}; say whose it is,"
                f" e.g. --probe {known[0]}"
            )
        near = nearest_word(name, known)
        raise RecordError(f"{outline.path}: there is no probing '{name}'{near} {there}")
    if len(set(names)) < len(names):
        twin = next(name for name in names if names.count(name) > 1)
        raise RecordError(f"two results are given for the probing '{twin}'; give one")


def _session_file(path: Path) -> Path:
    """The session file that a folder or a file name means."""
    file = path / "session.toml" if path.is_dir() else path
    if not file.is_file() or (path.is_file() and path.suffix.lower() != ".toml"):
        raise RecordError(
            f"{path}: is no session; name its folder, or its session.toml, after the files and"
            " before the options"
        )
    return file
