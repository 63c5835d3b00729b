"""From a pinhole picture to a camera's, without a renderer: closed forms, no noise."""

from dataclasses import replace

import numpy as np
import pytest
from vision_cameras import BARREL, RATIONAL, make_camera

from palpate.errors import CalibrationError, InputError
from palpate.lab.ideal_view import FINE, IdealView, camera_picture, ideal_view
from palpate.vision import normalised, project, rays

SIZE = (120, 90)


def _camera(lens=(), *, square=False):
    camera = make_camera(lens=lens, focal=130.0, size=SIZE, skew=0.0 if square else 0.4)
    matrix = camera.matrix.copy()
    matrix[:2, 2] = 58.7, 46.2
    if square:
        matrix[1, 1] = matrix[0, 0]
    return replace(camera, matrix=matrix)


def _points(camera, pixels):
    """Points 0.5 m behind pixels."""
    origin, direction = rays(camera, np.array(pixels, dtype=float))
    return origin + 0.5 * direction


def _whole(camera):
    """Points behind the corners of the picture and beyond."""
    columns, rows = camera.size
    return _points(camera, [[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])


def _waves(view):
    """A smooth pattern over the plane z = 1, as the pixels of a view average it."""
    row, column = np.mgrid[: view.shape[0], : view.shape[1]]
    x, y = (column - view.centre[0]) / view.focal, (row - view.centre[1]) / view.focal
    return _pattern(x, y, 1.0 / view.focal)


def _pattern(x, y, width):
    """0.5 + 0.4 sin(a x) sin(b y), averaged over squares: six pixels are a wave."""
    a, b = 2.0 * np.pi * 130.0 / 6.0 * np.array([1.0, 0.8])
    damping = np.sinc(a * width / (2 * np.pi)) * np.sinc(b * width / (2 * np.pi))
    return 0.5 + 0.4 * damping * np.sin(a * x) * np.sin(b * y)


@pytest.mark.parametrize("lens", [(), BARREL, RATIONAL])
def test_each_pixel_is_the_mean_over_its_own_area(lens):
    camera = _camera(lens)
    view = ideal_view(camera, _whole(camera))
    assert view.fine == FINE
    picture = camera_picture(camera, view, _waves(view).astype(np.float32))
    parts = 8
    place = (np.arange(parts) + 0.5) / parts - 0.5
    expected = np.zeros(picture.shape)
    row, column = np.mgrid[: SIZE[1], : SIZE[0]]
    for down in place:
        for right in place:
            pixels = np.stack([column.ravel() + right, row.ravel() + down], axis=1)
            x, y = normalised(camera, pixels).T
            expected += _pattern(x, y, 0.0).reshape(picture.shape)
    expected /= parts**2
    inner = (slice(6, -6), slice(6, -6))
    # Twelve fine pixels a wave: the cubic's error is (2 pi / 12)^3 / 20 of 0.4; where the lens
    # makes the fine pixels smaller or larger than half a pixel the blur differs by less.
    assert np.abs(picture - expected)[inner].max() < 5e-3
    slope = np.stack([np.gradient(expected, axis=1)[inner], np.gradient(expected, axis=0)[inner]])
    error = (picture - expected)[inner]
    shift = np.linalg.lstsq(slope.reshape(2, -1).T, error.ravel(), rcond=None)[0]
    assert np.abs(shift).max() < 2e-4


def test_a_pinhole_with_square_pixels_keeps_its_own_pixels():
    camera = _camera(square=True)
    points = _points(camera, [[30.2, 40.7], [61.0, 70.9]])
    view = ideal_view(camera, points)
    assert view.fine == 1
    assert view.focal == camera.matrix[0, 0]
    row, column = np.mgrid[: view.shape[0], : view.shape[1]]
    picture = camera_picture(camera, view, (100 * row + column + 1.0).astype(np.float32))
    assert picture.shape == SIZE[::-1]
    shown_row, shown_column = np.nonzero(picture)
    left, top = shown_column.min(), shown_row.min()
    assert view.centre == pytest.approx((58.7 - left, 46.2 - top), abs=1e-12)
    assert picture[top, left] == 1.0
    # The points and the pixels next to them are there, and not much more.
    assert left <= 29 <= 62 <= shown_column.max()
    assert top <= 39 <= 71 <= shown_row.max()
    assert view.shape[0] < 45
    assert view.shape[1] < 45


@pytest.mark.parametrize("square", [True, False])
def test_what_lies_beside_the_picture_is_not_rendered(square):
    camera = _camera((), square=square)
    columns, rows = SIZE
    far = _points(camera, [[-300.0, -200.0], [500.0, 600.0]])
    view = ideal_view(camera, far)
    assert view.shape[0] <= view.fine * 1.05 * rows + 8
    assert view.shape[1] <= view.fine * 1.05 * columns + 8
    whole = camera_picture(camera, view, np.ones(view.shape, dtype=np.float32))
    assert np.abs(whole - 1.0).max() < 1e-6


def test_beyond_the_view_and_the_lens_it_is_dark():
    camera = replace(_camera(), distortion=np.array([-2.0]))
    # This lens folds over 0.4 off the axis, 37 pixels from its middle.
    view = ideal_view(camera, _points(camera, [[50.0, 40.0], [60.0, 50.0]]))
    picture = camera_picture(camera, view, np.ones(view.shape, dtype=np.float32))
    assert picture[45, 55] == pytest.approx(1.0, abs=1e-6)
    assert picture[2, 2] == 0.0
    assert picture[80, 100] == 0.0


def test_projection_of_the_view_agrees_with_the_cameras():
    camera = _camera(square=True)
    points = _points(camera, [[30.0, 40.0], [60.0, 70.0]])
    view = ideal_view(camera, points)
    assert isinstance(view, IdealView)
    pose = camera.T_camera_object
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    place = np.stack([x, y], 1) / z[:, None] * view.focal + view.centre
    offset = project(camera, points) - place
    assert np.abs(offset - np.rint(offset)).max() < 1e-9


def test_refusals():
    camera = _camera()
    with pytest.raises(InputError, match="has no size"):
        ideal_view(replace(camera, size=None), _whole(camera))
    with pytest.raises(InputError, match="sees nothing of the bodies"):
        ideal_view(camera, _points(camera, [[-100.0, 10.0], [-50.0, 20.0]]))
    origin, direction = rays(camera, np.array([[50.0, 50.0], [60.0, 60.0]]))
    with pytest.raises(CalibrationError, match="1 of 2 points of the bodies"):
        ideal_view(camera, origin + np.array([[0.5], [-0.5]]) * direction)
