"""One point from the matches of all cameras: which cameras are used, with which covariance."""

import numpy as np
from vision.scenes import example, projected

from palpate.vision.cameras.triangulation import triangulate
from palpate.vision.stereo.stereo import _excess, triangulate_consistent


def _seen(count: int = 4, points: int = 60, noise: float = 0.01):
    """Pixels of points on the example's dome in all cameras, with noise of matches."""
    rng = np.random.default_rng(2)
    stage = example(count)
    space = stage.points(rng.uniform(-0.015, 0.015, size=(points, 2)))
    pixels = np.stack([projected(camera, space) for camera in stage.rig.cameras])
    pixels += rng.normal(scale=noise, size=pixels.shape)
    covariance = np.broadcast_to(2.0 * noise**2 * np.eye(2), (count, points, 2, 2)).copy()
    return stage.rig, space, pixels, covariance


def test_the_camera_that_contradicts_the_others_is_left_out():
    rig, space, pixels, covariance = _seen()
    pixels[2, :9] += [0.4, 0.3]
    pixels[3, 20:24] = np.nan
    found, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert not used[2, :9].any()
    assert used[[0, 1, 3], :9].all()
    assert not used[3, 20:24].any()
    assert used.sum() == 4 * 60 - 13
    np.testing.assert_array_equal(found.cameras, used.sum(axis=0))
    # A hundredth of a pixel of 0.3 mm, at 20 degrees.
    assert np.abs(found.point - space).max() < 6e-5


def test_two_cameras_that_contradict_each_other_are_both_left_out():
    rig, _, pixels, covariance = _seen(2)
    # Across the epipolar lines, which run along the rows.
    pixels[1, :5, 1] += 0.6
    found, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert not used[:, :5].any()
    assert used[:, 5:].all()
    assert np.isnan(found.point[:5]).all()


def test_half_of_each_matchs_variance_is_the_references():
    """The joint point is that of triangulation with these shares; the reference has their mean."""
    rig, _, pixels, covariance = _seen()
    covariance *= np.array([np.nan, 1.0, 2.0, 3.0])[:, None, None, None]
    found, used = triangulate_consistent(rig, pixels, covariance, reprojection=2.0)
    assert used.all()
    covariance[0] = covariance[1:].mean(axis=0)
    expected = triangulate(rig, pixels, 0.5 * covariance)
    np.testing.assert_allclose(found.point, expected.point, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=1e-12)


def test_what_all_points_share_is_the_rig_and_only_limited():
    """A row offset of a drifted camera: below the limit accepted, above not."""
    rig, _, pixels, covariance = _seen(2)
    pixels[1, :, 1] += 1.5
    for limit, count in ((2.0, 60), (0.5, 0)):
        _, used = triangulate_consistent(rig, pixels, covariance, reprojection=limit)
        assert used[0].sum() == count


def test_excess_is_over_the_noise_of_the_match_and_over_what_all_points_miss_by():
    """All points of the second camera miss by the same 0.5 px, the first by 1.2 px more."""
    covariance = np.broadcast_to(0.02 * np.eye(2), (2, 9, 2, 2))
    error = np.zeros((2, 9, 2))
    error[1] = [0.3, 0.4]
    error[1, 0] += [1.2, 0.0]
    used = np.ones((2, 9), dtype=bool)
    used[1, 8] = False
    excess = _excess(error, used, covariance, 2.0)
    # Five standard deviations, root of the trace 0.2 px.
    expected = np.array([[0.0] * 9, [1.2 / (5.0 * 0.2), *([0.5 / 2.0] * 7), -np.inf]])
    np.testing.assert_allclose(excess, expected, atol=1e-12)
    # By turns 0.3 px to either side, the scatter of all points adds to the noise.
    error[1, :8] = np.array([[0.3, 0.0], [-0.3, 0.0]] * 4)
    excess = _excess(error, used, covariance, 10.0)
    allowed = 5.0 * np.hypot(1.4826 * 0.3, 0.2)
    np.testing.assert_allclose(excess[1, :8], 0.3 / allowed, rtol=1e-12)
