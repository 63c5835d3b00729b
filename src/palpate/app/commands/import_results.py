"""`palpate import`: displacements measured by other programs into a session."""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from cyclopts import Parameter
from rich.table import Table

from palpate.app.tables import number_text, terminal_table
from palpate.app.terminal import print_file_notes, print_notes, print_tables, print_text
from palpate.disk import atomic_replacement, new_files, write_bytes
from palpate.errors import InputError
from palpate.pipeline import survey_field, triangulated, without_contradicted
from palpate.records import (
    ImportedField,
    ImportItem,
    Session,
    displacement_line,
    displacement_text,
    import_kinds,
    import_plan,
    in_object_frame,
    kinds_text,
    named_displacements,
    on_surface,
    read_import_pose,
    read_measured,
    read_rig,
    read_session,
    record_inputs,
    require_probings,
    result_folder,
    session_files,
    with_displacements,
)

if TYPE_CHECKING:
    _Kind = str
else:
    # The choices are those of the list of programs, which a type checker cannot know.
    _Kind = Literal[tuple(import_kinds())]

# Writes the CSV of a probing and gives its file's name.
_Write = Callable[[str, bytes], str]


@dataclass(frozen=True, slots=True, eq=False)
class _Import:
    """One result and what became of it."""

    name: str
    file: Path
    imported: ImportedField
    written: str


def import_displacements(
    kind: Annotated[_Kind, Parameter(help=f"The program: {kinds_text()}.")],
    files: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    rig: Path | None = None,
    to_object: Path | None = None,
    length_unit: Literal["um", "mm", "cm", "m", "in"] | None = None,
    frame: Annotated[list[int] | None, Parameter(consume_multiple=True)] = None,
    min_score: float | None = None,
    drop_off_surface: bool = False,
    replace: bool = False,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Import displacements that another image correlation program measured.

    Give one result file for each probing (loaded state against the reference), then the session:
    palpate import vic3d n01.csv n02.csv SESSION. Writes NAME.csv for the probing NAME into the
    session's folder, or NAME_2.csv where that name is taken, and names it in session.toml, all of
    it or nothing.

    Parameters
    ----------
    files
        Result files, and last the session: its folder, or a session file in it.
    probe
        Names of the probings, in the order of the files, or of the frames of one file. Default:
        the files' names without suffix.
    rig
        Calibration of the cameras, where the files hold matches in their pictures (multidic and
        duodic, step 2); the points are then in its frame.
    to_object
        TOML file with the place of the program's frame: length_unit, R and t (or T, 4 x 4), where
        x_object = R x_file + t. Default: both frames are the same.
    length_unit
        Unit of the files, where they do not say. Default: mm; vtu has no default.
    frame
        State to read from files that hold several, from 0; one for all, or one for each probing.
        Default: the last one.
    min_score
        Lowest correlation, -1 to 1, at which a match counts as measured, if the files give it
        (dice, opencorr, multidic, duodic). Default: 0.75.
    drop_off_surface
        Leave out measured points that are not on the object: background, tool, holder.
    replace
        Replace displacements that the session already names; their files stay where they are.
    out
        Write the CSV files into this result folder instead, and leave the session as it is.
    force
        Overwrite whatever is at --out; the old content is kept as NAME.old.
    """
    session, plan = _import_targets(files, probe, frame, replace=replace or out is not None)
    pose, notes = (np.eye(4), ()) if to_object is None else read_import_pose(to_object)
    print_notes((*session.notes, *notes))
    triangulate = None
    if rig is not None:
        # Of the files, --length-unit says the unit of what has lengths: the calibration.
        triangulate = partial(triangulated, rig=read_rig(rig, length_unit=length_unit))
    # The targets are tried first: no one should wait for a result that cannot be kept.
    done: list[_Import] = []
    inputs = [*(item.file for item in plan), *session_files(session.path)]
    inputs += [to_object] if to_object is not None else []
    with _session_files(session) if out is None else _folder(out, inputs, force) as write:
        for item in plan:
            measured = read_measured(
                kind,
                item.file,
                length_unit=None if triangulate else length_unit,
                frame=item.frame,
                min_score=min_score,
                triangulate=triangulate,
            )
            if import_kinds()[kind].correlates:
                measured = without_contradicted(measured)
            moved = in_object_frame(measured, pose) if to_object is not None else measured
            imported = on_surface(moved, session.mesh, drop_off_surface=drop_off_surface)
            text = displacement_text(imported.field, metres_per_unit=session.metres_per_unit)
            written = write(item.probe, text.encode())
            done.append(_Import(item.probe, item.file, imported, written))
    _print_report(session, done, out)
    return 0


def _import_targets(
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
        if name in named and not replace:
            raise InputError(
                f"{session.path}: the probing '{name}' already has displacement ="
                f' "{named[name]}"; use --replace, or write elsewhere with --out'
            )
    return session, plan


@contextmanager
def _session_files(session: Session) -> Iterator[_Write]:
    """Writes CSV files beside the session, which names them at the end, all or none."""
    names: dict[str, str] = {}
    with new_files(session.path) as write, atomic_replacement(session.path) as staged:

        def write_csv(probe: str, content: bytes) -> str:
            names[probe] = write(session.path.with_name(_csv_name(probe)), content).name
            return names[probe]

        yield write_csv
        # As it is by now, and as bytes, so that line ends stay as they are.
        text = session.path.read_bytes().decode("utf-8")
        mark = "\ufeff" if text.startswith("\ufeff") else ""
        edited = mark + with_displacements(text.removeprefix(mark), names)
        staged.write_bytes(edited.encode("utf-8"))


@contextmanager
def _folder(out: Path, inputs: Sequence[Path], force: bool) -> Iterator[_Write]:
    """Writes CSV files into a result folder."""
    with result_folder(out, kind="import", force=force) as folder:
        record_inputs(folder, inputs)

        def write_csv(probe: str, content: bytes) -> str:
            write_bytes(folder / _csv_name(probe), content)
            return _csv_name(probe)

        yield write_csv


def _csv_name(probe: str) -> str:
    return f"{probe}.csv"


def _print_report(session: Session, done: Sequence[_Import], out: Path | None) -> None:
    """What was read and where it went."""
    print_tables(_table(done))
    notes = [(item.file.name, note) for item in done for note in item.imported.notes]
    print_file_notes(notes, files=len(done))
    for item in done:
        if out is None:
            line = f"{session.path}, probing '{item.name}': {displacement_line(item.written)}"
        else:
            file = os.path.relpath(out / item.written, session.path.parent)
            line = f"Add to probing '{item.name}': {displacement_line(Path(file).as_posix())}"
        print_text(line, wrapped=False)


def _table(done: Sequence[_Import]) -> Table:
    """One line per file."""
    rows = []
    for item in done:
        read, field = item.imported, survey_field(item.imported.field)
        lengths = (read.median_distance, field.median_displacement, field.median_sigma)
        left_out = read.without_position + read.off_surface
        counts = (
            read.read, field.observed, read.failed, read.poorly_correlated, read.contradicted,
            left_out,
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
