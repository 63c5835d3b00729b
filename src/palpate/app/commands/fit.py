"""`palpate fit`: a session in, a table and a result folder out."""

import shlex
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from palpate.app.environment import check_cache
from palpate.app.exit_codes import NOT_OK
from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import StageLog, progress_bar
from palpate.app.terminal.tables import constants_table, probes_table
from palpate.app.versions import versions
from palpate.bem import check_memory
from palpate.errors import print_message
from palpate.estimation import FitResult, FitSettings
from palpate.pipeline import (
    PoseChoice,
    fit_session,
    keep_motion,
    kept_motion,
    measure_pictures,
    unread_probings,
    with_motions,
)
from palpate.progress import Progress, part_of
from palpate.records import (
    REPORT_FILE,
    Estimate,
    Session,
    Status,
    default_folder,
    parts_folder,
    read_session,
    record_inputs,
    require_probings,
    result_folder,
    session_files,
    write_text,
)
from palpate.report import write_report, write_result_files

# Fractions of the work that are done when the fit and when the drawing begin.
_FIT_BEGINS, _DRAWING_BEGINS = 0.5, 0.9
_REUSED = (
    "the motion in the pictures of {} of {} probings is the one that {} holds: their pictures, the"
    " cameras and the mesh are the same"
)


def fit(
    session: Path,
    /,
    *,
    out: Path | None = None,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    method: Literal["reduced", "nelder-mead"] = "reduced",
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    surface: Literal["smooth", "flat"] = "smooth",
    strain: Literal["small", "finite"] = "small",
    pose: PoseChoice = "auto",
    cache: Path | None = None,
    force: bool = False,
) -> int:
    """Estimate shear modulus, Poisson's ratio and Young's modulus from a session.

    Prints the constants with their intervals and writes a folder with a report, estimate.json and
    plots. Motion measured in pictures is kept there and reused by the next fit.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    out
        Result folder; it appears whole or not at all. Default: the session's folder name followed
        by -result, in the current folder.
    probe
        Use these probings only.
    method
        How to search for the constants: Gauss-Newton on a reduced model, or Nelder-Mead on the full
        one.
    poisson_range
        Range of Poisson's ratio to allow; -0.99 0.4999 for auxetic foams.
    surface
        How to read the mesh: as points on a smooth object (with edges where triangles meet at more
        than 40 degrees), or as flat facets.
    strain
        Small: displacements are linear in the force. Finite: the nonlinear part for an object that
        was pressed far is computed with finite elements and corrected for.
    pose
        Where the object is in pictures: as the camera file says (given), as the pictures at rest
        show (register), or registered only where they contradict the file (auto).
    cache
        Folder in which to keep factors and reduced models of this object for the next fit: at most
        16 GB or a quarter of the free disk; the least recently used go first.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.

    Returns
    -------
    int
        0, or 3 where the data do not determine a constant.
    """
    log = StageLog()
    log.add("reading")
    loading = log.seconds
    check_cache(cache)
    settings = FitSettings(method=method, poisson_range=poisson_range)
    # The target is tried first: no one should wait for a result that cannot be kept.
    target = out or default_folder(session, "result")
    with result_folder(target, kind="fit", force=force) as folder:
        given = read_session(session, probes=probe, allow=check_memory)
        given = replace(given, smooth=surface == "smooth")
        record_inputs(folder, session_files(session))
        require_probings(given)
        print_notes(given.notes)
        with progress_bar() as bar:
            progress = log.logged(bar)
            count = len(unread_probings(given))
            # Shares of the work, about: pictures, where there are some, take as long as the rest.
            fit_begins = _FIT_BEGINS if count else 0.0
            measured, reused = _with_motion_measured(
                given, target, folder, pose, part_of(progress, 0.0, fit_begins)
            )
            print_notes(measured.notes[len(given.notes) :])
            before = {"loading": loading, "reading_and_motion": log.seconds - loading}
            result = fit_session(
                measured,
                settings=settings,
                cache=cache,
                finite_strain=strain == "finite",
                progress=part_of(progress, fit_begins, _DRAWING_BEGINS),
            )
            progress("tables and pictures", _DRAWING_BEGINS)
            result = _with_provenance(
                result, before, log, _command(session, probe, settings, surface, strain, pose)
            )
            estimate = _write(folder, measured, result, log)
    _print(estimate, measured)
    if reused:
        print_text(f"Note: {_REUSED.format(reused, count, target)}.")
    print_text(
        f"Result in {target}, report in {target / REPORT_FILE} ({estimate.seconds['total']:.1f} s)"
    )
    if estimate.status is not Status.OK:
        print_message(estimate.status.advice)
        return NOT_OK
    return 0


def _with_motion_measured(
    given: Session, target: Path, folder: Path, pose: PoseChoice, progress: Progress
) -> tuple[Session, int]:
    """The session with the motion of its pictures, which the result keeps, and the number of
    probings whose motion an earlier result held."""
    kept = kept_motion(given, target, pose=pose)
    motions = measure_pictures(
        given, known=kept, pose=pose, progress=progress, parts=parts_folder(folder)
    )
    if motions:
        keep_motion(folder, given, motions, pose=pose)
    return with_motions(given, motions), len(kept)


def _with_provenance(
    result: FitResult, before: dict[str, float], log: StageLog, command: str
) -> FitResult:
    """The result with the seconds of the whole work so far, and what repeats it."""
    estimate = result.estimate
    seconds = {**before, **estimate.seconds, "total": log.seconds}
    settings = {"command": command, "versions": versions(), **estimate.settings}
    return replace(result, estimate=replace(estimate, seconds=seconds, settings=settings))


def _command(
    session: Path,
    probe: list[str] | None,
    settings: FitSettings,
    surface: str,
    strain: str,
    pose: str,
) -> str:
    """The line that repeats a fit, without what has no part in its numbers."""
    words = ["palpate", "fit", str(session)]
    words += ["--probe", *probe] if probe else []
    words += ["--method", settings.method, "--surface", surface, "--strain", strain]
    words += ["--pose", pose]
    return shlex.join([*words, "--poisson-range", *(f"{end:g}" for end in settings.poisson_range)])


def _write(folder: Path, measured: Session, result: FitResult, log: StageLog) -> Estimate:
    """All files of the result, the report last, which is made of the others; the estimate as
    written."""
    estimate = write_result_files(folder, measured, result)
    log.add("report")
    write_text(folder / "log.txt", "\n".join([*log.lines, ""]))
    write_report(folder, folder / REPORT_FILE)
    return estimate


def _print(estimate: Estimate, session: Session) -> None:
    """The tables, and what a reader must know besides."""
    if len(estimate.probes) > 0:
        print_tables(probes_table(estimate))
    print_tables(constants_table(estimate))
    for note in estimate.notes:
        if note not in session.notes:
            print_text(f"Note: {note}")
