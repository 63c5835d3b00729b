"""Windows of growing size on known warps, and what neighbours reject, on matches made by hand."""

import numpy as np
import pytest
from vision.textures import Speckle, affine, noisy, pixel_grid, turned

from palpate.vision.images.spline import make_spline_picture
from palpate.vision.matching.planar_match import refine_planar
from palpate.vision.range_flow.flow import Outcome
from palpate.vision.stereo.pair_disparity import StereoStart
from palpate.vision.stereo.window_matches import (
    MIN_WINDOW_PX,
    WindowMatches,
    _contrast,
    _sides,
    confirmed_matches,
    window_matches,
)

SHAPE = (110, 130)
POINTS = pixel_grid(SHAPE)[25:-25:5, 25:-25:5].reshape(-1, 2)


def _matched(first, second, truth, *, subset=21):
    """Matches of `POINTS` that start half a pixel off the truth."""
    start = StereoStart(truth + np.array([0.4, -0.3]), np.zeros((len(POINTS), 2, 2)))
    pictures = make_spline_picture(first), make_spline_picture(second)
    return window_matches(*pictures, POINTS, start, subset=subset)


def test_matches_are_as_good_as_they_claim():
    """Turned by three degrees, stretched by two percent: the gradient is known too."""
    matrix, noise = turned(3.0, 0.02), 3.0
    warp = affine(matrix, (4.3, -2.6), (65.0, 55.0))
    texture = Speckle(SHAPE, 1)
    truth = warp.displacement(POINTS)
    found = _matched(noisy(texture.image(), noise, 1), noisy(texture.image(warp), noise, 2), truth)
    assert (found.outcome == Outcome.VALID).all()
    error = found.displacement - truth
    whitened = np.linalg.solve(np.linalg.cholesky(found.covariance), error[..., None])[..., 0]
    # Windows of 21 px at 5 px: some twelve independent ones with two coordinates each, and a bias
    # of 0.005 px that the covariance does not hold.
    assert 0.6 < np.sqrt(np.mean(whitened**2)) < 1.5
    # 7 % of noise in windows of 21 px with six coefficients; measured 0.027. A weak window of the
    # 192 may end half a pixel off, in another minimum, which its neighbours will not confirm.
    length = np.linalg.norm(error, axis=1)
    usual = error[length <= np.quantile(length, 0.99)]
    assert np.sqrt(np.mean(usual**2)) < 0.035
    np.testing.assert_allclose(found.gradient.mean(axis=0), matrix - np.eye(2), atol=1e-3)


def test_a_window_across_an_edge_is_left_for_a_smaller_one():
    """Left of column 65 nothing moves, right of it everything by two pixels along the rows."""
    texture = Speckle(SHAPE, 2)
    right = pixel_grid(SHAPE)[..., 0] > 65.0
    still, moved = texture.image(), texture.image(affine(np.eye(2), (2.0, 0.0), (0.0, 0.0)))
    truth = np.where(POINTS[:, :1] > 65.0, [[2.0, 0.0]], [[0.0, 0.0]])
    found = _matched(noisy(still, 1.0, 1), noisy(np.where(right, moved, still), 1.0, 2), truth)
    good = found.outcome == Outcome.VALID
    away = np.abs(POINTS[:, 0] - 65.0)
    error = np.linalg.norm(found.displacement - truth, axis=1)
    assert good[away > 13.0].all()
    # Of a match across the edge a good part of the two pixels would be left.
    assert error[away > 13.0].max() < 0.1
    # Windows of 9 px fit beside the edge from 5 px on.
    beside = (away >= 6.0) & (away <= 13.0)
    assert good[beside].mean() > 0.7
    assert np.percentile(error[beside & good], 90.0) < 0.1


def test_every_failure_has_its_outcome():
    texture = Speckle(SHAPE, 3)
    first, second = (noisy(texture.image(), 2.0, seed) for seed in (1, 2))
    column, row = POINTS.T
    # Without texture, with another in the second picture, and with much noise there.
    first[:45, :50] = second[:45, :50] = 100.0
    second[55:, 90:] = Speckle(SHAPE, 4).image()[55:, 90:]
    second[55:, :60] += np.random.default_rng(5).normal(0.0, 20.0, (55, 60)).astype(np.float32)
    truth = np.zeros_like(POINTS)
    truth[-1] = np.nan
    found = _matched(first, second, truth)
    assert found.outcome[-1] == Outcome.HIDDEN
    blank = (column < 38) & (row < 33)
    assert np.isin(found.outcome[blank], [Outcome.TEXTURE, Outcome.LOST]).all()
    other = (column > 101) & (row > 67)
    assert (found.outcome[other] != Outcome.VALID).all()
    rough = (column < 48) & (row > 67)
    assert (found.outcome[rough] == Outcome.SCORE).all()
    rest = (column > 62) & (row < 43)
    assert (found.outcome[rest] == Outcome.VALID).all()
    bad = found.outcome != Outcome.VALID
    for values in (found.displacement, found.gradient, found.covariance):
        np.testing.assert_array_equal(np.isnan(values).reshape(len(bad), -1).all(axis=1), bad)


def test_larger_windows_know_their_match_better():
    """Noise averages over the area, from 9 px to 27 px; the smaller one has fewer gradients."""
    texture = Speckle(SHAPE, 5)
    first, second = (noisy(texture.image(), 3.0, seed) for seed in (1, 2))
    sigma = []
    for subset in (MIN_WINDOW_PX, 27):
        found = _matched(first, second, np.zeros_like(POINTS), subset=subset)
        sigma.append(np.nanmedian(np.sqrt(found.covariance[:, 0, 0])))
    assert 2.0 < sigma[0] / sigma[1] < 5.0


def _grid(rows: int = 12, columns: int = 14, step: float = 5.0):
    cell = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1)
    cell = cell.reshape(-1, 2)
    return cell, step * cell[:, ::-1].astype(np.float64)


def _rejected(cell, pixel, displacement, gradient, valid, sigma=0.01):
    """Flags of the valid matches that are rejected; `sigma` is the root of the trace."""
    variance = np.broadcast_to(0.5 * sigma**2 * np.eye(2), (len(cell), 2, 2))
    outcome = np.where(valid, int(Outcome.VALID), int(Outcome.LOST))
    matches = WindowMatches(displacement, np.array(gradient), np.array(variance), outcome)
    found = confirmed_matches(matches, cell, pixel)
    wrong = found.outcome == Outcome.NEIGHBOURS
    np.testing.assert_array_equal(found.outcome[~wrong], outcome[~wrong])
    np.testing.assert_array_equal(np.isnan(found.displacement).all(axis=1), wrong)
    np.testing.assert_array_equal(found.displacement[~wrong], displacement[~wrong])
    return wrong


@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_the_limit_is_five_deviations_of_scatter_and_noise(scatter):
    """In an affine field, so that a gradient of the wrong sign or order would add to the scatter.

    Neighbours lie by turns `scatter` to one side of the field and to the other: for the point in
    the middle their median is the field and its scatter is `scatter`.
    """
    cell, pixel = _grid(5, 5)
    slope = np.array([[0.2, -0.1], [0.05, 0.3]])
    field = pixel @ slope.T + [3.0, -40.0]
    middle = 12
    side = np.where(cell.sum(axis=1) % 2, -scatter, scatter)
    side[middle] = 0.0
    field[:, 0] += side
    gradient = np.broadcast_to(slope, (25, 2, 2))
    everything = np.ones(25, dtype=bool)
    for share in (0.99, 1.01):
        moved = field.copy()
        moved[middle, 1] += share * 5.0 * np.hypot(scatter, 0.01)
        wrong = _rejected(cell, pixel, moved, gradient, everything)
        assert wrong[middle] == (share > 1.0)
        assert not np.delete(wrong, middle).any()


def test_a_jump_rejects_only_points_beside_it():
    rng = np.random.default_rng(0)
    cell, pixel = _grid()
    field = rng.normal(scale=0.007, size=pixel.shape)
    field[pixel[:, 0] > 32.0] += 6.0
    everything = np.ones(len(cell), dtype=bool)
    wrong = _rejected(cell, pixel, field, np.zeros((len(cell), 2, 2)), everything)
    # A point beside the jump keeps five of its eight neighbours, a majority.
    assert not wrong[np.abs(pixel[:, 0] - 32.5) > 8.0].any()
    assert wrong.mean() < 0.05


def test_mistakes_and_lonely_points_are_rejected():
    rng = np.random.default_rng(1)
    cell, pixel = _grid()
    field = rng.normal(scale=0.01, size=pixel.shape)
    gradient = np.zeros((len(cell), 2, 2))
    bad = rng.choice(len(cell), 12, replace=False)
    field[bad] += rng.uniform(0.5, 3.0, size=(12, 2))
    valid = np.ones(len(cell), dtype=bool)
    wrong = _rejected(cell, pixel, field, gradient, valid)
    assert wrong[bad].all()
    assert wrong.sum() <= 14
    # Two points by themselves are confirmed by nobody; four around a corner are, by three each.
    few = np.zeros(len(cell), dtype=bool)
    few[[0, 1]] = True
    field[:] = 0.0
    np.testing.assert_array_equal(_rejected(cell, pixel, field, gradient, few), few)
    few[[14, 15]] = True
    assert not _rejected(cell, pixel, field, gradient, few).any()


def test_nothing_contradicts_nothing():
    none = np.zeros((0, 2))
    wrong = _rejected(
        np.zeros((0, 2), dtype=np.int64), none, none, np.zeros((0, 2, 2)), np.zeros(0, dtype=bool)
    )
    assert wrong.shape == (0,)


def test_sides_halve_the_pixels_down_to_the_smallest():
    for subset in (21, 31, 43):
        sides = np.array(_sides(subset))
        assert sides[-1] == subset
        assert (sides % 2 == 1).all()
        # Rounded to odd numbers: by one at most, of nine or more.
        np.testing.assert_allclose(sides[1:] ** 2 / sides[:-1] ** 2, 2.0, rtol=0.3)
    assert _sides(MIN_WINDOW_PX) == [MIN_WINDOW_PX]


def test_residual_is_the_noise_and_contrast_is_the_least_beside_the_middle():
    """The first picture has no noise, the right half of both no texture."""
    sigma = 4.0
    first = Speckle(SHAPE, 6).image()
    first[:, 65:] = 100.0
    second = first + np.random.default_rng(7).normal(0.0, sigma, SHAPE).astype(np.float32)
    reference = make_spline_picture(first)
    points = np.array([[40.0, 30.0], [40.0, 60.0], [52.0, 80.0], [64.0, 50.0]])
    match = refine_planar(
        reference, make_spline_picture(second), points, np.zeros((4, 2)), subset=21
    )
    residual, beside = _contrast(reference, points, match, 21)
    # 441 pixels fix a standard deviation to 3.4 %; the match takes six of them.
    np.testing.assert_allclose(residual, sigma, rtol=0.12)
    # The last window shows texture on its left only.
    assert (beside[:3] > 100.0).all()
    assert beside[3] < 1e-3
