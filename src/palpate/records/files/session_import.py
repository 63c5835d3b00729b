"""Import of other programs' displacements: assigns files to probings and edits session.toml."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from palpate.errors import RecordError
from palpate.records.session import Session
from palpate.records.text.nearest import nearest_word
from palpate.records.text.text_file import read_text


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
