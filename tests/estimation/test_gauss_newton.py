"""The search: every step lowers the objective, and its end is what a general optimiser finds."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, problem_of
from estimation.half_space import Cantilever, half_space_probes
from scipy.optimize import minimize

from palpate.estimation import (
    ProbeObservations,
    fit,
)
from palpate.estimation.gauss_newton import _neighbours_sharing, _scores, fitted, gauss_newton
from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import StudentT
from palpate.estimation.normal_equations import Evaluation
from palpate.pipeline.model.shared_errors import force_gain
from palpate.pipeline.observations import model_step
from palpate.records import PointCorrelation


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    given = {"count": 3, "grid": 6, "noise": 1e-4, "force_noise": 0.05} | options
    return half_space_probes(np.random.default_rng(seed), **given)


def test_every_step_lowers_the_objective() -> None:
    probes = [replace(p, nuisances=(force_gain(0.05),)) for p in _probes()]
    wild = probes[0].displacement.copy()
    wild[::7] += 2e-3
    problem = problem_of([replace(probes[0], displacement=wild), *probes[1:]], "student-t")
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.05, np.log(9e4)
    values = []
    for _ in range(15):
        minimum = gauss_newton(problem.expanded(theta[0]), theta, poisson_range=RANGE, steps=1)
        start = problem.expanded(theta[0])
        values.append((Evaluation(start, theta).value, minimum.value))
        theta = minimum.theta
    # The model is expanded anew where nu moves, by 1e-6 of the residuals at most.
    assert all(after <= before * (1 + 1e-5) for before, after in values)
    assert values[-1][1] == pytest.approx(minimum_of(problem).value, rel=1e-6)


def test_steps_lower_the_objective_where_an_error_of_the_model_changes_with_nu() -> None:
    """The expansion leaves that out, and a beam tells nothing else of nu."""
    x = np.linspace(0.02, 0.1, 6)
    beam, force = Cantilever(np.column_stack([x, 0 * x, 0 * x])), np.array([0.0, 0.0, -0.3])
    turned = np.zeros((18, 1, 4))
    turned[2::3, 0, 2] = x / x[-1] * np.abs(beam.value(0.2)).max()
    moved = ((beam.value(0.2) + 0.1 * turned[:, 0])[:, :3] @ force / 2e4).reshape(-1, 3)
    error = model_step(
        "mesh", 1.0, lambda nu: 0 * turned, lambda nu: (0.1 - 0.3 * (nu - 0.2)) * turned
    )
    probe = replace(
        _probes()[0], position=beam.position, displacement=moved, force=force, response=beam,
        std=np.full((6, 3), 1e-3 * np.abs(moved).max()), force_std=np.zeros(3), nuisances=(error,),
    )  # fmt: skip
    problem = problem_of([probe]).expanded(0.3)
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.3, np.log(2e4)
    at = Evaluation(problem, theta)
    for _ in range(15):
        minimum = gauss_newton(at.problem, at.theta, poisson_range=RANGE, steps=1)
        assert minimum.value <= at.value
        at = minimum
    assert gauss_newton(at.problem, at.theta, poisson_range=RANGE).converged


def test_the_minimum_is_that_of_a_general_optimiser() -> None:
    probes = [replace(p, nuisances=(force_gain(0.05),)) for p in _probes()]
    minimum = minimum_of(problem_of(probes, "student-t"))
    problem = minimum.problem

    def objective(theta: np.ndarray) -> float:
        return Evaluation(problem, theta).value

    free = minimize(objective, minimum.theta + 0.01, method="BFGS", options={"gtol": 1e-6})
    assert minimum.converged
    assert minimum.value == pytest.approx(free.fun, abs=1e-6)
    # A flat bottom: the root of the objective's accuracy.
    np.testing.assert_allclose(minimum.theta, free.x, atol=2e-3)


def test_what_is_fixed_stays() -> None:
    problem = problem_of(_probes())
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.2, np.log(3e4)
    held = gauss_newton(problem, theta, fixed=(0, 1), poisson_range=RANGE)
    assert held.theta[:2].tolist() == theta[:2].tolist()
    along = gauss_newton(problem, theta, fixed=(0,), poisson_range=RANGE)
    assert along.theta[0] == 0.2
    best = minimum_of(problem)
    assert best.value < along.value < held.value


def test_the_range_of_nu_is_kept() -> None:
    problem = problem_of(_probes(poisson_ratio=0.45, noise=1e-6))
    minimum = minimum_of(problem, (0.0, 0.3))
    assert minimum.poisson_ratio == 0.3
    # The modulus follows: no step along it lowers the objective.
    assert abs(minimum.normal.gradient[1]) < 1e-4 * np.sqrt(minimum.normal.common[1, 1])


def test_noise_that_nobody_told_is_found() -> None:
    probes = [replace(p, std=None) for p in _probes(count=6, grid=14, noise=4e-5)]
    minimum = fitted(tuple(map(observed_rows_of, probes)), StudentT(), RANGE)
    # 1000 values a component: the median of their squares is known to 7 %.
    np.testing.assert_allclose(minimum.problem.level[:3], 4e-5, rtol=0.1)
    assert minimum.problem.scale == 1.0


def _stepped(probe: ProbeObservations, share: float) -> ProbeObservations:
    """With an error of the model that is a share of what moves, of the same shape."""
    step = model_step(
        "mesh", share,
        lambda nu: probe.response.value(nu)[:, None],
        lambda nu: 2.0 * probe.response.value(nu)[:, None],
    )  # fmt: skip
    return replace(probe, nuisances=(step,), std=None)


def test_exact_data_do_not_claim_to_be_better_than_the_model() -> None:
    """No noise, no std: noise levels fall to nothing, and the model's own error keeps its say."""
    probes = [_stepped(p, 0.01) for p in _probes(noise=0.0, grid=10, force_noise=0.0)]
    minimum = fitted(tuple(map(observed_rows_of, probes)), StudentT(), RANGE)
    for variance, probe in zip(minimum.problem.variance(), probes, strict=True):
        moved = np.linalg.norm(probe.displacement, axis=1).min()
        # At least the share that varies from point to point.
        assert np.sqrt(variance.min()) > np.sqrt(0.3 / 3) * 0.01 * moved
    assert minimum.problem.scale == 1.0


def test_a_larger_error_of_the_model_is_seen_in_the_residuals() -> None:
    """A smooth error five times as large as the comparison says."""
    wrong = []
    for probe in _probes(noise=0.0, grid=14, force_noise=0.0, count=4):
        wave = np.sin(150.0 * probe.position[:, :1] + [0.0, 1.0, 2.0])
        size = np.linalg.norm(probe.displacement, axis=1, keepdims=True) / np.sqrt(3.0)
        off = replace(probe, displacement=probe.displacement + 0.05 * np.sqrt(2.0) * size * wave)
        wrong.append(_stepped(off, 0.01))
    minimum = fitted(tuple(map(observed_rows_of, wrong)), StudentT(), RANGE)
    # The largest among neighbours is taken, and one wave is not what the process expects.
    assert 2.0 < minimum.problem.scale < 10.0


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
