"""Signals of a bench in closed form: presses whose force, times and drift are known."""

from pathlib import Path

import numpy as np

PEAKS = np.array([0.8, 1.2, 0.6, 1.0, 1.5, 0.9, 0.4, 1.1, 1.3, 0.7])
WEIGHT = np.array([0.05, -0.02, -1.3])
DIRECTION = np.array([0.1, -0.2, -0.97]) / np.linalg.norm([0.1, -0.2, -0.97])
# Pause, loading, hold, unloading [s].
PAUSE, RAMP, HOLD = 2.0, 0.7, 1.5
PERIOD = PAUSE + 2.0 * RAMP + HOLD


def push(time: np.ndarray, peaks: np.ndarray = PEAKS) -> np.ndarray:
    """Size of the true force [N] at any time [s]: smooth ramps, level holds, a pause before each.

    The pauses differ, as a person's do: 0.0, 0.3 and 0.6 s longer in turn.
    """
    size = np.zeros_like(time)
    for peak, begin in zip(peaks, begins(len(peaks)), strict=True):
        up = np.clip((time - begin) / RAMP, 0.0, 1.0)
        down = np.clip((time - begin - RAMP - HOLD) / RAMP, 0.0, 1.0)
        size += peak * (up**2 * (3.0 - 2.0 * up) - down**2 * (3.0 - 2.0 * down))
    return size


def begins(count: int) -> np.ndarray:
    """When each press begins [s]."""
    k = np.arange(count)
    return PAUSE + k * PERIOD + 0.3 * np.cumsum(k % 3)


def duration(count: int) -> float:
    """Length of the recording [s]."""
    return float(begins(count)[-1] + PERIOD)


def readings(
    *, seed: int = 1, rate: float = 200.0, noise: float = 0.003, drift: float = 0.03,
    walk: float = 0.0, peaks: np.ndarray = PEAKS,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Times and three components of a gauge: weight, a bent drift of so many N, noise; and a random
    walk of so many N in a second."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration(len(peaks)), 1.0 / rate)
    share = time / time[-1]
    moved = drift * (share + 0.3 * np.sin(2.0 * np.pi * share))[:, None] * [1.0, 0.5, -1.0]
    force = push(time, peaks)[:, None] * DIRECTION + WEIGHT + moved
    steps = walk / np.sqrt(rate) * rng.standard_normal(force.shape)
    return time, force + np.cumsum(steps, axis=0) + noise * rng.standard_normal(force.shape)


def write_log(path: Path, time: np.ndarray, force: np.ndarray, heading: str) -> Path:
    """A force log as a program writes it."""
    rows = np.column_stack([time, force])
    np.savetxt(path, rows, delimiter=",", header=heading, comments="", fmt="%.7g")
    return path
