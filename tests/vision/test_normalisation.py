"""Normalised images: noise and width of known textures, invariance to lighting."""

import numpy as np
import pytest
from scipy.special import ndtr
from vision.textures import Speckle, noisy

from palpate.vision.normalisation import (
    WINDOW,
    _noise,
    cropped,
    make_normalised_image,
    moments,
    point_spread_variance,
)

SHAPE = (150, 170)


@pytest.mark.parametrize("periods", [1, 2, 3])
def test_width_of_a_wave(periods):
    """Whole periods in a window: variance a^2 / 2; Sobel's central difference a^2 sin^2(k) / 2."""
    k = 2.0 * np.pi * periods / WINDOW
    wave = np.sin(k * np.arange(SHAPE[1])) + np.zeros(SHAPE)
    # Windows that are mirrored at the edges, a seventh of all, hold no whole periods.
    assert make_normalised_image(wave).width == pytest.approx(1.0 / np.sin(k), rel=0.03)


def test_width_of_speckles():
    """Near their sigma: larger by their spread (1.08) and Sobel's blur, smaller by the window."""
    for sigma in (2.0, 3.0):
        picture = make_normalised_image(Speckle(SHAPE, 1, sigma).image())
        assert picture.width == pytest.approx(1.08 * sigma, rel=0.1)


def test_noise_does_not_make_texture_finer():
    """Three times as much texture as noise; uncorrected, the width would be a fifth too small."""
    texture = 80.0 + 0.2 * Speckle(SHAPE, 1, 3.0).image()
    clean = make_normalised_image(texture).width
    assert make_normalised_image(noisy(texture, 3.0, 1)).width == pytest.approx(clean, rel=0.1)


def test_noise_alone_is_no_texture_and_texture_is():
    half = np.where(np.arange(SHAPE[1]) < 85, Speckle(SHAPE, 1).image(), 20.0)
    textured = make_normalised_image(noisy(half, 2.0, 1)).textured
    # A window that touches the texture has some.
    assert textured[:, : 85 + WINDOW // 2 - 3].all()
    assert not textured[:, 85 + WINDOW // 2 + 1 :].any()
    assert not make_normalised_image(np.full(SHAPE, 3.0, dtype=np.float32)).textured.any()


@pytest.mark.parametrize(("gain", "offset"), [(0.3, 100.0), (1e-3, 0.0), (300.0, -5e3)])
def test_gain_and_offset_do_not_matter(gain, offset):
    grey = Speckle(SHAPE, 1).image()
    first, other = make_normalised_image(grey), make_normalised_image(gain * grey + offset)
    # Rounding to whole levels flips at most one of 40 that a standard deviation has.
    assert np.abs(first.levels.astype(int) - other.levels.astype(int)).max() <= 1
    assert other.width == pytest.approx(first.width, rel=1e-3)


def test_slow_shading_is_removed():
    grey = Speckle(SHAPE, 1).image()
    shade = (0.5 + np.arange(SHAPE[1]) / SHAPE[1]).astype(np.float32)
    gap = (
        make_normalised_image(grey).levels.astype(float)
        - make_normalised_image(grey * shade).levels
    )
    # A tenth of the 40 levels of a standard deviation: within a window the shade varies by 12 %.
    assert np.sqrt((gap**2).mean()) < 4.0


def test_moments_against_plain_sums():
    grey = Speckle(SHAPE, 1).image()
    mean, variance = moments(grey)
    window = grey[60 : 60 + WINDOW, 40 : 40 + WINDOW].astype(np.float64)
    middle = (60 + WINDOW // 2, 40 + WINDOW // 2)
    # Single precision of squares of some 1e4.
    assert mean[middle] == pytest.approx(window.mean(), abs=1e-3)
    assert variance[middle] == pytest.approx(window.var(), abs=1e-1)


def test_cropped_is_the_same_part():
    picture = make_normalised_image(Speckle(SHAPE, 1).image())
    part = cropped(picture, (slice(10, 70), slice(20, 90)))
    for name in ("grey", "levels", "mean", "variance", "textured"):
        np.testing.assert_array_equal(getattr(part, name), getattr(picture, name)[10:70, 20:90])
    assert part.width == picture.width


def test_noise_is_that_of_a_blank_picture():
    rng = np.random.default_rng(2)
    grey = rng.normal(120.0, 5.0, (400, 400)).astype(np.float32)
    # A quartile of 160 000 / 4 values, each with its neighbours: 2 %.
    assert _noise(grey) == pytest.approx(5.0, rel=0.03)
    # Rounding to whole levels is the least.
    assert _noise(np.full((50, 50), 7.0, dtype=np.float32)) == pytest.approx(1.0 / np.sqrt(12.0))


def test_levels_have_mean_128_and_contrast_40_but_for_the_noise():
    """By the window's own sums; a picture from 0 to 255 is taken as it is."""
    grey = noisy(Speckle(SHAPE, 1).image(), 6.0, 3)
    grey[0, :2] = [0.0, 255.0]
    picture = make_normalised_image(grey)
    np.testing.assert_allclose(picture.grey, grey, atol=1e-4)
    noise = _noise(grey)
    for row, column in ((40, 50), (75, 120), (100, 30)):
        half = WINDOW // 2
        window = grey[row - half : row + half + 1, column - half : column + half + 1].astype(float)
        contrast = np.sqrt(window.var() + (4.0 * noise) ** 2)
        level = 128.0 + 40.0 * (grey[row, column] - window.mean()) / contrast
        # Rounded to whole levels.
        assert picture.levels[row, column] == pytest.approx(level, abs=0.51)
        assert picture.textured[row, column] == (window.var() > (2.0 * noise) ** 2)


@pytest.mark.parametrize("sigma", [0.5, 0.7, 1.0, 1.5])
@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_spread_of_a_sharp_edge(sigma, noise):
    """An edge 5 degrees off the columns, blurred by sigma, gives the mean between sigma^2 and a
    pixel's 1/12 where the scale is not known: their difference over that of their logarithms."""
    row, column = np.mgrid[:80, :80] - 40.0
    edge = 30.0 + 180.0 * ndtr((0.996 * column + 0.087 * row) / sigma)
    expected = (sigma**2 - 1.0 / 12.0) / np.log(12.0 * sigma**2)
    # Pixels a whole step apart and noise make an edge look a tenth wider than it is.
    variance = point_spread_variance(noisy(edge, noise, 1))
    assert variance == pytest.approx(expected, rel=0.25)


def test_no_camera_is_sharper_than_its_pixels():
    flat = np.full((50, 60), 7.0)
    for picture in (flat, noisy(flat, 2.0, 1), np.where(np.arange(60) < 30, 10.0, 200.0) + flat):
        assert point_spread_variance(picture) == pytest.approx(1.0 / 12.0, rel=0.15)
