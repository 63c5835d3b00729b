"""The search: every step lowers the objective, and its end is what a general optimiser finds."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, problem_of
from estimation.half_space import half_space_probes
from scipy.optimize import minimize

from palpate.estimation import (
    ProbeObservations,
)
from palpate.estimation.gauss_newton import fitted, gauss_newton
from palpate.estimation.noise import StudentT
from palpate.estimation.normal_equations import Evaluation
from palpate.estimation.observed_rows import observed_rows_of
from palpate.pipeline.model.measurement_errors import force_gain
from palpate.pipeline.observations.converged_observations import model_step


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
        found = gauss_newton(problem.expanded(theta[0]), theta, poisson_range=RANGE, steps=1)
        start = problem.expanded(theta[0])
        values.append((Evaluation(start, theta).value, found.value))
        theta = found.theta
    # The model is expanded anew where nu moves, by 1e-6 of the residuals at most.
    assert all(after <= before * (1 + 1e-5) for before, after in values)
    assert values[-1][1] == pytest.approx(minimum_of(problem).value, rel=1e-6)


def test_the_minimum_is_that_of_a_general_optimiser() -> None:
    probes = [replace(p, nuisances=(force_gain(0.05),)) for p in _probes()]
    found = minimum_of(problem_of(probes, "student-t"))
    problem = found.problem

    def objective(theta: np.ndarray) -> float:
        return Evaluation(problem, theta).value

    free = minimize(objective, found.theta + 0.01, method="BFGS", options={"gtol": 1e-6})
    assert found.converged
    assert found.value == pytest.approx(free.fun, abs=1e-6)
    # A flat bottom: the root of the objective's accuracy.
    np.testing.assert_allclose(found.theta, free.x, atol=2e-3)


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
    found = minimum_of(problem, (0.0, 0.3))
    assert found.poisson_ratio == 0.3
    # The modulus follows: no step along it lowers the objective.
    assert abs(found.normal.gradient[1]) < 1e-4 * np.sqrt(found.normal.common[1, 1])


def test_noise_that_nobody_told_is_found() -> None:
    probes = [replace(p, std=None) for p in _probes(count=6, grid=14, noise=4e-5)]
    found = fitted(tuple(map(observed_rows_of, probes)), StudentT(), RANGE)
    # 1000 values a component: the median of their squares is known to 7 %.
    np.testing.assert_allclose(found.problem.level[:3], 4e-5, rtol=0.1)
    assert found.problem.scale == 1.0


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
    found = fitted(tuple(map(observed_rows_of, probes)), StudentT(), RANGE)
    for variance, probe in zip(found.problem.variance(), probes, strict=True):
        moved = np.linalg.norm(probe.displacement, axis=1).min()
        # At least the share that varies from point to point.
        assert np.sqrt(variance.min()) > np.sqrt(0.3 / 3) * 0.01 * moved
    assert found.problem.scale == 1.0


def test_a_larger_error_of_the_model_is_seen_in_the_residuals() -> None:
    """A smooth error five times as large as the comparison says."""
    wrong = []
    for probe in _probes(noise=0.0, grid=14, force_noise=0.0, count=4):
        wave = np.sin(150.0 * probe.position[:, :1] + [0.0, 1.0, 2.0])
        size = np.linalg.norm(probe.displacement, axis=1, keepdims=True) / np.sqrt(3.0)
        off = replace(probe, displacement=probe.displacement + 0.05 * np.sqrt(2.0) * size * wave)
        wrong.append(_stepped(off, 0.01))
    found = fitted(tuple(map(observed_rows_of, wrong)), StudentT(), RANGE)
    # The largest among neighbours is taken, and one wave is not what the process expects.
    assert 2.0 < found.problem.scale < 10.0
