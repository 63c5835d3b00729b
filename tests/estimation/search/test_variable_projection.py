"""Variable projection against dense least squares and against differences."""

import numpy as np
import pytest
from estimation.fitted import RANGE, misfit_of
from estimation.half_space import half_space_probes
from hypothesis import given, settings, strategies as st

from palpate.estimation.responses.table import response_table
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.variable_projection import (
    FixedWeights,
    best_compliance,
    best_constants,
    deviance_of,
    fixed_weights,
    refined_minimum,
)

GRID = np.array([0.0, 0.1, 0.33, 0.4999])


@pytest.fixture(scope="module")
def problem() -> tuple[Misfit, list[np.ndarray], np.ndarray, FixedWeights]:
    """Three probings with uncertain forces and weights of all sizes."""
    rng = np.random.default_rng(5)
    misfit = misfit_of(half_space_probes(rng, count=3, grid=5, noise=1e-4, force_noise=0.05))
    weights = [rng.uniform(0.1, 1.4, len(probe.components)) for probe in misfit.probes]
    force_weights = np.array([0.4, 1.0, 1.3])
    table = response_table(misfit.probes, RANGE)
    return misfit, weights, force_weights, fixed_weights(
        misfit.probes, table, misfit.level, weights, force_weights
    )  # fmt: skip


def _dense(problem: tuple, nu: float, modulus: float, chosen: range = range(3)) -> float:
    """Weighted squares left by the best true forces, one stacked least-squares problem each."""
    misfit, weights, force_weights, _ = problem
    total = 0.0
    for k in chosen:
        probe = misfit.probes[k]
        response = probe.value(nu) / modulus
        root = np.sqrt(probe.per_row(weights[k])) / probe.unit
        left = probe.measured - response[:, :3] @ probe.observations.force - response[:, 3]
        matrix = np.vstack(
            [
                root[:, None] * response[:, :3] * probe.observations.force_std,
                np.sqrt(force_weights[k]) * np.eye(3),
            ]
        )
        right = np.concatenate([root * left, np.zeros(3)])
        total += float(np.linalg.lstsq(matrix, right, rcond=None)[1][0])
    return total


def test_the_deviance_is_that_of_dense_least_squares(problem: tuple) -> None:
    modulus = np.array([1e4, 2e4, 8e4])
    compliance = np.repeat(1 / modulus[:, None], len(GRID), axis=1)
    found, _, _ = deviance_of(problem[-1].at(GRID), compliance)
    expected = [[_dense(problem, nu, g) for nu in GRID] for g in modulus]
    # The response is linear in nu, so interpolation is exact: rounding, of large squares' sums.
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_some_probings_alone(problem: tuple) -> None:
    compliance = np.full(len(GRID), 5e-5)
    for chosen in ([1], [0, 2]):
        found, _, _ = deviance_of(problem[-1].subset(np.array(chosen)).at(GRID), compliance)
        expected = [_dense(problem, nu, 2e4, chosen) for nu in GRID]
        np.testing.assert_allclose(found, expected, rtol=1e-8)
    alone, _, _ = deviance_of(problem[-1].subset(1).at(GRID), compliance)
    np.testing.assert_allclose(alone, [_dense(problem, nu, 2e4, [1]) for nu in GRID], rtol=1e-8)


def test_derivatives_in_log_compliance(problem: tuple) -> None:
    probes, step = problem[-1].at(GRID), 1e-4
    for compliance in (1e-5, 4.8e-5, 2e-4):
        places = [np.full(len(GRID), compliance * np.exp(k * step)) for k in (-1, 0, 1)]
        low, here, high = (deviance_of(probes, place) for place in places)
        # Central differences: 1e-8 from the step, rounding of 1e-16 over its square.
        np.testing.assert_allclose(here[1], (high[0] - low[0]) / (2 * step), rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(here[2], (high[1] - low[1]) / (2 * step), rtol=1e-5, atol=1e-3)


def test_the_best_compliance_is_the_lowest(problem: tuple) -> None:
    probes = problem[-1].at(GRID)
    best, height = best_compliance(probes)
    value, first, second = deviance_of(probes, best)
    # Newton steps end at 1e-10.
    assert np.all(np.abs(first) < 1e-7 * second)
    np.testing.assert_array_equal(value, height)
    for factor in np.geomspace(0.1, 10, 40):
        assert np.all(deviance_of(probes, factor * best)[0] >= height)


def test_displacements_against_the_force_have_no_compliance() -> None:
    """Pulled where it was pushed: the best is none, and stays positive."""
    probes = half_space_probes(np.random.default_rng(1), count=1, grid=5, noise=1e-4)
    object.__setattr__(probes[0], "displacement", -probes[0].displacement)
    misfit = misfit_of(probes)
    weights = fixed_weights(
        misfit.probes, response_table(misfit.probes, RANGE), misfit.level,
        [np.ones_like(misfit.probes[0].components)], np.ones(1),
    )  # fmt: skip
    best, height = best_compliance(weights.at(GRID))
    assert np.all(best > 0)
    assert np.all(best < 1e-3 / 2e4)
    # With nothing predicted all that was measured is left.
    np.testing.assert_allclose(height, weights.measured_measured.sum(), rtol=1e-5)


def test_exact_data_give_their_constants() -> None:
    probes = half_space_probes(np.random.default_rng(1), count=2, grid=5, poisson_ratio=0.41)
    misfit = misfit_of(probes)
    weights = fixed_weights(
        misfit.probes, response_table(misfit.probes, RANGE), misfit.level,
        [np.ones_like(probe.components) for probe in misfit.probes], np.ones(2),
    )  # fmt: skip
    nu, modulus = best_constants(weights)
    # The third order of the valley over the grid's hundredth.
    assert nu == pytest.approx(0.41, abs=3e-4)
    assert modulus == pytest.approx(2e4, rel=1e-3)


@given(
    centre=st.floats(0.06, 0.94), bend=st.floats(0.01, 1e6), height=st.floats(-1e3, 1e3),
)  # fmt: skip
@settings(max_examples=50, deadline=None)
def test_a_parabola_is_sharpened_exactly(centre: float, bend: float, height: float) -> None:
    place = np.linspace(0, 1, 21)
    found = refined_minimum(place, height + bend * (place - centre) ** 2)
    # Differences of neighbouring heights: rounding of the height over the bend.
    assert found[0] == pytest.approx(centre, abs=1e-7 + 1e-11 * (abs(height) / bend))
    assert found[1] == pytest.approx(height, abs=1e-9 * (bend + abs(height)))


def test_an_end_of_the_table_is_not_sharpened() -> None:
    place = np.linspace(1.0, 2.0, 5)
    assert refined_minimum(place, place) == (1.0, 1.0)
    assert refined_minimum(place, -place) == (2.0, -2.0)
    # Where the curve is level there is nothing to sharpen.
    assert refined_minimum(place, np.zeros(5)) == (1.0, 0.0)
    assert refined_minimum(place, np.array([1.0, 0.0, 0.0, 0.0, 1.0])) == (1.375, -0.125)
