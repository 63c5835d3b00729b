"""Displacement between two pictures without a seed, against analytic textures."""

import numpy as np
import pytest

from benchmarks.planar_flow import planar_flow
from palpate.vision.spline import make_spline_picture
from palpate.vision.stereo.window_matches import refine_planar
from tests.vision.textures import Speckle, affine, noisy, turned


def _grid(size: int, border: int, step: int) -> np.ndarray:
    line = np.arange(border, size - border, step, dtype=float)
    return np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)


@pytest.mark.parametrize(
    ("subset", "bound"),
    [
        # Noise of 1.5 grey levels on this texture leaves 0.007 px with 21 x 21 windows.
        (21, 0.010),
        # 7 x 7 windows: 0.026 px for windows of average contrast, twice that where it is poor.
        (7, 0.050),
    ],
)
def test_a_turned_and_stretched_texture_is_followed_everywhere(subset: int, bound: float) -> None:
    texture = Speckle(256, seed=3)
    warp = affine(turned(1.5, 0.03), (6.4, -4.7), (128.0, 128.0))
    first, second = noisy(texture.image(), 1.5, 1), noisy(texture.image(warp), 1.5, 2)
    pixel = _grid(256, 40, 8)
    flow = planar_flow(first, second, pixel, subset=subset)
    error = (flow.displacement - warp.displacement(pixel))[flow.valid]
    assert flow.valid.mean() > 0.99
    assert np.sqrt((error**2).mean()) < bound
    assert np.abs(error).max() < 0.5


def test_claimed_sigma_is_what_happens() -> None:
    """400 windows overlap little at this spacing: their mean square is known to 5 %."""
    texture = Speckle(512, seed=5)
    warp = affine(np.eye(2), (0.37, -0.23), (256.0, 256.0))
    first, second = noisy(texture.image(), 1.5, 1), noisy(texture.image(warp), 1.5, 2)
    pixel = _grid(512, 40, 22)
    flow = planar_flow(first, second, pixel)
    error = flow.displacement - warp.displacement(pixel)
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(flow.covariance), error) / 2
    assert np.sqrt(square[flow.valid].mean()) == pytest.approx(1.0, abs=0.12)


def test_the_low_pass_takes_most_of_the_bias_of_fine_speckle() -> None:
    """Speckles of 0.8 px, moved by 0.1 px without noise: what is finer than the pixels misleads.

    Unsmoothed the motion is 1.24 % too long, by aliasing: six textures agree to 0.02 %. The
    low-pass of 1 px leaves 0.08 %, less than half the error of lengths that every session grants.
    """
    texture = Speckle(256, seed=1, sigma=0.8)
    first = texture.image()
    second = texture.image(affine(np.eye(2), (0.1, 0.0), (128.0, 128.0)))
    pixel = _grid(256, 30, 7)
    start = np.broadcast_to([0.1, 0.0], pixel.shape)
    excess = []
    for smoothing in (0.0, 1.0):
        match = refine_planar(
            make_spline_picture(first, smoothing=smoothing),
            make_spline_picture(second, smoothing=smoothing),
            pixel,
            start,
        )
        excess.append(float(match.displacement[:, 0].mean()) / 0.1 - 1.0)
    assert excess[0] > 0.01
    assert abs(excess[1]) < 0.001
