"""`palpate flow`: the pictures of a session in, the motion of its surface out."""

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from rich.console import Console
from rich.markup import escape

from palpate.app.terminal import flow_table, print_notes, progress_bar
from palpate.figures import make_flow_view, write_flow_pictures
from palpate.pipeline import (
    FLOW_METHODS,
    MeasuredMotion,
    MotionFigures,
    SessionFlow,
    file_stems,
    measure_motion,
    motion_figures,
    seen_vertices,
    write_flow_document,
    write_flow_npz,
    write_flow_vtp,
    write_vertices,
)
from palpate.progress import Progress
from palpate.records import (
    Rig,
    Session,
    default_folder,
    disk_errors,
    read_session,
    result_folder,
)
from palpate.shapes import Flags
from palpate.vision import surface_map

if TYPE_CHECKING:
    MethodName = str
else:
    # The names that are registered; a type checker cannot read them.
    MethodName = Literal[tuple(FLOW_METHODS)]
_NOT_OK = 3
# Before this a rate says more about the start than about the work [s].
_RATE_STARTS = 1.0


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
    pictures: bool = True,
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
    pictures
        With --no-pictures none are drawn.

    Returns
    -------
    int
        0, or 3 where a step failed or nothing could be measured in it.
    """
    target = out or default_folder(session, "flow")
    asked = {"subset": subset, "step": step}
    options = {name: value for name, value in asked.items() if value is not None}
    chosen = FLOW_METHODS[method](**options)
    # The target is tried first: no one should wait for a result that cannot be kept.
    with result_folder(target) as folder:
        given = read_session(session, probes=probe)
        print_notes(given.notes)
        start = time.perf_counter()
        with progress_bar() as progress:
            report = _with_rate(progress, _instants(given))
            found = measure_motion(given, method=chosen, pose=pose, progress=report)
            seconds = time.perf_counter() - start
            settings = {"method": method, "pose": pose, method.replace("-", "_"): asdict(chosen)}
            heading = {"session": given.name, "settings": settings}
            with disk_errors(folder):
                figures = _write(
                    folder, given, found, progress, heading=heading, measuring=seconds,
                    pictures=pictures,
                )  # fmt: skip
    print_notes(note for note in found.notes if note not in given.notes)
    console = Console()
    console.print(flow_table(figures, found.rig))
    console.print(_closing(figures, seconds), markup=False, highlight=False)
    console.print(f"Result in {target}", markup=False, highlight=False)
    return _NOT_OK if _complaints(figures) else 0


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
    stems = file_stems([motion.name for motion in found.motions])
    camera, mesh = found.rig.cameras[found.rig.reference], session.mesh
    surfaces = {
        (rows, columns): surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
        for rows, columns in {motion.first.shape for motion in found.motions}
    }
    figures, files = [], []
    for k, (motion, stem) in enumerate(zip(found.motions, stems, strict=True)):
        report(f"writing {motion.name}, {k + 1} of {count}", k / count)
        surface = surfaces[motion.first.shape]
        seen = seen_vertices(surface, mesh)
        figures.append(motion_figures(motion, found.rig, seen))
        files.append(_write_motion(folder / stem, session, found.rig, motion, seen))
        if pictures and motion.flow is not None:
            view = make_flow_view(motion.first, camera, surface, mesh)
            files[-1]["picture"], files[-1]["quality"] = write_flow_pictures(
                folder, stem, motion.name, motion.flow, motion.vertices, view
            )
    heading |= {
        "csv_metres_per_unit": session.metres_per_unit,
        "seconds": {"measuring": measuring, "writing": time.perf_counter() - start},
        "notes": list(dict.fromkeys([*session.notes, *found.notes])),
    }
    write_flow_document(folder / "flow.json", figures, files, found.rig, heading)
    return figures


def _write_motion(
    stem: Path, session: Session, rig: Rig, motion: MeasuredMotion, seen: Flags
) -> dict[str, str]:
    """The files of one motion without its pictures: their names by what they are."""
    if motion.flow is None:
        return {}
    files = {"range_flow": f"{stem.name}_flow.npz", "points": f"{stem.name}_flow.vtp"}
    names = [camera.name for camera in rig.cameras]
    flow_file, points_file = (stem.with_name(name) for name in files.values())
    write_flow_npz(flow_file, motion.flow, name=motion.name, cameras=names)
    write_flow_vtp(points_file, motion.flow, rig.cameras[rig.reference])
    if motion.vertices is not None:
        files["vertices"] = f"{stem.name}.csv"
        write_vertices(
            stem.with_name(files["vertices"]), session.mesh, motion.vertices, seen=seen,
            metres_per_unit=session.metres_per_unit,
        )  # fmt: skip
    return files


def _closing(figures: Sequence[MotionFigures], seconds: float) -> str:
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


def _complaints(figures: Sequence[MotionFigures]) -> int:
    """Say what failed, on stderr; how many motions did."""
    failures = {f.name: f.failure for f in figures if f.failure is not None}
    for f in figures:
        if f.measured == 0:
            failures.setdefault(
                f.name,
                f"not one vertex could be followed ({f.valid} of {f.points} points valid);"
                " the table and the pictures say why",
            )
    for name, failure in failures.items():
        print(f"palpate: {name}: {failure}", file=sys.stderr)
    return len(failures)


def _instants(session: Session) -> int:
    """How many motions there are to measure."""
    images = [probing.images for probing in session.probings]
    loaded = sum(len(given.loaded) for given in images if given is not None)
    return max(len(session.steps) - 1, 0) + loaded


def _with_rate(progress: Progress, count: int) -> Progress:
    """The callback with the motions a second so far behind what is being done."""
    start = time.perf_counter()

    def report(stage: str, fraction: float) -> None:
        seconds = time.perf_counter() - start
        known = seconds > _RATE_STARTS and fraction > 0.0
        rate = f" ({fraction * count / seconds:.2g} motions/s)" if known else ""
        progress(escape(stage) + rate, fraction)

    return report
