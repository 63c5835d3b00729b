"""What neighbours say of a point: exact for linear and rigid motion, deaf to a single liar."""

import cv2
import numpy as np
import pytest

from palpate.vision.matching.outliers import median_around, median_test, predicted

REACH = 0.005


def _surface(curved=True, n=15):
    """Points 1.5 mm apart on a paraboloid or a tilted plane, with orthonormal tangents."""
    line = 1.5e-3 * (np.arange(n) - n // 2)
    x, y = (grid.ravel() for grid in np.meshgrid(line, line))
    if curved:
        point = np.stack([x, y, -(x**2 + y**2) / 0.06], axis=1)
        slope = -np.stack([x, y], axis=1) / 0.03
    else:
        point = np.stack([x, y, 0.3 * x - 0.2 * y], axis=1)
        slope = np.tile([0.3, -0.2], (len(x), 1))
    first = np.column_stack([np.ones(n * n), np.zeros(n * n), slope[:, 0]])
    first /= np.linalg.norm(first, axis=1)[:, None]
    normal = np.column_stack([-slope, np.ones(n * n)])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    # Turned about the normal by another angle at every point: nothing may rest on the choice.
    angle = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, n * n)[:, None]
    second = np.cross(normal, first)
    turned = np.cos(angle) * first + np.sin(angle) * second
    return point, np.stack([turned, np.cross(normal, turned)], axis=1)


def _predicted(point, tangent, displacement, gradient, valid=None, reach=REACH):
    valid = np.ones(len(point), dtype=bool) if valid is None else valid
    every = np.arange(len(point))
    return predicted(point, tangent, displacement, gradient, valid, every, reach=reach)


def _linear(point, tangent, matrix):
    return point @ matrix.T + [1e-3, 2e-3, -1e-3], tangent @ matrix.T


STRAIN = np.array([[0.02, -0.01, 0.0], [0.03, 0.01, 0.0], [-0.02, 0.01, 0.0]])


def test_a_linear_field_on_a_plane_is_continued_exactly():
    point, tangent = _surface(curved=False)
    displacement, gradient = _linear(point, tangent, STRAIN)
    prediction = _predicted(point, tangent, displacement, gradient)
    # Rounding of millimetres.
    np.testing.assert_allclose(prediction.displacement, displacement, atol=1e-17)
    np.testing.assert_allclose(prediction.gradient, gradient, atol=1e-15)
    np.testing.assert_allclose(prediction.scatter, 0.0, atol=1e-17)


def test_a_rigid_motion_of_a_curved_surface_is_continued_exactly():
    """The normal turns with the tangents, so what lies below the tangent plane does too."""
    point, tangent = _surface()
    turn = cv2.Rodrigues(np.array([0.3, -0.5, 0.4]))[0]
    displacement, gradient = _linear(point, tangent, turn - np.eye(3))
    prediction = _predicted(point, tangent, displacement, gradient)
    np.testing.assert_allclose(prediction.displacement, displacement, atol=1e-16)
    np.testing.assert_allclose(prediction.scatter, 0.0, atol=1e-16)
    # The gradient is a median of neighbours, whose tangents lean by up to a quarter: to that.
    assert np.abs(prediction.gradient - gradient).max() < 0.3 * np.abs(gradient).max()


def test_a_planted_outlier_is_contradicted_and_misleads_nobody():
    point, tangent = _surface()
    turn = cv2.Rodrigues(np.array([0.02, -0.01, 0.03]))[0] - np.eye(3)
    truth, gradient = _linear(point, tangent, turn)
    noise = np.random.default_rng(1).normal(0.0, 1e-6, truth.shape)
    displacement = truth + noise
    liars = [30, 112, 200, 0]
    displacement[liars] += [5e-5, 0.0, -5e-5]
    gradient = gradient.copy()
    gradient[liars] += 0.5
    prediction = _predicted(point, tangent, displacement, gradient)
    away = np.linalg.norm(displacement - prediction.displacement, axis=1) / prediction.scatter
    assert set(np.flatnonzero(away > 10.0)) == set(liars)
    others = np.setdiff1d(np.arange(len(point)), liars)
    # Medians of twelve or fewer words of 1 um, one of them false.
    assert np.abs(prediction.displacement - truth)[others].max() < 3e-6
    assert 0.5e-6 < np.median(prediction.scatter) < 3e-6


def test_its_own_word_does_not_count():
    point, tangent = _surface()
    displacement, gradient = _linear(point, tangent, STRAIN)
    plain = _predicted(point, tangent, displacement, gradient)
    displacement[77] += 1.0
    gradient[77] += 9.0
    other = _predicted(point, tangent, displacement, gradient)
    np.testing.assert_array_equal(other.displacement[77], plain.displacement[77])
    np.testing.assert_array_equal(other.gradient[77], plain.gradient[77])
    np.testing.assert_array_equal(other.scatter[77], plain.scatter[77])


def test_the_invalid_are_not_heard_but_answered():
    point, tangent = _surface(curved=False)
    displacement, gradient = _linear(point, tangent, STRAIN)
    truth = displacement.copy()
    valid = np.random.default_rng(2).random(len(point)) > 0.3
    displacement[~valid] = np.nan
    gradient[~valid] = np.nan
    prediction = _predicted(point, tangent, displacement, gradient, valid)
    assert np.isfinite(prediction.displacement).all()
    np.testing.assert_allclose(prediction.displacement, truth, atol=1e-17)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 4, 5])
def test_fewer_than_three_neighbours_say_nothing(count):
    point, tangent = _surface(curved=False)
    displacement, gradient = _linear(point, tangent, STRAIN)
    valid = np.zeros(len(point), dtype=bool)
    valid[[112, 113, 111, 97, 127][:count]] = True
    prediction = _predicted(point, tangent, displacement, gradient, valid)
    has_prediction = np.isfinite(prediction.displacement).all(axis=1)
    np.testing.assert_array_equal(has_prediction, np.isfinite(prediction.scatter))
    np.testing.assert_array_equal(has_prediction, np.isfinite(prediction.gradient).all(axis=(1, 2)))
    others = np.linalg.norm(point[:, None] - point[valid], axis=2)
    expected = ((others < REACH) & (others > 0.0)).sum(axis=1) >= 3
    np.testing.assert_array_equal(has_prediction, expected)


def test_median_around_counts_the_point_and_its_valid_neighbours():
    point, _ = _surface(curved=False)
    value = np.random.default_rng(3).random(len(point))
    valid = np.random.default_rng(4).random(len(point)) > 0.2
    value[~valid] = np.nan
    reach = 1.6e-3
    medians = median_around(point, value, valid, reach=reach)
    apart = np.linalg.norm(point[:, None] - point, axis=2)
    for i, median in enumerate(medians):
        group = value[(apart[i] < reach) & valid]
        assert median == (np.median(group) if len(group) else value[i]) or np.isnan(median)
    assert np.isfinite(medians[valid]).all()


def test_median_of_one_alone_is_its_own():
    point, _ = _surface(curved=False)
    value = np.arange(len(point), dtype=float)
    lone = np.zeros(len(point), dtype=bool)
    lone[5] = True
    assert median_around(point, value, lone, reach=1e-4)[5] == 5.0
    nobody = np.zeros(len(point), dtype=bool)
    np.testing.assert_array_equal(median_around(point, value, nobody, reach=1.0), value)


def test_normal_errors_and_slopes_pass_the_median_test():
    """Of 100 000 the largest is 5.2 standard deviations; the third quartile of lengths is 2."""
    rng = np.random.default_rng(1)
    point = np.column_stack([rng.uniform(0.0, 1.0, size=(100_000, 2)), np.zeros(100_000)])
    moved = 1e-3 * point[:, [1, 2, 0]] + 1e-5 * rng.normal(size=point.shape)
    ratio = median_test(point, moved, np.ones(len(point), dtype=bool))
    assert 1.5 < ratio.max() < 3.5


@pytest.mark.parametrize("width", [1.5e-3, 3e-3, 6e-3])
@pytest.mark.parametrize("noise", [0.0, 1e-7, 3e-6])
def test_a_liar_fails_the_median_test_and_nobody_else(noise, width):
    """Alone, or three of them side by side; the bottom of a dip as narrow as the points is none."""
    rng = np.random.default_rng(2)
    point, _ = _surface(n=25)
    middle = point[312, :2]
    dip = np.exp(-0.5 * ((point[:, :2] - middle) ** 2).sum(axis=1) / width**2)
    moved = np.column_stack([0.002 * point[:, :2], -1e-3 * dip])
    moved += noise * rng.normal(size=moved.shape)
    lies = [40, 41, 42, 570]
    moved[lies] += [2e-4, -1e-4, 1e-4]
    valid = np.arange(len(point)) != 7
    ratio = median_test(point, moved, valid)
    assert list(np.flatnonzero(ratio > 4.0)) == lies
    assert np.isnan(ratio[7])
    assert np.isfinite(np.delete(ratio, 7)).all()
