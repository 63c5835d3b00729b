"""Change of a camera's picture from frame to frame, and since the first frame.

Computed on reduced pictures; only three numbers are kept of each frame.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from palpate.arrays import STD_OVER_MEDIAN
from palpate.errors import RecordError
from palpate.progress import Progress, silent
from palpate.recording.pictures.footage import Footage, header_frame_count, read_frames

# Approximate number of columns of the reduced pictures.
_REDUCED_COLUMNS = 240
# A time step longer than this many median steps means dropped frames.
_DROPPED_STEP = 1.5
# A frame is still if its change exceeds the median change on plateaus by less than so many robust
# standard deviations, or this fraction.
_STILL_SIGMAS, _STILL_FRACTION = 5.0, 0.1


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


def downsampled(grey: Shaped[np.ndarray, "_ _"]) -> Float[np.ndarray, "rows columns"]:
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
    announced = header_frame_count(footage)
    for frame in read_frames(footage):
        picture = downsampled(frame.grey)
        if times:
            speeds.append(_rms(picture - before))
            changes.append(_rms(picture - first))
        else:
            first = picture
        times.append(frame.time)
        before = picture
        if frame.number % 30 == 0 and announced:
            progress(f"camera {footage.camera}", min(frame.number / announced, 1.0))
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
