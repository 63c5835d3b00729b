"""Charges on a sphere against the potential of what they stand for."""

import numpy as np
import pytest

from palpate.bem.compressed.charges import (
    charge_sphere,
    interpolative_decomposition,
    inverse_distances,
    points_on_sphere,
)


def test_inverse_distances():
    rng = np.random.default_rng(0)
    a, b = rng.random((4, 3)), 2.0 + rng.random((5, 3))
    wanted = 1.0 / np.linalg.norm(a[:, None] - b[None], axis=2)
    # A square root and a division, each rounded once, in fast arithmetic.
    assert np.abs(inverse_distances(a, b) / wanted - 1.0).max() < 1e-14


def test_points_on_a_sphere_are_spread_evenly():
    points = points_on_sphere(500)
    assert np.abs(np.linalg.norm(points, axis=1) - 1.0).max() < 1e-15 * 10
    # Moments of even points: zero, and a third of the unit matrix, but for one over their number.
    assert np.abs(points.mean(axis=0)).max() < 1 / 500
    assert np.abs(points.T @ points / 500 - np.eye(3) / 3).max() < 1 / 500


@pytest.mark.parametrize(("count", "most"), [(100, 1e-4), (200, 2e-7)])
def test_charges_stand_for_all_sources_inside(count, most):
    sphere = charge_sphere(count, 2.5)
    rng = np.random.default_rng(1)
    inside = rng.normal(size=(60, 3))
    inside *= (0.8 * rng.random(60) / np.linalg.norm(inside, axis=1))[:, None]
    strength = rng.random(60)
    charges = (strength @ inverse_distances(inside, sphere.check)) @ sphere.check_to_charge
    outside = 2.5 * points_on_sphere(91)
    outside[::2] *= 3.0
    wanted = strength @ inverse_distances(inside, outside)
    found = charges @ inverse_distances(sphere.charge, outside)
    # Harmonics that k charges do not tell apart, of a degree of about the root of k, have fallen
    # with (0.8 / 2.5)^degree.
    assert np.abs(found / wanted - 1.0).max() < most


def test_skeleton_points_interpolate_the_others():
    rng = np.random.default_rng(2)
    cluster = np.column_stack([rng.random((80, 2)), np.zeros(80)])
    around = np.array([0.5, 0.5, 0.0]) + 2.5 * points_on_sphere(300)
    values = inverse_distances(cluster, around)
    for tolerance in (1e-3, 1e-6):
        chosen, weights = interpolative_decomposition(values, tolerance)
        assert len(chosen) < 80
        left = np.abs(values - weights @ values[chosen])
        # The tolerance is of the diagonal of R; what it leaves out adds up over the points.
        assert left.max() < 10 * tolerance * np.abs(values).max()
        assert np.array_equal(weights[chosen], np.eye(len(chosen)))
