"""Strain in a surface against closed forms."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.geometry import surface_strain

RNG = np.random.default_rng(5)
# A sheet of 40 x 40 x 0 mm, turned out of all planes of the frame.
FRAME = Rotation.from_euler("xyz", [0.4, -0.9, 0.3]).as_matrix()
SHEET = np.column_stack([RNG.uniform(0.0, 0.04, (300, 2)), np.zeros(300)]) @ FRAME.T


def test_a_stretched_and_turned_sheet_has_the_strain_that_it_was_given():
    stretched = SHEET @ (FRAME @ np.diag([1.1, 0.95, 1.0]) @ FRAME.T)
    moved = stretched @ Rotation.from_rotvec([0.8, 0.5, -0.3]).as_matrix().T + 0.02
    strain = surface_strain(SHEET, moved - SHEET)
    # Green and Lagrange: half of the squared stretch less one. Linear motion is fitted exactly.
    expected = [0.5 * (1.1**2 - 1.0), 0.5 * (0.95**2 - 1.0)]
    np.testing.assert_allclose(strain, np.tile(expected, (300, 1)), rtol=1e-9)


def test_a_component_that_nobody_saw_is_no_strain():
    flat = SHEET @ FRAME
    displacement = np.column_stack([0.01 * flat[:, 0], -0.004 * flat[:, 1], np.full(300, np.nan)])
    strain = surface_strain(flat, displacement)
    expected = [0.01 + 0.5 * 0.01**2, -0.004 + 0.5 * 0.004**2]
    np.testing.assert_allclose(strain, np.tile(expected, (300, 1)), rtol=1e-9)


def test_a_ball_that_swells_is_strained_alike_everywhere():
    points = RNG.normal(size=(4000, 3))
    points *= 0.03 / np.linalg.norm(points, axis=1, keepdims=True)
    strain = surface_strain(points, 0.02 * points)
    # The best plane through a window leaves no slope of what rises above it.
    assert strain == pytest.approx(0.02 + 0.5 * 0.02**2, rel=1e-9)
