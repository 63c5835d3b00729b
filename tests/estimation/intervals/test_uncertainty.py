"""Intervals: coverage, correlation, disagreement, bounds, and what is not identifiable."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from estimation.fitted import RANGE, uncertainty_at
from estimation.half_space import Cantilever, HalfSpace, half_space_probes, surface_grid
from scipy.stats import t

from palpate.estimation import IntervalSet, ProbeObservations, cramer_rao_bound, fit
from palpate.estimation.intervals.sandwich import Scatter, directions
from palpate.estimation.intervals.uncertainty import Uncertainty, interval_set
from palpate.records import Status


def _repeats(repeats: int, **options: object) -> list[IntervalSet]:
    found = []
    for seed in range(repeats):
        rng = np.random.default_rng([7, seed])
        found.append(fit(half_space_probes(rng, **options)).intervals)
    return found


def _covered(found: list[IntervalSet], name: str, truth: float) -> float:
    ends = [getattr(one, name).ci95 for one in found]
    return float(np.mean([low <= truth <= high for low, high in ends]))


@pytest.mark.parametrize(("count", "grid"), [(1, 8), (3, 5)])
def test_intervals_cover_and_errors_reach_the_bound(count: int, grid: int) -> None:
    found = _repeats(50, count=count, grid=grid, noise=5e-5, force_noise=0.01)
    for name, truth in (("poisson_ratio", 0.3), ("shear_modulus", 2e4), ("young_modulus", 5.2e4)):
        # 95 % of 50: three standard deviations of a share are 9.2 %.
        assert _covered(found, name, truth) > 0.857, name
    error = np.array([one.poisson_ratio.value - 0.3 for one in found])
    claimed = np.array([one.poisson_ratio.std for one in found])
    pull = np.sqrt(np.mean((error / claimed) ** 2))
    # One with 10 % statistical error; much less means needlessly wide intervals.
    assert 0.72 < pull < 1.3


def test_bound_is_reached_by_claims() -> None:
    ratios = []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        probes = half_space_probes(rng, count=5, noise=5e-5, force_noise=0.01)
        bound = cramer_rao_bound(probes, poisson_ratio=0.3, shear_modulus=2e4)
        sets = fit(probes).intervals
        ratios.append([getattr(sets, name).std / limit for name, limit in bound.items()])
    # Student's t with 8 degrees loses 2 %. Claim and scatter of five probings know a variance with
    # five degrees, its mean over 15 sessions to 16 %.
    np.testing.assert_allclose(np.mean(np.square(ratios), axis=0), 1.0, atol=0.5)
    # All five agree perfectly: what is left is the claim's fifth.
    assert np.min(ratios) > np.sqrt(1 / 5)


def _correlated(probe: ProbeObservations, rng: np.random.Generator) -> ProbeObservations:
    gap = ((probe.position[:, None] - probe.position[None]) ** 2).sum(-1)
    root = np.linalg.cholesky(np.exp(-gap / (2 * 0.006**2)) + 1e-6 * np.eye(len(gap)))
    noise = root @ rng.normal(size=probe.displacement.shape)
    return replace(
        probe, displacement=probe.displacement + 5e-5 * noise, std=np.full_like(noise, 5e-5)
    )


def test_correlated_residuals_widen_the_interval() -> None:
    covered, widened = 0, []
    for seed in range(16):
        rng = np.random.default_rng([3, seed])
        probes = [_correlated(p, rng) for p in half_space_probes(rng, count=1, grid=12)]
        found = fit(probes).estimate
        bound = cramer_rao_bound(probes, poisson_ratio=0.3, shear_modulus=2e4)
        widened.append(found.poisson_ratio.std / bound["poisson_ratio"])
        covered += found.poisson_ratio.ci95[0] <= 0.3 <= found.poisson_ratio.ci95[1]
    # Points 4.6 mm apart with a correlation length of 6 mm: about five share one value.
    assert np.median(widened) > 1.5
    # Independent intervals cover about 65 %; 16 repeats leave 5.4 % of standard error.
    assert covered / 16 > 0.78


def test_probings_that_disagree_widen_the_interval() -> None:
    rng = np.random.default_rng(5)
    probes = half_space_probes(rng, count=10, noise=3e-5)
    off = [replace(p, force=p.force * (1 + 0.05 * rng.normal())) for p in probes]
    calm, torn = fit(probes).estimate, fit(off).estimate
    # 5 % a probing, ten of them: 1.6 %.
    assert 0.008 < torn.shear_modulus.std / torn.shear_modulus.value < 0.04
    assert torn.shear_modulus.std > 2 * calm.shear_modulus.std
    assert any("The probings disagree about" in note for note in torn.notes)
    assert calm.notes == ()


def _beam(rng: np.random.Generator, noise: float) -> list[ProbeObservations]:
    position = np.array(
        [[x, y, z] for x in (0.06, 0.08, 0.1) for y in (-5e-3, 5e-3) for z in (0.0,)]
    )
    response = Cantilever(position)
    probes = []
    for k, size in enumerate((-0.1, -0.2)):
        force = np.array([0.0, 0.0, size])
        moved = (response.value(0.4)[:, :3] @ force / 9e4).reshape(-1, 3)
        moved = moved + noise * rng.normal(size=moved.shape)
        std = np.full_like(moved, noise)
        probes.append(
            ProbeObservations(
                f"b{k}", position, moved, std, force, np.zeros(3), None, None, response
            )
        )
    return probes


def test_bent_beam_tells_only_young_modulus() -> None:
    estimate = fit(_beam(np.random.default_rng(1), 2e-5)).estimate
    assert estimate.identifiable == {
        "poisson_ratio": False,
        "shear_modulus": False,
        "young_modulus": True,
    }
    assert estimate.status is Status.SHEAR_MODULUS_AND_POISSON_RATIO_NOT_IDENTIFIABLE
    assert estimate.poisson_ratio.ci95 == (0.0, 0.4999)
    # The middle of the range, not an accident of the noise.
    assert estimate.poisson_ratio.value == pytest.approx(0.24995)
    assert estimate.young_modulus.value == pytest.approx(
        2 * estimate.shear_modulus.value * 1.24995, rel=1e-9
    )
    young = estimate.young_modulus
    truth = 2 * 9e4 * 1.4
    assert young.ci95[0] < truth < young.ci95[1]
    assert (young.ci95[1] - young.ci95[0]) / truth < 0.02
    low, high = estimate.shear_modulus.ci95
    # E / (2 (1 + nu)) over all nu.
    np.testing.assert_allclose([low, high], [truth / 2.9998, truth / 2], rtol=0.02)
    assert any("E = 2 G (1 + nu)" in note for note in estimate.notes)
    single = estimate.probes[0]
    assert single.poisson_ratio.ci95 == (0.0, 0.4999)


def test_normal_displacement_of_a_half_space_tells_one_combination() -> None:
    points = surface_grid(10, 0.03) + np.array([1e-3, 2e-3, 0.0])
    response = HalfSpace(points)
    force = np.array([0.0, 0.0, -0.8])
    moved = (response.value(0.3)[:, :3] @ force / 2e4).reshape(-1, 3)
    moved += 1e-5 * np.random.default_rng(1).normal(size=moved.shape)
    moved[:, :2] = np.nan
    probe = ProbeObservations(
        "n", points, moved, np.full_like(moved, 1e-5), force, np.zeros(3), None, None, response
    )
    estimate = fit([probe]).estimate
    assert not any(estimate.identifiable.values())
    assert estimate.status is Status.NOTHING_IDENTIFIABLE
    assert any("G / (1 - nu)" in note for note in estimate.notes)
    # All that nu may be: G = (1 - nu) 2e4 / 0.7.
    np.testing.assert_allclose(
        estimate.shear_modulus.ci95, [0.5001 / 0.7 * 2e4, 2e4 / 0.7], rtol=0.03
    )


def test_no_signal_is_said() -> None:
    probes = half_space_probes(np.random.default_rng(1), count=2, noise=1.0)
    estimate = fit(probes).estimate
    assert estimate.status is Status.NOTHING_IDENTIFIABLE
    assert estimate.shear_modulus.ci95 == (0.0, np.inf)


@pytest.mark.parametrize("truth", [0.0, 0.4999])
def test_intervals_at_the_ends_of_the_range(truth: float) -> None:
    found = _repeats(40, count=1, grid=7, noise=1e-4, poisson_ratio=truth)
    # A constrained estimate is at the bound half the time; its interval must not lose the truth.
    # 95 % of 40: three standard deviations of a share are 10 %.
    assert _covered(found, "poisson_ratio", truth) > 0.84
    assert _covered(found, "shear_modulus", 2e4) > 0.84
    at_bound = [one.poisson_ratio for one in found]
    assert 0.2 < np.mean([c.value == truth for c in at_bound]) < 0.8
    assert all(0.0 <= c.ci95[0] < c.ci95[1] <= 0.4999 for c in at_bound)


def _uncertainty(noise: float = 5e-5, **options: object) -> Uncertainty:
    """Of probings that agree with their claims and with each other."""
    probes = half_space_probes(np.random.default_rng(4), count=3, grid=6, noise=noise, **options)
    found = uncertainty_at(probes)
    assert found.noise.degrees == found.noise.blocks.total_degrees == np.inf
    return replace(found, scatters=dict.fromkeys(found.scatters, Scatter(1.0, 2.0)))


def test_a_narrow_interval_is_the_quantile_times_the_error() -> None:
    """Symmetric in nu and in the logarithms of the moduli."""
    uncertainty = _uncertainty(1e-6)
    found = interval_set(uncertainty)
    # As many degrees as the claim and two of the scatter; its factor is 1.
    quantile = t.ppf(0.975, 3.0)
    centre = uncertainty.minimum
    for name, direction in directions(centre.poisson_ratio).items():
        error = float(np.sqrt(direction @ uncertainty.scores.covariance() @ direction))
        constant = getattr(found, name)
        low, high = constant.ci95
        if name == "poisson_ratio":
            expected = constant.value + quantile * error * np.array([-1, 1])
        else:
            expected = constant.value * np.exp(quantile * error * np.array([-1, 1]))
        # The same products in another order.
        np.testing.assert_allclose((low, high), expected, rtol=1e-9)
        assert constant.std == pytest.approx((high - low) / (2 * quantile), rel=1e-9)
    young = 2 * centre.shear_modulus * (1 + centre.poisson_ratio)
    assert found.young_modulus.value == pytest.approx(young, rel=1e-12)


def test_disagreement_raises_the_variance_of_its_constant_alone() -> None:
    calm = _uncertainty(1e-6)
    torn = replace(calm, scatters=dict(calm.scatters) | {"shear_modulus": Scatter(9.0, 4.0)})
    # Claim and scatter: one part of 1, four parts of 9.
    raised = torn.variance("shear_modulus").total / calm.variance("shear_modulus").total
    assert raised == pytest.approx(37 / 5, rel=1e-12)
    assert torn.calibration("shear_modulus") / calm.calibration("shear_modulus") == pytest.approx(
        raised, rel=1e-12
    )
    assert torn.variance("poisson_ratio") == calm.variance("poisson_ratio")
    wide, narrow = (interval_set(one).shear_modulus for one in (torn, calm))
    widened = np.log(wide.ci95[1] / wide.value) / np.log(narrow.ci95[1] / narrow.value)
    quantiles = t.ppf(0.975, 5.0) / t.ppf(0.975, 3.0)
    assert widened == pytest.approx(np.sqrt(raised) * quantiles, rel=1e-9)


def test_for_small_errors_far_from_bounds_the_interval_is_symmetric() -> None:
    small = _uncertainty(1e-6)
    error = small.error("poisson_ratio")
    assert error < 9e-4

    def is_symmetric(uncertainty: Uncertainty) -> bool:
        found = interval_set(uncertainty).poisson_ratio
        low, high = found.ci95
        # The profile is read off a grid: never symmetric to rounding.
        return abs(low + high - 2 * found.value) < 1e-12

    assert is_symmetric(small)
    # Eight errors from a bound is far; less is near.
    nu = small.minimum.poisson_ratio
    for room, same in ((8.1, True), (7.9, False)):
        for ends in ((nu - room * error, 0.4999), (0.0, nu + room * error)):
            near = replace(small, weights=replace(small.weights, poisson_range=ends))
            assert is_symmetric(near) is same
    # Errors from a thousandth on are profiled.
    for wanted, same in ((0.99e-3, True), (1.01e-3, False)):
        scaled = replace(small.scores, noise=small.scores.noise * (wanted / error) ** 2)
        assert is_symmetric(replace(small, scores=scaled)) is same


def test_the_profile_is_a_parabola_for_plenty_of_data() -> None:
    """At a standard error of 0.002, profiled: quantile times error, but for the skewness left."""
    probes = half_space_probes(np.random.default_rng(2), count=8, grid=20, noise=5e-5)
    found = uncertainty_at(probes)
    for name, constant in asdict(interval_set(found)).items():
        error = found.error(name) * (1.0 if name == "poisson_ratio" else constant["value"])
        expected = constant["value"] + found.variance(name).quantile * error * np.array([-1, 1])
        # Student's quantile for nine degrees reaches 2.3 errors: the skewness there.
        np.testing.assert_allclose(constant["ci95"], expected, atol=0.05 * error, err_msg=name)


def test_a_range_that_ends_cuts_the_interval() -> None:
    found = interval_set(_uncertainty(1e-4, poisson_ratio=0.02)).poisson_ratio
    assert found.ci95[0] == RANGE[0]
    assert found.ci95[0] < found.ci95[1] < RANGE[1]
