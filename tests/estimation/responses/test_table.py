"""Tabulated responses: exact for polynomials, near enough for what has a pole."""

import numpy as np
import pytest
from estimation.fitted import misfit_of
from estimation.half_space import half_space_probes
from numpy.polynomial import Polynomial

from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.responses.table import interpolation_weights, response_table


def _rows(count: int) -> tuple[ObservedRows, ...]:
    rng = np.random.default_rng(1)
    return misfit_of(half_space_probes(rng, count=count, grid=4, noise=1e-5)).probes


@pytest.mark.parametrize("count", [4, 9])
def test_polynomials_are_interpolated_exactly(count: int) -> None:
    node = 0.2 - 0.3 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    target = np.concatenate([[-0.1, 0.5], node[:2], np.linspace(0, 0.4, 7)])
    weights = interpolation_weights(node, target)
    curve = Polynomial(np.arange(1.0, count + 1))
    # Barycentric weights are of order one: rounding.
    np.testing.assert_allclose(weights @ curve(node), curve(target), rtol=1e-12)
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-13)
    np.testing.assert_array_equal(weights[2], np.eye(count)[0])


@pytest.mark.parametrize(("ends", "count"), [((0.0, 0.4999), 9), ((-0.99, 0.4999), 27)])
def test_nodes_serve_the_whole_range(ends: tuple[float, float], count: int) -> None:
    rows = misfit_of(
        half_space_probes(np.random.default_rng(1), count=1, grid=4, noise=1e-5)
    ).probes
    table = response_table(rows, ends)
    assert len(table.poisson_ratio) == count
    assert table.poisson_range == ends
    node = table.poisson_ratio
    assert np.all(np.diff(node) > 0)
    # Chebyshev nodes lie about the middle, the first within a per cent of the end.
    np.testing.assert_allclose(node + node[::-1], sum(ends), atol=1e-12)
    assert 0 < node[0] - ends[0] < 0.01 * (ends[1] - ends[0])
    # An elastic response has its pole at nu = 1 or beyond 0.6.
    for nu in np.linspace(*ends, 20):
        pole = interpolation_weights(node, np.array([nu])) @ (1 / (0.75 - node))
        assert pole[0] == pytest.approx(1 / (0.75 - nu), rel=1e-4)


def test_the_table_gives_the_response() -> None:
    rows = misfit_of(
        half_space_probes(np.random.default_rng(1), count=2, grid=4, noise=1e-5)
    ).probes
    table = response_table(rows, (0.0, 0.4999))
    for probe, found in zip(rows, table.at(0.37), strict=True):
        # Linear in nu: rounding.
        np.testing.assert_allclose(found, probe.value(0.37).T, rtol=1e-12, atol=1e-12)
