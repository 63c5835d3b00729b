"""Block GMRES against LAPACK."""

import numpy as np
import pytest

from palpate.bem.compressed.iterative import block_gmres
from palpate.errors import NotConvergedError


@pytest.fixture(scope="module")
def system():
    rng = np.random.default_rng(0)
    matrix = np.eye(300) + 0.5 * rng.normal(size=(300, 300)) / np.sqrt(300)
    return matrix, rng.normal(size=(300, 30))


def same(vectors):
    return vectors


def test_the_solution_is_that_of_lapack(system):
    matrix, right = system
    solved = block_gmres(lambda x: matrix @ x, same, right, tolerance=1e-12)
    wanted = np.linalg.solve(matrix, right)
    # The tolerance, times a condition of three.
    assert np.abs(solved.solution - wanted).max() < 1e-11 * np.abs(wanted).max()
    left = np.linalg.norm(matrix @ solved.solution - right, axis=0)
    assert (left <= 2e-12 * np.linalg.norm(right, axis=0)).all()


def test_the_product_of_the_solution_comes_with_it(system):
    matrix, right = system
    solved = block_gmres(lambda x: matrix @ x, same, right, tolerance=1e-3)
    # Rounding, not the tolerance.
    assert np.abs(solved.product - matrix @ solved.solution).max() < 1e-12 * np.abs(right).max()


def test_a_good_inverse_needs_one_product(system):
    matrix, right = system
    inverse = np.linalg.inv(matrix)
    solved = block_gmres(lambda x: matrix @ x, lambda x: inverse @ x, right, tolerance=1e-10)
    assert solved.iterations == 1


def test_together_they_need_fewer_products(system):
    matrix, right = system
    alone = block_gmres(lambda x: matrix @ x, same, right[:, :1], tolerance=1e-9)
    all_of_them = block_gmres(lambda x: matrix @ x, same, right[:, :20], tolerance=1e-9)
    assert all_of_them.iterations < alone.iterations


@pytest.mark.parametrize("rounding", [1e-6, 1e-2])
def test_low_precision_products_leave_no_trace(system, rounding):
    matrix, right = system
    rng = np.random.default_rng(1)
    calls = []

    def exact(x):
        calls.append(x.shape[1])
        return matrix @ x

    def low_precision(x):
        product = matrix @ x
        return product + rounding * np.abs(product).max() * rng.normal(size=product.shape)

    solved = block_gmres(exact, same, right[:, :20], low_precision=low_precision, tolerance=1e-12)
    wanted = np.linalg.solve(matrix, right[:, :20])
    # The tolerance, times a condition of three.
    assert np.abs(solved.solution - wanted).max() < 1e-11 * np.abs(wanted).max()
    assert np.abs(solved.product - matrix @ solved.solution).max() < 1e-12 * np.abs(right).max()
    # 1e-12 in steps of 1e-5: three exact products. What is too rough to converge is not iterated.
    assert len(calls) == 3 if rounding < 1e-4 else len(calls) < 40


def test_columns_of_nothing_and_alike_columns(system):
    matrix, right = system
    right = np.column_stack([right[:, 0], np.zeros(300), 1e-9 * right[:, 0], right[:, 1]])
    solved = block_gmres(lambda x: matrix @ x, same, right, tolerance=1e-10)
    wanted = np.linalg.solve(matrix, right)
    size = np.linalg.norm(wanted, axis=0)
    error = np.linalg.norm(solved.solution - wanted, axis=0)
    assert (error <= 1e-9 * size).all()


def test_residuals_are_relative_to_what_is_given(system):
    matrix, right = system
    size = np.linalg.norm(right, axis=0)
    solved = block_gmres(lambda x: matrix @ x, same, right, scale=100 * size, tolerance=1e-4)
    left = np.linalg.norm(matrix @ solved.solution - right, axis=0)
    # No better than asked for by more than an iteration makes of it.
    assert (left <= 1e-2 * size).all()
    assert (left > 1e-5 * size).any()


def test_what_does_not_converge_says_so(system):
    matrix, right = system
    with pytest.raises(NotConvergedError, match=r"300 equations .* after 3 iterations"):
        block_gmres(lambda x: matrix @ x, same, right, max_iterations=3)
