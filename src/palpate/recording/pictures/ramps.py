"""Progress of each press in a camera's picture, during loading and unloading."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.recording.pictures.footage import Footage, read_frames
from palpate.recording.pictures.motion import downsampled

# Time kept before and after a ramp [s]: largest permitted error of the clocks' coarse offset.
MARGIN = 1.2
# Largest number of frames of a press in memory.
_MAX_FRAMES = 160


@dataclass(frozen=True, slots=True, eq=False)
class Ramp:
    """One press as seen by a camera.

    Attributes
    ----------
    time : (n,) float [s]           of the frames on both ramps, camera's clock
    progress : (n,) float [-]       progress of the picture from first contact (0) to full load (1);
                                    without NaN, linear in the displacement if that is small
    """

    time: Float[np.ndarray, " n"]
    progress: Float[np.ndarray, " n"]


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


def camera_ramps(footage: Footage, presses: Sequence[RampTimes]) -> list[Ramp | None]:
    """Progress of each press in the frames of its ramps.

    Only one press is in memory at a time.

    Parameters
    ----------
    footage : Footage
    presses : sequence of RampTimes     in order of time, accurate to within `MARGIN`,
                                    on the camera's clock

    Returns
    -------
    list of Ramp or None            None if the camera did not see the press

    Raises
    ------
    RecordError                     as in `read_frames`
    """
    found: list[Ramp | None] = []
    kept: list[tuple[float, np.ndarray]] = []
    waiting = list(presses)
    for frame in read_frames(footage):
        while waiting and frame.time > waiting[0].end + MARGIN:
            found.append(_ramp(waiting.pop(0), kept))
            kept = []
        if waiting and waiting[0].shows(frame.time):
            kept = _thinned(kept)
            kept.append((frame.time, downsampled(frame.grey)))
    for press in waiting:
        found.append(_ramp(press, kept))
        kept = []
    return found


def _thinned(kept: list[tuple[float, np.ndarray]]) -> list[tuple[float, np.ndarray]]:
    """The frames, reduced to every second one once there are too many."""
    return kept[::2] if len(kept) >= _MAX_FRAMES else kept


def _ramp(press: RampTimes, kept: list[tuple[float, np.ndarray]]) -> Ramp | None:
    """Projection of each frame's change on the change from first contact to full load."""
    if len(kept) < 8:
        return None
    time = np.array([when for when, _ in kept])
    pictures = np.stack([picture.ravel() for _, picture in kept])
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
    return Ramp(time, np.asarray(progress))
