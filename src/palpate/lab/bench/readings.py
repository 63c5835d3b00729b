"""What sensors say: the truth with noise, a bias, and rounded to their resolution."""

import numpy as np

from palpate.lab.config import Sensor
from palpate.shapes import Vector3


def read_sensor(truth: Vector3, sensor: Sensor, *, rng: np.random.Generator) -> Vector3:
    """A reading of a force, a position or a displacement.

    Parameters
    ----------
    truth : (3,) float [N or m]
    sensor : Sensor
    rng : Generator

    Returns
    -------
    (3,) float [N or m]
    """
    noise = _noise(truth, sensor) * rng.standard_normal(3)
    value = truth + sensor.bias + noise
    step = sensor.resolution
    return step * np.rint(value / step) if step > 0.0 else value


def sensor_std(truth: Vector3, sensor: Sensor) -> float:
    """Standard deviation of each component that the sensor's data sheet would state.

    The rounding counts as noise; a bias is not on the sheet.

    Parameters
    ----------
    truth : (3,) float [N or m]
    sensor : Sensor

    Returns
    -------
    float [N or m]
    """
    return float(np.hypot(_noise(truth, sensor), sensor.resolution / np.sqrt(12.0)))


def _noise(truth: Vector3, sensor: Sensor) -> float:
    """Standard deviation before the rounding."""
    return float(np.hypot(sensor.noise, sensor.relative_noise * np.linalg.norm(truth)))
