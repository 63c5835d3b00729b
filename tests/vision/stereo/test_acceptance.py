"""What neighbours and cameras reject, on matches made by hand."""

import numpy as np
from vision.scenes import example, projected

from palpate.vision.stereo.acceptance import contradicts_neighbours, joined_cameras


def _grid(rows: int = 12, columns: int = 14, step: float = 5.0):
    cell = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1)
    cell = cell.reshape(-1, 2)
    return cell, step * cell[:, ::-1].astype(np.float64)


def _judged(cell, pixel, displacement, gradient, valid, sigma=0.01):
    return contradicts_neighbours(
        cell, pixel, displacement, gradient, np.full(len(cell), sigma), valid, disagreement=5.0
    )


def test_an_affine_field_contradicts_nobody_and_a_jump_only_few():
    rng = np.random.default_rng(0)
    cell, pixel = _grid()
    slope = np.array([[0.2, -0.1], [0.05, 0.3]])
    gradient = np.broadcast_to(slope, (len(cell), 2, 2))
    field = pixel @ slope.T + [3.0, -40.0]
    field += rng.normal(scale=0.01, size=field.shape)
    valid = np.ones(len(cell), dtype=bool)
    assert not _judged(cell, pixel, field, gradient, valid).any()
    # Without the gradients the neighbours would be off by a pixel and more.
    flat = np.zeros_like(gradient)
    field[pixel[:, 0] > 32.0] += 6.0
    wrong = _judged(cell, pixel, field, gradient, valid)
    assert not wrong[np.abs(pixel[:, 0] - 32.5) > 8.0].any()
    steep = _judged(cell, pixel, 30.0 * field, flat, valid, sigma=1e-3)
    assert steep.shape == valid.shape


def test_mistakes_and_lonely_points_are_told():
    rng = np.random.default_rng(1)
    cell, pixel = _grid()
    field = rng.normal(scale=0.01, size=pixel.shape)
    gradient = np.zeros((len(cell), 2, 2))
    bad = rng.choice(len(cell), 12, replace=False)
    field[bad] += rng.uniform(0.5, 3.0, size=(12, 2))
    valid = np.ones(len(cell), dtype=bool)
    wrong = _judged(cell, pixel, field, gradient, valid)
    assert wrong[bad].all()
    assert wrong.sum() <= 14
    # Two points by themselves are confirmed by nobody; three around a corner are.
    few = np.zeros(len(cell), dtype=bool)
    few[[0, 1]] = True
    field[:] = 0.0
    np.testing.assert_array_equal(_judged(cell, pixel, field, gradient, few), few)
    few[[14, 15]] = True
    assert not _judged(cell, pixel, field, gradient, few).any()


def test_nothing_contradicts_nothing():
    none = np.zeros((0, 2))
    wrong = contradicts_neighbours(
        np.zeros((0, 2), dtype=np.int64), none, none, np.zeros((0, 2, 2)), np.zeros(0),
        np.zeros(0, dtype=bool), disagreement=5.0,
    )  # fmt: skip
    assert wrong.shape == (0,)


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
    found, used = joined_cameras(rig, pixels, covariance, disagreement=5.0, reprojection=2.0)
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
    found, used = joined_cameras(rig, pixels, covariance, disagreement=5.0, reprojection=2.0)
    assert not used[:, :5].any()
    assert used[:, 5:].all()
    assert np.isnan(found.point[:5]).all()


def test_what_all_points_share_is_the_rig_and_only_limited():
    """A row offset of a drifted camera: below the limit accepted, above not."""
    rig, _, pixels, covariance = _seen(2)
    pixels[1, :, 1] += 1.5
    for limit, count in ((2.0, 60), (0.5, 0)):
        _, used = joined_cameras(rig, pixels, covariance, disagreement=5.0, reprojection=limit)
        assert used[0].sum() == count
