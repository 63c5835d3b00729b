"""Noise that derivatives taken from the neighbours carry into a window's displacement."""

import cv2
import numpy as np
import pytest

from palpate.vision.joint.match import BEND_REACH, _inflation
from palpate.vision.matching.local_regression import local_field
from palpate.vision.matching.scatter import Scatter

PITCH, SUBSET, PIXELS, DRAWS = 3e-4, 21, 141, 60
HALF_WINDOW = SUBSET // 2 * PITCH


@pytest.mark.parametrize("step", [2, 5, 10])
def test_carried_noise_is_that_of_many_draws(step):
    """White noise of pixels, averaged over windows, is the noise of their displacements."""
    line = np.arange(SUBSET // 2, PIXELS - SUBSET // 2, step, dtype=float)
    pixel = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    point = np.column_stack([(pixel - pixel.mean(axis=0)) * PITCH, np.zeros(len(pixel))])
    tangent = np.tile(np.eye(3)[:2], (len(point), 1, 1))
    half_window = np.full(len(point), HALF_WINDOW)
    sigma = 1e-6
    covariance = np.tile(sigma**2 * np.eye(3), (len(point), 1, 1))
    rng, columns, squares = np.random.default_rng(0), pixel.astype(int).T, 0.0
    for _ in range(DRAWS):
        noise = rng.normal(size=(PIXELS, PIXELS, 3))
        window = sigma * SUBSET * cv2.blur(noise, (SUBSET, SUBSET))[columns[1], columns[0]]
        scatter = Scatter(point, pixel, window, covariance, 0.0 * covariance, SUBSET)
        field = local_field(scatter, point, tangent, reach=BEND_REACH * HALF_WINDOW)
        # The mean of a window whose curvature is known, when the curvature is wrong.
        bend = field.curvature[:, 0] + field.curvature[:, 2]
        moment = ((SUBSET * PITCH) ** 2 - PITCH**2) / 12.0
        squares += ((window - moment * bend) ** 2).mean(axis=1) / sigma**2 / DRAWS
    claimed = _inflation(scatter, field, half_window)
    # Neighbours lie on all sides in the middle, on one side at the rim, too few in a corner.
    # Squares of 180 draws scatter by a tenth, their mean over the points by a fiftieth. The half
    # window of 10 px claims a second moment that is a tenth smaller than that of 21 pixels.
    middle = np.abs(pixel - pixel.mean(axis=0)).max(axis=1) < 20.0
    known = np.isfinite(claimed)
    for chosen in (middle & known, ~middle & known):
        assert claimed[chosen].mean() == pytest.approx(squares[chosen].mean(), rel=0.08)
    assert claimed[middle & known].mean() > 1.3
