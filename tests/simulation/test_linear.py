"""Small linear algebra of the simulation, against numpy's."""

import numpy as np
import pytest

from palpate.simulation.contact_response import assign, solve


@pytest.mark.parametrize("size", [0, 1, 2, 7, 40])
def test_a_system_is_solved_as_numpy_solves_it(size):
    rng = np.random.default_rng(size)
    matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
    # Without pivoting, this would divide by zero.
    np.fill_diagonal(matrix, 0.0 if size > 1 else 2.0)
    expected, found = np.linalg.solve(matrix, right), right.copy()
    assert solve(matrix.copy(), found)
    # Rounding, times a condition of a few hundred.
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-11)


def test_a_singular_system_is_refused():
    assert not solve(np.array([[1.0, 2.0], [2.0, 4.0]]), np.ones(2))
    assert not solve(np.zeros((3, 3)), np.ones(3))


@pytest.mark.parametrize("values", [np.arange(4), np.linspace(0.0, 1.0, 6).reshape(2, 3)])
def test_all_values_are_assigned(values):
    out = np.zeros_like(values)
    assign(values, out)
    np.testing.assert_array_equal(out, values)
