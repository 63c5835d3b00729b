"""The factor for correlated residuals: one for independent points, the right one for clumps."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, misfit_of
from estimation.half_space import HalfSpace, half_space_probes

from palpate.estimation import ProbeObservations
from palpate.estimation.intervals.sandwich import scores_of
from palpate.estimation.intervals.spatial_correlation import (
    CorrelationFactor,
    correlation_factor,
)
from palpate.estimation.search.misfit import LocalProbe


def _factor(seed: int, clump: int, *, force_noise: float = 0.0) -> CorrelationFactor:
    """Factor where squares of clump x clump points share one noise vector."""
    rng = np.random.default_rng(seed)
    probes = []
    for probe in half_space_probes(rng, count=4, grid=24, force_noise=force_noise):
        probes.append(_clumped(probe, clump, rng))
    misfit = misfit_of(probes, "student-t")
    return scores_of(misfit, minimum_of(misfit).probes)[1].correlation


def _clumped(probe: ProbeObservations, clump: int, rng: np.random.Generator) -> ProbeObservations:
    cell = np.floor((probe.position[:, :2] + 0.031) / (clump * 0.06 / 23)).astype(int)
    noise = rng.normal(size=(40, 40, 3))[cell[:, 0], cell[:, 1]]
    moved = probe.displacement + 3e-5 * noise
    return replace(probe, displacement=moved, std=np.full_like(moved, 3e-5))


@pytest.mark.parametrize("force_noise", [0.0, 0.02])
def test_independent_points_have_no_factor(force_noise: float) -> None:
    factors = [_factor(seed, 1, force_noise=force_noise) for seed in range(12)]
    # Each of five sizes of block is tested at three sigma: a few per cent of false alarms.
    assert sum(factor.variance > 1 for factor in factors) <= 2
    assert factors[0] == CorrelationFactor(1.0, np.inf, 1.0)


def test_clumps_have_the_factor_of_their_size() -> None:
    factors = [_factor(seed, 3) for seed in range(8)]
    # Nine points share one value: variance nine times, clumps cut by blocks count for less and the
    # largest of several block sizes for more.
    assert 5 < np.median([factor.variance for factor in factors]) < 14
    assert all(np.isfinite(factor.degrees) for factor in factors)
    assert all(factor.block_points > 1 for factor in factors)


def _one_probing(points: int, residual: np.ndarray | None = None) -> LocalProbe:
    """A probing of its first points, its residuals replaced."""
    probe = half_space_probes(np.random.default_rng(1), count=1, grid=16, noise=3e-5)[0]
    field = probe.displacement.copy()
    field[points:] = np.nan
    misfit = misfit_of([replace(probe, displacement=field)])
    one = misfit.at_best_forces(0.3, 2e4)[1][0]
    if residual is not None:
        one.table[:, 5] = residual[: len(one.table)]
    return one


def _found(one: LocalProbe) -> CorrelationFactor:
    projection = np.vstack([np.eye(2), np.zeros((3, 2))])
    return correlation_factor([one], [projection], score_variance=1.0)


def test_few_points_say_nothing() -> None:
    """Fewer than eight blocks of six points."""
    alike = 5.0 * np.ones(3 * 256)
    assert _found(_one_probing(47, alike)) == CorrelationFactor(1.0, np.inf, 1.0)
    assert _found(_one_probing(48, alike)).variance > 5


def test_the_mean_factor_is_one_for_independent_points() -> None:
    """Its square form has its expectation at every size of block: no factor by mistake, and none
    missed. Seen through residuals so large that all is significant."""
    rng = np.random.default_rng(5)
    one = _one_probing(256)
    design = one.design[:, :2]
    hat = design @ np.linalg.solve(design.T @ design, design.T)
    drawn = []
    for _ in range(300):
        residual = 3.0 * rng.normal(size=len(design))
        # What a fit leaves of it.
        one.table[:, 5] = residual - hat @ residual
        drawn.append(_found(one))
    # The largest of three sizes of block (32, 16 and 8) of chi-square of about twice as many
    # degrees: 9 and a little more; each factor alone is good to 25 %.
    variances = np.array([factor.variance for factor in drawn])
    assert 9.0 < variances.mean() < 13.0
    assert {round(256 / factor.block_points) for factor in drawn} <= {8, 16, 32}


def test_missing_components_and_a_tip_do_not_shift_the_blocks() -> None:
    rng = np.random.default_rng(4)
    probe = half_space_probes(rng, count=1, grid=16, noise=3e-5, tip=True)[0]
    response = HalfSpace(probe.response.offset[:-1])
    bare = replace(probe, tip_displacement=None, tip_displacement_std=None, response=response)
    plain = misfit_of([bare]).at_best_forces(0.3, 2e4)[1][0]
    with_tip = misfit_of([probe]).at_best_forces(0.3, 2e4)[1][0]
    plain.table[:, 5] = 5.0
    with_tip.table[:, 5] = 5.0
    with_tip.table[-3:, 5] = 1e6
    expected, found = _found(plain), _found(with_tip)
    # The tip has no neighbours: it is left out of scores and information alike.
    assert found.variance == pytest.approx(expected.variance, rel=1e-9)
    assert found.degrees == pytest.approx(expected.degrees, rel=1e-9)
