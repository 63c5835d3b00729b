"""Camera pictures on the gauge's clock: clock offsets, times of rest, moments for rest pictures."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import RecordError
from palpate.progress import Progress, part_of, silent
from palpate.recording.clock import Clock, ForceMagnitude, coarse_offset, fine_clock, hysteresis_of
from palpate.recording.force.log import true_runs
from palpate.recording.force.touches import ResampledForce, Touch, Zero
from palpate.recording.pictures.footage import Footage
from palpate.recording.pictures.motion import CameraMotion, camera_motion, still_frames
from palpate.recording.pictures.ramps import RampTimes, camera_ramps
from palpate.recording.recording_file import Recording
from palpate.threads import map_in_threads

# Least time between a touch and the rest picture before it, and least duration of that rest [s].
_MIN_GAP, _MIN_REST = 0.15, 0.2
# Changes of a picture that differ by less than this fraction of the largest count as equal.
_EQUAL_CHANGE = 0.01
# Largest scatter of single presses' offsets, in frames; more means that a clock runs unevenly.
_MAX_SCATTER = 1.0
# A given offset may differ from the estimated one by the largest of: so many standard deviations,
# frames, and fractions of a ramp's duration (the bias that a hysteresis of 30 % causes).
_OFFSET_SIGMAS, _OFFSET_FRAMES, _OFFSET_RAMPS = 5.0, 1.0, 0.15

Span = tuple[float, float]
# Motion in a camera's pictures, and its clock.
Camera = tuple[CameraMotion, Clock]


def synchronise_cameras(
    recording: Recording,
    resampled: ResampledForce,
    zero: Zero,
    touches: Sequence[Touch],
    plateaus: Sequence[Span | None],
    *,
    progress: Progress = silent,
) -> list[Camera]:
    """Motion in every camera's pictures, and its clock offset; each video is decoded twice.

    Parameters
    ----------
    recording : Recording
    resampled, zero : ResampledForce, Zero
    touches, plateaus : sequences   of the same presses, found in the force alone
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Returns
    -------
    list of (motion, clock)         one per camera

    Raises
    ------
    RecordError                     a video that cannot be decoded or shows no press; a clock that
                                    drifts against the gauge's, or contradicts a given offset
    """
    magnitude = np.linalg.norm(resampled.force - zero.at(resampled.time), axis=1)
    known = np.isfinite(magnitude)
    force = ForceMagnitude(
        resampled.time, np.interp(resampled.time, resampled.time[known], magnitude[known])
    )
    # Without a plateau, take the middle of the touch.
    middles = [0.5 * (touch.begin + touch.end) for touch in touches]
    plateau_spans = [plateau or (m, m) for plateau, m in zip(plateaus, middles, strict=True)]
    count = len(recording.footage)

    def process(k: int) -> Camera:
        footage, report = recording.footage[k], part_of(progress, k / count, (k + 1) / count)
        motion = camera_motion(footage, progress=part_of(report, 0.0, 0.5))
        return motion, _clock(footage, motion, force, touches, plateau_spans)

    return list(map_in_threads(process, range(count)))


def _clock(
    footage: Footage,
    motion: CameraMotion,
    force: ForceMagnitude,
    touches: Sequence[Touch],
    plateau_spans: Sequence[Span],
) -> Clock:
    """A camera's clock offset; a given one is checked against the estimate from the pictures."""
    given = footage.offset
    coarse = coarse_offset(force, motion) if given is None else (given, np.nan, None)
    times = [
        RampTimes(*(time - coarse[0] for time in (touch.begin, *rest, touch.end)))
        for touch, rest in zip(touches, plateau_spans, strict=True)
    ]
    ramps = camera_ramps(footage, times)
    found = fine_clock(coarse, force, touches, ramps, footage.camera)
    frame = motion.interval
    if found.scatter > _MAX_SCATTER * frame:
        raise RecordError(
            f"{footage.source}: the clock of camera '{footage.camera}' does not run with the"
            f" gauge's: its offset differs by {1e3 * found.scatter:.0f} ms (one sigma) from press"
            f" to press, a frame is {1e3 * frame:.0f} ms; were frames dropped? Give the time of"
            " each frame as `times`"
        )
    if given is None:
        return found
    difference = abs(found.offset - given)
    ramp = float(
        np.median([a - touch.begin for touch, (a, _) in zip(touches, plateau_spans, strict=True)])
    )
    if difference > max(_OFFSET_SIGMAS * found.std, _OFFSET_FRAMES * frame, _OFFSET_RAMPS * ramp):
        raise RecordError(
            f"{footage.source}: the offset of camera '{footage.camera}' is said to be {given:g} s,"
            f" and its pictures go with the force at {found.offset:.3f} s, {difference / frame:.1f}"
            " frames away: the camera was not synchronised; correct `offset`, or leave it out"
        )
    hysteresis = tuple(
        np.nan if ramp is None else hysteresis_of(force, touch, ramp, given)
        for touch, ramp in zip(touches, ramps, strict=True)
    )
    return replace(found, offset=given, given=True, hysteresis=hysteresis)


def still_pictures(
    resampled: ResampledForce, cameras: Sequence[Camera], plateaus: Sequence[Span | None]
) -> Bool[np.ndarray, " n"]:
    """Times at which all cameras recorded and no motion is seen in any of them.

    Parameters
    ----------
    resampled : ResampledForce
    cameras : sequence of (motion, clock)
    plateaus : sequence of (begin, end) [s] or None     plateaus of the force, gauge's clock

    Returns
    -------
    (n,) bool                       at the times of `resampled`
    """
    still = np.ones(len(resampled.time), dtype=bool)
    for motion, clock in cameras:
        shifted = [(a - clock.offset, b - clock.offset) for a, b in filter(None, plateaus)]
        flags = still_frames(motion, shifted)
        time = motion.time + clock.offset
        # Motion between two frames shows in the later one.
        later = np.searchsorted(time, resampled.time)
        inside = (later > 0) & (later < len(time))
        later = np.clip(later, 1, len(time) - 1)
        contiguous = time[later] - time[later - 1] < 3.0 * motion.interval
        still &= inside & flags[later] & contiguous
    return still


def rest_before(
    resampled: ResampledForce, cameras: Sequence[Camera], free: Span, still: Bool[np.ndarray, " n"]
) -> Span | None:
    """Time span at rest within a pause, chosen so that the tool is least visible.

    Pictures are compared with the first one of each camera, when the tool is away.

    Parameters
    ----------
    resampled : ResampledForce
    cameras : sequence of (motion, clock)
    free : (begin, end) [s]         the pause, without contact
    still : (n,) bool               no motion, at the times of `resampled`

    Returns
    -------
    (begin, end) [s] or None        gauge's clock; None if there is no such span
    """
    time = resampled.time
    at_rest = still & (time > free[0] + _MIN_GAP) & (time < free[1] - _MIN_GAP)
    length = max(2, round(_MIN_REST / resampled.step))
    best: tuple[float, Span] | None = None
    for first, last in true_runs(at_rest):
        if last - first < length:
            continue
        change = _total_change(cameras, time[first:last])
        mean = np.convolve(change, np.ones(length) / length, "valid")
        smallest = float(mean.min())
        if best is None or smallest < best[0]:
            # Many spans are nearly as good; take their middle, farthest from any motion.
            equal = np.flatnonzero(mean < smallest + _EQUAL_CHANGE * len(cameras))
            k = first + int(equal[len(equal) // 2])
            best = smallest, (float(time[k]), float(time[k + length - 1]))
    return None if best is None else best[1]


def _total_change(
    cameras: Sequence[Camera], time: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Sum over the cameras of the change since the first picture, each relative to its maximum."""
    parts = [
        np.interp(time - clock.offset, motion.time, motion.change) / max(motion.change.max(), 1e-12)
        for motion, clock in cameras
    ]
    return np.sum(parts, axis=0)
