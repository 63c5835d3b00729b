"""Presses of a recording: times of contact and of rest, and the force at each."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from palpate.errors import RecordError
from palpate.progress import Progress, silent
from palpate.recording.clock import Clock
from palpate.recording.follow import follow, rest_before, still_pictures
from palpate.recording.force import (
    EvenForce,
    ForceLog,
    Reading,
    Touch,
    Zero,
    even_force,
    find_plateau,
    find_touches,
    find_zero,
    read_force,
    read_force_log,
    still_force,
    why_unread,
)
from palpate.recording.pictures import CameraMotion
from palpate.recording.recording_file import Recording, check_count

_NO_REST = (
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
    even : EvenForce
    zero : Zero
    touches : tuple of Touch        all touches
    presses : tuple of Press        those that can be measured
    motions : tuple of CameraMotion in the rig's order
    clocks : tuple of Clock         in the rig's order
    notes : tuple of str            what was left out, dropped or assumed, in sentences
    """

    log: ForceLog
    even: EvenForce
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
    """
    log = read_force_log(recording.gauge)
    even = even_force(log)
    touches, knocks = find_touches(even)
    if not touches:
        raise RecordError(
            f"{log.source}: no press is found in {log.time[-1] - log.time[0]:.1f} s: the force"
            f" never leaves its zero by more than its noise of {1e3 * even.noise:.3g} mN for 0.3 s"
            f" ({knocks} knocks); is it the log of this recording, and in the unit that is said?"
        )
    check_count(recording, len(touches))
    zero = find_zero(log, touches)
    still = still_force(even, zero)
    plateaus = [find_plateau(even, zero, touch, still) for touch in touches]
    _require_any(recording, [why_unread(log, plateau) for plateau in plateaus])
    motions, clocks = follow(recording, even, zero, touches, plateaus, progress=progress)
    seen = still & still_pictures(even, motions, clocks, plateaus)
    presses, reasons = _presses(log, even, zero, touches, (motions, clocks), seen)
    _require_any(recording, reasons if not presses else [""])
    knocked = [f"{knocks} touches too short or too weak for a press were passed over"] * (
        knocks > 0
    )
    remarks = [text for one in motions for text in one.notes]
    remarks += [text for one in clocks for text in one.notes]
    left = [f"left out is {reason}" for reason in reasons]
    notes = tuple(f"{text}." for text in (*remarks, *knocked, *left))
    return Recorded(log, even, zero, touches, presses, motions, clocks, log.notes + notes)


def _require_any(recording: Recording, reasons: list[str]) -> None:
    """Refuse a recording in which there is a reason to leave out every press."""
    if reasons and all(reasons):
        told = "; ".join(dict.fromkeys(reasons[:3]))
        raise RecordError(f"{recording.path}: none of the presses can be measured: {told}")


def _presses(
    log: ForceLog,
    even: EvenForce,
    zero: Zero,
    touches: tuple[Touch, ...],
    cameras: tuple[tuple[CameraMotion, ...], tuple[Clock, ...]],
    still: Bool[np.ndarray, " n"],
) -> tuple[tuple[Press, ...], list[str]]:
    """The presses that can be measured, and a reason for each of the others."""
    presses, reasons = [], []
    for k, touch in enumerate(touches):
        plateau = find_plateau(even, zero, touch, still)
        free = (touches[k - 1].end if k else float(even.time[0]) - 1.0, touch.begin)
        rest = rest_before(even, *cameras, free, still)
        if reason := why_unread(log, plateau) or ("" if rest else _NO_REST):
            reasons.append(f"press {k + 1}: {reason}")
        elif plateau and rest:
            reading = read_force(log, zero, plateau, 0.5 * (plateau[0] + plateau[1]))
            presses.append(Press(k + 1, f"n{k + 1:02d}", touch, reading, rest))
    return tuple(presses), reasons
