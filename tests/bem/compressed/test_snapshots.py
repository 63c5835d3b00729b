"""Directions of a reduced basis: orthonormal, and none where a vector adds nothing."""

import numpy as np
import pytest

from palpate.bem import face_columns
from palpate.bem.compressed.iterative import cluster_inverse
from palpate.bem.reduced_model import _Snapshots, orthogonalised

ROWS, COLUMNS = 500, 3


@pytest.fixture(scope="module")
def basis():
    """Four orthonormal directions for each of three columns."""
    ratios = []
    for vectors in np.random.default_rng(0).normal(size=(4, ROWS, COLUMNS)):
        ratios.append(orthogonalised(vectors, ratios)[0])
    return ratios


def test_directions_are_orthonormal(basis):
    stack = np.stack(basis)
    products = np.einsum("ikc,jkc->ijc", stack, stack)
    # Rounding of sums of 500 terms.
    np.testing.assert_allclose(products, np.eye(4)[:, :, None] * np.ones(COLUMNS), atol=1e-14)


def test_a_vector_is_the_sum_of_its_parts(basis):
    vectors = np.random.default_rng(1).normal(size=(ROWS, COLUMNS))
    direction, coefficients = orthogonalised(vectors, basis)
    solution = np.einsum("jkc,jc->kc", np.stack([*basis, direction]), coefficients)
    np.testing.assert_allclose(solution, vectors, atol=1e-13)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_a_vector_in_the_span_has_no_direction(basis, size):
    vectors = np.random.default_rng(2).normal(size=(ROWS, COLUMNS))
    inside = size * np.random.default_rng(3).normal(size=(4, 2))
    vectors[:, :2] = np.einsum("jkc,jc->kc", np.stack(basis)[:, :, :2], inside)
    direction, coefficients = orthogonalised(vectors, basis)
    assert not direction[:, :2].any()
    assert not coefficients[-1, :2].any()
    np.testing.assert_allclose(coefficients[:-1, :2], inside, rtol=1e-12, atol=1e-13 * size)
    # The third column, beside these, has one.
    assert np.linalg.norm(direction[:, 2]) == pytest.approx(1.0)


@pytest.mark.slow
def test_the_same_snapshot_again_adds_nothing(compressed):
    surface = compressed.surface
    middle = surface.mesh.vertices[surface.mesh.triangles].mean(axis=1)
    right = face_columns(compressed, np.flatnonzero(middle[:, 0] > 5.0 - 1e-9)).terms
    snapshots = _Snapshots(compressed, cluster_inverse(compressed, 0.3), right)
    snapshots.add(0.3, None, 1e-9)
    once = snapshots.basis().coefficients(0.3)[0]
    snapshots.add(0.3, None, 1e-9)
    assert not snapshots.directions[1].any()
    twice = snapshots.basis().coefficients(0.3)[0]
    assert not twice[1].any()
    np.testing.assert_allclose(twice[0], once[0], rtol=1e-9)
