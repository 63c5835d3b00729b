"""Cholesky and products for small systems within kernels, against LAPACK and BLAS."""

import numpy as np
import pytest

from palpate.vision.cholesky import (
    add_congruence_kernel,
    add_transposed_kernel,
    cholesky_inverse_kernel,
    cholesky_kernel,
    cholesky_solve_kernel,
    product_kernel,
)


def _positive(n, seed):
    """A random symmetric matrix with a condition of 1e4."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return turn * np.geomspace(1.0, 1e4, n) @ turn.T


@pytest.mark.parametrize("n", [1, 2, 3, 6, 9, 12, 18])
def test_solution_factor_and_inverse_agree_with_lapack(n):
    a = _positive(n, n)
    factor = a.copy()
    assert cholesky_kernel(factor)
    # Condition times rounding, with a factor of ten to spare.
    np.testing.assert_allclose(np.tril(factor), np.linalg.cholesky(a), rtol=1e-10, atol=1e-9)
    right = np.random.default_rng(n + 50).normal(size=n)
    solution = right.copy()
    cholesky_solve_kernel(factor, solution)
    np.testing.assert_allclose(solution, np.linalg.solve(a, right), rtol=1e-10, atol=1e-11)
    inverse = np.full((n, n), np.nan)
    cholesky_inverse_kernel(factor, inverse)
    np.testing.assert_allclose(inverse, np.linalg.inv(a), rtol=1e-10, atol=1e-11)


def test_only_the_lower_triangle_is_read():
    a = _positive(5, 9)
    factor = np.tril(a)
    assert cholesky_kernel(factor)
    np.testing.assert_allclose(factor, np.linalg.cholesky(a), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize(
    "a",
    [
        np.zeros((1, 1)),
        np.full((1, 1), -1.0),
        np.full((1, 1), np.nan),
        np.ones((2, 2)),
        np.array([[1.0, 2.0], [2.0, 1.0]]),
        np.diag([1.0, 0.0, 2.0]),
    ],
)
def test_what_is_not_positive_definite_is_refused(a):
    assert not cholesky_kernel(a.copy())


@pytest.mark.parametrize("n", [3, 9, 18])
def test_one_direction_without_information_is_refused_at_any_scale(n):
    """Rank n - 1 up to rounding; the units of the unknowns must not matter."""
    rng = np.random.default_rng(n)
    columns = rng.normal(size=(4 * n, n))
    columns[:, -1] = columns[:, :-1] @ rng.normal(size=n - 1)
    for scale in (np.ones(n), np.geomspace(1e-6, 1e6, n)):
        scaled = columns * scale
        assert not cholesky_kernel(scaled.T @ scaled)
    columns[:, -1] += 0.01 * rng.normal(size=4 * n)
    assert cholesky_kernel(columns.T @ columns)


@pytest.mark.parametrize(("k", "m"), [(1, 1), (2, 3), (6, 9), (12, 18)])
def test_products_are_added_to_what_is_there(k, m):
    rng = np.random.default_rng(k)
    matrix, inner, vector = rng.normal(size=(k, m)), rng.normal(size=(k, k)), rng.normal(size=k)
    column, square, row = np.ones(m), np.ones((m, m)), np.full(k, np.nan)
    product_kernel(matrix, matrix[0], 0.5, row)
    np.testing.assert_allclose(row, 0.5 * matrix @ matrix[0], atol=1e-12)
    add_transposed_kernel(matrix, vector, 0.5, column)
    add_congruence_kernel(inner, matrix, 0.5, square)
    # Rounding of sums of at most 144 products of size one.
    np.testing.assert_allclose(column, 1.0 + 0.5 * matrix.T @ vector, atol=1e-12)
    np.testing.assert_allclose(square, 1.0 + 0.5 * matrix.T @ inner @ matrix, atol=1e-12)
