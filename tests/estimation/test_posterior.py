"""The posterior: against dense linear algebra, brute force, and its laws."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, dense_information, minimum_of, problem_of
from estimation.half_space import Cantilever, half_space_probes, surface_grid

from palpate.estimation import (
    ProbeObservations,
    fit,
)
from palpate.estimation.gauss_newton import gauss_newton
from palpate.estimation.posterior import (
    POINTS,
    Profile,
    directions,
    interval_set,
    posterior_of,
    profile_of,
    reported_intervals,
    uncertainty_budget,
)
from palpate.pipeline.model.shared_errors import force_direction, force_gain, length_scale
from palpate.pipeline.observations import model_step

EVERY = {"poisson_ratio": True, "shear_modulus": True, "young_modulus": True}


def _probes(**options: object) -> list[ProbeObservations]:
    given = {"count": 3, "grid": 7, "noise": 5e-5, "force_noise": 0.02} | options
    probes = []
    for probe in half_space_probes(np.random.default_rng(4), **given):
        value = probe.response.value
        step = model_step(
            "mesh", 0.01, lambda nu, v=value: v(nu)[:, None],
            lambda nu, v=value: (2.0 + nu) * v(nu)[:, None],
        )  # fmt: skip
        kinds = (force_gain(0.03), force_direction(0.01), length_scale(0.004), step)
        probes.append(replace(probe, nuisances=kinds))
    return probes


@pytest.fixture(scope="module")
def minimum():
    return minimum_of(problem_of(_probes()))


def test_eliminating_blocks_is_inverting_the_whole(minimum) -> None:
    whole = np.linalg.inv(dense_information(minimum))
    d = minimum.problem.layout.common
    np.testing.assert_allclose(minimum.normal.covariance, whole[:d, :d], rtol=1e-6)
    np.testing.assert_allclose(minimum.normal.std, np.sqrt(np.diag(whole)), rtol=1e-6)
    direction = np.array([0.7, -1.2])
    np.testing.assert_allclose(
        minimum.normal.covariance_with(direction),
        whole[:, :2] @ direction,
        atol=1e-6 * np.abs(whole[:, :2] @ direction).max(),
    )


@pytest.mark.parametrize("noise", [1e-8, 5e-5, 5e-3])
def test_no_posterior_is_wider_than_its_prior(noise: float) -> None:
    estimate = fit(_probes(noise=noise)).estimate
    every = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    assert len(every) >= 8
    # Equal where the data say nothing: rounding of an inverse.
    assert max(error.std / error.prior_std for error in every) < 1.0 + 1e-6


def test_the_budget_is_all_of_the_variance(minimum) -> None:
    posterior = posterior_of(minimum, RANGE, np.inf)
    entries = uncertainty_budget(posterior, EVERY)
    for name in EVERY:
        total = sum(getattr(entry, name) ** 2 for entry in entries)
        assert np.sqrt(total) == pytest.approx(posterior.error(name), rel=1e-9)
    by_source = {entry.source: entry for entry in entries}
    # A gain moves both moduli by itself, and hardly nu.
    assert by_source["gain of the force sensor"].young_modulus == pytest.approx(0.03, rel=0.05)
    assert by_source["gain of the force sensor"].poisson_ratio < 1e-3
    assert {POINTS, "measured forces", "scale of lengths", "mesh"} <= set(by_source)


def test_the_noise_s_part_of_the_budget_is_the_propagated_noise(minimum) -> None:
    """Variance of the estimate over draws of noise alone, to first order: C J' W J C."""
    information = dense_information(minimum)
    whole = np.linalg.inv(information)
    prior = np.diag(minimum.problem.precision())
    propagated = whole @ (information - prior) @ whole
    entries = uncertainty_budget(posterior_of(minimum, RANGE, np.inf), EVERY)
    noise = next(entry for entry in entries if entry.source == POINTS)
    for name, direction in directions(minimum.poisson_ratio).items():
        expected = np.sqrt(direction @ propagated[:2, :2] @ direction)
        assert getattr(noise, name) == pytest.approx(expected, rel=1e-5)


def test_the_profile_is_a_search_with_the_constants_held() -> None:
    minimum = minimum_of(problem_of(_probes(force_noise=0.0)))
    error = posterior_of(minimum, RANGE, np.inf).error
    ends = tuple(minimum.poisson_ratio + 2.0 * error("poisson_ratio") * np.array([-1, 1]))
    profile = profile_of(minimum, ends)
    for nu_steps, modulus_steps in ((-1.0, 0.0), (1.0, 1.0), (0.0, -1.0)):
        nu = minimum.poisson_ratio + nu_steps * error("poisson_ratio")
        modulus = minimum.shear_modulus * np.exp(modulus_steps * error("shear_modulus"))
        theta = minimum.theta.copy()
        theta[:2] = nu, np.log(modulus)
        held = gauss_newton(minimum.problem, theta, fixed=(0, 1), poisson_range=RANGE)
        at = int(np.abs(profile.poisson_ratio - nu).argmin())
        deviance = profile.deviance(np.array([modulus]))[at, 0]
        # Effects of errors are those at the minimum, whose own change is left out.
        assert deviance == pytest.approx(held.value - minimum.value, rel=0.15, abs=0.02)


def test_a_modulus_is_never_negative() -> None:
    """Where displacements point against the load, the best is no displacement at all."""
    a, b, c = np.array([[2.0, 2.0], [-1.0, -5.0], [9.0, 9.0]])
    profile = Profile(np.array([0.1, 0.2]), a, b, c, 1e4)
    # At z = b / a, and at z = -1, where G is infinite.
    np.testing.assert_allclose(profile.lowest, [9.0 - 0.5, 2.0 - 10.0 + 9.0])


def test_intervals_are_those_of_a_normal_distribution_where_all_is_linear() -> None:
    minimum = minimum_of(problem_of(_probes(noise=2e-6)))
    posterior = posterior_of(minimum, RANGE, np.inf)
    intervals = interval_set(posterior)
    low, high = intervals.poisson_ratio.ci95
    assert (high - low) / 2 == pytest.approx(1.96 * posterior.error("poisson_ratio"), rel=0.01)
    for name in ("shear_modulus", "young_modulus"):
        low, high = getattr(intervals, name).ci95
        # The gain's 3 % is no small error: the ends of a modulus are those of its inverse.
        half = 0.5 * (1 / low - 1 / high) * getattr(intervals, name).value
        assert half == pytest.approx(1.96 * posterior.error(name), rel=0.02)
    few = posterior_of(minimum, RANGE, 3.0)
    assert few.quantile == pytest.approx(3.182, abs=1e-3)


def test_at_the_end_of_the_range_an_interval_is_cut() -> None:
    minimum = minimum_of(problem_of(_probes(poisson_ratio=0.0, noise=2e-5)))
    low, high = interval_set(posterior_of(minimum, RANGE, np.inf)).poisson_ratio.ci95
    assert low == 0.0
    assert 0.0 < high < 0.1


def test_what_is_known_does_not_depend_on_where_the_range_lies() -> None:
    """An interval is judged by its share of the range, which may begin below zero."""
    minimum = minimum_of(problem_of(_probes(poisson_ratio=0.1, noise=2e-5)))
    for ends in ((-0.45, 0.45), (-0.3, 0.45), (0.0, 0.45)):
        assert posterior_of(minimum, ends, np.inf).determines_ratio, ends


def _beam() -> ProbeObservations:
    points = surface_grid(8, 0.04) + np.array([0.05, 0.0, 0.0])
    response = Cantilever(points)
    force = np.array([0.0, 0.0, -0.5])
    moved = (response.value(0.3)[:, :3] @ force / 2e4).reshape(-1, 3)
    noise = 1e-3 * np.random.default_rng(1).normal(size=moved.shape) * np.abs(moved).max()
    return ProbeObservations(
        "beam", points, moved + noise, np.full_like(moved, 1e-3 * np.abs(moved).max()), force,
        np.zeros(3), None, None, response,
    )  # fmt: skip


def test_bending_tells_young_s_modulus_alone() -> None:
    estimate = fit([_beam()]).estimate
    assert estimate.identifiable == {
        "poisson_ratio": False, "shear_modulus": False, "young_modulus": True
    }  # fmt: skip
    assert estimate.young_modulus.value == pytest.approx(5.2e4, rel=0.01)
    assert estimate.poisson_ratio.ci95 == RANGE
    # G = E / 2 (1 + nu) over the whole range.
    low, high = estimate.shear_modulus.ci95
    assert high / low == pytest.approx(1.5, rel=0.02)
    assert any("What the data determine is E = 2 G (1 + nu)" in note for note in estimate.notes)
    assert estimate.budget == ()


def test_an_interval_as_wide_as_a_factor_of_two_is_no_measurement() -> None:
    """A gain that nobody knows to 34 %: nu is determined, the moduli are not."""
    probes = [replace(p, nuisances=(force_gain(0.34),)) for p in _probes(noise=1e-6)]
    estimate = fit(probes).estimate
    assert not estimate.identifiable["young_modulus"]
    assert not estimate.identifiable["shear_modulus"]
    assert estimate.identifiable["poisson_ratio"]
    assert estimate.status == "shear_modulus_and_young_modulus_not_identifiable"
    minimum = minimum_of(problem_of(probes))
    assert reported_intervals(posterior_of(minimum, RANGE, np.inf))[1] == estimate.identifiable
