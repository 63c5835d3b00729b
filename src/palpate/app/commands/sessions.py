"""`palpate init` and `palpate record`: a session of a folder of files, or of recordings."""

import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Literal, cast

import numpy as np
from rich.prompt import Prompt
from rich.table import Table

from palpate.app.tables import number_text, terminal_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.errors import InputError, RecordError, quoted, visible
from palpate.figures import recording_figure, save_drawing
from palpate.progress import part_of
from palpate.recording import (
    TEMPLATES,
    FolderSurvey,
    Outline,
    PlacedPress,
    Recorded,
    Recording,
    Template,
    chosen_side,
    default_radius,
    find_presses,
    flat_sides,
    hysteresis,
    likely_template,
    likely_unit,
    next_command,
    opposite_side,
    outline_text,
    read_recording,
    read_surface,
    survey_folder,
    write_recorded,
)
from palpate.records import (
    FILE_LENGTH_UNITS,
    default_folder,
    length_unit,
    read_rig,
    record_inputs,
    result_folder,
    write_text,
)

_Side = Literal["x-", "x+", "y-", "y+", "z-", "z+"]
_Unit = Literal["m", "cm", "mm", "in"]


def init(
    folder: Path,
    /,
    *,
    template: Template | None = None,
    name: str | None = None,
    mesh: str | None = None,
    rig: Path | None = None,
    unit: _Unit | None = None,
    held: _Side | None = None,
    radius: float | None = None,
    tool_radius: float | None = None,
) -> int:
    """Write a commented session.toml, recording.toml or bench.toml from the files in a folder.

    On a terminal, it asks for whatever was not given; elsewhere, it takes the likeliest choice.
    Existing files are never replaced.

    Parameters
    ----------
    folder
        Folder with the mesh and whatever else there is: rig, pictures, videos, tables.
    template
        lab: sorted pictures of calibrated cameras. dic: displacements of another program. tension:
        the same, of a specimen between two grips. robot: videos, force log and log of poses. gauge:
        videos and force log. webcams: two webcams and a kitchen scale, to measure live. Default:
        what the files look like.
    name
        Of the session. Default: the folder's.
    mesh
        File of the surface, in the folder or elsewhere. Default: the only one.
    rig
        File of the calibrated cameras, or the folder that `palpate calibrate` wrote. Default: the
        one in the folder.
    unit
        Of the mesh and all lengths. Default: the one in which the object can stand on a bench.
    held
        Flat face of the object that does not move. Default: the largest; the smallest, where grips
        pull.
    radius
        Radius of the contact patch, in that unit.
    tool_radius
        Radius of the ball that presses, in that unit; the contact patch is computed from it.

    Returns
    -------
    int
        0.
    """
    survey = _with_files(survey_folder(folder), mesh, rig)
    if not survey.meshes:
        raise RecordError(
            f"{folder}: holds no surface of the object (PLY, STL, OBJ, OFF, MSH, VTU or VTP); put"
            " it there first"
        )
    interactive = sys.stdin is not None and sys.stdin.isatty()
    kind = template or _choose(
        "what is it", likely_template(survey), list(TEMPLATES), interactive=interactive
    )
    kind = cast(Template, kind)
    target = folder / TEMPLATES[kind][1]
    if target.exists():
        raise InputError(f"{target}: is there already; nothing was changed: move it away first")
    file = survey.meshes[0]
    if mesh is None:
        file = _choose("mesh", file, list(survey.meshes), interactive=interactive)
    surface = read_surface(survey, file)
    sides = flat_sides(surface)
    units = list(FILE_LENGTH_UNITS)
    length = unit or _choose(
        "unit of lengths", likely_unit(surface), units, interactive=interactive
    )
    flat = [side.name for side in sides]
    if held is None and flat:
        likely = flat[-1 if kind == "tension" else 0]
        held = _choose("side that is held", likely, flat, interactive=interactive)  # type: ignore[assignment]
    side = chosen_side(sides, held)
    outline = Outline(
        kind, _checked_name(name) or folder.resolve().name, file, length,
        side, _checked_radius("radius", radius) or default_radius(surface), radius is not None,
        _checked_radius("tool-radius", tool_radius), opposite_side(sides, side),
    )  # fmt: skip
    write_text(target, outline_text(survey, outline))
    print_text(f"{_found_text(survey)}\n{target} is written; {_next_step(kind, target)}")
    return 0


def record(
    recording: Path,
    /,
    *,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Build a session from recordings: one video per camera and a force gauge's log.

    Finds the presses, the clock offsets, the tool's weight and the moments when nothing moves, and
    writes pictures at rest and under load, forces with their standard deviations, and a plot.

    Parameters
    ----------
    recording
        recording.toml, or the folder that holds it.
    out
        Folder of the session. Default: the recording's folder name followed by -session, in the
        current folder.
    force
        Overwrite whatever is there; the old content is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    given = read_recording(recording)
    destination = out or default_folder(given.path.parent, "session")
    with result_folder(destination, kind="record", force=force) as folder:
        with progress_bar("shorter videos, or fewer pictures a second") as progress:
            presses = find_presses(given, progress=part_of(progress, 0.0, 0.6))
            placed = write_recorded(folder, given, presses, progress=part_of(progress, 0.6, 1.0))
        save_drawing(recording_figure(presses, given.name), folder / "recording.png")
        record_inputs(folder, _inputs(given))
    print_notes(presses.notes)
    print_tables(_presses(presses, placed))
    print_tables(_clocks(presses))
    print_text(f"{_zero(presses)}\nSession in {destination}; next: palpate check {destination}")
    return 0


def _with_files(survey: FolderSurvey, mesh: str | None, rig: Path | None) -> FolderSurvey:
    """What was found, the files that were named first; one may lie elsewhere."""
    if mesh is not None:
        name = mesh if mesh in survey.meshes else _relative_name(survey.folder, Path(mesh))
        survey = replace(
            survey, meshes=(name, *(file_name for file_name in survey.meshes if file_name != name))
        )
    if rig is not None:
        file = rig / "rig.toml" if rig.is_dir() else rig
        names = _relative_name(survey.folder, file), *survey.rigs
        survey = replace(survey, rigs=tuple(dict.fromkeys(names)), rig=read_rig(file))
    return survey


def _relative_name(folder: Path, file: Path) -> str:
    """A file's name from a folder."""
    if not file.exists():
        raise RecordError(f"{file}: no such file, nor is it in {folder}; check the name")
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _checked_name(name: str | None) -> str | None:
    max_length = 200
    if name is not None and not (name.strip() and name.isprintable() and len(name) <= max_length):
        raise InputError(
            f"--name is {quoted(name)}; must be one line of 1 to {max_length} characters"
        )
    return name


def _checked_radius(option: str, radius: float | None) -> float | None:
    if radius is not None and radius <= 0.0:
        raise InputError(f"--{option} is {radius:g}; must be positive, in the unit of the mesh")
    return radius


def _choose(what: str, default: str, allowed: list[str], *, interactive: bool) -> str:
    """The person's answer, or the most likely one where nobody can be asked."""
    if not interactive or len(allowed) == 1:
        return default
    shown = {visible(word): word for word in allowed}
    return shown[Prompt.ask(what, choices=list(shown), default=visible(default))]


def _found_text(survey: FolderSurvey) -> str:
    """How many files of each kind are there."""
    counts = (
        (survey.meshes, "mesh", "meshes"),
        (survey.rigs, "rig", "rigs"),
        (survey.videos, "video", "videos"),
        (survey.pictures, "picture", "pictures"),
        (survey.displacements, "table of displacements", "tables of displacements"),
        (survey.forces, "force log", "force logs"),
        (survey.poses, "log of poses", "logs of poses"),
    )
    return "Found: " + ", ".join(
        f"{len(names)} {singular if len(names) == 1 else plural}"
        for names, singular, plural in counts
        if names
    )


def _next_step(kind: Template, target: Path) -> str:
    marks = target.read_text(encoding="utf-8").count("<- fill in")
    places = "place" if marks == 1 else f"{marks} places"
    done = f"fill in the {places} marked, then" if marks else "next"
    return f"{done}: {next_command(kind)} {target.parent}"


def _inputs(given: Recording) -> list[Path]:
    """Files that the session is made from."""
    files = {given.path, given.gauge.file, *given.files}
    for footage in given.footage:
        files |= {footage.video} if footage.video else set(footage.pictures)
    return sorted(files | ({given.contact_source.poses} if given.contact_source.poses else set()))


def _presses(recorded: Recorded, placed: tuple[PlacedPress, ...]) -> Table:
    rows = []
    for item in placed:
        reading = item.press.reading
        size = float(np.linalg.norm(reading.force))
        sigma = float(np.linalg.norm(reading.std * reading.force) / max(size, 1e-300))
        factor, unit = length_unit(1e-3)
        point = ", ".join(f"{x / factor:.2f}" for x in item.point)
        std = number_text(item.point_std / factor, ".2f")
        rows.append(
            (
                item.press.name, f"{reading.time:.2f}", f"{reading.end - reading.begin:.2f}",
                f"{size:.4f} ± {sigma:.4f}", f"{100 * reading.creep:+.2f}",
                number_text(100 * hysteresis(recorded, item.press), "+.1f"), str(item.frames),
                point, std,
            )
        )  # fmt: skip
    columns = (
        "press", "time s", "plateau s", "force N", "creep %", "hysteresis %", "frames",
        f"contact {unit}", f"± {unit}",
    )  # fmt: skip
    caption = (
        "time: of the picture under load, gauge's clock; creep: of the force along the plateau;"
        " hysteresis: force going in less coming out at the same picture, of the full force, where"
        " the clocks' offset is given;"
        " frames: whose mean the picture is; ±: one standard deviation along the surface, - where"
        " the place was given"
    )
    return terminal_table(
        f"{len(placed)} of {len(recorded.touches)} presses", columns, rows, caption=caption
    )


def _clocks(recorded: Recorded) -> Table:
    rows = [
        (
            motion.camera, str(len(motion.time)), f"{1.0 / motion.interval:.2f}",
            str(motion.dropped), str(motion.repeated), str(motion.lost), f"{clock.offset:+.4f}",
            "given" if clock.given else number_text(1e3 * clock.std, ".1f"),
            number_text(1e3 * clock.scatter, ".1f"),
        )
        for motion, clock in zip(recorded.motions, recorded.clocks, strict=True)
    ]  # fmt: skip
    columns = (
        "camera", "frames", "rate Hz", "dropped", "repeated", "lost", "clock s", "± ms",
        "scatter ms",
    )  # fmt: skip
    caption = (
        "clock: what to add to the camera's time for the gauge's; scatter: standard deviation of"
        " that over the presses; dropped: by the frames' times; lost: cannot be decoded"
    )
    return terminal_table("Cameras", columns, rows, caption=caption)


def _zero(recorded: Recorded) -> str:
    """Weight and drift in words."""
    weight = np.round(recorded.zero.value[0], 4).tolist()
    return (
        f"Without contact the gauge reads {weight} N in the beginning (the tool's weight, taken"
        f" off) and drifts by up to {recorded.zero.drift:.4f} N"
    )
