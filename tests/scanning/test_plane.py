"""Planes as they are said on the command line."""

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.scanning import plane_from_text
from palpate.scanning.plane import Plane, plane_text


@pytest.mark.parametrize("text", ["z=12", "Z = 12.0", "5,-3,12, 0,0,7", "5 -3 12 0 0 1"])
def test_one_plane_said_in_several_ways(text):
    plane = plane_from_text(text, metres_per_unit=1e-3)
    np.testing.assert_allclose(
        plane.heights(np.array([[0.3, 0.1, 0.012], [0, 0, 0.022]])), [0, 0.01]
    )


def test_a_plane_is_read_as_it_is_written():
    plane = Plane(np.array([0.01, 0.02, -0.03]), np.array([1.0, 2.0, 2.0]))
    again = plane_from_text(plane_text(plane))
    np.testing.assert_allclose(again.point, plane.point, rtol=1e-4)
    np.testing.assert_allclose(again.normal, plane.normal, rtol=1e-4)


@pytest.mark.parametrize("text", ["", "w=1", "z=up", "1,2,3", "0,0,0,0,0,0"])
def test_what_is_no_plane_is_refused(text):
    with pytest.raises(InputError, match="plane"):
        plane_from_text(text)
