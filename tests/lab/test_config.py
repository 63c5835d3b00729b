"""Readings of sensors: the statistics that were asked for."""

import numpy as np
import pytest

from palpate.lab.config import Sensor

FORCE = np.array([0.3, -0.4, 1.2])


def _readings(truth, sensor, count=4000):
    rng = np.random.default_rng(5)
    return np.array([sensor.read(truth, rng=rng) for _ in range(count)])


def test_force_readings_have_their_noise_and_bias():
    sensor = Sensor(noise=0.01, relative_noise=0.02, bias=np.array([0.05, 0.0, -0.02]))
    readings = _readings(FORCE, sensor)
    sigma = np.hypot(0.01, 0.02 * 1.3)
    # 4000 draws: the mean to sigma / 63, the spread to 1.1 %; five of these.
    np.testing.assert_allclose(readings.mean(axis=0), FORCE + sensor.bias, atol=5 * sigma / 63)
    np.testing.assert_allclose(readings.std(axis=0), sigma, rtol=0.06)
    np.testing.assert_allclose(np.corrcoef(readings.T) - np.eye(3), 0.0, atol=0.08)
    assert sensor.std(FORCE) == pytest.approx(sigma, rel=1e-14)


def test_readings_are_multiples_of_the_resolution():
    sensor = Sensor(noise=0.03, resolution=0.02)
    readings = _readings(FORCE, sensor)
    np.testing.assert_allclose(readings / 0.02, np.rint(readings / 0.02), atol=1e-9)
    # Sheppard: rounding adds a twelfth of the step's square.
    np.testing.assert_allclose(readings.std(axis=0), sensor.std(FORCE), rtol=0.06)


def test_positions_have_their_noise_bias_and_steps():
    sensor = Sensor(noise=5e-5, bias=np.array([1e-4, 0.0, 0.0]), resolution=1e-5)
    readings = _readings(np.zeros(3), sensor)
    np.testing.assert_allclose(readings.mean(axis=0), sensor.bias, atol=5 * 5e-5 / 63)
    np.testing.assert_allclose(readings.std(axis=0), sensor.std(np.zeros(3)), rtol=0.06)
    np.testing.assert_allclose(readings / 1e-5, np.rint(readings / 1e-5), atol=1e-6)


def test_perfect_sensors_tell_the_truth():
    rng = np.random.default_rng(0)
    np.testing.assert_array_equal(Sensor().read(FORCE, rng=rng), FORCE)
    assert Sensor().std(FORCE) == 0.0
