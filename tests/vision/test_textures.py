"""The texture that other tests rest on: against the plain sum, and warps against their inverse."""

import numpy as np
import pytest
from vision.textures import STILL, Speckle, affine, inverse_quadratic, noisy, pixel_grid, turned

_CENTRE = (40.0, 30.0)
_QUADRATIC = inverse_quadratic(
    np.array([[2.0, 0.02, -0.05, 1e-3, 5e-4, -7e-4], [-3.0, 0.03, 0.01, -4e-4, 8e-4, 6e-4]]),
    _CENTRE,
)
_WARPS = [STILL, affine(turned(10.0, 0.1), (-7.3, 4.6), _CENTRE), _QUADRATIC]


@pytest.mark.parametrize("warp", _WARPS)
def test_displaced_points_come_from_where_they_were(warp):
    points = pixel_grid((60, 80)).reshape(-1, 2)
    there = points + warp.displacement(points)
    # Fixed point to 1e-12, coordinates of 100 rounded at 1e-14.
    np.testing.assert_allclose(warp.inverse(there), points, atol=1e-11)


def test_affine_displacement_has_its_closed_form():
    matrix, shift = turned(7.0, 0.05), (3.0, -2.0)
    points = np.array([[10.0, 50.0], [70.0, 5.0]])
    expected = np.array(_CENTRE) + (points - _CENTRE) @ matrix.T + shift - points
    warp = affine(matrix, shift, _CENTRE)
    np.testing.assert_allclose(warp.displacement(points), expected, atol=1e-11)


@pytest.mark.parametrize("sigma", [1.2, 4.0])
def test_picture_is_the_mean_over_each_pixel_of_the_sum_of_speckles(sigma):
    texture, warp = Speckle((60, 80), 3, sigma), _WARPS[1]
    picture = texture.image(warp)
    third = np.array([-1.0, 0.0, 1.0]) / 3.0
    x, y, narrow, peak = texture.speckles.T
    for row, column in ((0, 0), (31, 57), (59, 79)):
        pixel = np.array([[column + a, row + b] for a in third for b in third])
        source = warp.inverse(pixel)
        square = (source[:, :1] - x) ** 2 + (source[:, 1:] - y) ** 2
        grey = texture.grey((peak * np.exp(-narrow * square)).sum(axis=1).mean())
        # Some dozen speckles are cut off below 4e-5 of their peak, which is about 60 grey levels.
        assert picture[row, column] == pytest.approx(grey, abs=0.02)


def test_grey_levels_have_the_promised_mean_and_contrast():
    picture = Speckle(256, 1).image()
    # 256^2 pixels hold about 3000 independent speckles: 45 / sqrt(3000) = 0.8; the mean over each
    # pixel takes a few per cent of the contrast.
    assert picture.mean() == pytest.approx(110.0, abs=3.0)
    assert picture.std() == pytest.approx(45.0, rel=0.05)


def test_noise_is_as_large_as_asked_and_levels_are_whole():
    picture = noisy(np.full((100, 100), 110.0), 1.5, 1)
    # 1e4 pixels tell the deviation to 0.7 %; rounding adds 1/12 to the variance.
    assert picture.std() == pytest.approx(np.hypot(1.5, 12**-0.5), rel=0.03)
    np.testing.assert_array_equal(picture, np.round(picture))
