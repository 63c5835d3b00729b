"""The start of stereo matching against the exact projection of an analytic surface."""

from dataclasses import replace

import numpy as np
import pytest
from vision.scenes import LENS, STILL, example, example_views, noisy_views, projected

from palpate.errors import InputError
from palpate.vision.matching.features import find_features, prepare_pictures
from palpate.vision.normalisation import make_normalised_image
from palpate.vision.stereo import pair_disparity
from palpate.vision.stereo.pair_disparity import _planes, _row_offset, stereo_start


def _pair(count: int, lens: tuple[float, ...], roll: float = 0.0):
    """The example's views; the second's calibration rolled about its axis."""
    stage = example(count, lens)
    views = noisy_views(example_views("still", count, lens), 1.0, seed=count)
    cameras = list(stage.rig.cameras)
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]]
    cameras[1] = replace(cameras[1], T_camera_object=turn @ cameras[1].T_camera_object)
    return stage, prepare_pictures(replace(stage.rig, cameras=tuple(cameras)), views)


def _truth(stage, pixel, other):
    def match(first_pixel):
        space = stage.points(stage.rest_points(stage.rig.cameras[0], first_pixel, STILL))
        return projected(stage.rig.cameras[other], space)

    gradient = np.stack([match(pixel + step) - match(pixel - step) for step in np.eye(2)], axis=2)
    return match(pixel) - pixel, 0.5 * gradient - np.eye(2)


PIXEL = np.stack(np.meshgrid(np.arange(30.0, 160.0, 8.0), np.arange(25.0, 125.0, 8.0)), -1)
PIXEL = PIXEL.reshape(-1, 2)


@pytest.mark.parametrize(("count", "lens", "other"), [(2, (), 1), (3, LENS, 2), (4, (), 3)])
def test_matches_and_gradients_are_near_the_truth(count, lens, other):
    stage, pictures = _pair(count, lens)
    start, start_gradient = stereo_start(pictures, other, PIXEL, half=10)
    displacement, gradient = _truth(stage, PIXEL, other)
    matched = np.isfinite(start).all(axis=1)
    assert matched.mean() > 0.95
    gap = np.linalg.norm(start - displacement, axis=1)[matched]
    # Half a pixel is what the refinement is promised.
    assert np.percentile(gap, 95.0) < 0.5
    # Views 20 degrees apart, of a dome: gradients up to 0.3 that differ by 0.2 over the picture; of
    # whole disparities, half a pixel over ten.
    off = np.abs(start_gradient - gradient)[matched]
    assert np.median(off) < 0.02
    assert np.percentile(off, 95.0) < 0.08


def test_rows_that_differ_are_corrected_from_features():
    """Rolled by two degrees the rows of the rectified pair differ by up to 3 px, both ways."""
    stage, pictures = _pair(2, (), roll=np.radians(2.0))
    start, _ = stereo_start(pictures, 1, PIXEL, half=10)
    displacement, _ = _truth(stage, PIXEL, 1)
    matched = np.isfinite(start).all(axis=1)
    assert matched.mean() > 0.9
    gap = np.linalg.norm(start - displacement, axis=1)[matched]
    assert np.percentile(gap, 90.0) < 1.0


def test_halved_pictures_give_the_same_to_a_pixel(monkeypatch):
    """Half as many disparities of half the resolution: twice the error."""
    stage, pictures = _pair(2, ())
    whole, _ = stereo_start(pictures, 1, PIXEL, half=10)
    monkeypatch.setattr(pair_disparity, "_MAX_WORK", 1_500_000)
    halved, _ = stereo_start(pictures, 1, PIXEL, half=10)
    truth, _ = _truth(stage, PIXEL, 1)
    both = np.isfinite(whole + halved).all(axis=1)
    assert both.mean() > 0.8
    assert np.abs(halved - whole)[both].max() > 0.05
    assert np.percentile(np.abs(halved - truth)[both], 95.0) < 1.0


def test_too_few_features_are_refused():
    _, pictures = _pair(2, ())
    none = find_features(make_normalised_image(np.zeros((50, 50), dtype=np.float32)))
    blind = replace(pictures, features=(none, none))
    with pytest.raises(InputError, match="'c0' and 'c1' have 0 features in common"):
        stereo_start(blind, 1, PIXEL, half=10)


def test_row_offset_is_the_polynomial_that_most_features_follow():
    rng = np.random.default_rng(5)
    column, row = rng.uniform(0.0, 400.0, (2, 300))
    x, y = column / 200.0 - 1.0, row / 200.0 - 1.0
    gap = 3.0 + 2.0 * x - y + 0.5 * x * x + 0.3 * x * y - 0.4 * y * y
    wrong = np.arange(300) < 60
    other = np.stack([column, row - gap - np.where(wrong, 25.0, 0.0)], axis=1)
    offset, agree = _row_offset(np.stack([column + 50.0, row], axis=1), other)
    np.testing.assert_array_equal(agree, ~wrong)
    # The coefficients are drawn to zero by a thousandth of the terms' mean squares, which are 0.1
    # and more.
    np.testing.assert_allclose(offset.at(column, row), gap, atol=0.05)
    # Constant beyond the features, and for shapes that broadcast.
    corner = offset.at(column.max(keepdims=True), row.max(keepdims=True))
    assert offset.at(np.array([[900.0]]), np.array([900.0])) == pytest.approx(corner[0])
    # Too few features for a polynomial: their median.
    few, _ = _row_offset(np.stack([column + 50.0, row], axis=1)[60:75], other[60:75])
    np.testing.assert_allclose(few.at(column, row), np.median(gap[60:75]), rtol=1e-12)
    assert _row_offset(other[:5], other[:5])[0].at(column, row).max() == 0.0


def test_planes_through_disparities():
    """Two slanted surfaces, one nearer by 30 px; a hole in each; and the picture's end."""
    row, column = np.mgrid[:100, :120].astype(float)
    far, near = 5.0 + 0.2 * column - 0.1 * row, 50.0 - 0.15 * column + 0.05 * row
    disparity = np.where(column < 60.0, far, near)
    disparity[40:43, 25:28] = disparity[40:43, 90:93] = np.nan
    disparity[70:, :40] = np.nan
    at = np.array(
        [[26.3, 41.2], [91.0, 41.0], [57.0, 20.0], [63.0, 20.0], [20.0, 85.0], [-9.0, 3.0]]
    )
    plane, good = _planes(disparity, at, 10)
    np.testing.assert_array_equal(good, [True, True, True, True, False, False])
    x, y = at.T
    expected = np.where(
        (x < 60.0)[:, None],
        np.stack([5.0 + 0.2 * x - 0.1 * y, np.full(6, 0.2), np.full(6, -0.1)], axis=1),
        np.stack([50.0 - 0.15 * x + 0.05 * y, np.full(6, -0.15), np.full(6, 0.05)], axis=1),
    )
    # The normal matrix has 1e-6 on its diagonal, of at least 24 samples.
    np.testing.assert_allclose(plane[:4], expected[:4], atol=1e-5)
