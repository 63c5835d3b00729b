"""Local polynomials as operators, against the polynomials themselves."""

import numpy as np
import pytest

from palpate.vision.matching.fit_operators import coefficient_operators, local_fits
from palpate.vision.matching.local_regression import local_field
from palpate.vision.matching.scatter import Scatter

REACH = 6e-3
RADIUS = 0.04


def _scatter(seed=0):
    """Points of a paraboloid, each known to a little less or more."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform(-0.02, 0.02, (900, 2))
    point = np.column_stack([flat, -(flat**2).sum(axis=1) / (2.0 * RADIUS)])
    # Claimed far worse than any polynomial fits, so that no point is an outlier.
    variance = rng.uniform(1.0, 2.0, 900)[:, None, None] * 1e-4 * np.eye(3)
    return Scatter(point, flat / 3e-4, _motion(point), variance, 0.0 * variance, 21)


def _motion(point):
    """A small motion that no quadratic holds, with a turn about every axis."""
    turn = np.cross([2e-3, -3e-3, 1e-3], point)
    return turn + 1e-5 * np.sin(point @ np.array([[200.0, 90.0, 0.0], [0, 240, 70], [160, 0, 50]]))


def _places():
    flat = np.random.default_rng(1).uniform(-0.012, 0.012, (30, 2))
    place = np.column_stack([flat, -(flat**2).sum(axis=1) / (2.0 * RADIUS)])
    normal = np.column_stack([flat / RADIUS, np.ones(30)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    first = np.cross(normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first, axis=1)[:, None]
    return place, np.stack([first, np.cross(normal, first)], axis=1)


@pytest.mark.parametrize("order", [1, 2])
def test_operators_give_the_coefficients_of_the_field(order):
    scatter, (place, tangent) = _scatter(), _places()
    field = local_field(scatter, place, tangent, reach=REACH, order=order)
    fits = local_fits(scatter, place, tangent, reach=REACH)
    operators, determined = coefficient_operators(fits, order, range(3 * order))
    assert determined.all()
    found = [(one @ scatter.displacement.ravel()).reshape(-1, 3) for one in operators]
    # The field turns its normal by the turn itself, an operator by its first order: their square.
    turn = (5e-3 * REACH) * 5e-3
    np.testing.assert_allclose(found[0], field.displacement, atol=0.1 * turn)
    for k in range(2):
        np.testing.assert_allclose(found[1 + k] / REACH, field.gradient[:, k], atol=5e-3**2)
    for k in range(3 * (order - 1)):
        expected = field.curvature[:, k] * REACH**2
        np.testing.assert_allclose(found[3 + k], expected, atol=turn)
        assert np.abs(expected).max() > 20.0 * turn


def test_rigid_motions_are_exact_on_a_curved_surface():
    scatter, (place, tangent) = _scatter(), _places()
    (value,), _ = coefficient_operators(local_fits(scatter, place, tangent, reach=REACH), 2, (0,))
    for turn in 1e3 * np.eye(3):
        moved = (value @ np.cross(turn, scatter.point).ravel()).reshape(-1, 3)
        # Heights over the tangent plane are no quadratics, but they turn along.
        np.testing.assert_allclose(moved, np.cross(turn, place), atol=1e-7)


def test_points_on_a_line_determine_nothing():
    line = np.linspace(-0.01, 0.01, 60)
    point = np.column_stack([line, 0.0 * line, 0.0 * line])
    noise = np.tile(1e-12 * np.eye(3), (60, 1, 1))
    scatter = Scatter(point, point[:, :2] / 3e-4, point, noise, 0.0 * noise, 21)
    fits = local_fits(scatter, np.zeros((1, 3)), np.eye(3)[None, :2], reach=REACH)
    (value,), determined = coefficient_operators(fits, 2, (0,))
    assert not determined.any()
    assert abs(value).sum() == 0.0


def test_a_place_without_points_has_no_weights():
    scatter = _scatter()
    fits = local_fits(scatter, np.full((1, 3), 0.5), np.eye(3)[None, :2], reach=REACH)
    (value,), determined = coefficient_operators(fits, 1, (0,))
    assert value.shape == (3, 2700)
    assert not determined.any()
    assert abs(value).sum() == 0.0
