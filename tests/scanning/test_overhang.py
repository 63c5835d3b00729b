"""An object that is wider above its foot: the foot is where its flank meets the support."""

import numpy as np
import pytest

from palpate.geometry import triangle_areas
from palpate.scanning import Plane
from palpate.scanning.fusion import fused
from palpate.scanning.solid import above

TABLE = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
RADIUS, CENTRE = 0.03, 0.02


@pytest.mark.slow
def test_the_foot_of_a_ball_that_was_cut_has_its_size():
    """Points everywhere but on the foot itself, with its lowest millimetre hidden."""
    count = 3000
    height = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * np.arange(count)
    across = np.sqrt(1.0 - height**2)
    normals = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    points = RADIUS * normals + [0.0, 0.0, CENTRE]
    seen = points[:, 2] > 1e-3
    skin = above(fused(points[seen], normals[seen], support=TABLE), TABLE)
    foot = (skin.vertices[skin.triangles][:, :, 2] < 1e-6).all(axis=1)
    found = np.sqrt(triangle_areas(skin)[foot].sum() / np.pi)
    true = np.sqrt(RADIUS**2 - CENTRE**2)
    # The bend below the last points; straight down from them it would be 0.9 mm too wide.
    assert abs(found - true) < 2.5e-4
