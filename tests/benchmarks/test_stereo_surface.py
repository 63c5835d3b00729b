"""The surface through stereo points against counts and areas of plane grids."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.stereo_surface import triangulated_surface
from palpate.vision import StereoPoints

STEP, SPACING = 5, 1.5e-3  # px, m
COLUMNS, ROWS = 12, 9


def _plane(columns: int = COLUMNS, rows: int = ROWS) -> StereoPoints:
    """A grid that fronts a camera: x along its columns, y along its rows, z away from it."""
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    cell = grid.reshape(-1, 2).astype(float)
    n = len(cell)
    return StereoPoints(
        pixel=2.0 + STEP * cell,
        point=np.column_stack([SPACING * cell, np.full(n, 0.5)]),
        covariance=np.zeros((n, 3, 3)),
        residual=np.zeros(n),
        cameras=np.full(n, 2),
        spacing=np.full(n, SPACING),
        counts=np.zeros(8, dtype=np.int64),
        step=STEP,
    )


def _moved_back(stereo: StereoPoints, steps: float) -> tuple[StereoPoints, np.ndarray]:
    """The right half farther away by some steps of the grid."""
    right = stereo.pixel[:, 0] > 2.0 + STEP * 5.5
    point = stereo.point.copy()
    point[right, 2] += steps * SPACING
    return replace(stereo, point=point), right


def test_it_covers_the_grid_and_faces_the_camera() -> None:
    vertices, triangles = triangulated_surface(_plane())
    assert len(triangles) == 2 * (COLUMNS - 1) * (ROWS - 1)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    assert (normal[:, 2] < 0.0).all()
    area = 0.5 * np.linalg.norm(normal, axis=1).sum()
    # Rounding of coordinates.
    assert area == pytest.approx((COLUMNS - 1) * (ROWS - 1) * SPACING**2, rel=1e-12)


def test_it_ends_at_jumps() -> None:
    """A side may be 5.8 diagonals long, 8.2 steps: less than a jump from column to column."""
    whole = 2 * (COLUMNS - 1) * (ROWS - 1)
    assert len(triangulated_surface(_moved_back(_plane(), 8.0)[0])[1]) == whole
    torn, right = _moved_back(_plane(), 8.3)
    triangles = triangulated_surface(torn)[1]
    assert len(triangles) == whole - 2 * (ROWS - 1)
    assert (right[triangles].all(axis=1) | ~right[triangles].any(axis=1)).all()


def test_no_points_make_no_surface() -> None:
    vertices, triangles = triangulated_surface(_plane(0, 0))
    assert vertices.shape == triangles.shape == (0, 3)
