"""The factorisation by panels against LAPACK's own, which no test can take to where it fails."""

import numpy as np
import pytest
from elastic_bodies import cube_with_faces, held_part
from scipy.linalg import lu_factor, lu_solve

from palpate.bem import factorise, solve
from palpate.bem.system import system as module
from palpate.bem.system.large_lu import lu_by_panels
from palpate.bem.system.refinement import TOLERANCE, refined_solution, refines
from palpate.bem.system.system import system_matrix, system_product
from palpate.errors import NotConvergedError


@pytest.mark.parametrize(
    ("size", "panel", "chunk"), [(1, 4, 4), (50, 7, 9), (64, 16, 16), (60, 80, 8), (51, 50, 1)]
)
def test_the_same_factors_as_lapack(size, panel, chunk):
    plain = np.random.default_rng(size).normal(size=(size, size))
    # Sums of up to 64 products in another order; no growth beyond a factor of ten.
    for kind, error in ((np.float64, 1e-12), (np.float32, 1e-3)):
        matrix = np.asfortranarray(plain.astype(kind))
        expected, order = lu_factor(matrix)
        found, pivots = lu_by_panels(matrix, panel=panel, chunk=chunk)
        assert found is matrix
        assert np.array_equal(pivots, order)
        np.testing.assert_allclose(found, expected, rtol=0, atol=error)


def test_what_it_gives_solves():
    rng = np.random.default_rng(1)
    matrix, right = rng.normal(size=(90, 90)), rng.normal(size=(90, 3))
    pair = lu_by_panels(np.asfortranarray(matrix), panel=32, chunk=20)
    np.testing.assert_allclose(matrix @ lu_solve(pair, right), right, atol=1e-11)


@pytest.fixture(scope="module")
def system():
    mesh, face = cube_with_faces(2)
    return held_part(mesh, face == 4)


@pytest.fixture
def panels(system, monkeypatch):
    """Every system counts as a large one; what is factorised by panels."""
    taken = []

    def seen(matrix):
        taken.append((len(matrix), matrix.dtype))
        return lu_by_panels(matrix, panel=32)

    monkeypatch.setattr(module, "lu_by_panels", seen)
    monkeypatch.setattr(module, "LARGEST_WHOLE", system.size - 1)
    return taken


def test_large_systems_are_solved_as_well_from_single_precision(system, panels, monkeypatch):
    right = np.random.default_rng(2).normal(size=(system.size, 2)) * [1.0, 1e-30]
    right[:, 1] += 1e-30  # small as it is: single precision would have nothing of it
    with monkeypatch.context() as patched:
        patched.setattr(module, "LARGEST_WHOLE", system.size)
        expected = solve(factorise(system, 0.3), right)
    found = solve(factorise(system, 0.3), right)
    assert panels == [(system.size, np.float32)]
    # The residual is 1e-11 of the right-hand side; the condition of this matrix, about 100, times.
    assert (np.abs(found - expected) <= 1e-9 * np.abs(expected).max(axis=0)).all()
    # Without refinement only single precision's digits would be right.
    monkeypatch.setattr("palpate.bem.system.refinement.TOLERANCE", 1.0)
    rough = solve(factorise(system, 0.3), right)
    assert np.abs(rough - expected)[:, 0].max() > 1e-8 * np.abs(expected[:, 0]).max()


def test_a_product_is_that_of_the_matrix(system):
    vectors = np.random.default_rng(3).normal(size=(system.size, 4))
    for nu in (0.0, 0.49):
        expected = system_matrix(system, nu) @ vectors
        # Rounding of sums of some hundred products.
        np.testing.assert_allclose(system_product(system, nu, vectors), expected, atol=1e-11)


def test_what_single_precision_cannot_solve_is_solved_in_double(system, panels, monkeypatch):
    monkeypatch.setattr(module, "refines", lambda *_: False)
    found = factorise(system, 0.3)
    assert [kind for _, kind in panels] == [np.float32, np.float64]
    assert found.product is None
    right = np.random.default_rng(4).normal(size=(system.size, 1))
    left = system_product(system, 0.3, solve(found, right)) - right
    assert np.abs(left).max() < 1e-11  # rounding, times the condition


@pytest.mark.parametrize(("condition", "possible"), [(1e3, True), (1e5, True), (1e9, False)])
def test_refinement_takes_as_much_as_single_precision_can(condition, possible):
    # Singular values from 1 to 1/condition; a step leaves about 6e-8 times the condition.
    rng = np.random.default_rng(5)
    left, right = (np.linalg.qr(rng.normal(size=(80, 80)))[0] for _ in range(2))
    matrix = left * np.geomspace(1.0, 1.0 / condition, 80) @ right
    pair = lu_by_panels(np.asfortranarray(matrix.astype(np.float32)))
    assert refines(lambda vectors: matrix @ vectors, *pair) == possible
    if possible:
        given = rng.normal(size=(80, 3))
        found = refined_solution(lambda vectors: matrix @ vectors, *pair, given)
        left_over = np.linalg.norm(matrix @ found - given, axis=0)
        assert (left_over <= TOLERANCE * np.linalg.norm(given, axis=0)).all()
    else:
        with pytest.raises(NotConvergedError, match="refinement of a solution"):
            refined_solution(lambda vectors: matrix @ vectors, *pair, rng.normal(size=(80, 3)))
