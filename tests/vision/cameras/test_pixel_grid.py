"""Rays of whole pictures against OpenCV and the closed form of the fold."""

import cv2
import numpy as np
import pytest

from palpate.errors import InputError
from palpate.records import Camera
from palpate.vision.cameras.projection import pixel_grid

SHAPE = (48, 64)
LENSES = {
    "none": [],
    "barrel": [-0.3, 0.1, 2e-3, -1e-3, 0.02],
    "cushion": [0.4, 0.1],
    "rational": [-0.3, 0.1, 2e-3, -1e-3, 0.02, 0.05, 0.01, -0.02],
    "tangential": [0.0, 0.0, 5e-3, -4e-3],
}


def _camera(lens, *, focal=70.0, centre=(31.2, 24.3), skew=0.4, size=SHAPE[::-1]):
    terms = np.zeros(8)
    terms[: len(lens)] = lens
    matrix = np.array([[focal, skew, centre[0]], [0.0, 1.05 * focal, centre[1]], [0.0, 0.0, 1.0]])
    return Camera("c0", size, matrix, terms, np.eye(4))


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
@pytest.mark.parametrize("centre", [(31.2, 24.3), (-12.0, 60.0), (90.0, -5.0)])
def test_opencv_projects_the_rays_onto_their_pixels(lens, centre):
    camera = _camera(lens, centre=centre, focal=120.0, skew=0.0)
    x, y = pixel_grid(camera, SHAPE).reshape(2, -1)
    points = np.stack([x, y, np.ones_like(x)], axis=1)
    zero = np.zeros(3)
    pixel = cv2.projectPoints(points, zero, zero, camera.matrix, camera.distortion)[0]
    column, row = np.meshgrid(np.arange(64.0), np.arange(48.0))
    truth = np.stack([column, row], axis=-1).reshape(-1, 1, 2)
    np.testing.assert_allclose(pixel, truth, atol=1e-9)


@pytest.mark.parametrize(
    ("lens", "square", "focal"),
    [
        ([-0.3], 1.0 / 0.9, 30.0),
        # Rises again farther out: those rays reach pixels within the picture a second time.
        ([-0.6, 0.15], (1.8 - np.sqrt(0.24)) / 1.5, 15.0),
    ],
)
def test_pixels_that_no_ray_reaches_are_nan_and_no_others(lens, square, focal):
    """The lens folds over where the derivative of r (1 + k1 r^2 + k2 r^4) is zero."""
    camera = _camera(lens, focal=focal, skew=0.0)
    grid = pixel_grid(camera, SHAPE)
    column, row = np.meshgrid(np.arange(64.0), np.arange(48.0))
    distorted = np.hypot((column - 31.2) / focal, (row - 24.3) / (1.05 * focal))
    terms = np.polyval([*lens[::-1], 1.0], square)
    np.testing.assert_array_equal(np.isnan(grid[0]), distorted > np.sqrt(square) * terms)
    assert 300 < np.isnan(grid[0]).sum() < 2900
    # What is seen lies before the fold, at the radius that the lens takes to the pixel's.
    radius = np.hypot(*grid)[np.isfinite(grid[0])]
    assert radius.max() < np.sqrt(square)
    forward = radius * np.polyval([*lens[::-1], 1.0], radius**2)
    np.testing.assert_allclose(forward, distorted[np.isfinite(grid[0])], atol=1e-12)


def test_small_pictures_and_other_sizes():
    camera = _camera(LENSES["barrel"], size=None)
    whole = pixel_grid(camera, SHAPE)
    for shape in ((1, 1), (1, 9), (7, 1), (29, 37)):
        np.testing.assert_allclose(
            pixel_grid(camera, shape), whole[:, : shape[0], : shape[1]], atol=1e-12
        )
    with pytest.raises(InputError, match="camera 'c0' has 64 x 48 pixels; asked for 37 x 29"):
        pixel_grid(_camera([]), (29, 37))
