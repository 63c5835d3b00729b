"""Camera pictures on the gauge's clock: offsets of the clocks, times of rest.

Motion and force of the same presses give the offset between a camera's clock and the gauge's. A
coarse search maximises the correlation of the picture's change with the force over the whole
recording. A fine search then finds, for each press, the offset at which the force is best explained
as a smooth function of the displacement in the picture, the same for loading and unloading.
Hysteresis of the material biases this offset by half its fraction of the force times the duration
of a ramp. That is harmless: pictures are taken on plateaus, where a tenth of a second would do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import RecordError
from palpate.progress import Progress, part_of, silent
from palpate.recording.footage import (
    MARGIN,
    CameraMotion,
    Footage,
    RampTimes,
    Signal,
    Span,
    camera_motion,
    camera_ramps,
    still_frames,
)
from palpate.recording.force_log import true_runs
from palpate.recording.recording_file import Recording
from palpate.recording.touches import ResampledForce, Touch, Zero
from palpate.threads import map_in_threads

# Step of the coarse search [s].
_COARSE_STEP = 0.02
# Least overlap of the two signals, as a fraction of the shorter one.
_MIN_OVERLAP = 0.5
# Least correlation of picture and force; another offset with this fraction of the best correlation
# makes the result doubtful.
_MIN_CORRELATION, _RIVAL_CORRELATION = 0.3, 0.95
# Presses whose intervals are equal within this time [s] can be mistaken for each other.
_SAME_INTERVAL = 0.05
# Least force for certain contact, as a fraction of the peak: before contact the tool moves without
# force.
_CONTACT_FORCE = 0.15
# The same if the clocks' offset is known.
_CONTACT_FORCE_KNOWN_OFFSET = 0.02
# Degree of the polynomial that relates displacement and force.
_DEGREE = 3
# Least number of pictures of a press for fitting that polynomial.
_MIN_PICTURES = 2 * (_DEGREE + 1)
# Steps of the fine search in its first and second round [s].
_FINE_STEP, _FINEST_STEP = 0.01, 0.002
# Fractions of the displacement at which loading and unloading are compared.
_COMPARED_FRACTIONS = np.linspace(0.3, 0.9, 7)
# Least time between a touch and the rest picture before it, and least duration of that rest [s].
_MIN_GAP, _MIN_REST = 0.15, 0.2
# Changes of a picture that differ by less than this fraction of the largest count as equal.
_EQUAL_CHANGE = 0.01
# Largest scatter of single presses' offsets, in frames; more means that a clock runs unevenly.
_MAX_SCATTER = 1.0
# A given offset may differ from the estimated one by the largest of: so many standard deviations,
# frames, and fractions of a ramp's duration (the bias that a hysteresis of 30 % causes).
_OFFSET_SIGMAS, _OFFSET_FRAMES, _OFFSET_RAMPS = 5.0, 1.0, 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Clock:
    """A camera's clock relative to the gauge's.

    Attributes
    ----------
    camera : str
    offset : float [s]              gauge's time minus the camera's
    std : float [s]                 of the offset, from the scatter over the presses; NaN: unknown
    correlation : float [-]         of the picture's change with the force, over the recording; NaN
                                    if the offset was given
    scatter : float [s]             standard deviation of single presses' offsets; NaN: unknown
    hysteresis : tuple of float [-] for each press: excess of the force in loading over that in
                                    unloading at the same picture, as a fraction of the full force;
                                    NaN if unknown, as always for an estimated offset, which cannot
                                    be distinguished from hysteresis
    given : bool                    the offset was given, not estimated
    rival_offset : float [s] or None    another offset that fits nearly as well
    """

    camera: str
    offset: float
    std: float
    correlation: float
    scatter: float
    hysteresis: tuple[float, ...]
    given: bool = False
    rival_offset: float | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """Doubts about the offset, as sentences without full stop."""
        if self.rival_offset is None:
            return ()
        text = (
            f"camera {self.camera}: the clocks' offset is {self.offset:.3f} s, but"
            f" {self.rival_offset:.1f} s fits nearly as well: the presses are too alike; make"
            " pauses of different length, or give `offset`"
        )
        return (text,)


def coarse_offset(force: Signal, motion: CameraMotion) -> tuple[float, float, float | None]:
    """Offset that maximises the correlation of the picture's change with the force.

    Parameters
    ----------
    force : (n,) float [s], (n,) float [N]  times of the gauge, and the force's magnitude without
                                    weight and drift
    motion : CameraMotion

    Returns
    -------
    offset : float [s]              to a fraction of a second: the tool is also seen before contact
    correlation : float [-]         at that offset
    rival_offset : float [s] or None    the best distant offset, if it is nearly as good

    Raises
    ------
    RecordError                     the picture's change does not correlate with the force
    """
    gauge = _resampled(*force)
    camera = _resampled(motion.time, motion.change)
    # Cross-correlation by FFT; importing scipy.signal would cost every command half a second.
    size = len(gauge) + len(camera) - 1
    product = np.fft.irfft(np.fft.rfft(gauge, size) * np.fft.rfft(camera[::-1], size), size)
    # In entry [len(camera) - 1] both signals begin at the same time.
    lag = np.arange(len(product)) - (len(camera) - 1)
    shared = np.minimum(len(gauge), lag + len(camera)) - np.maximum(lag, 0)
    product[shared < _MIN_OVERLAP * min(len(gauge), len(camera))] = -np.inf
    quality = product / max(float(np.linalg.norm(gauge) * np.linalg.norm(camera)), 1e-300)
    best = int(quality.argmax())
    correlation = float(quality[best])
    if correlation < _MIN_CORRELATION:
        raise RecordError(
            f"camera '{motion.camera}': its pictures do not change with the force at any offset of"
            f" the clocks (correlation {correlation:.2f} at best; {_MIN_CORRELATION} is needed):"
            " is it the video of these presses, and is the object in it? Give `offset` if the"
            " clocks are known"
        )
    begin = float(force[0][0] - motion.time[0])
    is_distant = np.abs(lag - lag[best]) * _COARSE_STEP > 2.0 * MARGIN
    other = int(np.where(is_distant, quality, -np.inf).argmax())
    has_rival = is_distant.any() and quality[other] > _RIVAL_CORRELATION * correlation
    rival_offset = begin + float(lag[other]) * _COARSE_STEP if has_rival else None
    return begin + float(lag[best]) * _COARSE_STEP, correlation, rival_offset


def _resampled(time: Float[np.ndarray, " n"], values: Float[np.ndarray, " n"]) -> np.ndarray:
    """Values resampled at equal steps, minus their mean."""
    resampled = np.interp(np.arange(time[0], time[-1], _COARSE_STEP), time, values)
    return resampled - resampled.mean()


def fine_clock(
    coarse: tuple[float, float, float | None],
    force: Signal,
    touches: Sequence[Touch],
    ramps: Sequence[Signal | None],
    camera: str,
) -> Clock:
    """Offset at which the force is best explained by the displacement in the picture.

    Parameters
    ----------
    coarse : offset, correlation, rival_offset  of `coarse_offset`
    force : times, magnitude        as in `coarse_offset`
    touches, ramps : sequences      of the same presses; a ramp is None if the camera missed it
    camera : str

    Returns
    -------
    Clock

    Raises
    ------
    RecordError                     the camera saw none of the presses, or too few pictures of each
    """
    visible = [(t, r) for t, r in zip(touches, ramps, strict=True) if r is not None]
    if not visible:
        raise RecordError(
            f"camera '{camera}': its recording shows none of the {len(touches)} presses; is it"
            " shorter than the force log?"
        )

    def unexplained(offset: float) -> np.ndarray:
        return np.array([_unexplained(force, touch, ramp, offset) for touch, ramp in visible])

    offset, width, step = coarse[0], 0.9 * MARGIN, _FINE_STEP
    for _ in range(2):
        trial = offset + np.arange(-width, width + step / 2, step)
        cost = np.stack([unexplained(value) for value in trial])
        # The cost is unknown at offsets at which no press is seen.
        known = np.isfinite(cost).any(axis=1)
        if not known.any():
            raise RecordError(
                f"camera '{camera}': its pictures lie too far apart to tell its clock, fewer than"
                f" {_MIN_PICTURES} of each press; is the frame rate right?"
            )
        mean = np.full(len(trial), np.nan)
        mean[known] = np.nanmean(cost[known], axis=1)
        offset = _parabola_minimum(trial, mean)
        width, step = 4.0 * _FINE_STEP, _FINEST_STEP
    single = np.array(
        [
            _parabola_minimum(trial, press_cost)
            for press_cost in cost.T
            if np.isfinite(press_cost).all()
        ]
    )
    scatter = float(single.std(ddof=1)) if len(single) > 1 else np.nan
    unknown = (np.nan,) * len(touches)
    std = scatter / np.sqrt(max(len(single), 1))
    rival_offset = coarse[2]
    if rival_offset is not None and not _repeats_itself(touches, rival_offset - offset):
        rival_offset = None
    return Clock(camera, offset, std, coarse[1], scatter, unknown, rival_offset=rival_offset)


def _repeats_itself(touches: Sequence[Touch], shift: float) -> bool:
    """Whether the sequence of presses matches itself after a shift in time [s].

    If the pauses differ, each press would need another offset.
    """
    begin = np.array([touch.begin for touch in touches])
    distance = begin[:, None] - (begin + shift)
    nearest = distance[np.abs(distance).argmin(axis=0), np.arange(len(begin))]
    inside = (begin + shift > begin[0] - MARGIN) & (begin + shift < begin[-1] + MARGIN)
    return inside.sum() < 2 or float(nearest[inside].std()) < _SAME_INTERVAL


def _parabola_minimum(trial: Float[np.ndarray, " t"], cost: Float[np.ndarray, " t"]) -> float:
    """Minimum of a parabola through the lowest value and its neighbours."""
    k = int(np.clip(np.nanargmin(cost), 1, len(trial) - 2))
    below, here, above = cost[k - 1 : k + 2]
    curvature = below - 2.0 * here + above
    shift = 0.5 * (below - above) / curvature if curvature > 0.0 else 0.0
    return float(trial[k] + np.clip(shift, -1.0, 1.0) * (trial[1] - trial[0]))


def _in_contact(
    force: Signal,
    touch: Touch,
    ramp: Signal,
    offset: float,
    min_force: float = _CONTACT_FORCE,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, displacement fractions and forces of the frames with certain contact."""
    time = ramp[0] + offset
    magnitude = np.interp(time, *force)
    inside = (time > touch.begin) & (time < touch.end) & (magnitude > min_force * touch.peak)
    return time[inside], ramp[1][inside], magnitude[inside]


def _unexplained(force: Signal, touch: Touch, ramp: Signal, offset: float) -> float:
    """Fraction of the force's variance not explained by the picture; NaN if too few frames."""
    _, progress, magnitude = _in_contact(force, touch, ramp, offset)
    if len(progress) < _MIN_PICTURES:
        return np.nan
    powers = np.vander(progress, _DEGREE + 1)
    residual = magnitude - powers @ np.linalg.lstsq(powers, magnitude, rcond=None)[0]
    return float(
        residual @ residual / max(float(np.square(magnitude - magnitude.mean()).sum()), 1e-300)
    )


def hysteresis_of(force: Signal, touch: Touch, ramp: Signal, offset: float) -> float:
    """Excess of the force in loading over that in unloading, at the same picture.

    Only meaningful with a known offset: on equal ramps an error of the offset has the same effect.

    Parameters
    ----------
    force : times, magnitude        as in `coarse_offset`
    touch, ramp : Touch, Signal     of one press
    offset : float [s]              gauge's time minus the camera's

    Returns
    -------
    float [-]                       mean over the displacement, as a fraction of the full force;
                                    NaN if too few frames
    """
    time, progress, magnitude = _in_contact(force, touch, ramp, offset, _CONTACT_FORCE_KNOWN_OFFSET)
    middle = 0.5 * (touch.begin + touch.end)
    levels = []
    for rows in (time < middle, time > middle):
        if rows.sum() < 4:
            return np.nan
        order = np.argsort(progress[rows])
        ordered = progress[rows][order]
        levels.append(
            np.interp(
                _COMPARED_FRACTIONS, ordered, magnitude[rows][order], left=np.nan, right=np.nan
            )
        )
    difference = levels[0] - levels[1]
    known = np.isfinite(difference)
    return float(difference[known].mean() / touch.peak) if known.any() else np.nan


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
    force = (
        resampled.time, np.interp(resampled.time, resampled.time[known], magnitude[known])
    )  # fmt: skip
    # Without a plateau, take the middle of the touch.
    middles = [0.5 * (touch.begin + touch.end) for touch in touches]
    plateau_spans = [plateau or (m, m) for plateau, m in zip(plateaus, middles, strict=True)]
    count = len(recording.footage)

    def process(k: int) -> Camera:
        footage = recording.footage[k]
        camera_progress = part_of(progress, k / count, (k + 1) / count)
        motion = camera_motion(footage, progress=part_of(camera_progress, 0.0, 0.5))
        return motion, _clock(footage, motion, force, touches, plateau_spans)

    return list(map_in_threads(process, range(count)))


def _clock(
    footage: Footage,
    motion: CameraMotion,
    force: Signal,
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
    clock = fine_clock(coarse, force, touches, ramps, footage.camera)
    frame = motion.interval
    if clock.scatter > _MAX_SCATTER * frame:
        raise RecordError(
            f"{footage.source}: the clock of camera '{footage.camera}' does not run with the"
            f" gauge's: its offset differs by {1e3 * clock.scatter:.0f} ms (one sigma) from press"
            f" to press, a frame is {1e3 * frame:.0f} ms; were frames dropped? Give the time of"
            " each frame as `times`"
        )
    if given is None:
        return clock
    difference = abs(clock.offset - given)
    ramp = float(
        np.median([a - touch.begin for touch, (a, _) in zip(touches, plateau_spans, strict=True)])
    )
    if difference > max(_OFFSET_SIGMAS * clock.std, _OFFSET_FRAMES * frame, _OFFSET_RAMPS * ramp):
        raise RecordError(
            f"{footage.source}: the offset of camera '{footage.camera}' is said to be {given:g} s,"
            f" and its pictures go with the force at {clock.offset:.3f} s, {difference / frame:.1f}"
            " frames away: the camera was not synchronised; correct `offset`, or leave it out"
        )
    hysteresis = tuple(
        np.nan if ramp is None else hysteresis_of(force, touch, ramp, given)
        for touch, ramp in zip(touches, ramps, strict=True)
    )
    return replace(clock, offset=given, given=True, hysteresis=hysteresis)


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
