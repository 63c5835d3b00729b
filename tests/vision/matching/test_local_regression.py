"""Local polynomials on a surface: exact fields, outliers, and covariances by Monte Carlo."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from palpate.vision.matching.local_regression import Scatter, local_field, noise_correlation

PITCH = 3e-4
SUBSET = 21
STEP = 5
SIGMA = 2e-6


def _grid(n=25):
    line = STEP * np.arange(n, dtype=float)
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


def _surface(pixel, *, radius=None):
    """Points behind pixels, PITCH wide; a plane, or a paraboloid with its top in the middle."""
    flat = (pixel - pixel.mean(axis=0)) * PITCH
    height = np.zeros(len(flat)) if radius is None else -(flat**2).sum(axis=1) / (2.0 * radius)
    return np.column_stack([flat, height])


def _tangents(point, radius=None):
    slope = np.zeros((len(point), 2)) if radius is None else -point[:, :2] / radius
    first = np.column_stack([np.ones(len(point)), np.zeros(len(point)), slope[:, 0]])
    first /= np.linalg.norm(first, axis=1)[:, None]
    normal = np.column_stack([-slope, np.ones(len(point))])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)


def _scatter(point, pixel, displacement, sigma=SIGMA, bias=0.0):
    noise = np.tile(np.diag([sigma**2, sigma**2, 9.0 * sigma**2]), (len(point), 1, 1))
    shared = np.tile(bias**2 * np.eye(3), (len(point), 1, 1))
    return Scatter(point, pixel, displacement, noise + shared, shared, SUBSET)


REACH = 2.4 * 10 * PITCH


def test_quadratics_on_a_plane_are_exact_with_their_derivatives():
    pixel = _grid()
    point = _surface(pixel)
    c = np.random.default_rng(0).normal(size=(6, 3)) * 1e-4

    def field(x, y):
        a, b = x / 5e-3, y / 5e-3
        return np.stack([a**0, a, b, a * a, a * b, b * b], axis=1) @ c

    position = np.column_stack(
        [np.random.default_rng(1).uniform(-0.012, 0.012, (40, 2)), np.zeros(40)]
    )
    fitted = local_field(
        _scatter(point, pixel, field(*point[:, :2].T)), position, _tangents(position), reach=REACH
    )
    x, y = position[:, :2].T / 5e-3
    np.testing.assert_allclose(fitted.displacement, field(*position[:, :2].T), atol=1e-14)
    first = (c[1] + 2.0 * x[:, None] * c[3] + y[:, None] * c[4]) / 5e-3
    second = (c[2] + x[:, None] * c[4] + 2.0 * y[:, None] * c[5]) / 5e-3
    np.testing.assert_allclose(fitted.gradient, np.stack([first, second], axis=1), atol=1e-11)
    expected = np.broadcast_to(c[3:] / 5e-3**2, fitted.curvature.shape)
    np.testing.assert_allclose(fitted.curvature, expected, atol=1e-7)


def test_order_one_takes_planes_and_no_more():
    pixel = _grid()
    point = _surface(pixel)
    slope = np.array([[0.01, -0.02, 0.03], [0.02, 0.01, -0.01]])
    plane = point[:, :2] @ slope
    fitted = local_field(
        _scatter(point, pixel, plane), point, _tangents(point), reach=REACH, order=1
    )
    np.testing.assert_allclose(fitted.displacement, plane, atol=1e-15)
    np.testing.assert_allclose(fitted.gradient, np.broadcast_to(slope, fitted.gradient.shape),
                               atol=1e-12)  # fmt: skip
    assert not fitted.curvature.any()
    bent = plane + (point[:, :1] / 5e-3) ** 2 * 1e-4
    other = local_field(_scatter(point, pixel, bent), point, _tangents(point), reach=REACH, order=1)
    assert np.abs(other.displacement - bent)[:, 0].mean() > 1e-6


@pytest.mark.parametrize("order", [1, 2])
def test_rigid_motions_of_a_curved_surface_are_exact(order):
    radius = 0.03
    pixel = _grid()
    point = _surface(pixel, radius=radius)
    turn = cv2.Rodrigues(np.array([0.2, -0.3, 0.25]))[0]
    displacement = point @ turn.T - point + [1e-3, 0.0, -2e-3]
    fitted = local_field(
        _scatter(point, pixel, displacement), point, _tangents(point, radius), reach=REACH,
        order=order,
    )  # fmt: skip
    good = np.isfinite(fitted.displacement).all(axis=1)
    assert good.mean() > 0.95
    # The normal's turn is found with the gradient, by six rounds: 0.4^6 of a height of 0.9 mm is
    # what is left of a turn of half a radian.
    assert np.abs(fitted.displacement - displacement)[good].max() < 2e-7
    expected = _tangents(point, radius) @ (turn - np.eye(3)).T
    assert np.abs(fitted.gradient - expected)[good].max() < 2e-4


def _correlated(n, seed, count):
    """Noise of windows that overlap: white pixels summed over each; draws of unit variance."""
    rng = np.random.default_rng(seed)
    side = STEP * (n - 1) + SUBSET
    white = rng.normal(size=(count, side, side))
    mean = uniform_filter(white, size=(1, SUBSET, SUBSET), mode="constant") * SUBSET
    half = SUBSET // 2
    return mean[:, half : half + STEP * n : STEP, half : half + STEP * n : STEP].reshape(count, -1)


@pytest.mark.parametrize("order", [1, 2])
def test_covariance_with_windows_that_share_pixels(order):
    """Over many draws, and places in the middle, at the rim and beyond it."""
    n, draws = 11, 150
    pixel = _grid(n)
    point = _surface(pixel)
    position = np.array([[0.0, 0.0, 0.0], [0.0021, -0.0008, 0.0], [0.0075, 0.0, 0.0],
                      [0.0072, 0.0072, 0.0], [0.0081, 0.0, 0.0]])  # fmt: skip
    scale = SIGMA * np.array([1.0, 1.0, 3.0])
    noise = np.stack([_correlated(n, seed, draws) for seed in range(3)], axis=2) * scale
    values, claims = [], []
    for drawn in noise:
        fitted = local_field(
            _scatter(point, pixel, drawn),
            position,
            _tangents(position),
            reach=1.6 * 10 * PITCH,
            order=order,
        )
        values.append(fitted.displacement)
        claims.append(fitted.covariance)
    actual = np.sqrt((np.array(values) ** 2).mean(axis=0))
    claimed = np.sqrt(np.einsum("dtii->dti", np.array(claims)).mean(axis=0))
    # 6 % from 150 draws; Student weights fitted to each draw cost some more.
    np.testing.assert_allclose(claimed / actual, 1.0, atol=0.22)
    # In the middle smoothing helps little, since the windows share pixels; beyond the rim the
    # polynomials are extrapolated and say it.
    assert (claimed[0] < scale).all()
    assert (claimed[0] > 0.3 * scale).all()
    assert (claimed[4] > 1.15 * claimed[0]).all()


def test_places_whose_windows_overlap_err_together():
    """Against the correlation over many draws, of places a third of a window to two windows
    apart."""
    n, draws = 15, 400
    pixel = _grid(n)
    point = _surface(pixel)
    along = np.array([0.0, 7.0, 14.0, 21.0, 42.0]) - 20.0
    position = np.column_stack([along * PITCH, along * PITCH * 0.3, np.zeros(5)])
    noise = SIGMA * np.stack([_correlated(n, seed, draws) for seed in range(3)], axis=2)
    drawn = [
        local_field(
            _scatter(point, pixel, moved), position, _tangents(position), reach=1.2 * 10 * PITCH
        )
        for moved in noise
    ]
    value = np.array([field.displacement for field in drawn])[..., :2]
    square = np.sqrt((value**2).sum(axis=(0, 2)))
    actual = np.einsum("dta,dsa->ts", value, value) / np.outer(square, square)
    correlation = noise_correlation(_scatter(point, pixel, noise[0]), drawn[0])
    claimed = np.eye(5)
    claimed[tuple(correlation.pair.T)] = correlation.value
    # Three standard errors of 800 draws of a correlation.
    np.testing.assert_allclose(np.triu(claimed), np.triu(actual), atol=0.11)
    assert claimed[0, 1] > 0.5
    assert abs(claimed[0, 4]) < 0.05


def test_undetermined_places_are_correlated_with_none():
    pixel = _grid()
    point = _surface(pixel)
    position = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1e-3, 0.0, 0.0]])
    scatter = _scatter(point, pixel, np.zeros_like(point))
    field = local_field(scatter, position, _tangents(position), reach=REACH)
    np.testing.assert_array_equal(noise_correlation(scatter, field).pair, [[0, 2]])


def test_displacements_that_share_nothing_average_out():
    """Windows of one pixel: the covariance falls as one over their number."""
    pixel = _grid(11)
    point = _surface(pixel)
    draws = np.random.default_rng(5).normal(0.0, SIGMA, (200, len(point), 3))
    claims, values = [], []
    for drawn in draws:
        scatter = Scatter(
            point, pixel, drawn, np.tile(SIGMA**2 * np.eye(3), (len(point), 1, 1)),
            np.zeros((len(point), 3, 3)), 1,
        )  # fmt: skip
        fitted = local_field(scatter, np.zeros((1, 3)), _tangents(np.zeros((1, 3))), reach=REACH)
        values.append(fitted.displacement[0])
        claims.append(np.diag(fitted.covariance[0]))
    actual, claimed = np.sqrt(np.mean(np.square(values))), np.sqrt(np.mean(claims))
    assert actual < 0.5 * SIGMA
    # 3 % from chance, 5 % for the weights.
    assert claimed / actual == pytest.approx(1.0, abs=0.12)


def test_bias_that_all_share_is_not_averaged_away():
    pixel = _grid()
    point = _surface(pixel)
    zero = np.zeros_like(point)
    position = np.zeros((1, 3))
    plain = local_field(_scatter(point, pixel, zero), position, _tangents(position), reach=REACH)
    other = local_field(
        _scatter(point, pixel, zero, bias=5e-6), position, _tangents(position), reach=REACH
    )
    np.testing.assert_allclose(
        other.covariance - plain.covariance, 25e-12 * np.eye(3)[None], atol=1e-18
    )


def test_outliers_are_not_followed():
    """15 % of points off by 30 sigma: the error stays within what is claimed."""
    rng = np.random.default_rng(7)
    pixel = _grid()
    point = _surface(pixel)
    truth = np.column_stack([point[:, 0] * 0.02, point[:, 1] * -0.01, point[:, 0] ** 2 * 3.0])
    noise = rng.normal(0.0, SIGMA, point.shape) * [1.0, 1.0, 3.0]
    clean = truth + noise
    dirty = clean.copy()
    wrong = rng.random(len(point)) < 0.15
    dirty[wrong] += 30.0 * SIGMA * rng.normal(size=(wrong.sum(), 3)) * [1.0, 1.0, 3.0]
    inner = (np.abs(point[:, :2]) < 0.012).all(axis=1)
    position = point[inner]
    errors = []
    for values in (clean, dirty):
        fitted = local_field(
            _scatter(point, pixel, values), position, _tangents(position), reach=REACH
        )
        errors.append(np.sqrt(((fitted.displacement - truth[inner]) ** 2).mean()))
        sigma = np.sqrt(np.einsum("nii->ni", fitted.covariance))
        assert np.abs((fitted.displacement - truth[inner]) / sigma).max() < 6.0
    # Least squares without weights would be worse by sqrt(1 + 0.15 * 900) = 12.
    assert errors[1] < 2.5 * errors[0]


def test_covariance_grows_where_the_field_is_no_polynomial():
    pixel = _grid()
    point = _surface(pixel)
    rough = 3e-4 * np.sin(point / (5.0 * PITCH))
    fitted = local_field(_scatter(point, pixel, rough), point, _tangents(point), reach=REACH)
    flat = local_field(_scatter(point, pixel, 0.0 * rough), point, _tangents(point), reach=REACH)
    inner = np.isfinite(fitted.displacement).all(axis=1)
    bigger = np.trace(fitted.covariance, axis1=1, axis2=2) / np.trace(
        flat.covariance, axis1=1, axis2=2
    )
    # What is left is three times the noise and more in four of five places.
    assert (bigger[inner] > 9.0).mean() > 0.8
    assert bigger[inner].min() >= 1.0 - 1e-12


def test_too_few_displacements_give_nothing():
    pixel = _grid()
    point = _surface(pixel)
    zero = np.zeros_like(point)
    far = np.array([[0.5, 0.0, 0.0]])
    none = local_field(_scatter(point, pixel, zero), far, _tangents(far), reach=REACH)
    assert none.count[0] == 0
    assert np.isnan(none.displacement).all()
    assert np.isnan(none.covariance).all()
    for count, is_determined in ((6, False), (7, True)):
        keep = np.argsort((point**2).sum(axis=1))[:count]
        position = np.zeros((1, 3))
        fitted = local_field(
            _scatter(point[keep], pixel[keep], zero[keep]),
            position,
            _tangents(position),
            reach=REACH,
        )
        assert fitted.count[0] == count
        # Seven of the nearest nine do not lie on a conic, so they fix a quadratic.
        assert np.isfinite(fitted.displacement).all() == is_determined
    empty = local_field(_scatter(point[:0], pixel[:0], zero[:0]), far, _tangents(far), reach=REACH)
    assert np.isnan(empty.displacement).all()


def test_points_on_a_line_fix_no_plane():
    pixel = np.column_stack([5.0 * np.arange(20), np.full(20, 50.0)])
    point = np.column_stack([pixel[:, 0] * PITCH, np.zeros((20, 2))])
    fitted = local_field(
        _scatter(point, pixel, np.zeros_like(point)), point, _tangents(point), reach=REACH, order=1
    )
    assert np.isnan(fitted.displacement).all()
