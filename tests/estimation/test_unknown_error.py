"""The model's own error: its size, its correlation, and that it limits what points can tell."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, patterns, problem_of
from estimation.half_space import half_space_probes

from palpate.estimation import (
    ProbeObservations,
)
from palpate.estimation.observed_rows import ObservedRows, observed_rows_of
from palpate.estimation.unknown_error import UnknownRows, correlated_patterns, unknown_rows
from palpate.pipeline.observations.converged_observations import model_step


def _probe(grid: int = 12, **options: object) -> ProbeObservations:
    rng = np.random.default_rng(3)
    return half_space_probes(rng, count=1, grid=grid, noise=1e-6, **options)[0]


def _unknown(probe: ObservedRows, fields: np.ndarray) -> UnknownRows:
    return unknown_rows(probe, fields, correlated_patterns(probe.position))


def test_a_step_is_the_difference_of_two_models() -> None:
    probe = _probe(4)
    value = probe.response.value(0.3)
    step = model_step("mesh", 0.2, lambda nu: value[:, None], lambda nu: 1.05 * value[:, None])
    problem = problem_of([replace(probe, nuisances=(step,))])
    theta = np.zeros(problem.layout.size)
    theta[:2] = 0.3, np.log(2e4)
    (column,) = problem.linearised(theta)[1][0][problem.layout.blocks[0].errors]
    expected = 0.2 * 0.05 * value[:, :3] @ probe.force / 2e4
    np.testing.assert_allclose(column, expected, rtol=1e-9)


def test_the_covariance_has_the_size_of_the_fields() -> None:
    """A field of one size everywhere: variance of every row, fields and patterns and what is white
    together, and a correlation that falls with distance."""
    probe = observed_rows_of(_probe())
    fields = np.full((len(probe.measured), 1), 2e-6)
    unknown = _unknown(probe, fields)
    smooth = np.stack([unknown.moved(one) for one in np.eye(unknown.count)])[1:]
    covariance_of_rows = smooth.T @ smooth + np.diag(unknown.variance)
    # One field of size s has variance s^2 of every component.
    np.testing.assert_allclose(np.diag(covariance_of_rows), 4e-12, rtol=1e-6)
    along_x = covariance_of_rows[::3, ::3] / 4e-12
    distance = np.linalg.norm(probe.position[:, None] - probe.position[None], axis=2)
    near, far = (along_x[(distance > a) & (distance < b)].mean() for a, b in ((0, 7e-3), (5e-2, 1)))
    assert near > 0.4 > 0.15 > far
    # Components are independent.
    np.testing.assert_allclose(covariance_of_rows[::3, 1::3], 0.0, atol=1e-18)
    assert _unknown(probe, fields[:, :0]).variance.max() == 0.0


def test_products_are_those_of_the_dense_patterns() -> None:
    rng = np.random.default_rng(5)
    probe = _probe(8)
    mixed = rng.normal(size=(len(probe.position), 3, 3))
    probe = replace(probe, covariance=1e-12 * (np.eye(3) + mixed @ mixed.swapaxes(1, 2)))
    rows = observed_rows_of(probe)
    unknown = _unknown(rows, rng.normal(size=(len(rows.measured), 2)))
    dense = np.stack([unknown.moved(one) for one in np.eye(unknown.count)])
    columns, weight = rng.normal(size=(4, dense.shape[1])), rng.uniform(1, 2, dense.shape[1])
    cross, whole = unknown.products(columns, weight)
    # The same sums in another order.
    np.testing.assert_allclose(cross, (columns * weight) @ dense.T, atol=1e-9)
    np.testing.assert_allclose(whole, (dense * weight) @ dense.T, atol=1e-9)


def test_information_saturates() -> None:
    """Sixteen times as many points, or a tenth of the noise, tell hardly more once the model's own
    error decides."""

    def error(grid: int, noise: float) -> float:
        probe = replace(_probe(grid), std=None)
        probe = replace(probe, std=np.full_like(probe.displacement, noise))
        value = probe.response.value
        step = model_step(
            "m", 0.01, lambda nu: value(nu)[:, None], lambda nu: 2 * value(nu)[:, None]
        )
        normal = minimum_of(problem_of([replace(probe, nuisances=(step,))])).normal
        return float(np.sqrt(normal.covariance[0, 0]))

    few, many = error(10, 1e-9), error(40, 1e-9)
    assert few / many < 2.5
    assert error(10, 1e-10) == pytest.approx(few, rel=0.01)
    # Without an error of the model it is the noise alone.
    plain = []
    for grid in (10, 40):
        probe = _probe(grid)
        sure = replace(probe, std=np.full((len(probe.position), 3), 1e-9))
        plain.append(np.sqrt(minimum_of(problem_of([sure])).normal.covariance[0, 0]))
    assert plain[0] / plain[1] > 3.0


def test_probings_share_their_modes() -> None:
    """Of few of the points as of all, where these are all that is observed."""
    places = observed_rows_of(_probe()).position
    at = correlated_patterns(places)
    np.testing.assert_allclose(at(places[::5]), at(places)[::5], rtol=1e-12)
    twice = correlated_patterns(np.concatenate([places, places]))
    np.testing.assert_allclose(np.abs(twice(places)), np.abs(at(places)), atol=1e-9)


def test_few_points_have_no_patterns() -> None:
    rows = observed_rows_of(_probe(3))
    unknown = _unknown(rows, np.full((len(rows.measured), 1), 1e-6))
    assert unknown.count == 1
    np.testing.assert_allclose(unknown.variance, 1e-12)
    assert patterns(problem_of([_probe(3)]), 0).shape[0] == 0


@pytest.mark.slow
def test_an_error_that_all_probings_share_does_not_average_out() -> None:
    """Eight looks at the same nine points of a mesh, each point a tenth of a micrometre off, the
    same in every look: Poisson's ratio scatters as one look's would, and as claimed."""
    rng, size, draws = np.random.default_rng(8), 1e-7, 60
    look = half_space_probes(rng, count=1, grid=3, noise=0.0)[0]
    value = look.response.value(0.28)[:, None]
    other = value * (1.0 + size / (value[:, 0, :3] @ look.force / 2.1e4))[:, None, None]
    step = model_step("mesh", 1.0, lambda _: value, lambda _: other)
    std = np.full_like(look.displacement, 1e-9)
    looks = [replace(look, name=f"look {k}", std=std, nuisances=(step,)) for k in range(8)]

    def found(displacement: np.ndarray, count: int = 8) -> tuple[float, float]:
        probes = [replace(each, displacement=displacement) for each in looks[:count]]
        minimum = minimum_of(problem_of(probes))
        return minimum.poisson_ratio, float(np.sqrt(minimum.normal.covariance[0, 0]))

    off = look.displacement + size * rng.normal(size=(draws, *look.displacement.shape))
    ratios, claims = np.transpose([found(each) for each in off])
    assert found(look.displacement)[1] == pytest.approx(found(look.displacement, 1)[1], rel=0.02)
    # A scatter from 60 draws is known to 9 %; eight independent looks would claim a third of it.
    assert np.std(ratios) == pytest.approx(claims.mean(), rel=0.3)
