"""Pictures of single moments from the footage, each the mean of several frames at rest."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.progress import Progress, silent
from palpate.recording.pictures.footage import Footage, read_frames

# Largest number of averaged frames: it reduces the noise to a third within a short time.
MAX_FRAMES = 8
_SCALE_TO_16_BITS = 257.0


@dataclass(frozen=True, slots=True)
class Moment:
    """A picture to be taken from the footage.

    Attributes
    ----------
    file : str                      file name, with `{camera}` in place of the camera's name
    begin, end : float [s]          time span at rest, camera's clock
    """

    file: str
    begin: float
    end: float


def write_moments(
    folder: Path, footage: Footage, moments: Sequence[Moment], *, progress: Progress = silent
) -> dict[str, int]:
    """Write a picture for each moment; the video is decoded once, frame by frame.

    Parameters
    ----------
    folder : Path                   an existing folder
    footage : Footage
    moments : sequence of Moment    not overlapping, in any order
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    dict of str to int              `Moment.file` -> number of averaged frames

    Raises
    ------
    RecordError                     as in `read_frames`; a moment without a frame; a picture that
                                    cannot be written
    """
    taken: dict[str, int] = {}
    waiting = sorted(moments, key=lambda moment: moment.begin)
    total, count, is_16_bit = np.zeros((0, 0)), 0, False

    def finish(moment: Moment) -> None:
        if not count:
            raise RecordError(
                f"{footage.source}: has no frame from {moment.begin:.2f} to {moment.end:.2f} s of"
                " its own clock"
            )
        name = moment.file.replace("{camera}", footage.camera)
        mean = total / count
        picture = (
            np.rint(_SCALE_TO_16_BITS * mean).astype(np.uint16) if is_16_bit else _as_8_bits(mean)
        )
        if not cv2.imwrite(str(folder / name), picture):
            raise RecordError(f"{folder / name}: cannot be written; check the folder's rights")
        taken[moment.file] = count

    for frame in read_frames(footage):
        while waiting and (frame.time > waiting[0].end or count == MAX_FRAMES):
            finish(waiting.pop(0))
            count = 0
            progress(f"pictures of camera {footage.camera}", len(taken) / len(moments))
        if not waiting:
            break
        if frame.time >= waiting[0].begin:
            total = frame.grey + (total if count else np.float64(0.0))
            count, is_16_bit = count + 1, frame.grey.dtype != np.uint8
    for moment in waiting:
        finish(moment)
        count = 0
    return taken


def _as_8_bits(grey: Float[np.ndarray, "rows columns"]) -> np.ndarray:
    return np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)
