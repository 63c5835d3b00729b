"""Writes a recording as a session folder: pictures, copied files, session.toml, presses.csv."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit

from palpate.errors import RecordError
from palpate.geometry import closest_points, unit_normals
from palpate.progress import Progress, part_of, silent
from palpate.recording.contact_point import ContactModel, find_contact, make_contact_model
from palpate.recording.pictures.moments import MAX_FRAMES, Moment, write_moments
from palpate.recording.poses import read_poses, tip_motion
from palpate.recording.record import Press, Recorded
from palpate.recording.recording_file import Recording
from palpate.records import SESSION_FORMAT, read_session, spreadsheet_text, write_text
from palpate.shapes import Vector3
from palpate.vision import JointFlow, is_valid, read_pictures

_PICTURES = "images"
_REST, _LOADED = "{name}_rest_{{camera}}.png", "{name}_{{camera}}.png"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedPress:
    """A press with its contact point.

    Attributes
    ----------
    press : Press
    point : (3,) float [m]          contact point, object frame
    point_std : float [m]           standard deviation along each tangent; NaN: not estimated
    travel : (3,) float [m] or None     displacement of the contact point, from a log of poses
    travel_std : float [m]          standard deviation of each component; NaN without a log
    frames : int                    number of frames averaged for the picture under load
    """

    press: Press
    point: Vector3
    point_std: float
    travel: Vector3 | None
    travel_std: float
    frames: int


def write_recorded(
    folder: Path, recording: Recording, found: Recorded, *, progress: Progress = silent
) -> tuple[PlacedPress, ...]:
    """Write a session folder and check it by reading it back.

    Parameters
    ----------
    folder : Path                   an existing, empty folder
    recording : Recording
    found : Recorded
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    tuple of PlacedPress            one for each probing

    Raises
    ------
    RecordError                     a force that pulls, a contact that cannot be found, an invalid
                                    session; a file that cannot be written
    InputError                      the model that finds the contacts does not fit into memory
    SingularSystemError             the support does not hold the object
    CalibrationError                pictures of another size than the rig was calibrated with
    OSError                         a file of the recording cannot be copied
    """
    for file in recording.files:
        shutil.copyfile(file, folder / file.name)
    (folder / _PICTURES).mkdir()
    frames = _write_pictures(folder / _PICTURES, recording, found, part_of(progress, 0.0, 0.6))
    report = part_of(progress, 0.6, 1.0)
    model: ContactModel | None = None
    if recording.contact_source.points is None and recording.contact_source.poses is None:
        report("model of the object", 0.0)
        model = make_contact_model(recording.mesh, recording.held)
    placed = []
    for k, press in enumerate(found.presses):
        report(f"contact of {press.name}", k / len(found.presses))
        frame_count = frames[_LOADED.format(name=press.name)]
        placed.append(_place_press(folder, recording, press, model, frame_count))
    _write_session(folder, recording, placed)
    write_text(folder / "presses.csv", _table(found, placed))
    try:
        read_session(folder)
    except RecordError as error:
        text = str(error).replace(str(folder / "session.toml"), str(recording.path))
        raise RecordError(text) from error
    return tuple(placed)


def _write_pictures(
    folder: Path, recording: Recording, found: Recorded, progress: Progress
) -> dict[str, int]:
    """Write pictures at rest and under load of every camera; gives, for each picture, the least
    number of averaged frames over the cameras."""
    frames: dict[str, int] = {}
    count = len(recording.footage)
    for k, (footage, motion, clock) in enumerate(
        zip(recording.footage, found.motions, found.clocks, strict=True)
    ):
        moments = []
        half = 0.5 * MAX_FRAMES * motion.interval
        for press in found.presses:
            reading = press.reading
            span = max(reading.begin, reading.time - half), min(reading.end, reading.time + half)
            for name, (begin, end) in ((_REST, press.rest), (_LOADED, span)):
                moments.append(
                    Moment(name.format(name=press.name), begin - clock.offset, end - clock.offset)
                )
        report = part_of(progress, k / count, (k + 1) / count)
        for name, number in write_moments(folder, footage, moments, progress=report).items():
            frames[name] = min(number, frames.get(name, number))
    return frames


def _place_press(
    folder: Path, recording: Recording, press: Press, model: ContactModel | None, frames: int
) -> PlacedPress:
    """Contact point of a press: given, from the log of poses, or from the surface's motion."""
    source, unit = recording.contact_source, recording.metres_per_unit
    travel, travel_std, std = None, np.nan, np.nan
    if source.points is not None:
        point = source.points[press.number - 1]
    elif source.poses is not None:
        poses = read_poses(source.poses, metres_per_unit=unit, topic=source.topic)
        point, travel, travel_std = tip_motion(poses, press.touch, press.reading)
    elif model is not None:
        point, std = _contact_from_motion(folder, recording, press, model)
    place = closest_points(recording.mesh, point[None])
    normal = unit_normals(recording.mesh)[place.triangle[0]]
    if press.reading.force @ normal > 0.0:
        raise RecordError(
            f"{recording.path}: the force of press {press.number},"
            f" {np.round(press.reading.force, 3).tolist()} N, points out of the surface at the"
            " contact: the sign is turned, or the axes; readings of the force on the tool need sign"
            ' = "on tool" in [force]'
        )
    return PlacedPress(press, point, std, travel, travel_std, frames)


def _contact_from_motion(
    folder: Path, recording: Recording, press: Press, model: ContactModel
) -> tuple[Vector3, float]:
    """Contact point and its standard deviation from the motion of the surface in the pictures."""
    pictures = [
        read_pictures(
            recording.rig, name.format(name=press.name), folder=folder / _PICTURES,
            what=f"press {press.number}",
        ).grey
        for name in (_REST, _LOADED)
    ]  # fmt: skip
    method = JointFlow()
    state = method.start(recording.rig, pictures[0], recording.mesh)
    _, flow = method.follow(state, pictures[1])
    valid = is_valid(flow)
    found = find_contact(
        model, flow.point[valid], flow.displacement[valid], press.reading.force,
        radius=recording.search_radius(press.number),
        profile=recording.contact_source.patch.get("profile", "smooth"),
    )  # fmt: skip
    return found.point, found.std


def _write_session(folder: Path, recording: Recording, placed: list[PlacedPress]) -> None:
    """Write session.toml, in the recording's own unit of length."""
    head = _with_local_paths(recording.head, {path.name for path in recording.files})
    content: dict[str, Any] = {"format": SESSION_FORMAT, "name": recording.name, **head}
    content["probe"] = [_probe(recording, press) for press in placed]
    write_text(folder / "session.toml", tomlkit.dumps(content))


def _with_local_paths(value: Any, names: set[str]) -> Any:
    """Nested tables in which paths of copied files are replaced by their names in this folder."""
    if isinstance(value, dict):
        return {key: _with_local_paths(item, names) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_local_paths(item, names) for item in value]
    return Path(value).name if isinstance(value, str) and Path(value).name in names else value


def _probe(recording: Recording, placed: PlacedPress) -> dict[str, Any]:
    """The table of one probing."""
    unit, press, contact_source = recording.metres_per_unit, placed.press, recording.contact_source
    contact: dict[str, Any] = {"point": (placed.point / unit).tolist()}
    if np.isfinite(placed.point_std):
        contact["point_std"] = placed.point_std / unit
    contact |= contact_source.patch
    if contact_source.radii is not None:
        contact["radius"] = contact_source.radii[press.number - 1]
    table: dict[str, Any] = {
        "name": press.name,
        "contact": contact,
        "force": press.reading.force.tolist(),
        "force_std": press.reading.std.tolist(),
    }
    if placed.travel is not None:
        table["tip_displacement"] = (placed.travel / unit).tolist()
        table["tip_displacement_std"] = placed.travel_std / unit
    rest, loaded = (f"{_PICTURES}/{name.format(name=press.name)}" for name in (_REST, _LOADED))
    table["images"] = {"rest": rest, "loaded": [loaded]}
    return table


_HEADINGS = (
    "press,name,touch_begin_s,touch_end_s,plateau_begin_s,plateau_end_s,time_s,rest_begin_s,"
    "rest_end_s,fx_N,fy_N,fz_N,sx_N,sy_N,sz_N,creep,hysteresis,frames,x_m,y_m,z_m,point_std_m"
)


def _table(found: Recorded, placed: list[PlacedPress]) -> str:
    """CSV table with a line for each press, times on the gauge's clock."""
    rows = [_HEADINGS.split(",")]
    for placed_press in placed:
        press, reading = placed_press.press, placed_press.press.reading
        numbers = (
            press.touch.begin, press.touch.end, reading.begin, reading.end, reading.time,
            *press.rest, *reading.force, *reading.std, reading.creep, hysteresis(found, press),
            placed_press.frames, *placed_press.point, placed_press.point_std,
        )  # fmt: skip
        rows.append([str(press.number), press.name, *(f"{x:.6g}" for x in numbers)])
    return spreadsheet_text(rows)


def hysteresis(found: Recorded, press: Press) -> float:
    """Hysteresis of a press, the mean of `Clock.hysteresis` over the cameras.

    Parameters
    ----------
    found : Recorded
    press : Press

    Returns
    -------
    float [-]                       fraction of the full force; NaN if unknown for all cameras
    """
    values = np.array([clock.hysteresis[press.number - 1] for clock in found.clocks])
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan
