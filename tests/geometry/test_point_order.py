"""Points along a Morton curve."""

import numpy as np

from palpate.geometry import morton_order


def test_a_cube_is_ordered_by_interleaved_bits():
    grid = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    code = sum(((grid >> bit) & 1) @ [1, 2, 4] << (3 * bit) for bit in range(2))
    # Cells of 1 / 1023 of the longest side: thirds of it differ in the highest two bits alike.
    assert np.array_equal(morton_order(grid.astype(float)), np.argsort(code))


def test_place_and_size_do_not_matter_and_points_without_a_place_come_last():
    points = np.random.default_rng(0).random((50, 3))
    order = morton_order(points)
    assert np.array_equal(np.sort(order), np.arange(50))
    assert np.array_equal(morton_order(0.25 * points - 3.0), order)
    points[7] = np.nan
    assert morton_order(points)[-1] == 7


def test_points_at_one_place_keep_their_order():
    assert np.array_equal(morton_order(np.ones((4, 3))), np.arange(4))


def test_neighbours_on_a_grid_stay_together():
    grid = np.stack([*np.divmod(np.arange(256), 16), np.zeros(256)], axis=1)
    block = grid[morton_order(grid)].reshape(16, 16, 3)
    # Sixteen points in a square of four by four.
    assert np.all(np.ptp(block, axis=1)[:, :2] == 3)
