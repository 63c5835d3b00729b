"""The factor for correlated residuals: one for independent points, the right one for clumps."""

from dataclasses import replace

import numpy as np
from estimation.half_space import half_space_probes, surface_grid

from palpate.estimation import ProbeObservations
from palpate.estimation.intervals.sandwich import scores_of
from palpate.estimation.intervals.spatial_correlation import CorrelationFactor, morton_order
from palpate.estimation.noise.registry import NOISE_MODELS
from palpate.estimation.observations import observed_rows_of
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.scoring import scored_minimum


def _factor(seed: int, clump: int) -> CorrelationFactor:
    """Factor where squares of clump x clump points share one noise vector."""
    rng = np.random.default_rng(seed)
    probes = []
    for probe in half_space_probes(rng, count=4, grid=24):
        probes.append(_clumped(probe, clump, rng))
    rows = [observed_rows_of(probe) for probe in probes]
    misfit = Misfit(tuple(rows), np.ones(8), NOISE_MODELS["student-t"])
    minimum = scored_minimum(misfit, 0.3, 2e4, poisson_range=(0.0, 0.4999))
    return scores_of(misfit, minimum.probes)[1].correlation


def _clumped(probe: ProbeObservations, clump: int, rng: np.random.Generator) -> ProbeObservations:
    cell = np.floor((probe.position[:, :2] + 0.031) / (clump * 0.06 / 23)).astype(int)
    noise = rng.normal(size=(40, 40, 3))[cell[:, 0], cell[:, 1]]
    moved = probe.displacement + 3e-5 * noise
    return replace(probe, displacement=moved, std=np.full_like(moved, 3e-5))


def test_independent_points_have_no_factor() -> None:
    # Each of five sizes of block is tested at three sigma: a few per cent of false alarms.
    assert sum(_factor(seed, 1).variance > 1 for seed in range(20)) <= 3


def test_clumps_have_the_factor_of_their_size() -> None:
    factors = [_factor(seed, 3).variance for seed in range(8)]
    # Nine points share one value: variance nine times, clumps cut by blocks count for less and the
    # largest of several block sizes for more.
    assert 5 < np.median(factors) < 14


def test_morton_order_keeps_neighbours_together() -> None:
    points = surface_grid(16, 1.0)
    order = morton_order(points)
    assert sorted(order.tolist()) == list(range(256))
    block = points[order].reshape(16, 16, 3)
    # Sixteen points in a square of four by four.
    assert np.all(np.ptp(block, axis=1)[:, :2] < 0.5)
    with_tip = np.vstack([[np.nan] * 3, points])
    assert morton_order(with_tip)[-1] == 0
