"""Presses of a recording: times of contact and of rest, the force at each; as a session folder.

The folder has pictures, copied files, session.toml and presses.csv. A log of the tool's pose gives
the position of its tip at first contact, and its travel.
"""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import tomlkit
from jaxtyping import Bool, Float

from palpate.errors import RecordError
from palpate.geometry import closest_points, unit_normals
from palpate.progress import Progress, part_of, silent
from palpate.recording.clock import Camera, Clock, rest_before, still_pictures, synchronise_cameras
from palpate.recording.contact_point import ContactModel, find_contact, make_contact_model
from palpate.recording.footage import MAX_FRAMES, CameraMotion, write_moments
from palpate.recording.force_log import POSITIONS, ForceLog, read_force_log, read_log_table
from palpate.recording.recording_file import Recording, check_contact_count
from palpate.recording.touches import (
    Reading,
    ResampledForce,
    Touch,
    Zero,
    find_plateau,
    find_touches,
    find_zero,
    read_force,
    resample_force,
    still_force,
    unreadable_reason,
)
from palpate.records import (
    LENGTH_UNITS,
    SESSION_FORMAT,
    TIME_UNITS,
    read_session,
    spreadsheet_text,
    write_text,
)
from palpate.shapes import Points, Vector3
from palpate.vision import JointFlow, is_valid, read_pictures

_NO_REST_REASON = (
    "before it there is no moment at which nothing touches or moves and all cameras record; wait"
    " for a second before pressing"
)
_PICTURES = "images"
_REST, _LOADED = "{name}_rest_{{camera}}.png", "{name}_{{camera}}.png"
_HEADINGS = (
    "press,name,touch_begin_s,touch_end_s,plateau_begin_s,plateau_end_s,time_s,rest_begin_s,"
    "rest_end_s,fx_N,fy_N,fz_N,sx_N,sy_N,sz_N,creep,hysteresis,frames,x_m,y_m,z_m,point_std_m"
)
_COLUMNS = {"time": ("time", "t"), "x": ("x",), "y": ("y",), "z": ("z",)}
_CURE = "a log of poses is a table with the columns time, x, y, z"
# A press held for so many times as long as its force rose shows how the object creeps; its series
# begins so long before the contact [s].
_CREEPS, _BEFORE = 10.0, 0.5
_SERIES = "{name}_series.csv"
# Largest delay between the true contact and its detection in the force [s].
_MAX_DELAY = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Press:
    """One press of a recording.

    Attributes
    ----------
    number : int                    from 1, in order of time, including presses that are left out
    name : str                      of the probing
    touch : Touch
    reading : Reading
    rest : (begin, end) [s]         time span of the rest picture, gauge's clock
    """

    number: int
    name: str
    touch: Touch
    reading: Reading
    rest: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """Result of the analysis of a recording.

    Attributes
    ----------
    log : ForceLog
    resampled : ResampledForce
    zero : Zero
    touches : tuple of Touch        all touches
    presses : tuple of Press        those that can be measured
    motions : tuple of CameraMotion in the rig's order
    clocks : tuple of Clock         in the rig's order
    notes : tuple of str            what was left out, dropped or assumed, in sentences
    """

    log: ForceLog
    resampled: ResampledForce
    zero: Zero
    touches: tuple[Touch, ...]
    presses: tuple[Press, ...]
    motions: tuple[CameraMotion, ...]
    clocks: tuple[Clock, ...]
    notes: tuple[str, ...]


def find_presses(recording: Recording, *, progress: Progress = silent) -> Recorded:
    """Find the presses of a recording, the clocks' offsets and the moments to measure at.

    Every video is decoded twice, frame by frame.

    Parameters
    ----------
    recording : Recording
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    Recorded

    Raises
    ------
    RecordError                     no press, a video that cannot be decoded or shows no press, a
                                    camera whose clock drifts, no moment at rest
    InputError                      as in `read_force_log`
    """
    log = read_force_log(recording.gauge)
    resampled = resample_force(log)
    touches, knocks = find_touches(resampled)
    if not touches:
        raise RecordError(
            f"{log.source}: no press is found in {log.time[-1] - log.time[0]:.1f} s: the force"
            f" never leaves its zero by more than its noise of {1e3 * resampled.noise:.3g} mN for"
            f" 0.3 s ({knocks} knocks); is it the log of this recording, and in the unit that is"
            " said?"
        )
    check_contact_count(recording, len(touches))
    zero = find_zero(log, touches)
    still = still_force(resampled, zero)
    plateaus = [find_plateau(resampled, zero, touch, still) for touch in touches]
    unreadable = [unreadable_reason(log, plateau) for plateau in plateaus]
    if all(unreadable):
        _refuse(recording, unreadable)
    cameras = synchronise_cameras(recording, resampled, zero, touches, plateaus, progress=progress)
    usable = still & still_pictures(resampled, cameras, plateaus)
    presses, reasons = _presses(log, resampled, zero, touches, cameras, usable)
    if not presses:
        _refuse(recording, reasons)
    motions, clocks = zip(*cameras, strict=True)
    remarks = [text for item in (*motions, *clocks) for text in item.notes]
    if knocks:
        remarks.append(f"{knocks} touches too short or too weak for a press were passed over")
    remarks += [f"left out is {reason}" for reason in reasons]
    notes = tuple(f"{text}." for text in remarks)
    return Recorded(log, resampled, zero, touches, presses, motions, clocks, log.notes + notes)


def _refuse(recording: Recording, reasons: list[str]) -> NoReturn:
    """Refuse a recording in which there is a reason to leave out every press."""
    listed = "; ".join(dict.fromkeys(reasons[:3]))
    raise RecordError(f"{recording.path}: none of the presses can be measured: {listed}")


def _presses(
    log: ForceLog,
    resampled: ResampledForce,
    zero: Zero,
    touches: tuple[Touch, ...],
    cameras: list[Camera],
    still: Bool[np.ndarray, " n"],
) -> tuple[tuple[Press, ...], list[str]]:
    """The presses that can be measured, and a reason for each of the others."""
    presses, reasons = [], []
    for k, touch in enumerate(touches):
        plateau = find_plateau(resampled, zero, touch, still)
        free = (touches[k - 1].end if k else float(resampled.time[0]) - 1.0, touch.begin)
        rest = rest_before(resampled, cameras, free, still)
        if reason := unreadable_reason(log, plateau) or ("" if rest else _NO_REST_REASON):
            reasons.append(f"press {k + 1}: {reason}")
        elif plateau and rest:
            reading = read_force(log, zero, plateau, 0.5 * (plateau[0] + plateau[1]))
            presses.append(Press(k + 1, f"n{k + 1:02d}", touch, reading, rest))
    return tuple(presses), reasons


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
    series : str                    force and motion of the tip over time, as CSV in the recording's
                                    unit of length; empty without a log of poses or a long hold
    """

    press: Press
    point: Vector3
    point_std: float
    travel: Vector3 | None
    travel_std: float
    frames: int
    series: str = ""


def write_recorded(
    folder: Path, recording: Recording, recorded: Recorded, *, progress: Progress = silent
) -> tuple[PlacedPress, ...]:
    """Write a session folder and check it by reading it back.

    Parameters
    ----------
    folder : Path                   an existing, empty folder
    recording : Recording
    recorded : Recorded
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
    frames = _write_pictures(folder / _PICTURES, recording, recorded, part_of(progress, 0.0, 0.6))
    stage_progress = part_of(progress, 0.6, 1.0)
    model: ContactModel | None = None
    if recording.contact_source.points is None and recording.contact_source.poses is None:
        stage_progress("model of the object", 0.0)
        model = make_contact_model(recording.mesh, recording.held)
    placed = []
    for k, press in enumerate(recorded.presses):
        stage_progress(f"contact of {press.name}", k / len(recorded.presses))
        frame_count = frames[_LOADED.format(name=press.name)]
        placed.append(_place_press(folder, recording, press, model, frame_count, recorded))
        if placed[-1].series:
            write_text(folder / _SERIES.format(name=press.name), placed[-1].series)
    _write_session(folder, recording, placed)
    write_text(folder / "presses.csv", _table(recorded, placed))
    try:
        read_session(folder)
    except RecordError as error:
        text = str(error).replace(str(folder / "session.toml"), str(recording.path))
        raise RecordError(text) from error
    return tuple(placed)


def _write_pictures(
    folder: Path, recording: Recording, recorded: Recorded, progress: Progress
) -> dict[str, int]:
    """Write pictures at rest and under load of every camera; gives, for each picture, the least
    number of averaged frames over the cameras."""
    frames: dict[str, int] = {}
    count = len(recording.footage)
    for k, (footage, motion, clock) in enumerate(
        zip(recording.footage, recorded.motions, recorded.clocks, strict=True)
    ):
        moments = {}
        half = 0.5 * MAX_FRAMES * motion.interval
        for press in recorded.presses:
            reading = press.reading
            span = max(reading.begin, reading.time - half), min(reading.end, reading.time + half)
            for name, (begin, end) in ((_REST, press.rest), (_LOADED, span)):
                span = begin - clock.offset, end - clock.offset
                moments[name.format(name=press.name)] = span
        camera_progress = part_of(progress, k / count, (k + 1) / count)
        written = write_moments(folder, footage, moments, progress=camera_progress)
        for name, number in written.items():
            frames[name] = min(number, frames.get(name, number))
    return frames


def _place_press(
    folder: Path, recording: Recording, press: Press, model: ContactModel | None, frames: int,
    recorded: Recorded,
) -> PlacedPress:  # fmt: skip
    """Contact point of a press: given, from the log of poses, or from the surface's motion."""
    source, unit = recording.contact_source, recording.metres_per_unit
    travel, travel_std, std, series = None, np.nan, np.nan, ""
    if source.points is not None:
        point = source.points[press.number - 1]
    elif source.poses is not None:
        poses = read_poses(source.poses, metres_per_unit=unit, topic=source.topic)
        point, travel, travel_std = _tip_motion(poses, press.touch, press.reading)
        series = _series(recorded, poses, press, point, unit)
    elif model is not None:
        point, std = _contact_from_motion(folder, recording, press, model)
    closest = closest_points(recording.mesh, point[None])
    normal = unit_normals(recording.mesh)[closest.triangle[0]]
    if press.reading.force @ normal > 0.0:
        raise RecordError(
            f"{recording.path}: the force of press {press.number},"
            f" {np.round(press.reading.force, 3).tolist()} N, points out of the surface at the"
            " contact: the sign is turned, or the axes; readings of the force on the tool need sign"
            ' = "on tool" in [force]'
        )
    return PlacedPress(press, point, std, travel, travel_std, frames, series)


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
    point, std, _ = find_contact(
        model, flow.point[valid], flow.displacement[valid], press.reading.force,
        radius=recording.search_radius(press.number),
        profile=recording.contact_source.patch.get("profile", "smooth"),
    )  # fmt: skip
    return point, std


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
    if placed.series:
        table["series"] = _SERIES.format(name=press.name)
        table["measured_at"] = press.reading.time
    rest, loaded = (f"{_PICTURES}/{name.format(name=press.name)}" for name in (_REST, _LOADED))
    table["images"] = {"rest": rest, "loaded": [loaded]}
    return table


def _table(recorded: Recorded, placed: list[PlacedPress]) -> str:
    """CSV table with a line for each press, times on the gauge's clock."""
    rows = [_HEADINGS.split(",")]
    for placed_press in placed:
        press, reading = placed_press.press, placed_press.press.reading
        numbers = (
            press.touch.begin, press.touch.end, reading.begin, reading.end, reading.time,
            *press.rest, *reading.force, *reading.std, reading.creep, hysteresis(recorded, press),
            placed_press.frames, *placed_press.point, placed_press.point_std,
        )  # fmt: skip
        rows.append([str(press.number), press.name, *(f"{x:.6g}" for x in numbers)])
    return spreadsheet_text(rows)


def hysteresis(recorded: Recorded, press: Press) -> float:
    """Hysteresis of a press, the mean of `Clock.hysteresis` over the cameras.

    Parameters
    ----------
    recorded : Recorded
    press : Press

    Returns
    -------
    float [-]                       fraction of the full force; NaN if unknown for all cameras
    """
    values = np.array([clock.hysteresis[press.number - 1] for clock in recorded.clocks])
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else np.nan


@dataclass(frozen=True, slots=True, eq=False)
class PoseLog:
    """Positions of the tool's tip over time.

    Attributes
    ----------
    time : (n,) float [s]           gauge's clock, not decreasing
    position : (n, 3) float [m]     position of the tip's end, object frame
    source : str                    file, for messages
    """

    time: Float[np.ndarray, " n"]
    position: Points
    source: str

    def at(self, time: float) -> Vector3:
        """Position at a time, by linear interpolation.

        Parameters
        ----------
        time : float [s]            gauge's clock

        Returns
        -------
        (3,) float [m]

        Raises
        ------
        RecordError                 a time outside the log
        """
        if not self.time[0] <= time <= self.time[-1]:
            raise RecordError(
                f"{self.source}: covers {self.time[0]:.2f} to {self.time[-1]:.2f} s, and a press is"
                f" at {time:.2f} s of the gauge's clock; the two logs must have the same clock"
            )
        return np.array([np.interp(time, self.time, part) for part in self.position.T])


def read_poses(path: Path, *, metres_per_unit: float, topic: str | None = None) -> PoseLog:
    """Read a log of the tool's tip.

    Parameters
    ----------
    path : Path                     a table, or a bag, whose lengths are in metres
    metres_per_unit : float         unit of lengths whose heading, as in "x [mm]", names none
    topic : str or None             of a bag; None: the only one with poses

    Returns
    -------
    PoseLog

    Raises
    ------
    RecordError                     no such table or columns; an unknown unit; times that decrease
    InputError                      the optional package for bags is missing
    """
    table = read_log_table(path, topic=topic, wanted=POSITIONS, cure=_CURE)
    columns = table.require(_COLUMNS, normalise=str.lower, reason=lambda _: _CURE)
    seconds = table.factor(columns[:1], TIME_UNITS, 1.0)
    metres = table.factor(columns[1:], LENGTH_UNITS, metres_per_unit)
    values = table.values(columns)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < 2 or np.any(np.diff(values[:, 0]) < 0.0):
        raise RecordError(f"{path}: has {len(values)} lines whose times do not increase; {_CURE}")
    return PoseLog(seconds * values[:, 0], metres * values[:, 1:], str(path))


def _tip_motion(poses: PoseLog, touch: Touch, reading: Reading) -> tuple[Vector3, Vector3, float]:
    """Contact point, displacement of the tip up to the reading, and its standard deviation.

    Contact is detected with a delay of up to a tenth of a second; the contact point is taken as
    uniformly distributed over the path of the tip during that time.

    Parameters
    ----------
    poses : PoseLog
    touch : Touch
    reading : Reading

    Returns
    -------
    point : (3,) float [m]          of first contact
    displacement : (3,) float [m]   from there to the reading
    std : float [m]                 of each component of the displacement

    Raises
    ------
    RecordError                     the log does not cover the press
    """
    late, early = poses.at(touch.begin), poses.at(touch.begin - _MAX_DELAY)
    point = 0.5 * (late + early)
    std = float(np.linalg.norm(late - early)) / np.sqrt(12.0)
    return point, poses.at(reading.time) - point, max(std, 1e-6)


def _series(
    recorded: Recorded, poses: PoseLog, press: Press, point: Vector3, metres_per_unit: float
) -> str:
    """`PlacedPress.series`: up to the end of the plateau, where the force or the tool is held."""
    begin, reading = press.touch.begin, press.reading
    if reading.end - reading.begin < _CREEPS * (reading.begin - begin):
        return ""
    every = recorded.resampled.time
    used = (every > begin - _BEFORE) & (every <= min(reading.end, poses.time[-1]))
    time = every[used]
    force = recorded.resampled.force[used] - recorded.zero.at(time)
    if not np.isfinite(force).all():
        return ""
    tip = [np.interp(time, poses.time, part) for part in (poses.position - point).T]
    # On its way to the object it is nobody's displacement.
    moved = np.where(time[:, None] < begin, np.nan, np.column_stack(tip) / metres_per_unit)
    rows = np.column_stack([time, force, moved]).tolist()
    lines = [",".join(f"{x:.9g}" for x in row) for row in rows]
    return "\n".join(["t,fx,fy,fz,tx,ty,tz", *lines, ""])
