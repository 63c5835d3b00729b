"""Presses of a recording: times of contact and of rest, and the force at each."""

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
from jaxtyping import Bool

from palpate.errors import RecordError
from palpate.progress import Progress, silent
from palpate.recording.camera_clocks import Camera, rest_before, still_pictures, synchronise_cameras
from palpate.recording.clock import Clock
from palpate.recording.force.log import ForceLog, read_force_log
from palpate.recording.force.plateaus import (
    Reading,
    find_plateau,
    read_force,
    still_force,
    unreadable_reason,
)
from palpate.recording.force.touches import (
    ResampledForce,
    Touch,
    Zero,
    find_touches,
    find_zero,
    resample_force,
)
from palpate.recording.pictures.motion import CameraMotion
from palpate.recording.recording_file import Recording, check_contact_count

_NO_REST_REASON = (
    "before it there is no moment at which nothing touches or moves and all cameras record; wait"
    " for a second before pressing"
)


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
