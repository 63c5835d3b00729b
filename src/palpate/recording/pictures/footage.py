"""A camera's recording: a video, or pictures with their times."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from palpate.arrays import fixed_array
from palpate.errors import InputError, RecordError
from palpate.records import TIME_UNITS, read_text_table
from palpate.vision import open_video, read_grey, video_frames

# Longest recording [s].
_LONGEST_RECORDING = 86400.0
_TIMES_CURE = "times of pictures are a table with a heading and a column of seconds, a line each"


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


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One frame of a recording.

    Attributes
    ----------
    number : int                    from 0
    time : float [s]                camera's clock
    grey : (rows, columns)          grey levels, 255 is white; uint8 from a video, else float32
    """

    number: int
    time: float
    grey: Shaped[np.ndarray, "_ _"]


def read_frames(footage: Footage) -> Iterator[Frame]:
    """Iterate over the frames, with only one of them in memory.

    Parameters
    ----------
    footage : Footage

    Yields
    ------
    Frame                           in order of time

    Raises
    ------
    RecordError                     a file that cannot be decoded; different numbers of times and
                                    frames; pictures of different sizes
    """
    frames = _video_frames(footage) if footage.video else _pictures(footage)
    size: tuple[int, ...] | None = None
    for frame in frames:
        if size not in (None, frame.grey.shape):
            if footage.video is None:
                which, others = f"{footage.pictures[frame.number]}:", "pictures"
            else:
                which, others = f"{footage.video}: frame {frame.number}, counted from 0,", "frames"
            raise RecordError(
                f"{which} has {frame.grey.shape[1]} x {frame.grey.shape[0]} pixels, {others} before"
                f" it {size[1]} x {size[0]}"
            )
        size = frame.grey.shape
        yield frame


def _pictures(footage: Footage) -> Iterator[Frame]:
    times = np.arange(len(footage.pictures)) if footage.times is None else footage.times
    for k, path in enumerate(footage.pictures):
        yield Frame(k, float(times[k]), read_grey(path))


def _video_frames(footage: Footage) -> Iterator[Frame]:
    times, count = footage.times, 0
    for number, (time, grey) in enumerate(video_frames(footage.source)):
        if times is not None and number == len(times):
            raise RecordError(
                f"{footage.source}: has more frames than there are times, {len(times)};"
                " was a frame dropped from the list, or is it that of another video?"
            )
        yield Frame(number, time if times is None else float(times[number]), grey)
        count = number + 1
    if times is not None and count < len(times):
        raise RecordError(
            f"{footage.source}: has {count} frames that can be decoded and {len(times)} times; is"
            " it cut off, or are the times those of another video?"
        )


def header_frame_count(footage: Footage) -> int:
    """Number of frames according to the file's header.

    Parameters
    ----------
    footage : Footage

    Returns
    -------
    int                             0 if the header does not tell

    Raises
    ------
    RecordError                     as in `open_video`
    """
    if footage.pictures:
        return len(footage.pictures)
    capture = open_video(footage.source)
    count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    return max(count, 0)


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
