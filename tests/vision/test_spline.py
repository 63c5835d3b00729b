"""The quintic spline through a picture, against polynomials, finite differences and exact sums."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from vision.textures import Speckle

from palpate.vision.spline import (
    PADDING,
    interpolate,
    make_spline_picture,
    noise_fraction_kernel,
    slope_gain,
    smoothing_gain,
)

SHAPE = (40, 52)
# Single precision of a grey level of 200, whose coefficients are sums of eight times as much.
ROUNDING = 2e-4


def _grid(rows, columns):
    row, column = np.mgrid[:rows, :columns].astype(np.float64)
    return np.stack([column.ravel(), row.ravel()], axis=1)


def test_the_spline_passes_through_the_pixels():
    grey = Speckle(SHAPE, 1).image()
    values = interpolate(make_spline_picture(grey), _grid(*SHAPE))
    np.testing.assert_allclose(values.reshape(SHAPE), grey, atol=ROUNDING)


def _quintic(pixel):
    x, y = (pixel - [30.0, 26.0]).T / 10.0
    low = 100.0 + 9.0 * x - 7.0 * y + 5.0 * x * y + 4.0 * x**3 - 3.0 * x * y**2
    return low + 2.0 * y**5 - 3.0 * x**3 * y**2 + x**5


def test_quintics_are_exact_away_from_the_edge():
    """What the mirrored edge bends has fallen to 0.43^20 = 5e-8 twenty pixels inside."""
    shape, inside = (53, 61), np.s_[20:33, 20:41]
    picture = make_spline_picture(_quintic(_grid(*shape)).reshape(shape).astype(np.float32))
    pixel = np.random.default_rng(2).uniform([20.0, 20.0], [40.0, 32.0], (300, 2))
    np.testing.assert_allclose(interpolate(picture, pixel), _quintic(pixel), atol=ROUNDING)
    at = _grid(*shape).reshape(*shape, 2)[inside].reshape(-1, 2)
    h = np.array([1e-3, 0.0])
    inner = picture.along_column[inside].ravel(), picture.along_row[inside].ravel()
    for interpolated, step in zip(inner, (h, h[::-1]), strict=True):
        slope = (_quintic(at + step) - _quintic(at - step)) / 2e-3
        np.testing.assert_allclose(interpolated, slope, atol=ROUNDING)


@pytest.mark.parametrize(("length", "error"), [(6.0, 6e-4), (8.0, 1e-4), (12.0, 5e-5)])
def test_the_phase_of_a_wave_follows_a_small_shift(length, error):
    """A cubic spline is off by 0.7, 0.2 and 0.04 %: so much too long it makes small motions."""
    number, shift = 2.0 * np.pi / length, 0.1
    pixel = _grid(60, 70)
    wave = (100.0 + 100.0 * np.cos(number * pixel[:, 0])).reshape(60, 70).astype(np.float32)
    at = pixel.reshape(60, 70, 2)[25:35, 22:46].reshape(-1, 2)
    values = interpolate(make_spline_picture(wave), at + np.array([shift, 0.0])) - 100.0
    parts = np.stack([np.cos(number * at[:, 0]), -np.sin(number * at[:, 0])], axis=1)
    cosine, sine = np.linalg.lstsq(parts, values, rcond=None)[0]
    assert np.arctan2(sine, cosine) == pytest.approx(number * shift, rel=error)


def test_stored_derivatives_are_those_of_the_spline():
    """Also at the edge, where the mirror image makes the derivative across vanish."""
    picture = make_spline_picture(Speckle(SHAPE, 3).image())
    at, h = _grid(*SHAPE), 1.0 / 16.0
    for axis, stored in enumerate((picture.along_column, picture.along_row)):
        step = np.eye(2)[axis]
        # Richardson: the terms in h^2 cancel, those in h^4 are below the rounding.
        small_step, two = (
            (interpolate(picture, at + k * h * step) - interpolate(picture, at - k * h * step))
            / (2.0 * k * h)
            for k in (1, 2)
        )
        # Differences of single precision over an eighth of a pixel.
        np.testing.assert_allclose(stored.ravel(), (4.0 * small_step - two) / 3.0, atol=3e-3)
    np.testing.assert_allclose(picture.along_column[:, [0, -1]], 0.0, atol=ROUNDING)
    np.testing.assert_allclose(picture.along_row[[0, -1]], 0.0, atol=ROUNDING)


def test_the_picture_is_mirrored_beyond_its_edge():
    picture = make_spline_picture(Speckle(SHAPE, 4).image())
    rng = np.random.default_rng(5)
    rows, columns = SHAPE
    beyond = rng.uniform(0.0, 1.5, 50)
    along = rng.uniform(0.0, columns - 1.0, 50)
    down = rng.uniform(0.0, rows - 1.0, 50)
    pairs = [
        ((-beyond, down), (beyond, down)),
        ((columns - 1 + beyond, down), (columns - 1 - beyond, down)),
        ((along, -beyond), (along, beyond)),
        ((along, rows - 1 + beyond), (along, rows - 1 - beyond)),
    ]
    for outside, inside in pairs:
        np.testing.assert_allclose(
            interpolate(picture, np.stack(outside, axis=1)),
            interpolate(picture, np.stack(inside, axis=1)),
            atol=ROUNDING,
        )


def test_smoothing_is_a_gaussian_before_anything_else():
    """SciPy's, cut off at the same four standard deviations, mirrored at the edge."""
    grey = Speckle(SHAPE, 8).image()
    smooth = gaussian_filter(grey.astype(float), 0.8, mode="mirror", truncate=4.0)
    smoothed = make_spline_picture(grey, smoothing=0.8)
    np.testing.assert_allclose(smoothed.grey, smooth, atol=ROUNDING)
    again = make_spline_picture(smoothed.grey)
    np.testing.assert_array_equal(smoothed.coefficients, again.coefficients)
    np.testing.assert_array_equal(smoothed.along_column, again.along_column)
    np.testing.assert_array_equal(make_spline_picture(grey).grey, grey)


@pytest.mark.parametrize("far", [1e3, 1e9, np.inf])
def test_far_outside_is_finite_and_harmless(far):
    """Windows may be warped anywhere before they are given up."""
    picture = make_spline_picture(Speckle(SHAPE, 6).image())
    pixel = np.array([[far, 5.0], [-far, 5.0], [5.0, far], [5.0, -far], [far, -far]])
    assert np.isfinite(interpolate(picture, pixel)).all()
    assert picture.coefficients.shape == (SHAPE[0] + 2 * PADDING, SHAPE[1] + 2 * PADDING)


def test_share_of_noise_is_the_sum_of_squares_of_the_cardinal_spline():
    """The cardinal spline is the picture of one bright pixel.

    The formula is a fit, 0.0102 off at most: half a percent of a standard deviation.
    """
    bright = np.zeros((41, 41), dtype=np.float32)
    bright[20, 20] = 1.0
    picture = make_spline_picture(bright)
    shift = np.arange(-14.0, 15.0)
    part = np.linspace(0.0, 1.0, 21)
    pixel = np.stack([20.0 + (part[:, None] + shift).ravel(), np.full(21 * 29, 20.0)], axis=1)
    line = (interpolate(picture, pixel).reshape(21, 29) ** 2).sum(axis=1)
    fractions = np.array(
        [noise_fraction_kernel(np.float32(7.0 + t), np.float32(3.0)) for t in part]
    )
    np.testing.assert_allclose(fractions, line, atol=0.0105)
    # Half way, where the formula is fitted, it is exact; both directions multiply.
    np.testing.assert_allclose(fractions[10], line[10], atol=2e-5)
    both = noise_fraction_kernel(np.float32(4.3), np.float32(-2.4))
    np.testing.assert_allclose(
        both, np.interp(0.3, part, fractions) * np.interp(0.6, part, fractions), atol=1e-5
    )


@pytest.mark.parametrize("smoothing", [0.0, 0.5, 0.9, 2.0])
def test_smoothing_gain_is_the_root_of_the_sum_of_squares_of_the_low_pass(smoothing):
    """The low-pass is the picture of one bright pixel."""
    bright = np.zeros((41, 41), dtype=np.float32)
    bright[20, 20] = 1.0
    left = make_spline_picture(bright, smoothing=smoothing).grey.astype(float)
    # OpenCV's kernel ends half a pixel earlier or later, where the Gaussian has fallen to 3e-4.
    assert smoothing_gain(smoothing) == pytest.approx(np.sqrt((left**2).sum()), rel=1e-3)


@pytest.mark.parametrize("smoothing", [0.0, 0.7, 1.0, 2.5])
def test_slope_gain_is_the_root_of_the_sum_of_squares_of_one_pixel_s_derivatives(smoothing):
    bright = np.zeros((61, 61), dtype=np.float32)
    bright[30, 30] = 1.0
    picture = make_spline_picture(bright, smoothing=smoothing)
    for slope in (picture.along_column, picture.along_row):
        slope_size = np.sqrt((slope.astype(float) ** 2).sum())
        # As above; a derivative gives the ends of the Gaussian ten times the share.
        assert slope_gain(smoothing) == pytest.approx(slope_size, rel=3e-3)
