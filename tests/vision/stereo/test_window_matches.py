"""Windows of growing size on known warps, and what neighbours reject, on matches made by hand."""

import numpy as np
import pytest

from palpate.vision.range_flow import Outcome
from palpate.vision.stereo.window_matches import WindowMatches, confirmed_matches


def _grid(rows: int = 12, columns: int = 14, step: float = 5.0):
    cell = np.stack(np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij"), -1)
    cell = cell.reshape(-1, 2)
    return cell, step * cell[:, ::-1].astype(np.float64)


def _rejected(cell, pixel, displacement, gradient, valid, sigma=0.01):
    """Flags of the valid matches that are rejected; `sigma` is the root of the trace."""
    variance = np.broadcast_to(0.5 * sigma**2 * np.eye(2), (len(cell), 2, 2))
    outcome = np.where(valid, int(Outcome.VALID), int(Outcome.LOST))
    matches = WindowMatches(displacement, np.array(gradient), np.array(variance), outcome)
    found = confirmed_matches(matches, cell, pixel)
    wrong = found.outcome == Outcome.NEIGHBOURS
    np.testing.assert_array_equal(found.outcome[~wrong], outcome[~wrong])
    np.testing.assert_array_equal(np.isnan(found.displacement).all(axis=1), wrong)
    np.testing.assert_array_equal(found.displacement[~wrong], displacement[~wrong])
    return wrong


@pytest.mark.parametrize("scatter", [0.0, 0.02])
def test_the_limit_is_five_deviations_of_scatter_and_noise(scatter):
    """In an affine field, so that a gradient of the wrong sign or order would add to the scatter.

    Neighbours lie by turns `scatter` to one side of the field and to the other: for the point in
    the middle their median is the field and its scatter is `scatter`.
    """
    cell, pixel = _grid(5, 5)
    slope = np.array([[0.2, -0.1], [0.05, 0.3]])
    field = pixel @ slope.T + [3.0, -40.0]
    middle = 12
    side = np.where(cell.sum(axis=1) % 2, -scatter, scatter)
    side[middle] = 0.0
    field[:, 0] += side
    gradient = np.broadcast_to(slope, (25, 2, 2))
    everything = np.ones(25, dtype=bool)
    for share in (0.99, 1.01):
        moved = field.copy()
        moved[middle, 1] += share * 5.0 * np.hypot(scatter, 0.01)
        wrong = _rejected(cell, pixel, moved, gradient, everything)
        assert wrong[middle] == (share > 1.0)
        assert not np.delete(wrong, middle).any()


def test_a_jump_rejects_only_points_beside_it():
    rng = np.random.default_rng(0)
    cell, pixel = _grid()
    field = rng.normal(scale=0.007, size=pixel.shape)
    field[pixel[:, 0] > 32.0] += 6.0
    everything = np.ones(len(cell), dtype=bool)
    wrong = _rejected(cell, pixel, field, np.zeros((len(cell), 2, 2)), everything)
    # A point beside the jump keeps five of its eight neighbours, a majority.
    assert not wrong[np.abs(pixel[:, 0] - 32.5) > 8.0].any()
    assert wrong.mean() < 0.05


def test_mistakes_and_lonely_points_are_rejected():
    rng = np.random.default_rng(1)
    cell, pixel = _grid()
    field = rng.normal(scale=0.01, size=pixel.shape)
    gradient = np.zeros((len(cell), 2, 2))
    bad = rng.choice(len(cell), 12, replace=False)
    field[bad] += rng.uniform(0.5, 3.0, size=(12, 2))
    valid = np.ones(len(cell), dtype=bool)
    wrong = _rejected(cell, pixel, field, gradient, valid)
    assert wrong[bad].all()
    assert wrong.sum() <= 14
    # Two points by themselves are confirmed by nobody; four around a corner are, by three each.
    few = np.zeros(len(cell), dtype=bool)
    few[[0, 1]] = True
    field[:] = 0.0
    np.testing.assert_array_equal(_rejected(cell, pixel, field, gradient, few), few)
    few[[14, 15]] = True
    assert not _rejected(cell, pixel, field, gradient, few).any()


def test_nothing_contradicts_nothing():
    none = np.zeros((0, 2))
    wrong = _rejected(
        np.zeros((0, 2), dtype=np.int64), none, none, np.zeros((0, 2, 2)), np.zeros(0, dtype=bool)
    )
    assert wrong.shape == (0,)
