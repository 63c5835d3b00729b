"""What features say about a rig: right, swapped, drifted, and what they cannot say."""

from dataclasses import replace

import numpy as np
import pytest
from vision.scenes import LENS, SHAPE, example, example_views, noisy_views

from palpate.errors import CalibrationError, InputError
from palpate.records.programs.registry import read_rig
from palpate.records.rig import Camera, Rig
from palpate.vision.matching.features import Samples, prepare_pictures
from palpate.vision.pictures import read_pictures
from palpate.vision.projection import project
from palpate.vision.stereo.rig_check import (
    _consistent,
    _epipolar_distance,
    _feature_error,
    check_rig,
)


def _views(count: int = 3, lens: tuple[float, ...] = ()) -> list[np.ndarray]:
    return noisy_views(example_views("still", count, lens), 1.5, seed=count)


def _matches(first: np.ndarray, second: np.ndarray) -> Samples:
    return Samples(first, second - first)


def _checked(rig: Rig, views):
    return check_rig(prepare_pictures(rig, views))


def _turned(camera: Camera, degrees: float) -> Camera:
    """A camera turned about its own x axis."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.eye(4)
    turn[1:3, 1:3] = [[c, -s], [s, c]]
    return replace(camera, T_camera_object=turn @ camera.T_camera_object)


@pytest.fixture(scope="module")
def half_ball(shared_data):
    """Rig and pictures of the rendered half ball."""
    folder = shared_data / "halfball_images"
    rig = replace(read_rig(folder / "rig.toml"), source="rig.toml")
    grey = read_pictures(rig, "images/rest_{camera}.png", folder=folder, what="rest").grey
    return rig, grey


@pytest.mark.parametrize(("count", "lens"), [(2, ()), (3, LENS)])
def test_a_rig_that_fits_is_accepted(count, lens):
    stage = example(count, lens)
    residual, matches, notes = _checked(stage.rig, _views(count, lens))
    assert len(residual) == len(matches) == count - 1
    # Features are found to a quarter of a pixel in each picture.
    assert max(residual) < 0.4
    assert min(matches) > 50
    assert notes == ()


def test_a_rendered_rig_fits(half_ball):
    rig, pictures = half_ball
    residual, _, notes = _checked(rig, pictures)
    assert max(residual) < 0.2
    assert notes == ()


def test_swapped_pictures_are_named(half_ball):
    rig, (a, b, c) = half_ball
    with pytest.raises(CalibrationError, match="pictures of 'c1' and 'c2' look swapped"):
        _checked(rig, (a, c, b))
    with pytest.raises(CalibrationError, match="pictures of 'c0' and 'c1' look swapped"):
        _checked(rig, (b, a, c))
    with pytest.raises(CalibrationError, match="'c0' shows what 'c1' sees, that of 'c1' shows"):
        _checked(rig, (b, c, a))
    two = Rig(rig.cameras[:2], 0, "rig.toml")
    with pytest.raises(CalibrationError, match="pictures of 'c0' and 'c1' look swapped"):
        _checked(two, (b, a))


def test_swapped_pictures_of_parallel_cameras_are_told_by_depth():
    """Cameras side by side share their epipolar lines: swapped, the object lies behind them."""
    rng = np.random.default_rng(0)
    matrix = np.array([[1000.0, 0.0, 94.5], [0.0, 1000.0, 74.5], [0.0, 0.0, 1.0]])
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = -0.05
    cameras = tuple(
        Camera(name, SHAPE[::-1], matrix, np.zeros(8), pose)
        for name, pose in zip("ab", poses, strict=True)
    )
    # A wall at 1 m: 50 px to the left in the second picture.
    wall = np.repeat(np.repeat(rng.uniform(0.0, 255.0, (50, 90)), 3, axis=0), 3, axis=1)
    first = wall[:, :190].astype(np.float32)
    second = wall[:, 50:240].astype(np.float32)
    assert max(_checked(Rig(cameras, 0, "rig"), [first, second])[0]) < 0.2
    with pytest.raises(CalibrationError, match="behind the cameras; the pictures of 'a' and 'b'"):
        _checked(Rig(cameras, 0, "rig"), [second, first])


def test_a_turned_camera_is_told_from_a_swap():
    stage, views = example(3), _views(3)
    cameras = stage.rig.cameras
    for degrees, wrong in ((0.05, False), (0.5, True)):
        turned = Rig((cameras[0], _turned(cameras[1], degrees), cameras[2]), 0, "rig.toml")
        # 0.05 degrees at 1000 px: 0.9 px off, a remark; 0.5 degrees: 9 px, too far.
        if wrong:
            with pytest.raises(CalibrationError, match=r"lie [89]\.\d px off .* no other order"):
                _checked(turned, views)
        else:
            *_, notes = _checked(turned, views)
            assert len(notes) == 1
            assert "'c0' and 'c1' to 0.9 px only" in notes[0]


def test_any_camera_may_be_the_reference(half_ball):
    rig, pictures = half_ball
    residual, *_ = _checked(Rig(rig.cameras, 2, "rig.toml"), pictures)
    assert max(residual) < 0.2


def test_distance_from_epipolar_lines_is_the_offset_across_them():
    """Cameras side by side: the lines are the rows; 3 px in one are 3 f_a / f_b in the other."""
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = -0.05
    focal = (1000.0, 800.0)
    first, second = (
        Camera(name, None, np.array([[f, 0.0, 94.5], [0.0, f, 74.5], [0.0, 0.0, 1.0]]), np.zeros(8),
               pose)
        for name, f, pose in zip("ab", focal, poses, strict=True)
    )  # fmt: skip
    points = np.random.default_rng(1).uniform((-0.1, -0.1, 0.7), (0.1, 0.1, 0.9), (40, 3))
    seen = _matches(project(first, points), project(second, points) + np.array([7.0, 3.0]))
    # 3 px in the second picture; in the first the same angle.
    expected = 0.5 * (3.0 + 3.0 * focal[0] / focal[1])
    np.testing.assert_allclose(_epipolar_distance(first, second, seen), expected, rtol=1e-9)


def test_own_error_of_features_is_not_that_of_the_rig():
    """Features that agree with one another to a tenth of a pixel, in a rig that is 3 px off."""
    rng = np.random.default_rng(4)
    rig = example(2).rig
    points = rng.uniform(-0.02, 0.02, (200, 3))
    first, second = (project(camera, points) for camera in rig.cameras)
    noise = 0.1
    second += rng.normal((0.0, 3.0), noise, size=second.shape)
    pairs = {(0, 1): _matches(first, second)}
    error = _feature_error(rig, pairs, (0, 1))
    # The median of a normal distribution's absolute values is 0.67 sigma; a fit of seven of 200
    # numbers takes little of it.
    assert error == pytest.approx(0.67 * noise, rel=0.4)


def test_matches_by_chance_are_none():
    """Places at random agree on no geometry, however many there are."""
    rng = np.random.default_rng(3)
    rig = example(2).rig
    pixel = rng.uniform(0.0, 150.0, size=(2, 300, 2))
    chance = _consistent(rig.cameras[0], rig.cameras[1], _matches(pixel[0], pixel[1]))
    assert len(chance.point) == 0


def test_no_texture_is_told_with_the_camera():
    rig, views = example(2).rig, _views(2)
    with pytest.raises(InputError, match="camera 'c1' shows no texture"):
        _checked(rig, [views[0], np.full_like(views[1], 90.0)])
    with pytest.raises(InputError, match="1 pictures for 2 cameras"):
        _checked(rig, views[:1])


def test_too_few_features_are_a_remark():
    rig, views = example(2).rig, _views(2)
    residual, matches, notes = _checked(rig, [views[0], np.ascontiguousarray(views[1][::-1])])
    assert np.isnan(residual[0])
    assert matches[0] < 12
    assert "cameras 'c0' and 'c1' have only" in notes[0]
