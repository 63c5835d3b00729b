"""`palpate flow`: the pictures of a session in, the motion of its surface out."""

import math
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from palpate.app.process import NOT_OK
from palpate.app.tables import flow_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.errors import InputError, print_message
from palpate.figures import make_flow_view, write_flow_pictures
from palpate.pipeline import (
    FLOW_METHODS,
    MeasuredMotion,
    MotionFigures,
    PoseChoice,
    Rejections,
    SessionFlow,
    measured_motions,
    motion_names,
    rejection_note,
    rejections,
    with_measured_displacement,
    write_flow_document,
    write_motion,
)
from palpate.records import (
    Rig,
    Session,
    default_folder,
    file_stems,
    parts_folder,
    read_session,
    record_inputs,
    result_folder,
    session_files,
)

if TYPE_CHECKING:
    MethodName = str
else:
    # The names that are registered; a type checker cannot read them.
    MethodName = Literal[tuple(FLOW_METHODS)]
_SHORTER = "a larger --step, a smaller --subset, fewer probings (--probe)"


def flow(
    session: Path,
    /,
    *,
    out: Path | None = None,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    method: MethodName = "joint",
    pose: PoseChoice = "auto",
    subset: int | None = None,
    step: int | None = None,
    no_pictures: bool = False,
    force: bool = False,
) -> int:
    """Measure how the surface moved, from the pictures of calibrated cameras.

    For every step, and every picture of a probing: the displacement of the mesh's vertices as CSV
    (what `palpate fit` takes), the range flow as NPZ and VTP, and two pictures; for all of them a
    table and flow.json.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    out
        Result folder; it appears whole or not at all. Default: the session's folder name followed
        by -flow, in the current folder.
    probe
        Use these probings only.
    method
        All cameras matched jointly, or the matching and voting of Lang and Pai (2001).
    pose
        Where the object is: as the camera file says (given), as the pictures at rest show
        (register), or registered only where they contradict the file (auto).
    subset
        Side of the matched window in pixels, odd: larger is less noise and less detail. Default:
        the method's, 21 for joint.
    step
        Spacing of the measured points in pixels of the reference camera. Default: the method's, 5
        for joint.
    no_pictures
        Draw no pictures.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.

    Returns
    -------
    int
        0, or 3 where a step failed or nothing could be measured in it.
    """
    target = out or default_folder(session, "flow")
    requested = {"subset": subset, "step": step}
    options = {name: value for name, value in requested.items() if value is not None}
    chosen = FLOW_METHODS[method](**options)
    # The target is tried first: no one should wait for a result that cannot be kept.
    with result_folder(target, kind="flow", force=force) as folder:
        given = read_session(session, probes=probe)
        record_inputs(folder, session_files(session))
        print_notes(given.notes)
        start, names = time.perf_counter(), motion_names(given)
        with progress_bar(_SHORTER, resumes=True) as progress:
            motions = measured_motions(
                given, method=chosen, pose=pose, progress=progress, parts=parts_folder(folder)
            )
            stems = file_stems(names, kind="motion")
            written = _write(folder, given, motions, stems, pictures=not no_pictures)
        seconds = time.perf_counter() - start - written.seconds
        rig, notes, figures = written.rig, written.notes, written.figures
        heading = {
            "session": given.name,
            "settings": {"method": method, "pose": pose, method.replace("-", "_"): asdict(chosen)},
            "csv_metres_per_unit": given.metres_per_unit,
            "seconds": {"measuring": seconds, "writing": written.seconds},
            "notes": list(dict.fromkeys([*given.notes, *notes])),
        }
        write_flow_document(folder / "flow.json", figures, written.files, rig, heading)
    print_notes(note for note in notes if note not in given.notes)
    print_tables(flow_table(figures, rig))
    _print_rejections(figures, written.counts)
    print_text(f"{_closing_text(figures, seconds)}\nResult in {target}")
    return NOT_OK if _print_failures(figures) else 0


@dataclass(frozen=True, slots=True)
class _Written:
    """What is kept of the motions of a session, all files but flow.json being written.

    Attributes
    ----------
    rig : Rig                       with the pose that was used
    notes : tuple of str            of the measurement
    figures : list of MotionFigures
    files : list of dict            kind of file -> its name, of each motion
    counts : list of Rejections     of the probings
    seconds : float [s]             that the writing took
    """

    rig: Rig
    notes: tuple[str, ...]
    figures: list[MotionFigures]
    files: list[dict[str, str]]
    counts: list[Rejections]
    seconds: float


def _write(
    folder: Path,
    session: Session,
    motions: Iterator[tuple[Rig, MeasuredMotion, tuple[str, ...]]],
    stems: Sequence[str],
    *,
    pictures: bool,
) -> _Written:
    """Write each motion and let it go before the next one is measured: a video may be long."""
    figures, files, counts = list[MotionFigures](), list[dict[str, str]](), list[Rejections]()
    surface, seconds = None, 0.0
    for measured, stem in zip(motions, stems, strict=True):
        start = time.perf_counter()
        rig, motion, notes = measured
        written = write_motion(folder, session, rig, motion, stem=stem, surface=surface)
        surface, names = written.surface, written.files
        if pictures and motion.flow is not None:
            camera = rig.cameras[rig.reference]
            view = make_flow_view(motion.first, camera, surface, session.mesh)
            names = names | write_flow_pictures(folder, stem, motion, view)
        figures.append(written.figures)
        files.append(names)
        counts += _rejections(session, rig, motion)
        seconds += time.perf_counter() - start
    return _Written(rig, notes, figures, files, counts, seconds)


def _rejections(session: Session, rig: Rig, motion: MeasuredMotion) -> tuple[Rejections, ...]:
    """Counts of a probing's lost vertices; empty for an earlier image, a step or a failure."""
    if motion.probing is None or not motion.last:
        return ()
    chosen = tuple(probing for probing in session.probings if probing.name == motion.probing)
    with suppress(InputError):
        measured = SessionFlow(rig, (motion,), ())
        return rejections(with_measured_displacement(replace(session, probings=chosen), measured))
    return ()


def _print_rejections(figures: Sequence[MotionFigures], counts: Sequence[Rejections]) -> None:
    """Print whether that many lost vertices are usual; nothing where a probing lost none."""
    probings = {f.probing for f in figures if f.probing is not None}
    if len(counts) == len(probings) and any(rejected.lost for rejected in counts):
        print_text(rejection_note(counts))


def _closing_text(figures: Sequence[MotionFigures], seconds: float) -> str:
    """Which motions went through the instant before; how much was measured, and how fast."""
    lines = [
        f"{f.name}: points followed through the instant before: {f.through_last}"
        + (f", drift {1e6 * f.drift:.2g} µm" if math.isfinite(f.drift) else "")
        for f in figures
        if f.through_last
    ]
    points = sum(f.points for f in figures)
    rate = f"{points / max(seconds, 1e-9):,.0f} points/s"
    return "\n".join(
        [*lines, f"{len(figures)} motions, {points} points in {seconds:.1f} s ({rate})"]
    )


def _print_failures(figures: Sequence[MotionFigures]) -> int:
    """Report on stderr what failed; the number of motions that did."""
    failures = {f.name: f.failure for f in figures if f.failure is not None}
    for f in figures:
        if f.vertices["measured"] == 0:
            failures.setdefault(
                f.name,
                f"not one vertex could be followed ({f.valid} of {f.points} points valid);"
                " the table and the pictures say why",
            )
    for name, failure in failures.items():
        print_message(f"{name}: {failure}")
    return len(failures)
