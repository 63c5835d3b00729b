"""The start of stereo matching against the exact projection of an analytic surface."""

from dataclasses import replace

import numpy as np
import pytest
from vision.scenes import LENS, STILL, example, example_views, noisy_views, projected

from palpate.errors import InputError
from palpate.vision.images.features import find_features, prepare_pictures
from palpate.vision.images.normalisation import make_normalised_image
from palpate.vision.stereo.pair_disparity import stereo_start


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
    def match(place):
        space = stage.points(stage.rest_points(stage.rig.cameras[0], place, STILL))
        return projected(stage.rig.cameras[other], space)

    gradient = np.stack([match(pixel + step) - match(pixel - step) for step in np.eye(2)], axis=2)
    return match(pixel) - pixel, 0.5 * gradient - np.eye(2)


PIXEL = np.stack(np.meshgrid(np.arange(30.0, 160.0, 8.0), np.arange(25.0, 125.0, 8.0)), -1)
PIXEL = PIXEL.reshape(-1, 2)


@pytest.mark.parametrize(("count", "lens", "other"), [(2, (), 1), (3, LENS, 2), (4, (), 3)])
def test_matches_and_gradients_are_near_the_truth(count, lens, other):
    stage, pictures = _pair(count, lens)
    start = stereo_start(pictures, other, PIXEL, half=10)
    displacement, gradient = _truth(stage, PIXEL, other)
    found = np.isfinite(start.displacement).all(axis=1)
    assert found.mean() > 0.95
    gap = np.linalg.norm(start.displacement - displacement, axis=1)[found]
    # Half a pixel is what the refinement is promised.
    assert np.percentile(gap, 95.0) < 0.5
    # Views 20 degrees apart, of a dome: gradients up to 0.3 that differ by 0.2 over the picture; of
    # whole disparities, half a pixel over ten.
    off = np.abs(start.gradient - gradient)[found]
    assert np.median(off) < 0.02
    assert np.percentile(off, 95.0) < 0.08


def test_rows_that_differ_are_corrected_from_features():
    """Rolled by two degrees the rows of the rectified pair differ by up to 3 px, both ways."""
    stage, pictures = _pair(2, (), roll=np.radians(2.0))
    start = stereo_start(pictures, 1, PIXEL, half=10)
    displacement, _ = _truth(stage, PIXEL, 1)
    found = np.isfinite(start.displacement).all(axis=1)
    assert found.mean() > 0.9
    gap = np.linalg.norm(start.displacement - displacement, axis=1)[found]
    assert np.percentile(gap, 90.0) < 1.0


def test_too_few_features_are_refused():
    _, pictures = _pair(2, ())
    none = find_features(make_normalised_image(np.zeros((50, 50), dtype=np.float32)))
    blind = replace(pictures, features=(none, none))
    with pytest.raises(InputError, match="'c0' and 'c1' have 0 features in common"):
        stereo_start(blind, 1, PIXEL, half=10)
