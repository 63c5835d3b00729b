"""`palpate import`: displacements measured by other programs into a session."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from cyclopts import Parameter
from rich.console import Console
from rich.table import Table

from palpate.app.terminal import (
    number_text,
    print_file_notes,
    print_notes,
    print_text,
    terminal_table,
)
from palpate.errors import InputError
from palpate.pipeline import survey_field, without_contradicted
from palpate.records import (
    ImportedField,
    ImportItem,
    Session,
    displacement_line,
    import_kinds,
    import_plan,
    kinds_text,
    named_displacements,
    on_object,
    on_surface,
    placed_files,
    read_import_pose,
    read_measured,
    read_session,
    require_probings,
    result_folder,
    with_displacements,
    write_displacement,
)

if TYPE_CHECKING:
    _Kind = str
else:
    # The choices are those of the list of programs, which a type checker cannot know.
    _Kind = Literal[tuple(import_kinds())]


@dataclass(frozen=True, slots=True, eq=False)
class _Import:
    """One result and what became of it."""

    name: str
    file: Path
    imported: ImportedField


def import_displacements(
    kind: Annotated[_Kind, Parameter(help=f"The program: {kinds_text()}.")],
    files: Annotated[list[Path], Parameter(consume_multiple=True, negative="")],
    /,
    *,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True, negative="")] = None,
    to_object: Path | None = None,
    length_unit: Literal["um", "mm", "cm", "m", "in"] | None = None,
    frame: Annotated[list[int] | None, Parameter(consume_multiple=True, negative="")] = None,
    min_score: float | None = None,
    drop_off_surface: Annotated[bool, Parameter(negative="")] = False,
    replace: Annotated[bool, Parameter(negative="")] = False,
    out: Path | None = None,
) -> int:
    """Take over displacements that another image correlation program measured.

    Give one result file for each probing (loaded state against the reference), then the session:
    palpate import vic3d n01.csv n02.csv SESSION. Writes NAME.csv for the probing NAME into the
    session's folder and names it in session.toml, all of it or nothing.

    Parameters
    ----------
    files
        Result files, and last the session: its folder, or a session file in it.
    probe
        Names of the probings, in the order of the files, or of the frames of one file. Default:
        the files' names without suffix.
    to_object
        TOML file with the place of the program's frame: length_unit, R and t (or T, 4 x 4), where
        x_object = R x_file + t. Default: both frames are the same.
    length_unit
        Unit of the files, where they do not say. Default: mm; vtu has no default.
    frame
        State to read from files that hold several, from 0; one for all, or one for each probing.
        Default: the last one.
    min_score
        Least correlation of a match that counts as measured, -1 to 1, where the files tell it
        (dice, opencorr, multidic, duodic). Default: 0.75.
    drop_off_surface
        Leave out measured points that are not on the object: background, tool, holder.
    replace
        Replace displacements that the session already has.
    out
        Write the CSV files into this result folder instead, and leave the session as it is.
    """
    session, plan = _targets(files, probe, frame, replace=replace or out is not None)
    pose, notes = (np.eye(4), ()) if to_object is None else read_import_pose(to_object)
    print_notes((*session.notes, *notes))
    done = []
    for item in plan:
        measured = read_measured(
            kind, item.file, length_unit=length_unit, frame=item.frame, min_score=min_score
        )
        if import_kinds()[kind].correlates:
            measured = without_contradicted(measured)
        placed = on_object(measured, pose) if to_object is not None else measured
        imported = on_surface(placed, session.mesh, drop_off_surface=drop_off_surface)
        done.append(_Import(item.probe, item.file, imported))
    if out is None:
        _write_into_session(session, done, replace=replace)
    else:
        _write_aside(session, done, out)
    _report(session, done, out)
    return 0


def _targets(
    files: Sequence[Path],
    probes: Sequence[str] | None,
    frames: Sequence[int] | None,
    *,
    replace: bool,
) -> tuple[Session, tuple[ImportItem, ...]]:
    """The session and what goes where; refused before anything is read of the files."""
    if len(files) < 2:
        raise InputError(
            "give the result files and then the session, before the options:"
            " palpate import KIND FILE... SESSION"
        )
    if not files[-1].is_dir() and files[-1].suffix.lower() != ".toml":
        raise InputError(
            f"{files[-1]}: is no session; name its folder, or its session.toml, after the files and"
            " before the options"
        )
    session = read_session(files[-1], observations=False)
    require_probings(session)
    plan = import_plan(session, files[:-1], probes=probes, frames=frames)
    named = named_displacements(session.path)
    for name in (item.probe for item in plan):
        if Path(name).name != name or name.startswith("."):
            raise InputError(
                f"{session.path}: the probing '{name}' cannot give a file its name;"
                " rename it: letters, digits, - and _"
            )
        if name in named and not replace:
            raise InputError(
                f"{session.path}: the probing '{name}' already has displacement ="
                f' "{named[name]}"; use --replace, or write elsewhere with --out'
            )
    return session, plan


def _write_into_session(session: Session, done: Sequence[_Import], *, replace: bool) -> None:
    """The CSV files and the session that names them, together or not at all."""
    folder = session.path.parent
    targets = [folder / _csv_name(item) for item in done]
    for target, item in zip(targets, done, strict=True):
        if target.exists() and target.samefile(item.file):
            raise InputError(
                f"{target}: the result would replace its own source; move the source elsewhere, or"
                " write elsewhere with --out"
            )
        if target.exists() and not replace:
            raise InputError(
                f"{target}: is there already; use --replace, or write elsewhere with --out"
            )
    # Bytes, so that line ends stay as they are.
    text = session.path.read_bytes().decode("utf-8")
    mark = "\ufeff" if text.startswith("\ufeff") else ""
    names = {item.name: _csv_name(item) for item in done}
    edited = mark + with_displacements(text.removeprefix(mark), names)
    with placed_files([*targets, session.path]) as staged:
        for path, item in zip(staged, done, strict=False):
            write_displacement(path, item.imported.field, metres_per_unit=session.metres_per_unit)
        staged[-1].write_bytes(edited.encode("utf-8"))


def _write_aside(session: Session, done: Sequence[_Import], out: Path) -> None:
    """The CSV files in a result folder."""
    with result_folder(out) as folder:
        for item in done:
            write_displacement(
                folder / _csv_name(item),
                item.imported.field,
                metres_per_unit=session.metres_per_unit,
            )


def _csv_name(item: _Import) -> str:
    return f"{item.name}.csv"


def _report(session: Session, done: Sequence[_Import], out: Path | None) -> None:
    """What was read and where it went."""
    Console().print(_table(done))
    notes = [(item.file.name, note) for item in done for note in item.imported.notes]
    print_file_notes(notes, files=len(done))
    for item in done:
        name = _csv_name(item)
        if out is None:
            line = f"{session.path}, probing '{item.name}': {displacement_line(name)}"
        else:
            file = os.path.relpath(out / name, session.path.parent)
            line = f"Add to probing '{item.name}': {displacement_line(Path(file).as_posix())}"
        print_text(line, wrapped=False)


def _table(done: Sequence[_Import]) -> Table:
    """One line per file."""
    rows = []
    for item in done:
        read, field = item.imported, survey_field(item.imported.field)
        lengths = (read.median_distance, field.median_displacement, field.median_sigma)
        left_out = read.nowhere + read.off_surface
        counts = (
            read.read, field.observed, read.failed, read.poor, read.contradicted, left_out
        )  # fmt: skip
        digits = (".3f", ".3f", ".4f")
        rows.append(
            (item.name, item.file.name, *map(str, counts),
             *(number_text(1e3 * x, form) for x, form in zip(lengths, digits, strict=True)))
        )  # fmt: skip
    return terminal_table(
        "Imported displacements (lengths in mm)",
        (
            "probing",
            "file",
            "points",
            "seen",
            "nan",
            "poor",
            "odd",
            "left out",
            "off",
            "|u|",
            "sigma",
        ),
        rows,
        caption="seen: measured points; nan: failed ones, kept as rows of NaN, some of them for a"
        " poor correlation (--min-score) or a motion at odds with all around; left out: failed"
        " without a place, or off the surface; off: distance of the measured points from the"
        " surface; medians of off, |u| and sigma",
    )
