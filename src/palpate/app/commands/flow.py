"""`palpate flow`: the pictures of a session in, the motion of its surface out."""

import math
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.markup import escape

from palpate.app.exit_codes import NOT_OK
from palpate.app.terminal import flow_table, print_notes, print_tables, print_text, progress_bar
from palpate.errors import InputError
from palpate.figures import make_flow_view, write_flow_pictures
from palpate.pipeline import (
    FLOW_METHODS,
    MotionFigures,
    SessionFlow,
    measure_motion,
    rejection_note,
    rejections,
    with_measured_displacement,
    write_flow_document,
    write_motions,
)
from palpate.progress import Progress
from palpate.records import (
    Session,
    default_folder,
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
# Before this a rate says more about the start than about the work [s].
_MIN_RATE_SECONDS = 1.0


def flow(
    session: Path,
    /,
    *,
    out: Path | None = None,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    method: MethodName = "joint",
    pose: Literal["auto", "given", "register"] = "auto",
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
        Write although something else than an unchanged result of this command is there; that is
        kept beside it as NAME.old.

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
        start = time.perf_counter()
        with progress_bar() as progress:
            report = _with_rate(progress, _motion_count(given))
            found = measure_motion(
                given, method=chosen, pose=pose, progress=report, parts=parts_folder(folder)
            )
            seconds = time.perf_counter() - start
            settings = {"method": method, "pose": pose, method.replace("-", "_"): asdict(chosen)}
            heading = {"session": given.name, "settings": settings}
            figures = _write(
                folder, given, found, progress, heading=heading, measuring=seconds,
                pictures=not no_pictures,
            )  # fmt: skip
    print_notes(note for note in found.notes if note not in given.notes)
    print_tables(flow_table(figures, found.rig))
    _print_rejections(given, found)
    print_text(f"{_closing_text(figures, seconds)}\nResult in {target}")
    return NOT_OK if _print_failures(figures) else 0


def _write(
    folder: Path,
    session: Session,
    found: SessionFlow,
    progress: Progress,
    *,
    heading: dict[str, Any],
    measuring: float,
    pictures: bool,
) -> list[MotionFigures]:
    """All files of the result; figures of every motion, in order."""
    start, count = time.perf_counter(), len(found.motions)
    report = _with_rate(progress, count)
    camera = found.rig.cameras[found.rig.reference]
    figures, files = [], []
    for written in write_motions(folder, session, found):
        motion = written.motion
        if pictures and motion.flow is not None:
            view = make_flow_view(motion.first, camera, written.surface, session.mesh)
            written.files.update(write_flow_pictures(folder, written.stem, motion, view))
        figures.append(written.figures)
        files.append(written.files)
        report(f"wrote {motion.name}, {len(files)} of {count}", len(files) / count)
    heading |= {
        "csv_metres_per_unit": session.metres_per_unit,
        "seconds": {"measuring": measuring, "writing": time.perf_counter() - start},
        "notes": list(dict.fromkeys([*session.notes, *found.notes])),
    }
    write_flow_document(folder / "flow.json", figures, files, found.rig, heading)
    return figures


def _print_rejections(session: Session, found: SessionFlow) -> None:
    """Whether so many lost vertices are usual; nothing where a probing has none at all."""
    with suppress(InputError):
        counts = rejections(with_measured_displacement(session, found))
        if any(rejection.lost for rejection in counts):
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
    """Say what failed, on stderr; how many motions did."""
    failures = {f.name: f.failure for f in figures if f.failure is not None}
    for f in figures:
        if f.vertices["measured"] == 0:
            failures.setdefault(
                f.name,
                f"not one vertex could be followed ({f.valid} of {f.points} points valid);"
                " the table and the pictures say why",
            )
    for name, failure in failures.items():
        print(f"palpate: {name}: {failure}", file=sys.stderr)
    return len(failures)


def _motion_count(session: Session) -> int:
    """How many motions there are to measure."""
    images = [probing.images for probing in session.probings]
    loaded = sum(len(given.loaded) for given in images if given is not None)
    return max(len(session.steps) - 1, 0) + loaded


def _with_rate(progress: Progress, count: int) -> Progress:
    """The callback with the motions a second so far behind what is being done."""
    start = time.perf_counter()

    def report(stage: str, fraction: float) -> None:
        seconds = time.perf_counter() - start
        known = seconds > _MIN_RATE_SECONDS and fraction > 0.0
        rate = f" ({fraction * count / seconds:.2g} motions/s)" if known else ""
        progress(escape(stage) + rate, fraction)

    return report
