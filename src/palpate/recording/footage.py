"""A camera's recording: a video, or pictures with their times; motion, presses, moments.

Recordings of any length are evaluated without keeping them in memory: motion, from frame to frame
and since the first one, is computed on reduced pictures, and only three numbers are kept of each
frame. A ramp is the progress of one press while loading or unloading. The picture of a moment is
the mean of several frames at rest.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from palpate.arrays import STD_OVER_MEDIAN, fixed_array
from palpate.errors import InputError, RecordError
from palpate.progress import Progress, silent
from palpate.records import TIME_UNITS, read_text_table
from palpate.vision import read_grey, video_frame_count, video_frames

# Longest recording [s].
_LONGEST_RECORDING = 86400.0
_TIMES_CURE = "times of pictures are a table with a heading and a column of seconds, a line each"
# Approximate number of columns of the reduced pictures.
_REDUCED_COLUMNS = 240
# A time step longer than this many median steps means dropped frames.
_DROPPED_STEP = 1.5
# A frame is still if its change exceeds the median change on plateaus by less than so many robust
# standard deviations, or this fraction.
_STILL_SIGMAS, _STILL_FRACTION = 5.0, 0.1
# Time kept before and after a ramp [s]: largest permitted error of the clocks' coarse offset.
MARGIN = 1.2
# Largest number of frames of a press in memory.
_MAX_FRAMES = 160
# Largest number of averaged frames: it reduces the noise to a third within a short time.
MAX_FRAMES = 8
_SCALE_TO_16_BITS = 257.0
Span = tuple[float, float]
# Number, time and grey levels of a frame.
Frame = tuple[int, float, Shaped[np.ndarray, "_ _"]]
# Times, and what was measured then.
Signal = tuple[Float[np.ndarray, " _"], Float[np.ndarray, " _"]]


@dataclass(frozen=True, slots=True, eq=False)
class Footage:
    """Recording of one camera.

    Parameters
    ----------
    camera : str                    name, as in the rig
    video : Path or None
    pictures : tuple of Path        in order of time, if there is no video
    times : (n,) float [s] or None  of the frames, the camera's own clock, increasing; None: from
                                    the video
    offset : float [s] or None      added to these times gives the gauge's clock; None: unknown

    Raises
    ------
    InputError                      neither video nor pictures, or both; pictures without times, or
                                    with another number of them; times that do not increase
    """

    camera: str
    video: Path | None
    pictures: tuple[Path, ...] = ()
    times: Float[np.ndarray, " n"] | None = None
    offset: float | None = None

    def __post_init__(self) -> None:
        if (self.video is None) == (not self.pictures):
            raise InputError(f"camera '{self.camera}' needs either a video or pictures")
        if self.times is not None:
            times = fixed_array(self.times, name="times", shape=(None,))
            object.__setattr__(self, "times", times)
            steps = np.diff(times)
            if len(times) < 2 or np.any(steps <= 0.0) or steps.sum() > _LONGEST_RECORDING:
                raise InputError(
                    f"times of camera '{self.camera}' must be two or more seconds of one day that"
                    " increase from frame to frame"
                )
        if self.pictures and (self.times is None or len(self.times) != len(self.pictures)):
            count = "no" if self.times is None else len(self.times)
            raise InputError(
                f"camera '{self.camera}' has {len(self.pictures)} pictures and {count} times; give"
                " a file with the time of each picture as `times`"
            )

    @property
    def source(self) -> Path:
        """The video, or the first picture."""
        return self.video or self.pictures[0]


def read_frames(footage: Footage) -> Iterator[Frame]:
    """Iterate over the frames, with only one of them in memory.

    Parameters
    ----------
    footage : Footage

    Yields
    ------
    number : int                    from 0
    time : float [s]                camera's clock, in order
    grey : (rows, columns)          grey levels, 255 is white; uint8 from a video, else float32

    Raises
    ------
    RecordError                     a file that cannot be decoded; different numbers of times and
                                    frames; pictures of different sizes
    """
    frames = _video_frames(footage) if footage.video else _pictures(footage)
    size: tuple[int, ...] | None = None
    for number, time, grey in frames:
        if size not in (None, grey.shape):
            if footage.video is None:
                which, others = f"{footage.pictures[number]}:", "pictures"
            else:
                which, others = f"{footage.video}: frame {number}, counted from 0,", "frames"
            raise RecordError(
                f"{which} has {grey.shape[1]} x {grey.shape[0]} pixels, {others} before"
                f" it {size[1]} x {size[0]}"
            )
        size = grey.shape
        yield number, time, grey


def _pictures(footage: Footage) -> Iterator[Frame]:
    times = np.arange(len(footage.pictures)) if footage.times is None else footage.times
    for k, path in enumerate(footage.pictures):
        yield k, float(times[k]), read_grey(path)


def _video_frames(footage: Footage) -> Iterator[Frame]:
    times, count = footage.times, 0
    for number, (time, grey) in enumerate(video_frames(footage.source)):
        if times is not None and number == len(times):
            raise RecordError(
                f"{footage.source}: has more frames than there are times, {len(times)};"
                " was a frame dropped from the list, or is it that of another video?"
            )
        yield number, time if times is None else float(times[number]), grey
        count = number + 1
    if times is not None and count < len(times):
        raise RecordError(
            f"{footage.source}: has {count} frames that can be decoded and {len(times)} times; is"
            " it cut off, or are the times those of another video?"
        )


def _header_frame_count(footage: Footage) -> int:
    """Number of frames according to the file's header.

    Parameters
    ----------
    footage : Footage

    Returns
    -------
    int                             0 if the header does not tell

    Raises
    ------
    RecordError                     as in `video_frame_count`
    """
    if footage.pictures:
        return len(footage.pictures)
    return video_frame_count(footage.source)


def read_times(path: Path) -> Float[np.ndarray, " n"]:
    """Times of frames from a table: its column named time or t, or its only column.

    Parameters
    ----------
    path : Path

    Returns
    -------
    (n,) float [s]

    Raises
    ------
    RecordError                     no such table or column; an unknown unit; a line without a
                                    number
    """
    table = read_text_table(path, cure=_TIMES_CURE)
    named = [column for column in table.columns if column.name.lower() in ("time", "t")]
    if not named and len(table.columns) > 1:
        raise RecordError(f"{path}: no column is called time or t; {_TIMES_CURE}")
    chosen = named[:1] or table.columns[:1]
    times = table.factor(chosen, TIME_UNITS, 1.0) * table.values(chosen)[:, 0]
    if bad := np.flatnonzero(~np.isfinite(times)).tolist():
        raise RecordError(f"{path}: line {table.numbers[bad[0]]}: is no number; {_TIMES_CURE}")
    return times


@dataclass(frozen=True, slots=True, eq=False)
class CameraMotion:
    """Changes of a camera's picture over time.

    Attributes
    ----------
    camera : str
    time : (n,) float [s]           of the frames, camera's clock
    speed : (n,) float              rms change from the previous frame [grey levels]; NaN for the
                                    first
    change : (n,) float             rms change from the first frame [grey levels]
    dropped : int                   number of missing frames, judged by the times
    repeated : int                  number of frames identical to the previous one
    lost : int                      number of frames announced by the file but not decoded
    """

    camera: str
    time: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]
    change: Float[np.ndarray, " n"]
    dropped: int
    repeated: int
    lost: int

    @property
    def notes(self) -> tuple[str, ...]:
        """Dropped, repeated and lost frames, as sentences without full stop."""
        counts = (
            (self.dropped, "frames were dropped, by their times"),
            (self.repeated, "frames are the one before again"),
            (self.lost, "frames that the file promises cannot be decoded"),
        )
        return tuple(f"camera {self.camera}: {count} {what}" for count, what in counts if count)

    @property
    def interval(self) -> float:
        """Median time between two frames [s]."""
        return float(np.median(np.diff(self.time)))


def _downsampled(grey: Shaped[np.ndarray, "_ _"]) -> Float[np.ndarray, "rows columns"]:
    """A picture downsampled by averaging blocks of pixels.

    Parameters
    ----------
    grey : (_, _)                   any real type

    Returns
    -------
    (rows, columns) float32
    """
    factor = max(1, round(grey.shape[1] / _REDUCED_COLUMNS))
    size = (grey.shape[1] // factor, grey.shape[0] // factor)
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def camera_motion(footage: Footage, *, progress: Progress = silent) -> CameraMotion:
    """Compute the changes of a camera's picture over its recording.

    Parameters
    ----------
    footage : Footage
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    CameraMotion

    Raises
    ------
    RecordError                     as in `read_frames`; fewer than three frames, or times that do
                                    not increase
    """
    times: list[float] = []
    speeds, changes = [np.nan], [0.0]
    first = before = np.zeros((0, 0), dtype=np.float32)
    announced = _header_frame_count(footage)
    for number, when, grey in read_frames(footage):
        picture = _downsampled(grey)
        if times:
            speeds.append(_rms(picture - before))
            changes.append(_rms(picture - first))
        else:
            first = picture
        times.append(when)
        before = picture
        if number % 30 == 0 and announced:
            progress(f"camera {footage.camera}", min(number / announced, 1.0))
    time, speed = np.array(times), np.array(speeds)
    if len(time) < 3 or np.any(np.diff(time) <= 0.0):
        raise RecordError(
            f"{footage.source}: has {len(time)} frames whose times do not increase; give their"
            f" times in a file as `times` of camera '{footage.camera}'"
        )
    steps = np.diff(time) / np.median(np.diff(time))
    dropped = int(np.rint(steps[steps > _DROPPED_STEP] - 1.0).sum())
    lost = max(announced - len(time), 0)
    return CameraMotion(
        footage.camera, time, speed, np.array(changes), dropped, int((speed == 0.0).sum()), lost
    )


def _rms(change: Float[np.ndarray, "rows columns"]) -> float:
    return float(np.sqrt(np.mean(change * change, dtype=np.float64)))


def still_frames(
    motion: CameraMotion, plateaus: list[tuple[float, float]]
) -> Bool[np.ndarray, " n"]:
    """Frames that differ from the previous one only by noise.

    Parameters
    ----------
    motion : CameraMotion
    plateaus : list of (begin, end) [s]     plateaus of the force, camera's clock

    Returns
    -------
    (n,) bool
    """
    held = np.zeros(len(motion.time), dtype=bool)
    for begin, end in plateaus:
        held |= (motion.time >= begin) & (motion.time <= end)
    # A repeated frame carries no information on motion.
    speed = np.where(motion.speed > 0.0, motion.speed, np.nan)
    plateau_speed = speed[held & np.isfinite(speed)]
    if not len(plateau_speed):
        return held
    level = float(np.median(plateau_speed))
    scatter = STD_OVER_MEDIAN * float(np.median(np.abs(plateau_speed - level)))
    limit = level + max(_STILL_SIGMAS * scatter, _STILL_FRACTION * level)
    return ~(speed > limit)


@dataclass(frozen=True, slots=True)
class RampTimes:
    """Begin of a press, begin and end of its plateau, and its end, on the camera's clock [s]."""

    begin: float
    plateau_begin: float
    plateau_end: float
    end: float

    def shows(self, time: float) -> bool:
        """Whether a frame at that time is on one of the ramps, or within `MARGIN` of them."""
        loading = self.begin - MARGIN <= time <= self.plateau_begin + MARGIN
        return loading or self.plateau_end - MARGIN <= time <= self.end + MARGIN


def camera_ramps(footage: Footage, presses: Sequence[RampTimes]) -> list[Signal | None]:
    """Progress of each press in the frames of its ramps.

    Only one press is in memory at a time.

    Parameters
    ----------
    footage : Footage
    presses : sequence of RampTimes     in order of time, accurate to within `MARGIN`,
                                    on the camera's clock

    Returns
    -------
    list of ((n,) float [s], (n,) float [-]) or None    time of the frames on both ramps, camera's
                                    clock, and progress of the picture from first contact (0) to
                                    full load (1): without NaN, linear in the displacement if that
                                    is small; None if the camera did not see the press

    Raises
    ------
    RecordError                     as in `read_frames`
    """
    ramps: list[Signal | None] = []
    frames: list[tuple[float, np.ndarray]] = []
    waiting = list(presses)
    for _, time, grey in read_frames(footage):
        while waiting and time > waiting[0].end + MARGIN:
            ramps.append(_ramp(waiting.pop(0), frames))
            frames = []
        if waiting and waiting[0].shows(time):
            frames = _thinned(frames)
            frames.append((time, _downsampled(grey)))
    for press in waiting:
        ramps.append(_ramp(press, frames))
        frames = []
    return ramps


def _thinned(frames: list[tuple[float, np.ndarray]]) -> list[tuple[float, np.ndarray]]:
    """The frames, reduced to every second one once there are too many."""
    return frames[::2] if len(frames) >= _MAX_FRAMES else frames


def _ramp(press: RampTimes, frames: list[tuple[float, np.ndarray]]) -> Signal | None:
    """Projection of each frame's change on the change from first contact to full load."""
    if len(frames) < 8:
        return None
    time = np.array([when for when, _ in frames])
    pictures = np.stack([picture.ravel() for _, picture in frames])
    resting = (time >= press.plateau_begin) & (time <= press.plateau_end)
    if not resting.any():
        return None
    full = pictures[resting].mean(axis=0, dtype=np.float64)
    first = pictures[np.abs(time - press.begin).argmin()].astype(np.float64)
    # A change of brightness is proportional to the picture, stray light adds a constant: both are
    # projected out, as they are not motion.
    light = np.linalg.qr(np.stack([first, np.ones_like(first)], axis=1))[0]
    change = full - first
    pattern = change - light @ (light.T @ change)
    size = float(pattern @ change)
    if size <= 0.0:
        return None
    progress = (pictures @ pattern - first @ pattern) / size
    return time, np.asarray(progress)


def write_moments(
    folder: Path, footage: Footage, moments: Mapping[str, Span], *, progress: Progress = silent
) -> dict[str, int]:
    """Write a picture for each moment; the video is decoded once, frame by frame.

    Parameters
    ----------
    folder : Path                   an existing folder
    footage : Footage
    moments : mapping               file name, with `{camera}` for the camera's name -> begin and
                                    end of the time span at rest [s], camera's clock; they do not
                                    overlap, and come in any order
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    dict of str to int              file name, as in `moments` -> number of averaged frames

    Raises
    ------
    RecordError                     as in `read_frames`; a moment without a frame; a picture that
                                    cannot be written
    """
    taken: dict[str, int] = {}
    waiting = sorted(moments.items(), key=lambda moment: moment[1])
    total, count, is_16_bit = np.zeros((0, 0)), 0, False

    def finish(file: str, span: Span) -> None:
        if not count:
            raise RecordError(
                f"{footage.source}: has no frame from {span[0]:.2f} to {span[1]:.2f} s of its own"
                " clock"
            )
        name = file.replace("{camera}", footage.camera)
        mean = total / count
        picture = (
            np.rint(_SCALE_TO_16_BITS * mean).astype(np.uint16) if is_16_bit else _as_8_bits(mean)
        )
        if not cv2.imwrite(str(folder / name), picture):
            raise RecordError(f"{folder / name}: cannot be written; check the folder's rights")
        taken[file] = count

    for _, time, grey in read_frames(footage):
        while waiting and (time > waiting[0][1][1] or count == MAX_FRAMES):
            finish(*waiting.pop(0))
            count = 0
            progress(f"pictures of camera {footage.camera}", len(taken) / len(moments))
        if not waiting:
            break
        if time >= waiting[0][1][0]:
            total = grey + (total if count else np.float64(0.0))
            count, is_16_bit = count + 1, grey.dtype != np.uint8
    for moment in waiting:
        finish(*moment)
        count = 0
    return taken


def _as_8_bits(grey: Float[np.ndarray, "rows columns"]) -> np.ndarray:
    return np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)
