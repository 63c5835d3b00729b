"""How far each press has gone in a camera's picture, while the tool goes in and comes out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.recording.pictures.footage import Footage, read_frames
from palpate.recording.pictures.motion import reduced

# Before and after a ramp [s]: so well the clocks' offset must be known to begin with.
MARGIN = 1.2
# Frames of a press that are kept while it is looked at.
_MOST = 160


@dataclass(frozen=True, slots=True, eq=False)
class Ramp:
    """One press as a camera saw it.

    Attributes
    ----------
    time : (n,) float [s]           camera's clock; frames of both ramps
    share : (n,) float [-]          how far the picture is from that at the first touch (0) to that
                                    under full load (1); NaN-free, linear in small motions
    """

    time: Float[np.ndarray, " n"]
    share: Float[np.ndarray, " n"]


@dataclass(frozen=True, slots=True)
class RampTimes:
    """When a press begins, rests and ends, the camera's clock [s]."""

    begin: float
    rest: float
    leave: float
    end: float

    def shows(self, time: float) -> bool:
        """Whether a frame of that time is on one of the ramps, or close to them."""
        loading = self.begin - MARGIN <= time <= self.rest + MARGIN
        return loading or self.leave - MARGIN <= time <= self.end + MARGIN


def camera_ramps(footage: Footage, presses: Sequence[RampTimes]) -> list[Ramp | None]:
    """How far each press has gone in each frame of its ramps.

    One press is in memory at a time.

    Parameters
    ----------
    footage : Footage
    presses : sequence of RampTimes     in time, the camera's clock, to within a second

    Returns
    -------
    list of Ramp or None            None where the camera did not see the press

    Raises
    ------
    RecordError                     as `read_frames`
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
            kept.append((frame.time, reduced(frame.grey)))
    for press in waiting:
        found.append(_ramp(press, kept))
        kept = []
    return found


def _thinned(kept: list[tuple[float, np.ndarray]]) -> list[tuple[float, np.ndarray]]:
    """Every other frame, once they are too many."""
    return kept[::2] if len(kept) >= _MOST else kept


def _ramp(press: RampTimes, kept: list[tuple[float, np.ndarray]]) -> Ramp | None:
    """Projection of what changed on what changes from the first touch to full load."""
    if len(kept) < 8:
        return None
    time = np.array([when for when, _ in kept])
    pictures = np.stack([picture.ravel() for _, picture in kept])
    resting = (time >= press.rest) & (time <= press.leave)
    if not resting.any():
        return None
    full = pictures[resting].mean(axis=0, dtype=np.float64)
    first = pictures[np.abs(time - press.begin).argmin()].astype(np.float64)
    # Brighter light changes a picture along itself, stray light by a constant: neither is motion.
    light = np.linalg.qr(np.stack([first, np.ones_like(first)], axis=1))[0]
    change = full - first
    pattern = change - light @ (light.T @ change)
    size = float(pattern @ change)
    if size <= 0.0:
        return None
    share = (pictures @ pattern - first @ pattern) / size
    return Ramp(time, np.asarray(share))
