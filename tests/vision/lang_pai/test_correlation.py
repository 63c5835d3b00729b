"""Correlation between whole pixels, against equation 6 and against interpolated windows."""

import numpy as np
import pytest

from palpate.vision.lang_pai.disparity import COLUMNS, ROWS
from palpate.vision.lang_pai.voting import (
    VALID,
    _interpolate,
    _normalise,
    _shifted_dot,
    window_kernel,
)

HALF = 3
ROWS_COLUMNS = (24, 31)


def _pictures(seed=0):
    rng = np.random.default_rng(seed)
    return rng.uniform(0.0, 255.0, (2, *ROWS_COLUMNS))


def correlation(one, two, a, p, b, q, *, window=7, along=COLUMNS):
    """What the vote correlates, at places `p` and `q` beyond the pixels `a` and `b`; NaN: none."""
    half, found = window // 2, []
    first, second = np.empty(window**2), np.empty(window**2)
    for (ca, ra), pa, (cb, rb), qb in zip(a, p, b, q, strict=True):
        known = window_kernel(one, ca, ra, float(pa), along, half, first) == VALID
        known &= _interpolate(two, cb, rb, float(qb), along, half, second)
        scale = _normalise(second) if known else np.nan
        if not np.isnan(scale):
            scale *= _shifted_dot(two, cb, rb, float(qb), along, half, first)
        found.append(scale)
    return np.array(found)


def _places(count, seed):
    """Pixels (column, row) whose windows, and their next ones, are inside; fractions 0 to 1."""
    rng = np.random.default_rng(seed)
    high = [ROWS_COLUMNS[1] - HALF - 1, ROWS_COLUMNS[0] - HALF - 1]
    fraction = np.concatenate([[0.0, 1.0], rng.uniform(0.0, 1.0, count - 2)])
    return rng.integers(HALF, high, (count, 2)), fraction


def _window(grey, column, row):
    return grey[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]


def _corr(one, column_a, row_a, two, column_b, row_b):
    """I_corr of equation 6."""
    a, b = _window(one, column_a, row_a), _window(two, column_b, row_b)
    return ((a - a.mean()) * (b - b.mean())).sum()


def _equation_6(one, two, a, p, b, q, *, printed=False):
    """The paper's equation, from correlations at whole pixels; `printed`: with its misprint."""
    (ca, ra), (cb, rb) = a, b
    second = cb if printed else cb + 1
    cross = (
        (1 - p) * (1 - q) * _corr(one, ca, ra, two, cb, rb)
        + (1 - p) * q * _corr(one, ca, ra, two, second, rb)
        + p * (1 - q) * _corr(one, ca + 1, ra, two, cb, rb)
        + p * q * _corr(one, ca + 1, ra, two, cb + 1, rb)
    )

    def own(grey, column, row, share):
        rest = 1 - share
        return (
            rest * rest * _corr(grey, column, row, grey, column, row)
            + 2.0 * rest * share * _corr(grey, column, row, grey, column + 1, row)
            + share * share * _corr(grey, column + 1, row, grey, column + 1, row)
        )

    size = np.sqrt(cross**2 / own(one, ca, ra, p) / own(two, cb, rb, q))
    return np.sign(cross) * size


@pytest.mark.slow
def test_it_is_equation_6():
    one, two = _pictures()
    a, p = _places(60, 1)
    b, q = _places(60, 2)
    score = correlation(one, two, a, p, b, q, window=7)
    literal = [_equation_6(one, two, *rest) for rest in zip(a, p, b, q, strict=True)]
    # Products of 8-bit greys summed over 49 pixels: 1e7 times double precision.
    np.testing.assert_allclose(score, literal, atol=1e-12)
    assert np.ptp(score) > 0.5
    # The equation as printed is another one: where q is 0 they meet, elsewhere not.
    printed = [_equation_6(one, two, *rest, printed=True) for rest in zip(a, p, b, q, strict=True)]
    assert abs(printed[0] - score[0]) < 1e-12
    assert np.median(np.abs(np.array(printed[2:]) - score[2:])) > 0.01


@pytest.mark.parametrize("along", [COLUMNS, ROWS])
@pytest.mark.parametrize("window", [3, 7, 9])
def test_it_is_the_correlation_of_interpolated_windows(along, window):
    one, two = _pictures(3)
    rng = np.random.default_rng(4)
    half = window // 2
    high = np.array([ROWS_COLUMNS[1], ROWS_COLUMNS[0]]) - half - 1
    a, b = rng.integers(half, high, (2, 40, 2))
    p, q = rng.uniform(0.0, 1.0, (2, 40))
    score = correlation(one, two, a, p, b, q, window=window, along=along)

    def interpolated(grey, pixel, share):
        further = np.roll(grey, -1, axis=1 - along)
        mixed = (1.0 - share) * grey + share * further
        column, row = pixel
        return mixed[row - half : row + half + 1, column - half : column + half + 1].ravel()

    direct = [
        np.corrcoef(interpolated(one, *x), interpolated(two, *y))[0, 1]
        for x, y in zip(zip(a, p, strict=True), zip(b, q, strict=True), strict=True)
    ]
    np.testing.assert_allclose(score, direct, atol=1e-12)


def test_a_window_matches_itself_whatever_the_lighting_and_not_its_negative():
    one, _ = _pictures(5)
    a, p = _places(20, 6)
    brighter = correlation(one, 2.5 * one - 40.0, a, p, a, p, window=7)
    np.testing.assert_allclose(brighter, 1.0, atol=1e-12)
    negative = correlation(one, 255.0 - one, a, p, a, p, window=7)
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
    one, two = _pictures(7)
    inside, outside = _ends(along, fraction)
    middle = np.array([15, 12])
    for places, known in ((inside, True), (outside, False)):
        share = np.full(len(places), fraction)
        here = np.broadcast_to(middle, places.shape).copy()
        none = np.zeros(len(places))
        for score in (
            correlation(one, two, places, share, here, none, window=7, along=along),
            correlation(one, two, here, none, places, share, window=7, along=along),
        ):
            assert np.array_equal(np.isfinite(score), np.full(len(places), known))


def test_unknown_greys_and_windows_without_contrast_have_no_correlation():
    one, two = _pictures(8)
    one[10, 14] = np.nan
    # 0.1 has no exact double: rounding must not pass for contrast.
    two[:, 20:] = 100.1
    column = np.array([9, 10, 11, 17, 18])
    pixel = np.stack([column, np.full(5, 10)], axis=1)
    for share, unknown in ((0.0, [11, 17]), (0.5, [10, 11, 17])):
        shares = np.full(5, share)
        score = correlation(one, one, pixel, shares, pixel, shares, window=7)
        assert column[np.isnan(score)].tolist() == unknown
    flat = np.array([[23, 10], [22, 10]])
    some = correlation(two, two, flat, np.array([0.3, 0.3]), flat, np.array([0.0, 0.0]), window=7)
    assert np.isfinite(some).tolist() == [False, True]
