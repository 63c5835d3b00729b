"""One surface through points: feet at the support, and vertices that err by their sigmas."""

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from palpate.geometry import TriangleMesh, triangle_areas
from palpate.scanning.fusion import fitted, fused
from palpate.scanning.plane import Plane
from palpate.scanning.solid import above

TABLE = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
RADIUS, CENTRE = 0.03, 0.02
_SIDE, _VIEWS, _WINDOW, _SIGMA = 40, 1, 5, 0.02


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
    radius = np.sqrt(triangle_areas(skin)[foot].sum() / np.pi)
    true = np.sqrt(RADIUS**2 - CENTRE**2)
    # The bend below the last points; straight down from them it would be 0.9 mm too wide.
    assert abs(radius - true) < 2.5e-4


def _sheet(step: float, count: int) -> TriangleMesh:
    """A flat sheet that begins at 5, 5."""
    line = 5.0 + step * np.arange(count)
    corners = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    first = (count * np.arange(count - 1)[:, None] + np.arange(count - 1)).ravel()
    quads = first[:, None] + np.array([0, 1, count + 1, count])
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return TriangleMesh(np.column_stack([corners, np.zeros(len(corners))]), triangles)


def _error(rng: np.random.Generator) -> np.ndarray:
    """Means of noise over windows: neighbours have as much in common as their windows overlap."""
    noise = uniform_filter(rng.normal(size=(_SIDE, _SIDE)), _WINDOW, mode="wrap")
    return _SIGMA * _WINDOW * noise.ravel()


def test_errors_of_overlapping_windows_are_in_the_sigma() -> None:
    mesh = _sheet(2.0, 15)
    grid = np.stack(np.meshgrid(np.arange(_SIDE), np.arange(_SIDE)), axis=-1).reshape(-1, 2)
    view = np.repeat(np.arange(_VIEWS), len(grid))
    ratio = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        # A single view, as of an object on a table.
        points = np.concatenate(
            [np.column_stack([grid + rng.uniform(0, 1, 2), _error(rng)]) for _ in range(_VIEWS)]
        )
        normals = np.tile([0.0, 0.0, 1.0], (len(points), 1))
        sigma = np.full(len(points), _SIGMA)
        for correlation_length in (float(_WINDOW), 0.0):
            moved, std = fitted(
                mesh,
                points,
                normals,
                sigma,
                view=view,
                correlation_length=np.full(len(points), correlation_length),
            )
            known = np.isfinite(std)
            assert known.mean() > 0.8
            height = moved.vertices[known, 2]
            ratio.append(np.sqrt(np.mean((height / std[known]) ** 2)))
    # 225 vertices, of which some 40 are independent: a deviation of 0.07 over three draws.
    assert 0.75 < np.mean(ratio[::2]) < 1.3
    # Residuals of one view alone show little of it: the fit follows what neighbours share.
    assert np.mean(ratio[1::2]) > 1.35
