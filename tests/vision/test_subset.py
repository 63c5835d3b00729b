"""Sums over one window, against plain least squares with a column each for gain and offset."""

import numpy as np
import pytest

from palpate.vision.subset import (
    BASES,
    EXPONENTS,
    load_window_kernel,
    window_blocks_kernel,
    window_hessian_kernel,
    window_right_kernel,
    window_side_sums_kernel,
)

HALF = 5
SIDE = 2 * HALF + 1
SHAPES = sorted(BASES)
# Sums of a hundred single-precision products against the same in double precision.
CLOSE = {"rtol": 2e-5, "atol": 2e-4}


def _picture(seed=0):
    rng = np.random.default_rng(seed)
    return [rng.normal(100.0, 30.0, (30, 34)).astype(np.float32) for _ in range(3)]


def _mask(kind):
    weight = np.ones((SIDE, SIDE), dtype=np.float32)
    if kind == "masked":
        weight[np.random.default_rng(7).random((SIDE, SIDE)) < 0.3] = 0.0
        weight[:, :3] = 0.0
    return weight


class Window:
    """One window as the kernels hold it, and its pixels for plain least squares."""

    def __init__(self, kind, shape, column=17, row=12):
        self.bases = BASES[shape]
        self.weight = _mask(kind)
        planes = _picture()
        self.window = np.full((4, SIDE, SIDE), np.nan, dtype=np.float32)
        self.window[3] = self.weight
        self.inside, self.mean, self.square = load_window_kernel(
            *planes, column, row, HALF, self.window
        )
        kept = self.weight > 0
        cut = np.s_[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        self.grey, self.slope = (
            planes[0][cut][kept].astype(float),
            [plane[cut][kept].astype(float) for plane in planes[1:]],
        )
        eta, xi = np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1] / HALF
        powers = [(xi**i * eta**j)[kept] for i, j in EXPONENTS[: self.bases]]
        self.columns = np.stack([d * p for d in self.slope for p in powers], axis=1)
        self.sums, self.moments = np.zeros((4, 6)), np.zeros((5, 5))
        window_side_sums_kernel(self.window, HALF, self.sums, self.moments)

    def hessian(self):
        result = np.full((2 * self.bases, 2 * self.bases), np.nan)
        window_hessian_kernel(
            self.window, HALF, self.bases, self.inside, self.square, self.sums, self.moments,
            result,
        )  # fmt: skip
        return result

    def right(self, sampled):
        result = np.full(2 * self.bases, np.nan)
        gain, left = window_right_kernel(
            self.window, sampled, HALF, self.bases, self.inside, self.mean, self.square, self.sums,
            result,
        )  # fmt: skip
        return result, gain, left

    def without_gain_and_offset(self, values):
        """What is left of columns after a least-squares fit of the grey level and of one."""
        nuisance = np.stack([self.grey, np.ones_like(self.grey)], axis=1)
        return values - nuisance @ np.linalg.lstsq(nuisance, values, rcond=None)[0]


@pytest.mark.parametrize("kind", ["whole", "masked"])
def test_a_window_is_loaded_about_its_mean_and_zero_outside(kind):
    one = Window(kind, "affine")
    assert one.inside == one.weight.sum()
    np.testing.assert_allclose(one.mean, one.grey.mean(), rtol=1e-6)
    np.testing.assert_allclose(one.square, ((one.grey - one.grey.mean()) ** 2).sum(), rtol=1e-5)
    kept = one.weight > 0
    np.testing.assert_allclose(one.window[0][kept], one.grey - one.grey.mean(), atol=1e-4)
    np.testing.assert_array_equal(one.window[1][kept], one.slope[0].astype(np.float32))
    np.testing.assert_array_equal(one.window[2][kept], one.slope[1].astype(np.float32))
    assert not one.window[:3, ~kept].any()


@pytest.mark.parametrize("kind", ["whole", "masked"])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_matrix_is_that_of_least_squares_with_gain_and_offset(kind, shape):
    one = Window(kind, shape)
    rest = one.without_gain_and_offset(one.columns)
    expected = rest.T @ rest
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(one.hessian() / scale, expected / scale, **CLOSE)


@pytest.mark.parametrize("kind", ["whole", "masked"])
@pytest.mark.parametrize("shape", SHAPES)
def test_right_hand_side_gain_and_rest_are_those_of_least_squares(kind, shape):
    one = Window(kind, shape)
    rng = np.random.default_rng(3)
    sampled = rng.normal(0.0, 5.0, (SIDE, SIDE)).astype(np.float32)
    kept = one.weight > 0
    sampled[kept] += (0.7 * one.grey + 40.0).astype(np.float32)
    # What lies outside is no matter, so it may be wild.
    sampled[~kept] = 200.0
    right, gain, left = one.right(sampled)
    value = sampled[kept].astype(float)
    fit = np.polyfit(one.grey, value, 1)
    rest = one.without_gain_and_offset(value)
    np.testing.assert_allclose(gain, fit[0], rtol=1e-5)
    np.testing.assert_allclose(left, (rest**2).sum() / fit[0] ** 2, rtol=1e-4)
    expected = one.columns.T @ rest / fit[0]
    size = np.linalg.norm(one.columns, axis=0) * np.linalg.norm(rest)
    np.testing.assert_allclose(right / size, expected / size, **CLOSE)


@pytest.mark.parametrize("kind", ["whole", "masked"])
def test_a_changed_gain_and_offset_leave_nothing(kind):
    one = Window(kind, "quadratic")
    sampled = np.zeros((SIDE, SIDE), dtype=np.float32)
    sampled[one.weight > 0] = 1.6 * one.grey - 30.0
    right, gain, left = one.right(sampled)
    assert gain == pytest.approx(1.6, rel=1e-6)
    # Rounding of single precision, of the square of what was taken away.
    assert left < 1e-6 * one.square
    size = np.linalg.norm(one.columns, axis=0) * np.sqrt(one.square)
    assert np.abs(right / size).max() < 1e-5


def test_a_negative_picture_has_no_gain():
    one = Window("whole", "affine")
    sampled = (200.0 - one.grey).reshape(SIDE, SIDE).astype(np.float32)
    _, gain, left = one.right(sampled)
    assert gain == 0.0
    assert left == np.inf


@pytest.mark.parametrize("kind", ["whole", "masked"])
@pytest.mark.parametrize("shape", SHAPES)
def test_blocks_add_up_to_the_sums_of_their_pixels(kind, shape):
    """Nine cells, each with its pixels' share in gradient times what is left."""
    one = Window(kind, shape)
    sampled = np.random.default_rng(4).normal(90.0, 20.0, (SIDE, SIDE)).astype(np.float32)
    gain = 0.8
    blocks = np.full((9, 2 * one.bases), np.nan)
    window_blocks_kernel(one.window, sampled, HALF, one.bases, one.inside, gain, blocks)
    kept = one.weight > 0
    value = sampled[kept].astype(float)
    rest = (value - value.mean()) / gain - (one.grey - one.grey.mean())
    row, column = np.nonzero(kept)
    cell = (row * 3 // SIDE) * 3 + column * 3 // SIDE
    expected = np.stack([(one.columns * rest[:, None])[cell == k].sum(axis=0) for k in range(9)])
    size = np.linalg.norm(one.columns, axis=0) * np.linalg.norm(rest)
    np.testing.assert_allclose(blocks / size, expected / size, **CLOSE)
