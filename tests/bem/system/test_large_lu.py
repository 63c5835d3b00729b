"""The factorisation by panels against LAPACK's own, which no test can take to where it fails."""

import numpy as np
import pytest
from elastic_bodies import cube_with_faces, held_part
from scipy.linalg import lu_factor, lu_solve

from palpate.bem import factorise, solve
from palpate.bem.system import factors as module
from palpate.bem.system.large_lu import lu_by_panels


@pytest.mark.parametrize(
    ("size", "panel", "chunk"), [(1, 4, 4), (50, 7, 9), (64, 16, 16), (60, 80, 8), (51, 50, 1)]
)
def test_the_same_factors_as_lapack(size, panel, chunk):
    matrix = np.asfortranarray(np.random.default_rng(size).normal(size=(size, size)))
    expected, order = lu_factor(matrix)
    found, pivots = lu_by_panels(matrix, panel=panel, chunk=chunk)
    assert found is matrix
    assert np.array_equal(pivots, order)
    # Sums of up to 64 products in another order; no growth beyond a factor of ten.
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("kind", "error"), [(np.float64, 1e-11), (np.float32, 1e-3)])
def test_what_it_gives_solves(kind, error):
    rng = np.random.default_rng(1)
    matrix, right = rng.normal(size=(90, 90)).astype(kind), rng.normal(size=(90, 3)).astype(kind)
    lu, pivots = lu_by_panels(np.asfortranarray(matrix), panel=32, chunk=20)
    assert lu.dtype == kind
    # Rounding (1e-16, 6e-8) times 90 terms and the condition of the matrix, some hundreds.
    np.testing.assert_allclose(matrix @ lu_solve((lu, pivots), right), right, atol=error)


def test_large_systems_take_it(monkeypatch):
    mesh, face = cube_with_faces(2)
    system = held_part(mesh, face == 4)
    right = np.random.default_rng(2).normal(size=(system.size, 2))
    expected = solve(factorise(system, 0.3), right)
    taken = []

    def panels(matrix):
        taken.append(len(matrix))
        return lu_by_panels(matrix, panel=32)

    monkeypatch.setattr(module, "lu_by_panels", panels)
    monkeypatch.setattr(module, "LARGEST_WHOLE", system.size - 1)
    np.testing.assert_allclose(
        solve(factorise(system, 0.3), right), expected, atol=1e-10 * np.abs(expected).max()
    )
    assert taken == [system.size]
