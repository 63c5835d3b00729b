"""Films of presses: what a frame shows has moved by what was solved."""

import numpy as np
import pytest
from scipy.ndimage import spline_filter

from palpate.lab.bench.press_film import _warped


@pytest.mark.parametrize("most", [0.05, 0.3])
def test_films_move_by_what_was_solved(most: float) -> None:
    """Tenths of a pixel, which a remap that rounds places makes a tenth longer.

    What a ramp shows is how far it has gone.
    """
    ramp = np.tile(np.arange(160.0, dtype=np.float32), (80, 1))
    motion = np.zeros((20, 40, 2), dtype=np.float32)
    motion[..., 0] = most * np.linspace(-1.0, 1.0, 40)
    gone = ramp - _warped(spline_filter(ramp, order=5, output=np.float32), motion)
    # A sample is every fourth pixel of the doubled picture, from its first half pixel on; the
    # field itself stretches by its gradient, 0.75 % at most.
    expected = 2.0 * most * (-1.0 + 2.0 * ((np.arange(160) - 0.5) / 4.0) / 39.0)
    inner = np.s_[20:-20, 20:-20]
    np.testing.assert_allclose(
        gone[inner], np.tile(expected, (80, 1))[inner], atol=0.01 * 2.0 * most
    )
