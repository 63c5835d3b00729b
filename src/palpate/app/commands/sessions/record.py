"""`palpate record`: a session from videos of presses and the log of a force gauge."""

from pathlib import Path

import numpy as np
from rich.table import Table

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import number_text, terminal_table
from palpate.figures import recording_figure, save_drawing
from palpate.progress import part_of
from palpate.recording import (
    PlacedPress,
    Recorded,
    Recording,
    find_presses,
    hysteresis,
    read_recording,
    write_recorded,
)
from palpate.records import default_folder, length_unit, record_inputs, result_folder


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
        with progress_bar() as progress:
            found = find_presses(given, progress=part_of(progress, 0.0, 0.6))
            placed = write_recorded(folder, given, found, progress=part_of(progress, 0.6, 1.0))
        save_drawing(recording_figure(found, given.name), folder / "recording.png")
        record_inputs(folder, _inputs(given))
    print_notes(found.notes)
    print_tables(_presses(found, placed))
    print_tables(_clocks(found))
    print_text(f"{_zero(found)}\nSession in {destination}; next: palpate check {destination}")
    return 0


def _inputs(given: Recording) -> list[Path]:
    """Files that the session is made from."""
    files = {given.path, given.gauge.file, *given.files}
    for footage in given.footage:
        files |= {footage.video} if footage.video else set(footage.pictures)
    return sorted(files | ({given.contact_source.poses} if given.contact_source.poses else set()))


def _presses(found: Recorded, placed: tuple[PlacedPress, ...]) -> Table:
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
                number_text(100 * hysteresis(found, item.press), "+.1f"), str(item.frames),
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
        f"{len(placed)} of {len(found.touches)} presses", columns, rows, caption=caption
    )


def _clocks(found: Recorded) -> Table:
    rows = [
        (
            motion.camera, str(len(motion.time)), f"{1.0 / motion.interval:.2f}",
            str(motion.dropped), str(motion.repeated), str(motion.lost), f"{clock.offset:+.4f}",
            "given" if clock.given else number_text(1e3 * clock.std, ".1f"),
            number_text(1e3 * clock.scatter, ".1f"),
        )
        for motion, clock in zip(found.motions, found.clocks, strict=True)
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


def _zero(found: Recorded) -> str:
    """Weight and drift in words."""
    weight = np.round(found.zero.value[0], 4).tolist()
    return (
        f"Without contact the gauge reads {weight} N in the beginning (the tool's weight, taken"
        f" off) and drifts by up to {found.zero.drift:.4f} N"
    )
