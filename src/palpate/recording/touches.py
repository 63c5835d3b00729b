"""Contacts of the tool with the object, their plateaus with the force on them, and the zero.

The gauge's zero without contact is weight and drift; creep bounds a plateau. Everything here is
derived from the force alone.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from palpate.arrays import STD_OVER_MEDIAN
from palpate.errors import RecordError
from palpate.recording.force_log import ForceLog, true_runs

# Readings are averaged over bins of this length [s].
_BIN_SECONDS = 0.02
# A touch begins where the force differs from the zero by so many standard deviations and by this
# fraction of the largest force of all; it ends below that threshold, or below this fraction of its
# own peak.
_BEGIN_SIGMAS, _BEGIN_FRACTION, _END_FRACTION = 6.0, 0.01, 0.05
# Time constant with which the zero is tracked [s]: so long that a slow push is not taken for drift.
_ZERO_TIME_CONSTANT = 2.0
# Least duration of a state, contact or none, to count [s]; and largest change of the force during
# that time at the end of a touch, as a fraction of the threshold.
_MIN_STATE_SECONDS, _REST_CHANGE = 0.06, 0.5
# A touch that is shorter [s], or weaker than so many thresholds, is a knock.
_MIN_TOUCH_SECONDS, _MIN_TOUCH_PEAK = 0.3, 3.0
# Least distance in time from a touch at which the zero is read, and duration of that reading [s].
_ZERO_DISTANCE, _ZERO_SECONDS = 0.15, 1.0
# Time without contact required at the beginning [s], and largest scatter of the force in it, as a
# fraction of the largest force.
_START_SECONDS, _MAX_START_SCATTER = 0.5, 0.1
# Standard deviation of second differences over that of the readings; and the rms length of a normal
# vector of one, two and three components over its median length.
_SECOND_DIFFERENCE_STD, _RMS_OVER_MEDIAN = np.sqrt(6.0), (STD_OVER_MEDIAN, 1.2011, 1.1260)
# Half the window for slopes of the force [s].
_HALF_WINDOW = 0.12
# At rest the force changes by less than this fraction of itself per second, or by less than this
# many standard deviations of the slope's noise.
_MAX_CREEP, _NOISE_SIGMAS = 0.03, 5.0
# Least force of a plateau as a fraction of the touch's peak.
_MIN_PEAK_FRACTION = 0.7
# Least duration of a plateau [s]; time cut off at either end [s].
_MIN_DURATION, _TRIM = 0.25, 0.04


@dataclass(frozen=True, slots=True, eq=False)
class ResampledForce:
    """Force resampled at equal time steps.

    Attributes
    ----------
    time : (n,) float [s]           gauge's clock
    force : (n, 3) float [N]        mean of the readings around each time; NaN within gaps
    noise : float [N]               rms length of the noise vector of one of these values
    """

    time: Float[np.ndarray, " n"]
    force: Float[np.ndarray, "n 3"]
    noise: float

    @property
    def step(self) -> float:
        """Time step [s]."""
        return float(self.time[1] - self.time[0])


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """One contact of the tool with the object.

    Attributes
    ----------
    begin, end : float [s]          gauge's clock; without a seen end, the end of the log
    peak : float [N]                largest force
    ended : bool                    the end of the contact is in the log
    """

    begin: float
    end: float
    peak: float
    ended: bool


@dataclass(frozen=True, slots=True, eq=False)
class Zero:
    """Zero of the gauge, its reading without contact: weight of the tool and drift.

    Attributes
    ----------
    time : (j,) float [s]           times at which it was read
    value : (j, 3) float [N]        readings
    std : float [N]                 standard deviation of a component of one reading
    interpolation_std : (3,) float [N]  standard deviation of the drift from linear interpolation,
                                    midway between two readings, if it is a random walk; an upper
                                    bound for a smooth drift
    """

    time: Float[np.ndarray, " j"]
    value: Float[np.ndarray, "j 3"]
    std: float
    interpolation_std: Float[np.ndarray, "3"]

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
        """Zero at given times, by linear interpolation between the readings.

        Parameters
        ----------
        time : (n,) float [s]

        Returns
        -------
        (n, 3) float [N]
        """
        return np.column_stack([np.interp(time, self.time, part) for part in self.value.T])

    @property
    def drift(self) -> float:
        """Largest difference between two readings of the zero [N]."""
        return float(np.linalg.norm(self.value[:, None] - self.value[None], axis=2).max())


def resample_force(log: ForceLog) -> ResampledForce:
    """Resample a force log at equal time steps.

    Parameters
    ----------
    log : ForceLog

    Returns
    -------
    ResampledForce
    """
    step = max(_BIN_SECONDS, 1.01 * float(np.median(np.diff(log.time))))
    count = int((log.time[-1] - log.time[0]) / step) + 1
    time = log.time[0] + step * (np.arange(count) + 0.5)
    number = np.minimum(((log.time - log.time[0]) / step).astype(int), count - 1)
    readings = np.bincount(number, minlength=count)
    filled = readings > 0

    def mean(values: Float[np.ndarray, " n"]) -> Float[np.ndarray, " k"]:
        total: np.ndarray = np.bincount(number, values, count)[filled]
        return total / readings[filled]

    # The mean time of the readings is not the middle of the bin: correct for it by interpolation.
    mean_time = mean(log.time)
    force = np.column_stack([np.interp(time, mean_time, mean(part)) for part in log.force.T])
    for begin, end in log.gaps:
        force[(time > begin) & (time < end)] = np.nan
    second_difference = np.diff(force, n=2, axis=0)
    second_difference = (
        np.linalg.norm(second_difference[np.isfinite(second_difference).all(axis=1)], axis=1)
        / _SECOND_DIFFERENCE_STD
    )
    return ResampledForce(
        time, force, float(np.median(second_difference)) * _RMS_OVER_MEDIAN[len(log.axes) - 1]
    )


def find_touches(resampled: ResampledForce) -> tuple[tuple[Touch, ...], int]:
    """Find the contacts of the tool with the object, and the number of knocks that were ignored.

    The log must begin with the tool off the object.

    Parameters
    ----------
    resampled : ResampledForce

    Returns
    -------
    touches : tuple of Touch        in order of time
    knocks : int                    number of contacts too short or too weak to be presses

    Raises
    ------
    RecordError                     the force is not quiet at the beginning
    """
    known = np.isfinite(resampled.force).all(axis=1)
    time, force = resampled.time[known], resampled.force[known]
    zero, limit = _initial_zero(time, force, resampled.noise)
    settled_steps = max(1, round(_MIN_STATE_SECONDS / resampled.step))
    weight = min(resampled.step / _ZERO_TIME_CONSTANT, 1.0)
    touches: list[Touch] = []
    knocks, begin, peak, count = 0, -1, 0.0, 0
    for k, value in enumerate(force):
        size = float(np.linalg.norm(value - zero))
        if begin < 0:
            count = count + 1 if size > limit else 0
            if count >= settled_steps:
                begin, peak, count = k - settled_steps + 1, size, 0
            elif count == 0:
                zero = zero + weight * (value - zero)
            continue
        peak = max(peak, size)
        # The end of the unloading must not be taken for the zero: the force must be at rest.
        moved = float(np.linalg.norm(value - force[max(k - settled_steps, 0)]))
        low = size < max(limit, _END_FRACTION * peak) and moved < _REST_CHANGE * limit
        count = count + 1 if low else 0
        if count >= settled_steps:
            touch = Touch(float(time[begin]), float(time[k - settled_steps + 1]), peak, True)
            knocks += _add_unless_knock(touches, touch, limit)
            zero, begin, count = force[k - settled_steps + 1 : k + 1].mean(axis=0), -1, 0
    if begin >= 0:
        knocks += _add_unless_knock(
            touches, Touch(float(time[begin]), float(time[-1]), peak, False), limit
        )
    return tuple(touches), knocks


def _initial_zero(
    time: Float[np.ndarray, " n"], force: Float[np.ndarray, "n 3"], noise: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Zero at the beginning, and the threshold by which a force must differ from it."""
    first = force[time < time[0] + _START_SECONDS]
    zero = np.median(first, axis=0)
    largest = float(np.linalg.norm(force - zero, axis=1).max())
    scatter = float(np.sqrt(((first - zero) ** 2).sum(axis=1).mean()))
    if scatter > max(_MAX_START_SCATTER * largest, 3.0 * noise):
        raise RecordError(
            f"the force changes by {scatter:.3g} N within the first {_START_SECONDS} s, up to"
            f" {largest:.3g} N later on: the recording must begin with the tool at rest and off the"
            " object, or the tool's weight is not known; cut off what is before"
        )
    return zero, max(_BEGIN_SIGMAS * max(noise, scatter), _BEGIN_FRACTION * largest)


def _add_unless_knock(touches: list[Touch], touch: Touch, limit: float) -> bool:
    """Add a touch if it is a press; True if it is a knock."""
    if touch.end - touch.begin < _MIN_TOUCH_SECONDS or touch.peak < _MIN_TOUCH_PEAK * limit:
        return True
    touches.append(touch)
    return False


def find_zero(log: ForceLog, touches: tuple[Touch, ...]) -> Zero:
    """The gauge's zero before, between and after the touches.

    Parameters
    ----------
    log : ForceLog
    touches : tuple of Touch

    Returns
    -------
    Zero

    Raises
    ------
    RecordError                     no time without contact
    """
    begins = [log.time[0] - _ZERO_DISTANCE, *(touch.end for touch in touches if touch.ended)]
    ends = [*(touch.begin for touch in touches), log.time[-1] + _ZERO_DISTANCE][: len(begins)]
    parts: list[Bool[np.ndarray, " n"]] = []
    for begin, end in zip(begins, ends, strict=True):
        low, high = begin + _ZERO_DISTANCE, end - _ZERO_DISTANCE
        windows = [(low, high)]
        if high - low > 2.0 * _ZERO_SECONDS:
            windows = [(low, low + _ZERO_SECONDS), (high - _ZERO_SECONDS, high)]
        parts += [(log.time >= a) & (log.time <= b) for a, b in windows]
    parts = [part for part in parts if part.sum() >= 2]
    if not parts:
        raise RecordError(
            f"{log.source}: there is no time without contact; lift the tool off the object for a"
            " second before and between the presses"
        )
    time = np.array([log.time[part].mean() for part in parts])
    value = np.stack([log.force[part].mean(axis=0) for part in parts])
    std = max(float(mean_std(log.force[part]).max()) for part in parts)
    return Zero(time, value, std, _interpolation_std(time, value))


def mean_std(values: Float[np.ndarray, "n k"]) -> Float[np.ndarray, " k"]:
    """Standard deviation of the mean of consecutive readings.

    Neighbouring readings may be correlated, e.g. by a filter: the effective number of independent
    readings is that of a first-order autoregressive process with the same lag-one correlation.

    Parameters
    ----------
    values : (n, k) float           readings in order of time, n >= 2

    Returns
    -------
    (k,) float                      in the unit of the values
    """
    deviation = values - values.mean(axis=0)
    variance = (deviation**2).sum(axis=0) / max(len(deviation) - 1, 1)
    product = (deviation[1:] * deviation[:-1]).sum(axis=0) / max(len(deviation) - 1, 1)
    correlation = np.clip(product / np.where(variance > 0.0, variance, 1.0), 0.0, 0.99)
    return np.sqrt(variance / len(deviation) * (1.0 + correlation) / (1.0 - correlation))


def _interpolation_std(
    time: Float[np.ndarray, " j"], value: Float[np.ndarray, "j 3"]
) -> np.ndarray:
    """Standard deviation of each component from linear interpolation, midway between two zeros.

    For a random walk, its variance is half that of a zero from the line through its two neighbours,
    which is measured.
    """
    if len(time) < 2:
        return np.zeros(3)
    if len(time) < 3:
        # A straight line fits two values whatever they are: allow for half their difference.
        return np.abs(value[1] - value[0]) / 2.0
    weight = ((time[1:-1] - time[:-2]) / (time[2:] - time[:-2]))[:, None]
    deviation = value[1:-1] - (1.0 - weight) * value[:-2] - weight * value[2:]
    std: np.ndarray = np.sqrt((deviation**2).mean(axis=0) / 2.0)
    return std


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Force on the plateau of one press.

    Attributes
    ----------
    begin, end : float [s]          of the plateau, gauge's clock
    time : float [s]                of the picture under load, to which the force refers
    force : (3,) float [N]          on the object
    std : (3,) float [N]            from the scatter on the plateau and of the zero, and its drift
    creep : float [-]               relative change of the force over the plateau
    """

    begin: float
    end: float
    time: float
    force: Float[np.ndarray, "3"]
    std: Float[np.ndarray, "3"]
    creep: float


def still_force(resampled: ResampledForce, zero: Zero) -> Bool[np.ndarray, " n"]:
    """Times at which the force changes by no more than noise and a bounded creep.

    Parameters
    ----------
    resampled : ResampledForce
    zero : Zero

    Returns
    -------
    (n,) bool                       at the times of `resampled`; False within and next to gaps
    """
    half = max(1, round(_HALF_WINDOW / resampled.step))
    kernel = np.concatenate([np.ones(half), np.zeros(1), -np.ones(half)]) / half
    span = (half + 1) * resampled.step
    known = np.isfinite(resampled.force)
    filled = np.where(known, resampled.force, 0.0)
    slope = np.column_stack([np.convolve(part, kernel, "same") for part in filled.T]) / span
    size = np.linalg.norm(filled - zero.at(resampled.time), axis=1)
    noise = resampled.noise * np.sqrt(2.0 / half) / span
    still = np.linalg.norm(slope, axis=1) <= np.maximum(_NOISE_SIGMAS * noise, _MAX_CREEP * size)
    complete = np.convolve(known.all(axis=1), np.ones(2 * half + 1), "same") > 2 * half
    return still & complete


def find_plateau(
    resampled: ResampledForce, zero: Zero, touch: Touch, still: Bool[np.ndarray, " n"]
) -> tuple[float, float] | None:
    """The longest span at rest near the peak force of a touch.

    Parameters
    ----------
    resampled : ResampledForce
    zero : Zero
    touch : Touch
    still : (n,) bool               at rest, at the times of `resampled`

    Returns
    -------
    (begin, end) [s] or None        None if there is none
    """
    size = np.linalg.norm(resampled.force - zero.at(resampled.time), axis=1)
    inside = (resampled.time >= touch.begin) & (resampled.time <= touch.end)
    runs = true_runs(still & inside & (size > _MIN_PEAK_FRACTION * touch.peak))
    if not runs:
        return None
    first, last = max(runs, key=lambda run: run[1] - run[0])
    begin, end = resampled.time[first] + _TRIM, resampled.time[last - 1] - _TRIM
    return (float(begin), float(end)) if end - begin >= _MIN_DURATION else None


def read_force(log: ForceLog, zero: Zero, plateau: tuple[float, float], time: float) -> Reading:
    """Force at one moment of a plateau, from all its readings.

    Value of a straight line fitted to the readings minus the zero: slow creep would bias the mean.

    Parameters
    ----------
    log : ForceLog
    zero : Zero
    plateau : (begin, end) [s]
    time : float [s]                within the plateau

    Returns
    -------
    Reading
    """
    begin, end = plateau
    rows = (log.time >= begin) & (log.time <= end)
    relative_time = log.time[rows] - time
    force = log.force[rows] - zero.at(log.time[rows])
    line = np.column_stack([np.ones_like(relative_time), relative_time])
    solution = np.linalg.lstsq(line, force, rcond=None)[0]
    residual = force - line @ solution
    # Variance of the line at that moment, relative to that of the mean of the readings.
    lever = 1.0 + (relative_time.mean() ** 2) / max(float(relative_time.var()), 1e-12)
    reading_std = np.hypot(mean_std(residual) * np.sqrt(lever), zero.interpolation_std)
    measured = (log.axes**2).sum(axis=0) > 0.0
    axis_weight = np.sqrt((log.axes**2).sum(axis=0))
    std = np.where(measured, np.hypot(reading_std, axis_weight * zero.std), 0.0)
    size = float(np.linalg.norm(solution[0]))
    along = float(solution[1] @ solution[0]) / max(size, 1e-12)
    return Reading(begin, end, time, solution[0], std, along * (end - begin) / max(size, 1e-12))


def unreadable_reason(log: ForceLog, plateau: tuple[float, float] | None) -> str:
    """Why the force of a press cannot be read; empty if it can.

    Parameters
    ----------
    log : ForceLog
    plateau : (begin, end) [s] or None

    Returns
    -------
    str                             a clause, without capital and full stop
    """
    if plateau is None:
        return (
            "force and pictures are at no time at rest together under its full load for"
            f" {_MIN_DURATION} s, gaps of the log apart; hold the tool still for a second or two"
        )
    rows = (log.time >= plateau[0]) & (log.time <= plateau[1])
    if log.saturated[rows].any():
        return (
            "the gauge is at the end of its range; press less deep, or take a gauge of a larger"
            " range"
        )
    return ""
