"""Matches of windows of any size, and one window matched between two pictures."""

import numpy as np
import pytest
from vision.textures import Speckle, affine, inverse_quadratic, noisy, pixel_grid, turned

from palpate.errors import InputError
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import make_spline_picture
from palpate.vision.stereo.window_matches import (
    MIN_WINDOW_PX,
    WindowMatches,
    _contrast,
    _sides,
    confirmed_matches,
    refine_planar,
    window_matches,
)

SHAPE = (110, 130)
POINTS = pixel_grid(SHAPE)[25:-25:5, 25:-25:5].reshape(-1, 2)
PLANAR_SHAPE = (190, 260)
CENTRE = (130.0, 95.0)
TEXTURE = Speckle(PLANAR_SHAPE, 3)
PLANAR_POINTS = pixel_grid(PLANAR_SHAPE)[20:-20:6, 20:-20:6].reshape(-1, 2)
NOISE = 1.5
BENT = np.array([[0.3, 0.004, 0.002, 3e-4, -2e-4, 1e-4], [-0.4, 0.003, -0.002, 1e-4, 2e-4, -3e-4]])
WARPS = {
    "shift": affine(np.eye(2), (0.37, -0.61), CENTRE),
    "strain": affine(turned(0.0, 0.02), (0.2, 0.4), CENTRE),
    "turn": affine(turned(4.0, 0.01), (1.3, -0.7), CENTRE),
    "bent": inverse_quadratic(BENT, CENTRE),
}


def _matched(first, second, truth, *, subset=21):
    """Matches of `POINTS` that start half a pixel off the truth."""
    start = truth + np.array([0.4, -0.3]), np.zeros((len(POINTS), 2, 2))
    pictures = make_spline_picture(first), make_spline_picture(second)
    return window_matches(*pictures, POINTS, start, subset=subset)


def test_matches_are_as_good_as_they_claim():
    """Turned by three degrees, stretched by two percent: the gradient is known too."""
    matrix, noise = turned(3.0, 0.02), 3.0
    warp = affine(matrix, (4.3, -2.6), (65.0, 55.0))
    texture = Speckle(SHAPE, 1)
    truth = warp.displacement(POINTS)
    matches = _matched(
        noisy(texture.image(), noise, 1), noisy(texture.image(warp), noise, 2), truth
    )
    assert (matches.outcome == Outcome.VALID).all()
    error = matches.displacement - truth
    whitened = np.linalg.solve(np.linalg.cholesky(matches.covariance), error[..., None])[..., 0]
    # Windows of 21 px at 5 px: some twelve independent ones with two coordinates each, and a bias
    # of 0.005 px that the covariance does not hold.
    assert 0.6 < np.sqrt(np.mean(whitened**2)) < 1.5
    # 7 % of noise in windows of 21 px with six coefficients; measured 0.027. A weak window of the
    # 192 may end half a pixel off, in another minimum, which its neighbours will not confirm.
    length = np.linalg.norm(error, axis=1)
    usual = error[length <= np.quantile(length, 0.99)]
    assert np.sqrt(np.mean(usual**2)) < 0.035
    np.testing.assert_allclose(matches.gradient.mean(axis=0), matrix - np.eye(2), atol=1e-3)


def test_a_window_across_an_edge_is_left_for_a_smaller_one():
    """Left of column 65 nothing moves, right of it everything by two pixels along the rows."""
    texture = Speckle(SHAPE, 2)
    right = pixel_grid(SHAPE)[..., 0] > 65.0
    still, moved = texture.image(), texture.image(affine(np.eye(2), (2.0, 0.0), (0.0, 0.0)))
    truth = np.where(POINTS[:, :1] > 65.0, [[2.0, 0.0]], [[0.0, 0.0]])
    matches = _matched(noisy(still, 1.0, 1), noisy(np.where(right, moved, still), 1.0, 2), truth)
    good = matches.outcome == Outcome.VALID
    away = np.abs(POINTS[:, 0] - 65.0)
    error = np.linalg.norm(matches.displacement - truth, axis=1)
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
    matches = _matched(first, second, truth)
    assert matches.outcome[-1] == Outcome.HIDDEN
    blank = (column < 38) & (row < 33)
    assert np.isin(matches.outcome[blank], [Outcome.TEXTURE, Outcome.LOST]).all()
    other = (column > 101) & (row > 67)
    assert (matches.outcome[other] != Outcome.VALID).all()
    rough = (column < 48) & (row > 67)
    assert (matches.outcome[rough] == Outcome.SCORE).all()
    rest = (column > 62) & (row < 43)
    assert (matches.outcome[rest] == Outcome.VALID).all()
    bad = matches.outcome != Outcome.VALID
    for values in (matches.displacement, matches.gradient, matches.covariance):
        np.testing.assert_array_equal(np.isnan(values).reshape(len(bad), -1).all(axis=1), bad)


def test_larger_windows_know_their_match_better():
    """Noise averages over the area, from 9 px to 27 px; the smaller one has fewer gradients."""
    texture = Speckle(SHAPE, 5)
    first, second = (noisy(texture.image(), 3.0, seed) for seed in (1, 2))
    sigma = []
    for subset in (MIN_WINDOW_PX, 27):
        matches = _matched(first, second, np.zeros_like(POINTS), subset=subset)
        sigma.append(np.nanmedian(np.sqrt(matches.covariance[:, 0, 0])))
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
    confirmed = confirmed_matches(matches, cell, pixel)
    wrong = confirmed.outcome == Outcome.NEIGHBOURS
    np.testing.assert_array_equal(confirmed.outcome[~wrong], outcome[~wrong])
    np.testing.assert_array_equal(np.isnan(confirmed.displacement).all(axis=1), wrong)
    np.testing.assert_array_equal(confirmed.displacement[~wrong], displacement[~wrong])
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


@pytest.fixture(scope="module")
def rest():
    return TEXTURE.image()


@pytest.fixture(scope="module")
def moved():
    return {name: TEXTURE.image(warp) for name, warp in WARPS.items()}


def _match(first, second, start, *, points=PLANAR_POINTS, gradient=None, **options):
    return refine_planar(
        make_spline_picture(first),
        make_spline_picture(second),
        points,
        start,
        start_gradient=gradient,
        **options,
    )


def _noisy(grey, seed):
    """White noise and no more: no rounding, and nothing cut off where speckles pile up."""
    noise = np.random.default_rng(seed).normal(0.0, NOISE, grey.shape)
    return (grey + noise).astype(np.float32)


def _start(truth, seed=0):
    """As good as a dense start: off by a third of a pixel in each direction."""
    return truth + np.random.default_rng(seed).normal(0.0, 0.3, truth.shape)


def _gradient(warp):
    h = 0.5
    columns = [
        (warp.displacement(PLANAR_POINTS + h * e) - warp.displacement(PLANAR_POINTS - h * e))
        / (2.0 * h)
        for e in np.eye(2)
    ]
    return np.stack(columns, axis=2)


def _ratios(match, truth):
    sigma = np.sqrt(np.einsum("nii->ni", match.covariance))
    return (match.displacement - truth) / sigma


@pytest.mark.parametrize("name", WARPS)
def test_without_noise_the_motion_is_found(rest, moved, name):
    """The spline's bias on this texture stays below a thousandth, 0.003 at the worst point.

    The bent one, given by its inverse, has cubic terms too: 5e-6 px^-2 times half a window's cube.
    """
    truth = WARPS[name].displacement(PLANAR_POINTS)
    match = _match(rest, moved[name], _start(truth), shape="quadratic")
    assert match.converged.all()
    error = match.displacement - truth
    assert np.sqrt((error**2).mean()) < 1e-3
    assert np.abs(error).max() < (7e-3 if name == "bent" else 3e-3)
    assert np.abs(error.mean(axis=0)).max() < 5e-4
    # The gradient times ten pixels, half a window, is as good as the shift or four times worse.
    assert np.abs(match.gradient - _gradient(WARPS[name])).max() < 1e-3
    assert match.score.min() > 0.9999


@pytest.mark.parametrize("sigma", [0.9, 1.3])
def test_small_motions_through_sharp_textures_are_as_long_as_they_are(sigma):
    """With the pictures' low-pass; interpolation by cubic splines makes them 0.6 and 0.3 % longer.

    The average over 1000 points is exact to 0.03 % for the finer texture, 0.01 % for the other.
    """
    sharp, truth = Speckle(PLANAR_SHAPE, 4, sigma), np.array([0.1, -0.07])
    first, second = (
        make_spline_picture(sharp.image(warp), smoothing=1.0)
        for warp in (affine(np.eye(2), (0.0, 0.0), CENTRE), affine(np.eye(2), truth, CENTRE))
    )
    match = refine_planar(first, second, PLANAR_POINTS, np.zeros_like(PLANAR_POINTS))
    assert match.converged.all()
    np.testing.assert_allclose(match.displacement.mean(axis=0), truth, rtol=1e-3)


@pytest.mark.parametrize("name", ["shift", "strain", "turn"])
def test_affine_motions_are_exact_for_affine_windows(rest, moved, name):
    truth = WARPS[name].displacement(PLANAR_POINTS)
    error = _match(rest, moved[name], _start(truth)).displacement - truth
    assert np.abs(error).max() < 2e-3


def test_affine_windows_are_biased_where_the_motion_bends(rest, moved):
    """By the mean of half the second derivatives, weighted by the texture: (35, 20) 3e-4 px."""
    truth = WARPS["bent"].displacement(PLANAR_POINTS)
    affine_error = (_match(rest, moved["bent"], truth).displacement - truth).mean(axis=0)
    # Over a window the mean of xi^2 is 10^2 / 3; minus, since the coefficients are the inverse's.
    expected = -(BENT[:, 3] + BENT[:, 5]) * 110.0 / 3.0
    np.testing.assert_allclose(affine_error, expected, atol=2e-3)
    match = _match(rest, moved["bent"], truth, shape="quadratic")
    assert np.abs((match.displacement - truth).mean(axis=0)).max() < 0.1 * np.abs(expected).min()


def _bound(rest, half, free):
    """Cramer-Rao: two noisy pictures, gain and offset unknown; (n, 2) variances [px^2]."""
    picture = make_spline_picture(rest)
    eta, xi = np.mgrid[-half : half + 1, -half : half + 1].astype(float).reshape(2, -1) / half
    powers = np.stack([xi**0, xi, eta, xi * xi, xi * eta, eta * eta])[:free]
    result = np.empty((len(PLANAR_POINTS), 2))
    for n, (column, row) in enumerate(PLANAR_POINTS.astype(int)):
        cut = np.s_[row - half : row + half + 1, column - half : column + half + 1]
        slopes = picture.along_column[cut].ravel(), picture.along_row[cut].ravel()
        design = np.concatenate([*(s * powers for s in slopes), [xi**0, rest[cut].ravel()]])
        result[n] = np.diag(np.linalg.inv(design @ design.T))[[0, free]]
    return 2.0 * NOISE**2 * result


@pytest.mark.parametrize(("shape", "free"), [("affine", 3), ("quadratic", 6)])
def test_errors_are_those_of_the_bound_and_are_claimed(rest, moved, shape, free):
    bound = _bound(rest, 10, free)
    squares, ratios = [], []
    for seed, name in enumerate(("shift", "turn", "shift", "strain")):
        truth = WARPS[name].displacement(PLANAR_POINTS)
        match = _match(
            _noisy(rest, 10 + seed), _noisy(moved[name], 20 + seed), _start(truth),
            gradient=_gradient(WARPS[name]), shape=shape,
        )  # fmt: skip
        assert match.converged.all()
        squares.append((match.displacement - truth) ** 2)
        ratios.append(_ratios(match, truth))
        # 8 % of standard deviation: the variance is taken from 430 pixels.
        np.testing.assert_allclose(
            np.sqrt(np.einsum("nii->ni", match.covariance)), np.sqrt(bound), rtol=0.25
        )
    # Some 600 windows that do not overlap, two components: 2 % from chance, and what noise in the
    # gradients costs, a percent or two.
    assert 0.95 < np.sqrt(np.mean(squares) / bound.mean()) < 1.1
    assert 0.93 < np.sqrt(np.mean(np.square(ratios))) < 1.1


@pytest.mark.parametrize("name", ["turn", "strain"])
def test_small_windows_reach_their_bound_where_the_gradient_is_known(rest, moved, name):
    """Seven pixels a side know two unknowns well enough, and six not at all."""
    truth, gradient = WARPS[name].displacement(PLANAR_POINTS), _gradient(WARPS[name])
    first, second = _noisy(rest, 5), _noisy(moved[name], 6)
    match = _match(first, second, truth, gradient=gradient, subset=7, shape="shift")
    assert match.converged.mean() > 0.999
    np.testing.assert_array_equal(match.gradient[match.converged], gradient[match.converged])
    bound = _bound(rest, 3, 1)
    # The windows without much texture: where the bound is a tenth of a pixel it is none any more.
    good = match.converged & (bound.max(axis=1) < 0.1**2)
    assert good.mean() > 0.97
    error = (match.displacement - truth)[good]
    # 900 windows that do not overlap: 2 % from chance; noise in the gradients as before, and more.
    assert 0.95 < np.sqrt((error**2).mean() / bound[good].mean()) < 1.15
    assert 0.93 < np.sqrt((_ratios(match, truth)[good] ** 2).mean()) < 1.2
    whole = _match(first, second, truth, gradient=gradient, subset=7, shape="affine")
    worse = (whole.displacement - truth)[whole.converged]
    assert np.sqrt((worse**2).mean()) > 1.1 * np.sqrt((error**2).mean())


def test_covariance_holds_for_both_components_together(rest, moved):
    """Mahalanobis distance: its mean is two, also where the texture has a preferred direction."""
    stretch = affine(np.diag([2.0, 1.0]), (0.0, 0.0), CENTRE)
    shifted = affine(np.diag([2.0, 1.0]), (0.4, -0.3), CENTRE)
    first, second = TEXTURE.image(stretch), TEXTURE.image(shifted)
    truth = np.tile([0.4, -0.3], (len(PLANAR_POINTS), 1))
    total = []
    for seed in range(4):
        match = _match(_noisy(first, seed), _noisy(second, 50 + seed), truth)
        error = match.displacement - truth
        total.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(match.covariance), error))
    sigma = np.sqrt(np.einsum("nii->ni", match.covariance).mean(axis=0))
    assert sigma[0] > 1.5 * sigma[1]
    # 3 % from chance, as much for the noise in the gradients, which makes them look steeper.
    assert np.mean(total) / 2.0 == pytest.approx(1.0, abs=0.12)


def test_light_that_changes_is_no_matter(rest, moved):
    """Gain and offset are eliminated exactly; single precision and the last step are left."""
    truth = WARPS["turn"].displacement(PLANAR_POINTS)
    first, second = _noisy(rest, 1), _noisy(moved["turn"], 2)
    plain = _match(first, second, _start(truth))
    other = _match(first, (1.4 * second - 35.0).astype(np.float32), _start(truth))
    np.testing.assert_array_equal(plain.converged, other.converged)
    np.testing.assert_allclose(other.displacement, plain.displacement, atol=2e-4)
    np.testing.assert_allclose(other.score, plain.score, atol=1e-5)
    np.testing.assert_allclose(other.covariance, plain.covariance, rtol=1e-2, atol=1e-9)


def test_pictures_that_change_places_give_minus_the_motion(rest):
    """Shift by whole pixels: the same pixels are compared, so the noise is the same too."""
    step = np.array([3.0, -2.0])
    first = _noisy(rest, 1)
    second = _noisy(TEXTURE.image(affine(np.eye(2), tuple(step), CENTRE)), 2)
    truth = np.tile(step, (len(PLANAR_POINTS), 1))
    there = _match(first, second, _start(truth))
    back = _match(second, first, -_start(truth), points=PLANAR_POINTS + step)
    gap = there.displacement + back.displacement
    sigma = np.sqrt(np.einsum("nii->ni", there.covariance))
    # Only the gradients' noise differs: a few percent of the error itself.
    assert np.sqrt(((gap / sigma) ** 2).mean()) < 0.2


def test_result_does_not_depend_on_the_start(rest, moved):
    truth = WARPS["shift"].displacement(PLANAR_POINTS)
    first = _match(rest, moved["shift"], _start(truth, 1))
    second = _match(rest, moved["shift"], _start(truth, 2))
    # The last step, 5e-4 px, is far longer than what is left after it.
    np.testing.assert_allclose(first.displacement, second.displacement, atol=1e-4)


def test_windows_without_contrast_or_room_are_not_found(rest, moved):
    flat = rest.copy()
    flat[80:110, 100:140] = 60.0
    points = np.array([
        [9.0, 95.0], [250.0, 95.0], [130.0, 9.0], [130.0, 180.0],  # beyond the edge
        [120.0, 95.0],  # nothing there
        [130.0, 40.0],  # no start
        [10.0, 95.0], [249.0, 95.0], [130.0, 10.0], [130.0, 179.0],  # touches the edge
        [40.0, 40.0],
    ])  # fmt: skip
    start = np.tile(WARPS["shift"].displacement(PLANAR_POINTS[:1]), (len(points), 1))
    start[5] = np.nan
    match = _match(flat, moved["shift"], start, points=points)
    # The shift (+0.37, -0.61) leads two of the last ones out of the picture.
    expected = [False] * 6 + [True, False, False, True, True]
    assert match.converged.tolist() == expected
    for value in (match.displacement, match.gradient, match.covariance, match.score):
        lost = value.reshape(len(points), -1)[~match.converged]
        assert np.isnan(lost).all()
        assert np.isfinite(value[match.converged]).all()


def test_a_flat_or_negative_later_picture_is_not_found(rest):
    start = np.zeros((len(PLANAR_POINTS), 2))
    assert not _match(rest, np.full_like(rest, 80.0), start).converged.any()
    # Where a window finds something in a negative it is the wrong place, and fits badly.
    match = _match(rest, 255.0 - rest, start)
    assert not (match.score > 0.8).any()


def test_what_leaves_its_start_is_lost():
    """Speckles so wide that windows are drawn over any distance; 8 px is the farthest allowed."""
    wide = Speckle(PLANAR_SHAPE, 3, 12.0)
    first, second = wide.image(), wide.image(affine(np.eye(2), (7.5, 0.0), CENTRE))
    points = PLANAR_POINTS[np.linalg.norm(PLANAR_POINTS - CENTRE, axis=1) < 40.0]
    near = _match(first, second, np.zeros_like(points), points=points, shape="shift", subset=41)
    good = near.converged
    # The others overshoot on their way.
    assert good.sum() > 20
    np.testing.assert_allclose(near.displacement[good], [[7.5, 0.0]] * good.sum(), atol=0.02)
    farther = np.tile([-1.0, 0.0], (len(points), 1))
    lost = _match(first, second, farther, points=points, shape="shift", subset=41)
    assert not lost.converged[good].any()


def test_windows_that_come_into_the_picture_are_not_found(rest):
    """What lies beyond the edge at rest is not known, wherever it goes."""
    step = np.array([[2.0, 1.0]])
    second = TEXTURE.image(affine(np.eye(2), (2.0, 1.0), CENTRE))
    for pixel in ([9.0, 95.0], [130.0, 9.0]):
        assert not _match(rest, second, step, points=np.array([pixel])).converged.any()
    for pixel in ([250.0, 95.0], [130.0, 180.0]):
        assert not _match(second, rest, -step, points=np.array([pixel])).converged.any()
    inside = np.array([[10.0, 95.0], [130.0, 10.0]])
    assert _match(rest, second, np.repeat(step, 2, axis=0), points=inside).converged.all()


def test_no_points_are_no_trouble(rest):
    match = _match(rest, rest, np.zeros((0, 2)), points=np.zeros((0, 2)))
    assert match.displacement.shape == (0, 2)
    assert match.converged.shape == (0,)


@pytest.mark.parametrize("subset", [-1, 0, 3, 4, 20])
def test_even_or_tiny_subsets_are_refused(subset):
    with pytest.raises(InputError, match=f"subset is {subset}"):
        _match(TEXTURE.image(), TEXTURE.image(), np.zeros((len(PLANAR_POINTS), 2)), subset=subset)
