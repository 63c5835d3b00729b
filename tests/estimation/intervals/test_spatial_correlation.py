"""What blocks of neighbours share: nothing for independent points, the right factor for clumps."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, misfit_of, uncertainty_at
from estimation.half_space import HalfSpace, half_space_probes

from palpate.estimation import ProbeObservations
from palpate.estimation.intervals.sandwich import scores_of
from palpate.estimation.intervals.scatter import NO_SCATTER, Scatter
from palpate.estimation.intervals.score_noise import ScoreNoise
from palpate.estimation.intervals.spatial_correlation import block_scatter
from palpate.estimation.search.misfit import LocalProbe
from palpate.records import PointCorrelation


def _noise(seed: int, clump: int, *, force_noise: float = 0.0, known: bool = False) -> ScoreNoise:
    """Of a session where squares of clump x clump points share one noise vector."""
    rng = np.random.default_rng(seed)
    probes = []
    for probe in half_space_probes(rng, count=4, grid=24, force_noise=force_noise):
        probes.append(_clumped(probe, clump, rng, known=known))
    misfit = misfit_of(probes, "student-t")
    return scores_of(misfit, minimum_of(misfit).probes)[1]


def _clumped(
    probe: ProbeObservations, clump: int, rng: np.random.Generator, *, known: bool
) -> ProbeObservations:
    cell = np.floor((probe.position[:, :2] + 0.031) / (clump * 0.06 / 23)).astype(int)
    noise = rng.normal(size=(40, 40, 3))[cell[:, 0], cell[:, 1]]
    moved = probe.displacement + 3e-5 * noise
    probe = replace(probe, displacement=moved, std=np.full_like(moved, 3e-5))
    if not known:
        return probe
    pair = np.argwhere(np.triu((cell[:, None] == cell[None]).all(axis=2), 1))
    return replace(probe, correlation=PointCorrelation(pair, np.ones(len(pair))))


@pytest.mark.parametrize("force_noise", [0.0, 0.02])
def test_independent_points_scatter_as_they_say(force_noise: float) -> None:
    found = [_noise(seed, 1, force_noise=force_noise).blocks for seed in range(12)]
    degrees = np.mean([one.degrees for one in found])
    # Two for each of four times eight blocks, if all said as much; those beside the contact say
    # more.
    assert 15 < degrees < 64
    # Three standard errors of the mean of twelve.
    expected = pytest.approx(1.0, abs=3 * np.sqrt(2 / (12 * degrees)))
    assert np.mean([one.ratio for one in found]) == expected


def test_clumps_have_the_factor_of_their_size() -> None:
    found = [_noise(seed, 3) for seed in range(8)]
    # Nine points share one value: variance nine times; clumps cut by blocks count for less.
    assert 6 < np.median([one.excess for one in found]) < 10
    assert all(one.sharing == 0.0 for one in found)


def test_what_is_known_of_clumps_is_no_excess() -> None:
    """Where it is known which points share their noise, blocks show no more than that."""
    found = [_noise(seed, 3, known=True) for seed in range(8)]
    # Chance, and Student weights, which clumps of large values lower together.
    assert 0.8 < np.median([one.blocks.ratio for one in found]) < 1.2
    assert np.mean([one.sharing for one in found]) == pytest.approx(1.0, abs=0.1)


def test_known_neighbours_that_are_independent_share_nothing() -> None:
    rng, found = np.random.default_rng(3), []
    for _ in range(8):
        probe = half_space_probes(rng, count=1, grid=24, noise=3e-5)[0]
        known = _clumped(probe, 3, rng, known=True).correlation
        misfit = misfit_of([replace(probe, correlation=known)])
        found.append(scores_of(misfit, minimum_of(misfit).probes)[1].sharing)
    # Some 2000 pairs of three components: 1.3 %, never below zero.
    assert max(found) < 0.05


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


def _found(one: LocalProbe) -> Scatter:
    projection = np.vstack([np.eye(2), np.zeros((3, 2))])
    return block_scatter([one], [projection], score_variance=1.0, sharing=0.0)


def test_errors_that_agree_over_a_part_of_the_surface_are_covered() -> None:
    """A single probing, its errors alike within a seventh of the width."""
    held = 0
    for seed in range(60):
        rng = np.random.default_rng([7, seed])
        probe = half_space_probes(rng, count=1, grid=12)[0]
        apart = ((probe.position[:, None] - probe.position[None]) ** 2).sum(axis=2)
        root = np.linalg.cholesky(np.exp(-apart / (2 * 0.008**2)) + 1e-6 * np.eye(len(apart)))
        noise = 3e-5 * root @ rng.normal(size=probe.displacement.shape)
        one = replace(probe, displacement=probe.displacement + noise, std=np.full_like(noise, 3e-5))
        found = uncertainty_at([one])
        error = found.minimum.poisson_ratio - 0.3
        held += abs(error) < found.variance("poisson_ratio").quantile * found.error("poisson_ratio")
    # 93 % by simulation; three standard errors of 60 draws. As independent points 64 %.
    assert held / 60 > 0.83


def test_few_points_say_nothing() -> None:
    """Fewer than eight blocks of six points."""
    alike = 5.0 * np.ones(3 * 256)
    assert _found(_one_probing(47, alike)) == NO_SCATTER
    assert _found(_one_probing(48, alike)).ratio > 5


def test_the_mean_factor_is_one_for_independent_points() -> None:
    """The square form has its expectation, leverage of the fit included."""
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
    ratios, degrees = np.array([found.ratio for found in drawn]), drawn[0].degrees
    # Nine times chi-square over its degrees: three standard errors of 300 draws.
    assert ratios.mean() == pytest.approx(9.0, rel=3 * np.sqrt(2 / degrees / 300))
    # The same for its spread.
    assert ratios.std() == pytest.approx(9.0 * np.sqrt(2 / degrees), rel=0.2)


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
    assert found.ratio == pytest.approx(expected.ratio, rel=1e-9)
    assert found.degrees == pytest.approx(expected.degrees, rel=1e-9)
