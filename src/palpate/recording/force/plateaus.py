"""Plateaus of the presses, with bounded creep, and the force read on them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from palpate.recording.force.log import ForceLog, true_runs
from palpate.recording.force.touches import ResampledForce, Touch, Zero, mean_std

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
