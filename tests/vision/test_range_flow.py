"""The grid of a range flow: its points, the triangles between them, its values at all pixels."""

import numpy as np

from palpate.vision.range_flow import (
    Outcome,
    RangeFlow,
    cause_counts,
    dense_maps,
    grid_points,
    grid_triangles,
)
from palpate.vision.surface_map import SurfaceMap


def _flow(rejected: int | None = None) -> RangeFlow:
    """A displacement that is linear in the pixel, at points every 4 px."""
    column, row = np.meshgrid(np.arange(6, 40, 4), np.arange(10, 30, 4))
    pixel = np.stack([column.ravel(), row.ravel()], axis=1).astype(float)
    n = len(pixel)
    displacement = np.stack([pixel[:, 0], 2.0 * pixel[:, 1], pixel @ [1.0, -1.0]], axis=1)
    outcome = np.zeros(n, dtype=np.int64)
    if rejected is not None:
        outcome[rejected] = Outcome.SCORE
        displacement[rejected] = np.nan
    covariance = np.broadcast_to(np.eye(3) / 3.0, (n, 3, 3)).copy()
    return RangeFlow(
        pixel=pixel,
        point=np.zeros((n, 3)),
        tangent=np.zeros((n, 2, 3)),
        displacement=displacement,
        gradient=np.zeros((n, 2, 3)),
        covariance=covariance,
        bias=0.0 * covariance,
        score=np.ones(n),
        reprojection=np.zeros(n),
        cameras=np.full(n, 2),
        outcome=outcome,
        through_last=np.zeros(n, dtype=bool),
        drift=np.nan,
        noise=np.ones(2),
        subset=21,
        step=4,
        shape=(36, 44),
    )


def test_a_linear_field_is_exact_at_every_pixel() -> None:
    displacement, sigma = dense_maps(_flow())
    row, column = np.nonzero(np.isfinite(sigma))
    assert (column.min(), column.max(), row.min(), row.max()) == (6, 38, 10, 26)
    truth = np.stack([column, 2.0 * row, column - row], axis=1)
    # Single precision of numbers up to 50.
    assert np.allclose(displacement[row, column], truth, atol=1e-5)
    assert np.allclose(sigma[row, column], 1.0, atol=1e-6)


def test_a_rejected_point_leaves_a_hole_and_no_guess() -> None:
    _, whole = dense_maps(_flow())
    _, holed = dense_maps(_flow(rejected=13))
    x, y = _flow().pixel[13].astype(int)
    missing = np.isfinite(whole) & np.isnan(holed)
    rows, columns = np.nonzero(missing)
    assert missing[y, x]
    assert np.abs(columns - x).max() < 4
    assert np.abs(rows - y).max() < 4


def test_nothing_valid_gives_empty_maps() -> None:
    flow = _flow()
    flow.outcome[:] = Outcome.LOST
    displacement, sigma = dense_maps(flow)
    assert np.isnan(displacement).all()
    assert np.isnan(sigma).all()


def test_rejected_points_are_counted_by_cause() -> None:
    flow = _flow()
    flow.outcome[[1, 5, 6]] = [Outcome.SCORE, Outcome.HIDDEN, Outcome.SCORE]
    counts = cause_counts(flow)
    assert list(counts) == [cause.name.lower() for cause in list(Outcome)[1:]]
    assert {name: count for name, count in counts.items() if count} == {"hidden": 1, "score": 2}


def test_triangles_fill_the_cells_that_have_all_their_corners() -> None:
    pixel = _flow().pixel
    whole = grid_triangles(pixel, 4)
    assert len(whole) == 2 * 8 * 4
    corner = pixel[whole]
    first, second = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    # Rows go down: this sign has its normal toward the camera. Half a cell each.
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    np.testing.assert_array_equal(area, -8.0)
    centre = corner.mean(axis=1)
    assert len(np.unique(centre, axis=0)) == len(centre)
    # An inner point is a corner of four cells.
    missing = np.arange(len(pixel)) != 13
    assert len(grid_triangles(pixel[missing], 4)) == len(whole) - 8
    assert grid_triangles(pixel[:0], 4).shape == (0, 3)


def test_grid_points_are_those_behind_the_pixels_that_may_be_used() -> None:
    """One triangle over the lower right of a picture, tilted about the rows."""
    vertices = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 1.0], [0.0, 2.0, 0.0]])
    column, row = np.meshgrid(np.arange(12.0), np.arange(9.0))
    point = np.stack([column, row, 0.5 * column], axis=-1)
    surface = SurfaceMap(point, np.zeros((9, 12), dtype=np.int64))
    shown = row > 2.0
    pixel, position, tangent = grid_points(surface, shown, vertices, np.array([[0, 1, 2]]), 3)
    expected = [(c, r) for r in (4, 7) for c in (1, 4, 7, 10)]
    assert [tuple(p) for p in pixel] == expected
    np.testing.assert_array_equal(position, [[c, r, 0.5 * c] for c, r in expected])
    along = np.array([2.0, 0.0, 1.0]) / np.sqrt(5.0)
    np.testing.assert_allclose(tangent[:, 0], [along] * 8, atol=1e-15)
    np.testing.assert_allclose(tangent[:, 1], [[0.0, 1.0, 0.0]] * 8, atol=1e-15)
