"""What sensors say: the truth with noise, a bias, and rounded to their resolution."""

import numpy as np

from palpate.lab.config import ForceSensor, PositionSensor
from palpate.shapes import Vector3


def read_force(force: Vector3, sensor: ForceSensor, *, rng: np.random.Generator) -> Vector3:
    """A reading of a force [N].

    Parameters
    ----------
    force : (3,) float [N]
    sensor : ForceSensor
    rng : Generator

    Returns
    -------
    (3,) float [N]
    """
    sigma = np.hypot(sensor.noise, sensor.relative_noise * np.linalg.norm(force))
    return _rounded(force + sensor.bias + sigma * rng.standard_normal(3), sensor.resolution)


def read_position(place: Vector3, sensor: PositionSensor, *, rng: np.random.Generator) -> Vector3:
    """A reading of a place or a way [m].

    Parameters
    ----------
    place : (3,) float [m]
    sensor : PositionSensor
    rng : Generator

    Returns
    -------
    (3,) float [m]
    """
    return _rounded(place + sensor.bias + sensor.noise * rng.standard_normal(3), sensor.resolution)


def force_std(force: Vector3, sensor: ForceSensor) -> float:
    """Standard deviation of each component that the sensor's data sheet would state [N].

    The rounding counts as noise; a bias is not on the sheet.
    """
    sigma = np.hypot(sensor.noise, sensor.relative_noise * float(np.linalg.norm(force)))
    return float(np.hypot(sigma, sensor.resolution / np.sqrt(12.0)))


def position_std(sensor: PositionSensor) -> float:
    """The same of a position sensor [m]."""
    return float(np.hypot(sensor.noise, sensor.resolution / np.sqrt(12.0)))


def _rounded(value: Vector3, resolution: float) -> Vector3:
    return resolution * np.rint(value / resolution) if resolution > 0.0 else value
