"""The factor by dense fronts against a dense solution; its cuts against what they promise."""

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array

from palpate.errors import SingularSystemError
from palpate.solids import sparse_cholesky
from palpate.solids.sparse_cholesky import factorise


def _chain_of_neighbours(points: np.ndarray, reach: np.ndarray) -> csr_array:
    """A node is linked to those nearer than its own reach or theirs."""
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    return csr_array((apart < np.maximum(reach[:, None], reach)).astype(np.int8))


@pytest.fixture(scope="module")
def graded() -> tuple[np.ndarray, csr_array]:
    """Nodes that are dense about the origin, as elements under a tip are: half within 0.03 of 1."""
    rng = np.random.default_rng(5)
    toward = rng.normal(size=(900, 3))
    away = np.exp(rng.uniform(np.log(1e-3), 0.0, 900))
    points = toward / np.linalg.norm(toward, axis=1)[:, None] * away[:, None]
    return points, _chain_of_neighbours(points, 0.35 * away)


def _matrix(graph: csr_array) -> csr_array:
    """Positive definite, with that pattern and three unknowns a node."""
    rng = np.random.default_rng(1)
    dense = np.kron(graph.toarray(), np.ones((3, 3))) * rng.uniform(-1.0, 1.0, 2 * [3 * 900])
    dense = dense + dense.T
    return csr_array(dense + np.diag(np.abs(dense).sum(axis=1) + 1.0))


def test_it_is_the_dense_solution(graded, capfd):
    points, graph = graded
    matrix = _matrix(graph)
    right = np.random.default_rng(2).normal(size=(2700, 3))
    factor = factorise(matrix, points)
    wanted = np.linalg.solve(matrix.toarray(), right)
    # The matrix is dominated by its diagonal: rounding only.
    np.testing.assert_allclose(factor.solve(right), wanted, atol=1e-13 * np.abs(wanted).max())
    half = factor.half_solve(right)
    np.testing.assert_allclose(half.T @ half, right.T @ wanted, rtol=1e-11)
    # BLAS complains of empty matrices on the terminal, and goes on.
    assert capfd.readouterr() == ("", "")


def test_a_cut_parts_the_nodes_and_is_small_where_they_are_graded(graded):
    points, graph = graded
    nodes = np.arange(len(points))
    cut, halves = sparse_cholesky._separator(graph, points, nodes)
    assert sorted(np.concatenate([cut, *halves])) == nodes.tolist()
    assert not graph[halves[0]][:, halves[1]].nnz
    assert min(len(half) for half in halves) > 0.3 * len(points)
    # A sphere about the origin meets one of the seven shells that have grown by e; a plane through
    # it meets all of them.
    plane = points[:, 0] > np.median(points[:, 0])
    met = np.flatnonzero(~plane)[graph[~plane][:, plane].sum(axis=1) > 0]
    assert len(cut) < 0.5 * len(met)


@pytest.mark.parametrize("density", [0.02, 0.1, 0.5])
def test_a_cover_meets_every_entry_with_as_few_as_a_matching_asks_for(density):
    links = csr_array(random_array((30, 40), density=density, rng=np.random.default_rng(3)))
    rows, columns = sparse_cholesky._vertex_cover(links)
    entries = links.toarray() != 0.0
    assert (rows[:, None] | columns)[entries].all()
    # No two pairs of a matching share a row or a column: a cover has one for each at least.
    partner = sparse_cholesky.maximum_bipartite_matching(links, perm_type="column")
    assert rows.sum() + columns.sum() == (partner >= 0).sum()


def test_what_is_not_positive_definite_is_refused(graded):
    points, graph = graded
    matrix = _matrix(graph).tolil()
    matrix[4, 4] = -1.0
    with pytest.raises(SingularSystemError, match="not positive definite"):
        factorise(csr_array(matrix), points)
