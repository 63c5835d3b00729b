"""Sums over a window, against plain least squares with a column per change of illumination."""

import numpy as np
import pytest

from palpate.vision.matching.window import (
    BASES,
    EXPONENTS,
    load_window_kernel,
    window_advance_kernel,
    window_blocks_kernel,
    window_residual_kernel,
    window_right_kernel,
    window_system_kernel,
)

HALF = 5
# By so much is the illumination blurred in the windows [px^2].
BLUR_VARIANCE = 1.4
SIDE = 2 * HALF + 1
PIXELS = SIDE**2
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

    def __init__(self, kind, shape, *, shading=False, column=17, row=12):
        self.bases = BASES[shape]
        self.weight = _mask(kind).ravel()
        planes = _picture()
        self.window = np.full((6, PIXELS), np.nan, dtype=np.float32)
        self.window[3] = self.weight
        self.count, self.mean, self.square = load_window_kernel(
            *planes, column, row, HALF, shading, BLUR_VARIANCE, self.window
        )
        self.kept = self.weight > 0
        cut = np.s_[row - HALF : row + HALF + 1, column - HALF : column + HALF + 1]
        self.grey, *slopes = (plane[cut].ravel()[self.kept].astype(float) for plane in planes)
        self.slopes = slopes
        eta, xi = (np.mgrid[-HALF : HALF + 1, -HALF : HALF + 1] / HALF).reshape(2, -1)
        powers = [xi**i * eta**j for i, j in EXPONENTS[: self.bases]]
        # Heights of a crease, which are no polynomial.
        self.basis = np.stack([*powers, np.abs(xi - 0.2)]).astype(np.float32)
        functions = self.basis[:, self.kept].astype(float)
        self.columns = np.stack([d * p for p in functions for d in slopes], axis=1)
        illumination = [np.ones_like(self.grey), self.grey]
        if shading:
            # Illumination that varies is blurred with the picture: x times it, and its derivative.
            for coordinate, slope in zip((xi, eta), slopes, strict=True):
                illumination.append(
                    self.grey * coordinate[self.kept] + BLUR_VARIANCE / HALF * slope
                )
        self.illumination = np.stack(illumination, axis=1)
        unknowns = 2 * len(self.basis)
        self.sums = np.full((unknowns, 4), np.nan)
        self.hessian = np.full((unknowns, unknowns), np.nan)
        window_system_kernel(
            self.window, self.basis, self.count, self.square, np.zeros(PIXELS, dtype=np.float32),
            self.sums, self.hessian,
        )  # fmt: skip

    def right(self, sampled):
        """Right-hand side, gain, illumination with the residual's sum of squares, and the share of
        each of nine blocks in the right-hand side."""
        result, illumination = np.full(len(self.hessian), np.nan), np.full(4, np.nan)
        sampled = sampled.copy()
        gain = window_right_kernel(
            self.window, self.basis, sampled, self.count, self.mean, self.square, self.sums,
            result, illumination,
        )  # fmt: skip
        blocks, square = np.full((9, len(result)), np.nan), np.inf
        if gain > 0.0:
            square = window_residual_kernel(self.window, sampled, illumination)
            window_blocks_kernel(self.window, self.basis, sampled, blocks)
        return result, gain, np.append(illumination, square), blocks

    def without_illumination(self, values):
        """What is left of columns after a least-squares fit of what the illumination may do."""
        return (
            values - self.illumination @ np.linalg.lstsq(self.illumination, values, rcond=None)[0]
        )


@pytest.mark.parametrize("kind", ["whole", "masked"])
def test_a_window_is_loaded_about_its_mean_and_zero_outside(kind):
    window = Window(kind, "affine")
    assert window.count == window.weight.sum()
    np.testing.assert_allclose(window.mean, window.grey.mean(), rtol=1e-6)
    np.testing.assert_allclose(
        window.square, ((window.grey - window.grey.mean()) ** 2).sum(), rtol=1e-5
    )
    inside = window.kept
    np.testing.assert_allclose(
        window.window[0][inside], window.grey - window.grey.mean(), atol=1e-4
    )
    np.testing.assert_array_equal(window.window[1][inside], window.slopes[0].astype(np.float32))
    np.testing.assert_array_equal(window.window[2][inside], window.slopes[1].astype(np.float32))
    assert not window.window[:3, ~inside].any()


WINDOWS = [
    (kind, shape, shading)
    for kind in ("whole", "masked")
    for shape in SHAPES
    for shading in (False, True)
]


def test_planes_of_the_illumination_are_orthonormal_and_span_a_linear_gain():
    window = Window("masked", "affine", shading=True)
    planes = window.window[[4, 5]]
    np.testing.assert_allclose(planes @ planes.T, np.eye(2), atol=1e-6)
    known = np.stack([window.window[3], window.window[0] / np.sqrt(window.square)])
    np.testing.assert_allclose(planes @ known.T, 0.0, atol=2e-5)
    assert not planes[:, ~window.kept].any()
    # Nothing of them is left once grey and the two linear gains are taken out.
    left = window.without_illumination(planes[:, window.kept].T.astype(float))
    np.testing.assert_allclose(left, 0.0, atol=1e-5)
    assert not Window("masked", "affine").window[4:].any()


@pytest.mark.parametrize(("kind", "shape", "shading"), WINDOWS)
def test_the_matrix_is_that_of_least_squares_without_illumination(kind, shape, shading):
    window = Window(kind, shape, shading=shading)
    rest = window.without_illumination(window.columns)
    expected = rest.T @ rest
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(window.hessian / scale, expected / scale, **CLOSE)


def _later(window, seed=3):
    """A later window: another gain and offset, noise, and wild outside the mask."""
    sampled = np.full(PIXELS, 200.0, dtype=np.float32)
    noise = np.random.default_rng(seed).normal(0.0, 5.0, len(window.grey))
    sampled[window.kept] = 0.7 * window.grey + 40.0 + noise
    return sampled


@pytest.mark.parametrize(("kind", "shape", "shading"), WINDOWS)
def test_right_hand_side_gain_and_rest_are_those_of_least_squares(kind, shape, shading):
    window = Window(kind, shape, shading=shading)
    sampled = _later(window)
    right, gain, illumination, _ = window.right(sampled)
    value = sampled[window.kept].astype(float)
    slope = np.polyfit(window.grey, value, 1)[0]
    rest = window.without_illumination(value)
    np.testing.assert_allclose(gain, slope, rtol=1e-5)
    np.testing.assert_allclose(illumination[1], gain)
    np.testing.assert_allclose(illumination[0], value.mean() - window.mean, rtol=1e-4)
    np.testing.assert_allclose(illumination[4], (rest**2).sum() / slope**2, rtol=1e-4)
    expected = window.columns.T @ rest / slope
    size = np.linalg.norm(window.columns, axis=0) * np.linalg.norm(rest)
    np.testing.assert_allclose(right / size, expected / size, **CLOSE)


@pytest.mark.parametrize("kind", ["whole", "masked"])
@pytest.mark.parametrize("shading", [False, True])
def test_a_change_of_illumination_leaves_nothing(kind, shading):
    window = Window(kind, "quadratic", shading=shading)
    weights = np.array([-30.0, 1.6, 0.3, -0.2])[: window.illumination.shape[1]]
    sampled = np.zeros(PIXELS, dtype=np.float32)
    sampled[window.kept] = window.illumination @ weights
    right, _, illumination, blocks = window.right(sampled)
    # Rounding of single precision, of the square of what was taken away.
    assert illumination[4] < 1e-5 * window.square
    size = np.linalg.norm(window.columns, axis=0) * np.sqrt(window.square)
    assert np.abs(right / size).max() < 1e-5
    np.testing.assert_allclose(blocks / size, 0.0, atol=1e-5)


def test_a_linear_gain_is_left_where_it_is_not_allowed():
    window = Window("whole", "affine")
    sampled = np.zeros(PIXELS, dtype=np.float32)
    xi = np.tile(np.arange(-HALF, HALF + 1) / HALF, SIDE)
    sampled[window.kept] = window.grey * (1.0 + 0.3 * xi)
    assert window.right(sampled)[2][4] > 0.01 * window.square


def test_a_negative_picture_has_no_gain():
    window = Window("whole", "affine")
    sampled = (200.0 - window.grey).astype(np.float32)
    _, gain, illumination, _ = window.right(sampled)
    assert gain == 0.0
    assert illumination[4] == np.inf


@pytest.mark.parametrize(("kind", "shape", "shading"), WINDOWS)
def test_blocks_are_the_sums_of_their_pixels(kind, shape, shading):
    """Nine cells, each with its pixels' share in gradient times what is left."""
    window = Window(kind, shape, shading=shading)
    sampled = _later(window, 4)
    right, gain, _, sums = window.right(sampled)
    rest = window.without_illumination(sampled[window.kept].astype(float)) / gain
    row, column = np.divmod(np.flatnonzero(window.kept), SIDE)
    cell = (row * 3 // SIDE) * 3 + column * 3 // SIDE
    expected = np.stack([(window.columns * rest[:, None])[cell == k].sum(axis=0) for k in range(9)])
    size = np.linalg.norm(window.columns, axis=0) * np.linalg.norm(rest)
    np.testing.assert_allclose(sums / size, expected / size, **CLOSE)
    # Together they are the right-hand side.
    np.testing.assert_allclose(sums.sum(axis=0) / size, right / size, **CLOSE)


@pytest.mark.parametrize(("kind", "shape", "shading"), WINDOWS)
def test_a_step_of_least_squares_leaves_no_right_hand_side(kind, shape, shading):
    """To first order the picture changes by its gradient times the step."""
    window = Window(kind, shape, shading=shading)
    sampled, illumination = _later(window, 5), np.full(4, np.nan)
    right, again = np.full((2, len(window.hessian)), np.nan)
    state = window.count, window.mean, window.square, window.sums
    gain = window_right_kernel(window.window, window.basis, sampled, *state, right, illumination)
    step = np.linalg.solve(window.hessian, right)
    window_advance_kernel(window.window, window.basis, gain * step, sampled)
    state = window.count, 0.0, window.square, window.sums
    window_right_kernel(window.window, window.basis, sampled, *state, again, illumination)
    # Single precision, beside the sum of squares of the window.
    size = np.linalg.norm(window.columns, axis=0) * np.sqrt(window.square)
    np.testing.assert_allclose(again / size, 0.0, atol=1e-6)
    assert np.abs(right / size).max() > 1e-3
