"""Wrong shapes are caught while tests run, in the first call of each function in each test."""

import numpy as np
import pytest
from jaxtyping import TypeCheckError

from palpate.geometry import SurfacePoints, bounding_diagonal


@pytest.mark.parametrize("_again", [1, 2])
def test_every_test_begins_anew(_again):
    with pytest.raises(TypeCheckError, match="mesh"):
        bounding_diagonal(np.zeros((4, 3)))


def test_fields_of_a_dataclass_are_checked():
    triangle, flat = np.zeros(2, dtype=np.int64), np.zeros((2, 2))
    with pytest.raises(TypeCheckError, match="position"):
        SurfacePoints(triangle, np.zeros((2, 3)), flat, np.zeros(2))


def test_later_calls_are_not_checked():
    """The second is left alone: what it is given fails where it is used, not at the door."""
    with pytest.raises(TypeCheckError):
        bounding_diagonal("no mesh")
    with pytest.raises(AttributeError):
        bounding_diagonal("no mesh")
