"""Thickness of walls whose thickness is known."""

import numpy as np
from surfaces import box, sphere

from palpate.geometry import wall_thickness


def test_a_slab_is_as_thick_as_it_is() -> None:
    mesh = box((1.0, 1.0, 0.1), (10, 10, 1))
    thickness = wall_thickness(mesh)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    top = np.isclose(middle[:, 2], 0.1) | np.isclose(middle[:, 2], 0.0)
    # Centres of triangles face each other, or lie a third of an edge of 0.1 beside.
    assert np.all(thickness[top] >= 0.1 - 1e-12)
    assert np.all(thickness[top] <= 0.1 * np.hypot(1.0, 0.5))


def test_a_ball_has_no_walls() -> None:
    assert np.isinf(wall_thickness(sphere(3))).all()
