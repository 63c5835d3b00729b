"""The vote of the cameras on textures that move by whole pixels, and against plain loops."""

import numba
import numpy as np
import pytest
from vision.textures import Speckle, Warp, noisy, window_correlation

from palpate.vision.lang_pai.disparity import COLUMNS, ROWS, Instant, Views
from palpate.vision.lang_pai.voting import (
    VALID,
    _interpolate,
    _normalise,
    _shifted_dot,
    vote,
    window_kernel,
)
from palpate.vision.range_flow import Outcome

SHAPE = (70, 90)
VIEWS = Views(np.array([0, COLUMNS, ROWS]), np.array([0.0, 1.0, 0.7]), np.array([0.0, -3.4, 1.3]))
REST, LOADED = 6.3, 7.1
# Camera and shift of a planted error [px].
RIGHT = (0, (0, 0))
HALF = 3
ROWS_COLUMNS = (24, 31)


def _instant(motion, disparity, *, wrong=RIGHT, noise=0.0, seed=0):
    """A flat texture that has moved by `motion`, seen by all cameras at one disparity.

    In camera `wrong[0]` it has moved by `wrong[1]` more than it should.
    """
    texture = Speckle(SHAPE, 5)
    pictures = []
    for c in range(len(VIEWS.along)):
        shift = np.array(motion, dtype=float)
        if c > 0:
            shift[VIEWS.along[c]] += VIEWS.offset[c] + VIEWS.ratio[c] * disparity
        if c == wrong[0]:
            shift += wrong[1]
        picture = texture.image(Warp(lambda pixel, shift=shift: pixel - shift))
        pictures.append(noisy(picture, noise, seed + c) if noise else picture)
    return Instant(np.stack(pictures).astype(np.float32), np.full(SHAPE, disparity))


def _vote(before, after, pixel, views=VIEWS, **sizes):
    return vote(before, after, views, pixel, **{"subset": 7, "search": 13} | sizes)


def _pixels(step=5):
    """Pixels whose search stays in all pictures."""
    row, column = np.mgrid[14:50:step, 16:68:step]
    return np.stack([column.ravel(), row.ravel()], axis=1)


@pytest.mark.parametrize("motion", [(0, 0), (4, -3), (-6, 6), (6, 6)])
@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_whole_pixels_are_found_exactly(motion, noise):
    """To the very ends of the search range; no window of speckle looks like another one."""
    pixel = _pixels()
    votes = _vote(
        _instant((0, 0), REST, noise=noise),
        _instant(motion, LOADED, noise=noise, seed=10),
        pixel,
    )
    assert (votes.outcome == Outcome.VALID).mean() > 0.99
    good = votes.outcome == Outcome.VALID
    assert np.array_equal(
        votes.pixel[good] - pixel[good], np.broadcast_to(motion, pixel.shape)[good]
    )
    assert (votes.agreed[good] == 3).all()
    # Interpolation between pixels blurs by different amounts before and after; noise of 1.5 grey
    # levels beside a contrast of 45.
    assert np.median(votes.score) > 0.95
    if not noise:
        assert not votes.distance.any()


@pytest.mark.parametrize(("fraction", "whole"), [(0.3, 0), (0.7, 1), (-0.3, 0), (-0.7, -1)])
def test_a_fraction_of_a_pixel_is_rounded(fraction, whole):
    """The paper has no sub-pixel step: the nearest pixel is most alike, nearly always."""
    pixel = _pixels()
    votes = _vote(_instant((0, 0), REST), _instant((2 + fraction, -1), LOADED), pixel)
    good = votes.outcome == Outcome.VALID
    moved = votes.pixel[good] - pixel[good]
    assert good.mean() > 0.98
    assert (moved == [2 + whole, -1]).all(axis=1).mean() > 0.97


@pytest.mark.parametrize("camera", [0, 1, 2])
@pytest.mark.parametrize("extra", [(3, 0), (0, 4), (-5, 2), (3, -6)])
def test_one_camera_that_contradicts_is_enough_to_reject(camera, extra):
    """A highlight, say, moves differently in one camera: no pixel is within one of 0 and of 3.

    By two, the highest sum may be the pixel between, and the vote is won.
    """
    pixel = _pixels(7)
    after = _instant((3, 1), LOADED, wrong=(camera, extra))
    votes = _vote(_instant((0, 0), REST), after, pixel)
    assert (votes.outcome == Outcome.REPROJECTION).all()
    assert (votes.agreed < 3).all()
    # Where the two that agree have the highest sum, the third is off by all of the extra.
    winner = (votes.pixel - pixel == [3, 1]).all(axis=1)
    assert winner.mean() > 0.2
    assert (votes.agreed[winner] == 2).all()
    np.testing.assert_allclose(votes.distance[winner], np.hypot(*extra) / np.sqrt(3.0), atol=1e-12)


@pytest.mark.parametrize("camera", [0, 1, 2])
@pytest.mark.parametrize("extra", [(1, 0), (0, -1), (1, 1)])
def test_the_eight_pixels_around_the_best_count_as_agreement(camera, extra):
    votes = _vote(
        _instant((0, 0), REST),
        _instant((3, 1), LOADED, wrong=(camera, extra)),
        _pixels(7),
    )
    good = votes.outcome == Outcome.VALID
    assert good.mean() > 0.95
    assert (votes.distance[good] <= np.sqrt(2.0)).all()
    assert (votes.distance[good] > 0.5).all()


@pytest.mark.slow
def test_it_is_the_vote_that_plain_loops_hold():
    """Bad pictures, so that every outcome of a vote occurs; disparity differs between pixels."""
    rng = np.random.default_rng(2)
    before = _instant((0, 0), REST, noise=12.0)
    after = _instant((2.4, -1.3), LOADED, noise=60.0, seed=7)
    near = REST + rng.uniform(-0.5, 0.5, SHAPE)
    far = np.where(rng.uniform(size=SHAPE) < 0.3, np.nan, LOADED + rng.uniform(-0.5, 0.5, SHAPE))
    before, after = Instant(before.pictures, near), Instant(after.pictures, far)
    pixel = _pixels(6)
    # Little of a negative is found where the search is narrow: there the mean is below zero.
    negative = Instant(255.0 - after.pictures, after.disparity)
    kinds = _agree_with_loops(before, after, pixel, 5, 9)
    kinds |= _agree_with_loops(before, negative, pixel, 5, 3)
    assert kinds == {Outcome.VALID, Outcome.SCORE, Outcome.REPROJECTION}


def _agree_with_loops(before, after, pixel, subset, search):
    """Compare a vote with that of plain loops; the outcomes that occurred."""
    votes = _vote(before, after, pixel, subset=subset, search=search)
    brute = [_brute_vote(before, after, centre, subset // 2, search // 2) for centre in pixel]
    for k, (voted, score, distance, agreed, outcome) in enumerate(brute):
        assert votes.pixel[k].tolist() == list(voted)
        assert votes.outcome[k] == outcome
        assert votes.agreed[k] == agreed
        np.testing.assert_allclose(
            [votes.score[k], votes.distance[k]], [score, distance], atol=1e-6
        )
    return {Outcome(k) for k in votes.outcome}


def _brute_vote(before, after, pixel, half, reach):
    start = before.disparity[pixel[1], pixel[0]]
    offsets = [(x, y) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)]
    table = np.full((3, len(offsets)), np.nan)
    for k, offset in enumerate(offsets):
        target = pixel + offset
        end = after.disparity[target[1], target[0]]
        for c in range(3 if np.isfinite(end) else 1):
            table[c, k] = window_correlation(
                before.pictures[c].astype(float), _moved(pixel, c, start),
                after.pictures[c].astype(float), _moved(target, c, end), half,
            )  # fmt: skip
    best = np.nanargmax(table.sum(axis=0))
    best_of_camera = np.nanargmax(table, axis=1)
    away = np.array([np.subtract(offsets[k], offsets[best]) for k in best_of_camera])
    agreed = int((np.abs(away).max(axis=1) <= 1).sum())
    outcome = Outcome.VALID if agreed == 3 else Outcome.REPROJECTION
    if table[:, best].mean() < 0.0:
        outcome = Outcome.SCORE
    distance = np.sqrt((away**2).sum(axis=1).mean())
    return pixel + offsets[best], table[:, best].min(), distance, agreed, outcome


def _moved(pixel, camera, disparity):
    """The place of the reference's pixel in a camera."""
    if camera == 0:
        return pixel
    shift = VIEWS.offset[camera] + VIEWS.ratio[camera] * disparity
    return pixel + shift * np.eye(2)[VIEWS.along[camera]]


def test_each_reason_has_its_outcome():
    before, after = _instant((0, 0), REST), _instant((1, 1), LOADED)
    hidden, lost = before.disparity.copy(), after.disparity.copy()
    hidden[20, 30] = np.nan
    lost[23:37, 38:52] = np.nan
    flat, unknown = before.pictures.copy(), after.pictures.copy()
    flat[1, 30:40, 60:75] = 80.0
    unknown[2, 50:, :] = np.nan
    pixel = np.array([[30, 20], [45, 30], [64, 35], [1, 30], [30, 58], [30, 30]])
    votes = _vote(Instant(flat, hidden), Instant(unknown, lost), pixel)
    names = [Outcome(k).name for k in votes.outcome]
    assert names == ["HIDDEN", "LOST", "TEXTURE", "OUTSIDE", "OUTSIDE", "VALID"]
    rejected = votes.outcome != Outcome.VALID
    assert np.isnan(votes.score[rejected]).all()
    assert not votes.agreed[rejected].any()
    assert np.array_equal(votes.pixel[rejected], pixel[rejected])
    pair = Views(*(a[:2] for a in (VIEWS.along, VIEWS.ratio, VIEWS.offset)))
    two = _vote(
        Instant(flat[:2], hidden), Instant(unknown[:2], lost), np.array([[30, 58], [30, 30]]), pair
    )
    assert (two.outcome == Outcome.VALID).all()
    assert (two.agreed == 2).all()


def test_a_negative_is_no_match():
    before, after = _instant((0, 0), REST), _instant((0, 0), REST)
    negative = Instant(255.0 - after.pictures, after.disparity)
    votes = _vote(before, negative, _pixels(), search=3)
    assert (votes.outcome != Outcome.VALID).all()
    assert (votes.outcome == Outcome.SCORE).mean() > 0.5


def test_the_number_of_threads_does_not_matter():
    before, after = _instant((0, 0), REST, noise=9.0), _instant((2, 2), LOADED, noise=9.0, seed=4)
    threads = numba.get_num_threads()
    first = _vote(before, after, _pixels(3))
    try:
        numba.set_num_threads(1)
        second = _vote(before, after, _pixels(3))
    finally:
        numba.set_num_threads(threads)
    for name in ("pixel", "score", "distance", "agreed", "outcome"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


def _pictures(seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 255.0, (2, *ROWS_COLUMNS))


def correlation(first_picture, two, a, p, b, q, *, window=7, along=COLUMNS):
    """What the vote correlates, at places `p` and `q` beyond the pixels `a` and `b`; NaN: none."""
    half, values = window // 2, []
    first, second = np.empty(window**2), np.empty(window**2)
    for (ca, ra), pa, (cb, rb), qb in zip(a, p, b, q, strict=True):
        known = window_kernel(first_picture, ca, ra, float(pa), along, half, first) == VALID
        known &= _interpolate(two, cb, rb, float(qb), along, half, second)
        scale = _normalise(second) if known else np.nan
        if not np.isnan(scale):
            scale *= _shifted_dot(two, cb, rb, float(qb), along, half, first)
        values.append(scale)
    return np.array(values)


def _places(count, seed):
    """Pixels (column, row) whose windows, and their next ones, are inside; fractions 0 to 1."""
    rng = np.random.default_rng(seed)
    high = [ROWS_COLUMNS[1] - HALF - 1, ROWS_COLUMNS[0] - HALF - 1]
    fraction = np.concatenate([[0.0, 1.0], rng.uniform(0.0, 1.0, count - 2)])
    return rng.integers(HALF, high, (count, 2)), fraction


def _window(grey, column, row):
    return grey[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]


def _corr(first_picture, column_a, row_a, two, column_b, row_b):
    """I_corr of equation 6."""
    a, b = _window(first_picture, column_a, row_a), _window(two, column_b, row_b)
    return ((a - a.mean()) * (b - b.mean())).sum()


def _equation_6(first_picture, two, a, p, b, q, *, printed=False):
    """The paper's equation, from correlations at whole pixels; `printed`: with its misprint."""
    (ca, ra), (cb, rb) = a, b
    second = cb if printed else cb + 1
    cross = (
        (1 - p) * (1 - q) * _corr(first_picture, ca, ra, two, cb, rb)
        + (1 - p) * q * _corr(first_picture, ca, ra, two, second, rb)
        + p * (1 - q) * _corr(first_picture, ca + 1, ra, two, cb, rb)
        + p * q * _corr(first_picture, ca + 1, ra, two, cb + 1, rb)
    )

    def own(grey, column, row, share):
        rest = 1 - share
        return (
            rest * rest * _corr(grey, column, row, grey, column, row)
            + 2.0 * rest * share * _corr(grey, column, row, grey, column + 1, row)
            + share * share * _corr(grey, column + 1, row, grey, column + 1, row)
        )

    size = np.sqrt(cross**2 / own(first_picture, ca, ra, p) / own(two, cb, rb, q))
    return np.sign(cross) * size


@pytest.mark.slow
def test_it_is_equation_6():
    first_picture, two = _pictures()
    a, p = _places(60, 1)
    b, q = _places(60, 2)
    score = correlation(first_picture, two, a, p, b, q, window=7)
    literal = [_equation_6(first_picture, two, *rest) for rest in zip(a, p, b, q, strict=True)]
    # Products of 8-bit greys summed over 49 pixels: 1e7 times double precision.
    np.testing.assert_allclose(score, literal, atol=1e-12)
    assert np.ptp(score) > 0.5
    # The equation as printed is another one: where q is 0 they meet, elsewhere not.
    printed = [
        _equation_6(first_picture, two, *rest, printed=True)
        for rest in zip(a, p, b, q, strict=True)
    ]
    assert abs(printed[0] - score[0]) < 1e-12
    assert np.median(np.abs(np.array(printed[2:]) - score[2:])) > 0.01


@pytest.mark.parametrize("along", [COLUMNS, ROWS])
@pytest.mark.parametrize("window", [3, 7, 9])
def test_it_is_the_correlation_of_interpolated_windows(along, window):
    first_picture, two = _pictures(3)
    rng = np.random.default_rng(4)
    half = window // 2
    high = np.array([ROWS_COLUMNS[1], ROWS_COLUMNS[0]]) - half - 1
    a, b = rng.integers(half, high, (2, 40, 2))
    p, q = rng.uniform(0.0, 1.0, (2, 40))
    score = correlation(first_picture, two, a, p, b, q, window=window, along=along)

    def interpolated(grey, pixel, share):
        further = np.roll(grey, -1, axis=1 - along)
        mixed = (1.0 - share) * grey + share * further
        column, row = pixel
        return mixed[row - half : row + half + 1, column - half : column + half + 1].ravel()

    direct = [
        np.corrcoef(interpolated(first_picture, *x), interpolated(two, *y))[0, 1]
        for x, y in zip(zip(a, p, strict=True), zip(b, q, strict=True), strict=True)
    ]
    np.testing.assert_allclose(score, direct, atol=1e-12)


def test_a_window_matches_itself_whatever_the_lighting_and_not_its_negative():
    picture, _ = _pictures(5)
    a, p = _places(20, 6)
    brighter = correlation(picture, 2.5 * picture - 40.0, a, p, a, p, window=7)
    np.testing.assert_allclose(brighter, 1.0, atol=1e-12)
    negative = correlation(picture, 255.0 - picture, a, p, a, p, window=7)
    np.testing.assert_allclose(negative, -1.0, atol=1e-12)


def _ends(along, fraction):
    """First and last pixels whose windows are just inside, and the four just outside."""
    rows, columns = ROWS_COLUMNS
    right, down = columns - HALF - 1, rows - HALF - 1
    if fraction > 0.0:
        right, down = (right - 1, down) if along == COLUMNS else (right, down - 1)
    inside = np.array([[HALF, HALF], [right, HALF], [HALF, down], [right, down]])
    out = inside + np.array([[-1, 0], [1, 0], [0, 1], [0, 1]])
    return inside, np.concatenate([out, [[HALF, HALF - 1]]])


@pytest.mark.parametrize("along", [COLUMNS, ROWS])
@pytest.mark.parametrize("fraction", [0.0, 0.4])
def test_windows_that_leave_the_picture_are_unknown(along, fraction):
    first_picture, two = _pictures(7)
    inside, outside = _ends(along, fraction)
    middle = np.array([15, 12])
    for places, known in ((inside, True), (outside, False)):
        share = np.full(len(places), fraction)
        here = np.broadcast_to(middle, places.shape).copy()
        none = np.zeros(len(places))
        for score in (
            correlation(first_picture, two, places, share, here, none, window=7, along=along),
            correlation(first_picture, two, here, none, places, share, window=7, along=along),
        ):
            assert np.array_equal(np.isfinite(score), np.full(len(places), known))


def test_unknown_greys_and_windows_without_contrast_have_no_correlation():
    picture, two = _pictures(8)
    picture[10, 14] = np.nan
    # 0.1 has no exact double: rounding must not pass for contrast.
    two[:, 20:] = 100.1
    column = np.array([9, 10, 11, 17, 18])
    pixel = np.stack([column, np.full(5, 10)], axis=1)
    for share, unknown in ((0.0, [11, 17]), (0.5, [10, 11, 17])):
        shares = np.full(5, share)
        score = correlation(picture, picture, pixel, shares, pixel, shares, window=7)
        assert column[np.isnan(score)].tolist() == unknown
    flat = np.array([[23, 10], [22, 10]])
    some = correlation(two, two, flat, np.array([0.3, 0.3]), flat, np.array([0.0, 0.0]), window=7)
    assert np.isfinite(some).tolist() == [False, True]
