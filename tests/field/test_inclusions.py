"""Round parts: their logarithm of the modulus and its derivatives."""

import numpy as np
import pytest

from palpate.field.inclusions import _fields

PARTS = np.array([[0.01, 0.0, 0.02, np.log(8e-3), 1.6], [-0.01, 0.004, 0.01, np.log(5e-3), -0.7]])
WIDTH = 1.5e-3


def test_a_part_is_stiff_within_and_as_the_rest_beyond() -> None:
    places = np.array([[0.01, 0.0, 0.02], [0.01, 0.008, 0.02], [-0.01, 0.004, 0.01], [0.1, 0, 0]])
    value = _fields(PARTS, places, WIDTH)[:, 0]
    np.testing.assert_allclose(value, [1.6, 0.8, -0.7, 0.0], atol=2e-3)


@pytest.mark.parametrize("which", range(10))
def test_derivatives_by_place_radius_and_contrast(which: int) -> None:
    places = np.random.default_rng(0).uniform(-0.02, 0.03, (200, 3))
    step = 1e-5 * (8e-3 if which % 5 < 3 else 1.0)
    change = np.zeros(10)
    change[which] = step
    more, less = (
        _fields(PARTS + side * change.reshape(2, 5), places, WIDTH)[:, 0] for side in (1, -1)
    )
    derivative = _fields(PARTS, places, WIDTH)[:, 1 + which]
    np.testing.assert_allclose(
        derivative, (more - less) / (2 * step), atol=1e-6 * np.abs(derivative).max()
    )
