"""`palpate fit`, and what goes before and after it: `check` looks at a session, `compile` has the
kernels ready, `report` writes a result's report again."""

import shlex
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from cyclopts import Parameter
from numba.core import event
from rich.table import Table

from palpate.app.process import NOT_OK, check_cache, check_kernel_cache, versions
from palpate.app.tables import (
    constants_table,
    held_out_table,
    number_text,
    probes_table,
    regions_table,
    relaxation_table,
    terminal_table,
    truth_text,
)
from palpate.app.terminal import StageLog, print_notes, print_tables, print_text, progress_bar
from palpate.bem import check_memory
from palpate.errors import InputError, counted, print_message
from palpate.estimation import FitResult, FitSettings, Prediction
from palpate.field import check_regions
from palpate.geometry import mesh_quality, triangle_areas
from palpate.paper import true_material
from palpate.pipeline import (
    NEAR_RADII,
    CameraSurvey,
    Material,
    PoseChoice,
    ProbingSurvey,
    ViewSurvey,
    expected_precision,
    fit_session,
    keep_motion,
    kept_motion,
    measure_pictures,
    moving_supports,
    reciprocity,
    require_given_motions,
    require_series,
    session_outlook,
    size_notes,
    sliding_motion,
    survey_cameras,
    survey_probing,
    survey_view,
    unread_probings,
    warm_up,
    with_motions,
    write_held_out,
)
from palpate.progress import Progress, part_of
from palpate.records import (
    REPORT_FILE,
    Estimate,
    Probing,
    Session,
    Status,
    check_fit_result,
    check_free,
    default_folder,
    disk_errors,
    parts_folder,
    read_session,
    record_inputs,
    require_probings,
    result_folder,
    session_files,
    write_text,
)
from palpate.report import write_for_paper, write_report, write_result_files

# Fractions of the work that are done when the fit and when the drawing begin.
_FIT_BEGINS, _DRAWING_BEGINS = 0.5, 0.8
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
    material: Literal["auto", "homogeneous", "regions", "field"] = "auto",
    time: bool = False,
    hold_out: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
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
        was pressed far is computed with finite elements and corrected for; pushes of several depths
        then tell whether the material stiffens, and by how much.
    material
        Homogeneous: one modulus everywhere. Regions: one for every [[region]] of the session.
        Field: a modulus that differs from place to place, where the data are decisively likelier
        with one. Auto: regions if there are any, else a field only where the data contradict one
        modulus.
    time
        Estimate the modulus as a function of time as well, or say what is missing. On by itself
        where a probing has a series.
    hold_out
        Do not fit these probings, but predict their displacement from their force.
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
    bar_of = progress_bar(_shorter(strain, method))
    with result_folder(target, kind="fit", force=force) as folder, bar_of as bar:
        bar("reading", 0.0)
        given = replace(_read(session, probe, hold_out or []), smooth=surface == "smooth")
        if time:
            require_series(given)
        record_inputs(folder, session_files(session))
        require_probings(given)
        print_notes(given.notes)
        progress = log.logged(bar)
        count = len(unread_probings(given))
        # Shares of the work, about: pictures, where there are some, take as long as the rest.
        fit_begins = _FIT_BEGINS if count else 0.0
        measured, reused = _with_motion_measured(
            given, target, folder, pose, part_of(progress, 0.0, fit_begins)
        )
        print_notes(measured.notes[len(given.notes) :])
        before = {"loading": loading, "reading_and_motion": log.seconds - loading}
        measured, held = _split(measured, hold_out or [])
        result = fit_session(
            measured,
            settings=settings,
            cache=cache,
            finite_strain=strain == "finite",
            material=Material(material),
            progress=part_of(progress, fit_begins, _DRAWING_BEGINS),
        )
        progress("tables and pictures", _DRAWING_BEGINS)
        command = _command(session, probe, hold_out, settings, (surface, strain, pose, material))
        result = _with_provenance(result, before, log, command)
        predictions = () if held is None else result.predict(held)
        write_held_out(folder, predictions)
        estimate = _write(folder, measured, result, log)
    _print(estimate, measured, predictions, result.error_sizes)
    if reused:
        print_text(f"Note: {_REUSED.format(reused, count, target)}.")
    print_text(
        f"Result in {target}, report in {target / REPORT_FILE} ({estimate.seconds['total']:.1f} s)"
    )
    if estimate.status not in (Status.OK, Status.HETEROGENEOUS):
        print_message(estimate.status.advice)
        return NOT_OK
    return 0


def _shorter(strain: str, method: str) -> str:
    """What makes a fit shorter."""
    slow = {"--strain small": strain == "finite", "--method reduced": method == "nelder-mead"}
    words = [word for word, is_slow in slow.items() if is_slow]
    return ", ".join([*words, "fewer probings (--probe)", "or a coarser mesh"])


def _read(session: Path, probe: list[str] | None, names: list[str]) -> Session:
    """The session with the probings that are fitted or held out; refuses to hold out those that are
    not there, or all of them."""
    given = read_session(
        session, probes=None if probe is None else [*probe, *names], allow=check_memory
    )
    known = [probing.name for probing in given.probings]
    if unknown := [name for name in names if name not in known]:
        raise InputError(
            f"--hold-out names {unknown[0]!r}, but the session's probings are {', '.join(known)}"
        )
    if names and set(names) == set(known):
        raise InputError("--hold-out names every probing; leave some to be fitted")
    return given


def _split(session: Session, names: Sequence[str]) -> tuple[Session, Session | None]:
    """The session with the probings that are fitted, and with those that are held out."""
    if not names:
        return session, None
    parts: tuple[list[Probing], list[Probing]] = ([], [])
    for probing in session.probings:
        parts[probing.name in names].append(probing)
    fitted, held = (replace(session, probings=tuple(part)) for part in parts)
    return fitted, held


def check(session: Path, /) -> int:
    """Check a session without fitting it: files, units, forces, contacts, pictures.

    Reads everything that `fit` and `flow` would: surface, displacements, cameras, every picture.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    """
    given = read_session(session, allow=check_memory)
    require_given_motions(given)
    check_regions(given)
    cameras, remarks = survey_cameras(given)
    view, doubts = survey_view(given)
    surveys = [survey_probing(given, probing) for probing in given.probings]
    print_text(f"{given.name} ({given.path})")
    print_tables(_mesh_table(given))
    if surveys:
        print_tables(_probings_table(surveys))
    if cameras:
        print_tables(_cameras_table(cameras))
    if view is not None:
        print_tables(_view_table(view, cameras))
    for note in (*given.notes, *size_notes(given), *remarks, *doubts):
        print_text(f"Note: {note}")
    if sum(probing.displacement is not None for probing in given.probings) > 1:
        print_text(reciprocity(given).text)
    print_text(session_outlook(given, surveys, _precision(given)))
    return 0


def _precision(session: Session) -> dict[str, float] | None:
    """What the constants can be known to at best; None where displacements are still to be measured
    and where it would take minutes."""
    unread = any(probing.displacement is None for probing in session.probings)
    if unread or not session.probings or size_notes(session):
        return None
    with progress_bar() as progress:
        progress("what the data can tell", 0.0)
        return expected_precision(session)


def report(
    result: Path,
    /,
    *,
    for_: Annotated[Literal["screen", "paper"], Parameter(name="--for")] = "screen",
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Write a result's report again, as one self-contained HTML file, or what a paper needs of it.

    `palpate fit` writes it along with its result, as report.html; this is for a copy elsewhere, or
    for a result whose report was removed.

    Parameters
    ----------
    result
        Result folder of `palpate fit`.
    for_
        Screen: the HTML file. Paper: a folder with a paragraph on methods, and the constants and
        the probings as LaTeX and CSV tables.
    out
        The file or folder. Default: the result folder's name followed by -report.html, or by
        -paper, in the current folder.
    force
        Replace a file of that name; a folder that is not unchanged is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    check_fit_result(result)
    if for_ == "paper":
        target = out or default_folder(result, "paper")
        with result_folder(target, kind="report --for paper", force=force) as folder:
            write_for_paper(folder, result)
        print_text(f"Methods, constants and probings in {target}")
        return 0
    target = out or Path(f"{result.resolve().name}-{REPORT_FILE}")
    check_free(target, force=force)
    with disk_errors(target):
        write_report(result, target)
    print_text(f"Report in {target} ({target.stat().st_size / 1e6:.1f} MB)", wrapped=False)
    return 0


def compile_kernels() -> int:
    """Compile the numerical kernels once, so that the first fit need not wait.

    Otherwise the first measurement compiles them. Does nothing if they are up to date.

    Returns
    -------
    int
    """
    check_kernel_cache()
    start = time.perf_counter()
    with progress_bar() as progress, event.install_recorder("numba:compile") as recorder:
        warm_up(progress)
        progress("the list of fonts", 0.99)
        # The figures of a result need it; it takes seconds, once, too.
        import_module("matplotlib.font_manager")
    compiled = sum(message.is_start for _, message in recorder.buffer)
    seconds = time.perf_counter() - start
    if compiled:
        print_text(f"{compiled} kernels compiled in {seconds:.0f} s: the first fit need not wait")
    else:
        print_text("all kernels of the flow and the fit were up to date")
    return 0


def _with_motion_measured(
    given: Session, target: Path, folder: Path, pose: PoseChoice, progress: Progress
) -> tuple[Session, int]:
    """The session with the motion of its pictures, which the result keeps, and the number of
    probings whose motion an earlier result held."""
    known = kept_motion(given, target, pose=pose)
    motions = measure_pictures(
        given, known=known, pose=pose, progress=progress, parts=parts_folder(folder)
    )
    if motions:
        keep_motion(folder, given, motions, pose=pose)
    return with_motions(given, motions), len(known)


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
    hold_out: list[str] | None,
    settings: FitSettings,
    choices: tuple[str, str, str, str],
) -> str:
    """The line that repeats a fit, without what has no part in its numbers."""
    words = ["palpate", "fit", str(session)]
    words += ["--probe", *probe] if probe else []
    words += ["--hold-out", *hold_out] if hold_out else []
    words += ["--method", settings.method]
    for name, choice in zip(("surface", "strain", "pose", "material"), choices, strict=True):
        words += [f"--{name}", choice]
    return shlex.join([*words, "--poisson-range", *(f"{end:g}" for end in settings.poisson_range)])


def _write(folder: Path, measured: Session, result: FitResult, log: StageLog) -> Estimate:
    """All files of the result, the report last, which is made of the others; the estimate as
    written."""
    estimate = write_result_files(folder, measured, result)
    log.add("report")
    write_text(folder / "log.txt", "\n".join([*log.lines, ""]))
    write_report(folder, folder / REPORT_FILE)
    return estimate


def _print(
    estimate: Estimate,
    session: Session,
    predictions: Sequence[Prediction],
    sizes: Mapping[str, float],
) -> None:
    """Print the tables, and the notes that a reader must know."""
    if len(estimate.probes) > 0:
        print_tables(probes_table(estimate))
    print_tables(constants_table(estimate))
    if (session.path.parent / "truth.toml").is_file():
        print_text(truth_text(estimate, true_material(session)))
    if estimate.regions:
        print_tables(regions_table(estimate))
    if estimate.relaxation is not None:
        print_tables(relaxation_table(estimate.relaxation))
    for note in estimate.notes:
        if note not in session.notes:
            print_text(f"Note: {note}")
    if predictions:
        print_tables(held_out_table(predictions, sizes))


def _mesh_table(session: Session) -> Table:
    quality = mesh_quality(session.mesh)
    moves = moving_supports(session)
    held = float(triangle_areas(session.mesh)[session.held_triangles].sum())
    support = f"{len(session.held_triangles)} triangles, {1e4 * held:.4g} cm^2,"
    support += f" {100.0 * held / quality.area:.1f} % of all"
    moving_rows = [
        (support.number, f"{support.motion}, {len(support.triangles)} triangles")
        for support in moves
    ]
    edges = (quality.edge_shortest, quality.edge_mean, quality.edge_longest)
    density = session.density
    rows = (
        ("vertices, triangles", f"{quality.vertices}, {quality.triangles}"),
        ("size", " x ".join(f"{1e3 * side:.4g}" for side in quality.size) + " mm"),
        ("volume", f"{1e6 * quality.volume:.4g} cm^3"),
        ("area", f"{1e4 * quality.area:.4g} cm^2"),
        ("edges shortest, mean, longest", ", ".join(f"{1e3 * e:.3g}" for e in edges) + " mm"),
        ("worst aspect (longest edge / height)", f"{quality.worst_aspect:.2f}"),
        ("smallest angle", f"{np.degrees(quality.smallest_angle):.1f} degrees"),
        ("support", support if session.probings else "-"),
        *((f"support {n} moves", motion) for n, motion in moving_rows),
        *((f"support {n} holds", what) for n, what in _rollers(session)),
        *((f"support {n} gives", what) for n, what in _springs(session)),
        ("density", "-" if density is None else f"{density:g} kg/m^3"),
        ("gravity", _gravity(session)),
    )
    title = "Surface: closed, manifold, outward, without self-intersection"
    return terminal_table(title, ("figure", "value"), rows)


def _rollers(session: Session) -> list[tuple[int, str]]:
    """Supports that hold some directions only, by their numbers; at the first, what slides."""
    rows = []
    slides = sliding_motion(session)
    for number, support in enumerate(session.supports, start=1):
        if support.directions is not None:
            held = [", ".join(f"{x:.3g}" for x in row) for row in support.directions + 0.0]
            text = "only " + " and ".join(f"({row})" for row in held)
            if slides is not None and slides.number == number:
                text += "; the object slides, and how far is estimated"
            rows.append((number, text))
    return rows


def _springs(session: Session) -> list[tuple[int, str]]:
    """Supports that give, by their numbers, and how far they would under the largest force."""
    rows = []
    areas = triangle_areas(session.mesh)
    force = max((float(np.linalg.norm(probing.force)) for probing in session.probings), default=0.0)
    for number, support in enumerate(session.supports, start=1):
        if support.stiffness is not None:
            settlement = force * support.compliance / float(areas[support.triangles].sum())
            text = f"{support.stiffness:.3g} N/m^3: {1e3 * settlement:.3g} mm under {force:.3g} N"
            rows.append((number, text))
    return rows


def _gravity(session: Session) -> str:
    if session.gravity is None:
        return "not in the model"
    text = ", ".join(f"{component:g}" for component in session.gravity) + " m/s^2"
    when = ", at rest too (counts with --strain finite)" if session.gravity_at_rest else ""
    return text + when


def _probings_table(surveys: list[ProbingSurvey]) -> Table:
    """Contacts, and what was measured, where displacements are there already."""
    columns = ["probing", "patch", "elem", "observed", "missing", "|u| mm", "snr", "along", "near"]
    rows = [
        [
            s.name, str(s.patch_triangles), number_text(s.elements_per_radius, ".1f"),
            str(s.observed), str(s.missing), number_text(1e3 * s.median_displacement, ".3g"),
            number_text(s.signal_to_noise, ".1f"), number_text(s.tangential_signal, ".1f"),
            str(s.near),
        ]
        for s in surveys
    ]  # fmt: skip
    caption = "patch: triangles under the tool; elem: elements per contact radius"
    measured = (
        "; snr: median |u| over sigma; along: the same along the surface; near: measured points"
        f" within {NEAR_RADII:g} contact radii"
    )
    if not any(s.observed + s.missing for s in surveys):
        columns, rows, measured = columns[:3], [row[:3] for row in rows], ""
    title = counted(len(surveys), "probing")
    return terminal_table(title, columns, rows, caption=caption + measured)


def _cameras_table(surveys: tuple[CameraSurvey, ...]) -> Table:
    rows = []
    for s in surveys:
        sizes = dict.fromkeys(f"{p.size[0]} x {p.size[1]}" for p in s.pictures)
        low = min((p.grey[0] for p in s.pictures), default=np.nan)
        high = max((p.grey[1] for p in s.pictures), default=np.nan)
        white = max((p.saturated for p in s.pictures), default=np.nan)
        rows.append(
            (
                s.name, str(len(s.pictures)), ", ".join(sizes) or "-",
                f"{number_text(low, '.0f')} to {number_text(high, '.0f')}",
                number_text(100.0 * white, ".2g"), number_text(100.0 * s.sees, ".0f"),
            )
        )  # fmt: skip
    return terminal_table(
        counted(len(surveys), "camera"),
        ("camera", "pictures", "size px", "grey", "white %", "sees %"),
        rows,
        caption="grey: 1st to 99th percentile over all pictures, 255 is white; white: pixels at the"
        " white end of the worst picture; sees: vertices of the mesh inside the picture",
    )


def _view_table(view: ViewSurvey, cameras: tuple[CameraSurvey, ...]) -> Table:
    """What the first pictures promise."""
    lengths = zip(cameras, view.structure, strict=True)
    rows = (
        ("windows on the surface", str(view.points)),
        ("of them, with texture and two cameras", str(view.followed)),
        ("vertices that would be measured", str(view.vertices)),
        ("windows around each, median", f"{view.windows:.0f}"),
        *(
            (f"structure in {camera.name}", f"{number_text(px, '.1f')} px")
            for camera, px in lengths
        ),
    )
    return terminal_table(
        "The first pictures", ("figure", "value"), rows,
        caption="before anything moves: a tool will hide some; structure: the length over which a"
        " grey level changes by its own spread, 1 to 3 px for a sharp speckle",
    )  # fmt: skip
