"""What neighbouring points share: nothing for independent points, the right factor for clumps."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, problem_of
from estimation.half_space import half_space_probes

from palpate.estimation import ProbeObservations, fit
from palpate.estimation.correlation import _neighbours_sharing, _scores
from palpate.records import PointCorrelation


def _clumped(seed: int, clump: int, *, known: bool = False) -> list[ProbeObservations]:
    """Squares of clump x clump points share one noise vector."""
    rng, probes = np.random.default_rng(seed), []
    for probe in half_space_probes(rng, count=4, grid=24):
        cell = np.floor((probe.position[:, :2] + 0.031) / (clump * 0.06 / 23)).astype(int)
        noise = rng.normal(size=(40, 40, 3))[cell[:, 0], cell[:, 1]]
        moved = probe.displacement + 3e-5 * noise
        probe = replace(probe, displacement=moved, std=np.full_like(moved, 3e-5))
        if known:
            pair = np.argwhere(np.triu((cell[:, None] == cell[None]).all(axis=2), 1))
            probe = replace(probe, correlation=PointCorrelation(pair, np.ones(len(pair))))
        probes.append(probe)
    return probes


def _factor(probes: list[ProbeObservations]) -> float:
    """Variance of nu over that of as many independent points."""
    alone = fit(_clumped(0, 1)).estimate.poisson_ratio.std
    return float((fit(probes).estimate.poisson_ratio.std / alone) ** 2)


@pytest.mark.slow
def test_independent_points_count_one_by_one() -> None:
    factors = [_factor(_clumped(seed, 1)) for seed in range(1, 7)]
    # Never below 1, and the scatter of 64 blocks is known to a fifth.
    assert np.mean(factors) == pytest.approx(1.0, abs=0.2)


@pytest.mark.slow
def test_clumps_have_the_factor_of_their_size() -> None:
    factors = [_factor(_clumped(seed, 3)) for seed in range(1, 7)]
    # Nine points share one value; clumps cut by blocks count for less.
    assert 5 < np.median(factors) < 11


@pytest.mark.slow
def test_correlation_that_is_known_is_not_counted_twice() -> None:
    factors = [_factor(_clumped(seed, 3, known=True)) for seed in range(1, 5)]
    assert 5 < np.median(factors) < 12


def test_pictures_at_rest_that_probings_share_do_not_average_out() -> None:
    """Half of the noise is common to all: the variance of the mean is not a fourth of one's."""
    probes = _clumped(1, 1)
    same = [replace(p, position=probes[0].position, response=probes[0].response,
                    displacement=probes[0].displacement, std=probes[0].std, force=probes[0].force,
                    name=f"p{k}") for k, p in enumerate(probes)]  # fmt: skip
    apart = fit(same).estimate.poisson_ratio.std
    shared = fit([replace(p, reference="rest") for p in same]).estimate.poisson_ratio.std
    # One of four independent ones, plus half of one that all share: (1/2 + 1/2 * 4) / 1.
    assert (shared / apart) ** 2 == pytest.approx(2.5, rel=0.15)


def test_what_neighbours_share_is_their_scores_product_over_the_expected() -> None:
    """Each pair once and its reverse, three components, by the formula."""
    (probe, *_) = _clumped(1, 3, known=True)
    pair = np.array([[0, 1], [2, 9]])
    few = replace(probe, correlation=PointCorrelation(pair, np.array([0.5, 0.8])))
    at = minimum_of(problem_of([few]))
    (score,) = _scores(at)
    first, second = score.reshape(-1, 3)[pair.T]
    observed = 2.0 * np.array([0.5, 0.8]) @ (first * second).sum(axis=1)
    expected = 6.0 * at.moments().power * (0.5**2 + 0.8**2)
    assert 0.0 < observed < expected
    assert _neighbours_sharing(at) == pytest.approx(observed / expected, rel=1e-9)
