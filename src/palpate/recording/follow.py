"""Camera pictures on the gauge's clock: clock offsets, times of rest, moments for rest pictures."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numba
import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import RecordError
from palpate.progress import Progress, part_of, silent
from palpate.recording.clock import Clock, SizeOfForce, coarse_offset, fine_clock, hysteresis_of
from palpate.recording.force import EvenForce, Touch, Zero, true_runs
from palpate.recording.pictures import (
    CameraMotion,
    Footage,
    RampTimes,
    camera_motion,
    camera_ramps,
    still_frames,
)
from palpate.recording.recording_file import Recording

# Least time between a touch and the rest picture before it, and least duration of that rest [s].
_AWAY, _REST = 0.15, 0.2
# Changes of a picture that differ by less than this fraction of the largest count as equal.
_AS_GOOD = 0.01
# Largest scatter of single presses' offsets, in frames; more means that a clock runs unevenly.
_MOST_SCATTER = 1.0
# A given offset may differ from the estimated one by the largest of: so many standard deviations,
# frames, and fractions of a ramp's duration (the bias that a hysteresis of 30 % causes).
_SIGMAS, _FRAMES, _RAMPS = 5.0, 1.0, 0.15

Span = tuple[float, float]


def follow(
    recording: Recording,
    even: EvenForce,
    zero: Zero,
    touches: Sequence[Touch],
    plateaus: Sequence[Span | None],
    *,
    progress: Progress = silent,
) -> tuple[tuple[CameraMotion, ...], tuple[Clock, ...]]:
    """Motion in every camera's pictures, and its clock offset; each video is decoded twice.

    Parameters
    ----------
    recording : Recording
    even, zero : EvenForce, Zero
    touches, plateaus : sequences   of the same presses, found in the force alone
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    motions, clocks : tuples        one of each per camera

    Raises
    ------
    RecordError                     a video that cannot be decoded or shows no press; a clock that
                                    drifts against the gauge's, or contradicts a given offset
    """
    size = np.linalg.norm(even.force - zero.at(even.time), axis=1)
    known = np.isfinite(size)
    force = SizeOfForce(even.time, np.interp(even.time, even.time[known], size[known]))
    # Without a plateau, take the middle of the touch.
    middles = [0.5 * (touch.begin + touch.end) for touch in touches]
    rests = [plateau or (m, m) for plateau, m in zip(plateaus, middles, strict=True)]
    count = len(recording.footage)

    def work(k: int) -> tuple[CameraMotion, Clock]:
        footage, say = recording.footage[k], part_of(progress, k / count, (k + 1) / count)
        motion = camera_motion(footage, progress=part_of(say, 0.0, 0.5))
        return motion, _clock(footage, motion, force, touches, rests)

    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        found = list(pool.map(work, range(count)))
    motions, clocks = zip(*found, strict=True)
    return motions, clocks


def _clock(
    footage: Footage,
    motion: CameraMotion,
    force: SizeOfForce,
    touches: Sequence[Touch],
    rests: Sequence[Span],
) -> Clock:
    """A camera's clock offset; a given one is checked against the estimate from the pictures."""
    told = footage.offset
    coarse = coarse_offset(force, motion) if told is None else (told, np.nan, None)
    times = [
        RampTimes(*(time - coarse[0] for time in (touch.begin, *rest, touch.end)))
        for touch, rest in zip(touches, rests, strict=True)
    ]
    ramps = camera_ramps(footage, times)
    found = fine_clock(coarse, force, touches, ramps, footage.camera)
    frame = motion.interval
    if found.scatter > _MOST_SCATTER * frame:
        raise RecordError(
            f"{footage.source}: the clock of camera '{footage.camera}' does not run with the"
            f" gauge's: its offset differs by {1e3 * found.scatter:.0f} ms (one sigma) from press"
            f" to press, a frame is {1e3 * frame:.0f} ms; were frames dropped? Give the time of"
            " each frame as `times`"
        )
    if told is None:
        return found
    away = abs(found.offset - told)
    ramp = float(np.median([a - touch.begin for touch, (a, _) in zip(touches, rests, strict=True)]))
    if away > max(_SIGMAS * found.std, _FRAMES * frame, _RAMPS * ramp):
        raise RecordError(
            f"{footage.source}: the offset of camera '{footage.camera}' is said to be {told:g} s,"
            f" and its pictures go with the force at {found.offset:.3f} s, {away / frame:.1f}"
            " frames away: the camera was not synchronised; correct `offset`, or leave it out"
        )
    hysteresis = tuple(
        np.nan if ramp is None else hysteresis_of(force, touch, ramp, told)
        for touch, ramp in zip(touches, ramps, strict=True)
    )
    return replace(found, offset=told, given=True, hysteresis=hysteresis)


def still_pictures(
    even: EvenForce,
    motions: Sequence[CameraMotion],
    clocks: Sequence[Clock],
    plateaus: Sequence[Span | None],
) -> Bool[np.ndarray, " n"]:
    """Times at which all cameras recorded and no motion is seen in any of them.

    Parameters
    ----------
    even : EvenForce
    motions, clocks : sequences     one per camera
    plateaus : sequence of (begin, end) [s] or None     plateaus of the force, gauge's clock

    Returns
    -------
    (n,) bool                       at the times of `even`
    """
    still = np.ones(len(even.time), dtype=bool)
    for motion, clock in zip(motions, clocks, strict=True):
        shifted = [(a - clock.offset, b - clock.offset) for a, b in filter(None, plateaus)]
        flags = still_frames(motion, shifted)
        time = motion.time + clock.offset
        # Motion between two frames shows in the later one.
        later = np.searchsorted(time, even.time)
        inside = (later > 0) & (later < len(time))
        later = np.clip(later, 1, len(time) - 1)
        whole = time[later] - time[later - 1] < 3.0 * motion.interval
        still &= inside & flags[later] & whole
    return still


def rest_before(
    even: EvenForce,
    motions: Sequence[CameraMotion],
    clocks: Sequence[Clock],
    free: Span,
    still: Bool[np.ndarray, " n"],
) -> Span | None:
    """Time span at rest within a pause, chosen so that the tool is least visible.

    Pictures are compared with the first one of each camera, when the tool is away.

    Parameters
    ----------
    even : EvenForce
    motions, clocks : sequences     one per camera
    free : (begin, end) [s]         the pause, without contact
    still : (n,) bool               no motion, at the times of `even`

    Returns
    -------
    (begin, end) [s] or None        gauge's clock; None if there is no such span
    """
    time = even.time
    quiet = still & (time > free[0] + _AWAY) & (time < free[1] - _AWAY)
    length = max(2, round(_REST / even.step))
    best: tuple[float, Span] | None = None
    for first, last in true_runs(quiet):
        if last - first < length:
            continue
        change = _change(motions, clocks, time[first:last])
        mean = np.convolve(change, np.ones(length) / length, "valid")
        least = float(mean.min())
        if best is None or least < best[0]:
            # Many spans are nearly as good; take their middle, farthest from any motion.
            good = np.flatnonzero(mean < least + _AS_GOOD * len(motions))
            k = first + int(good[len(good) // 2])
            best = least, (float(time[k]), float(time[k + length - 1]))
    return None if best is None else best[1]


def _change(
    motions: Sequence[CameraMotion], clocks: Sequence[Clock], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Sum over the cameras of the change since the first picture, each relative to its maximum."""
    parts = [
        np.interp(time - clock.offset, motion.time, motion.change) / max(motion.change.max(), 1e-12)
        for motion, clock in zip(motions, clocks, strict=True)
    ]
    return np.sum(parts, axis=0)
