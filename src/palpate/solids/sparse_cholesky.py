"""Multifrontal Cholesky factor of a stiffness matrix, for bodies of many thousand nodes.

Nested dissection: the nodes are bisected recursively and the separators eliminated last. Each front
is a small dense matrix; this is ten times faster than sparse elimination row by row. All products
are made by the library that factorises: numpy's own one would have threads that wait beside its.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from scipy.linalg import LinAlgError, cholesky, solve_triangular
from scipy.linalg.blas import dgemm, dsyrk
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from palpate.arrays import components_of
from palpate.errors import SingularSystemError

# Below this many nodes further dissection saves nothing.
_LEAF_NODES = 60


@dataclass(frozen=True, slots=True, eq=False)
class _Front:
    """Unknowns that are eliminated together: `lower` is L11, `coupling` the transpose of L21."""

    own: Int[np.ndarray, " k"]
    later: Int[np.ndarray, " b"]
    lower: Float[np.ndarray, "k k"]
    coupling: Float[np.ndarray, "k b"]


@dataclass(frozen=True, slots=True, eq=False)
class Cholesky:
    """Factor of a symmetric positive definite matrix.

    Parameters
    ----------
    size : int                      number of unknowns
    fronts : tuple                  in the order of elimination
    """

    size: int
    fronts: tuple[_Front, ...]

    def solve(self, right: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Solution for several right-hand sides at once.

        Parameters
        ----------
        right : (n, k) float

        Returns
        -------
        (n, k) float
        """
        x = self.half_solve(right)
        for front in reversed(self.fronts):
            unknowns = x[front.own]
            if len(front.later):
                unknowns -= dgemm(1.0, x[front.later].T, front.coupling, trans_b=True).T
            x[front.own] = solve_triangular(
                front.lower, unknowns, lower=True, trans="T", check_finite=False
            )
        return x

    def half_solve(self, right: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "n k"]:
        """Forward substitution, L^-1 times right-hand sides: a^T A^-1 b = (L^-1 a)^T (L^-1 b).

        Parameters
        ----------
        right : (n, k) float

        Returns
        -------
        (n, k) float                    in the order of the unknowns, not of elimination
        """
        x = np.array(right, dtype=np.float64)
        for front in self.fronts:
            # Loads on a few nodes affect only few fronts.
            if x[front.own].any():
                unknowns = solve_triangular(
                    front.lower, x[front.own], lower=True, check_finite=False
                )
                x[front.own] = unknowns
                if len(front.later):
                    x[front.later] -= dgemm(1.0, unknowns.T, front.coupling).T
        return x


def factorise(matrix: csr_array, points: Float[np.ndarray, "n 3"]) -> Cholesky:
    """Factorise a matrix with three unknowns per node.

    Parameters
    ----------
    matrix : (3 n, 3 n) sparse      symmetric, positive definite; three unknowns per node
    points : (n, 3) float [m]       node positions, used for the dissection

    Returns
    -------
    Cholesky

    Raises
    ------
    SingularSystemError             not positive definite

    Source
    ------
    George, Nested dissection of a regular finite element mesh, SIAM Journal on Numerical Analysis
    10 (1973) 345; Duff and Reid, The multifrontal solution of indefinite sparse symmetric linear
    equations, ACM Transactions on Mathematical Software 9 (1983) 302. No pivoting, as the matrix is
    positive definite.
    """
    blocks = matrix.tobsr((3, 3))
    graph = csr_array(
        (np.ones(len(blocks.indices), dtype=np.int8), blocks.indices, blocks.indptr),
        shape=(len(points), len(points)),
    )
    done = np.zeros(len(points), dtype=bool)
    position = np.empty(3 * len(points), dtype=np.int64)
    fronts: list[_Front] = []
    # One work array for all fronts: allocating one for each would take as long as its arithmetic.
    work = np.empty(0)

    def eliminate(nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Eliminate a set of nodes: the nodes coupled to it, and its update of their matrix."""
        nonlocal work
        cut, halves = _separator(graph, points, nodes)
        parts = [eliminate(half) for half in halves if len(half)]
        done[cut] = True
        reached = [graph[cut].indices] + [part[0] for part in parts]
        later = np.unique(np.concatenate(reached))
        later = later[~done[later]]
        if work.size < (3 * (len(cut) + len(later))) ** 2:
            work = np.empty((3 * (len(cut) + len(later))) ** 2)
        front, rest = _front(matrix, position, cut, later, parts, work)
        fronts.append(front)
        return later, rest

    eliminate(np.arange(len(points)))
    return Cholesky(3 * len(points), tuple(fronts))


def _separator(
    graph: csr_array, points: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, ...]]:
    """Separator of a set of nodes, and the two halves that it leaves.

    The halves are divided by a plane or by a sphere; around a refined region a sphere cuts fewer
    elements. The separator is a minimum vertex cover of the links between the halves.
    """
    if len(nodes) <= _LEAF_NODES:
        return nodes, ()
    links, positions = graph[nodes][:, nodes], points[nodes]
    away = np.linalg.norm(positions - np.median(positions, axis=0), axis=1)
    sides = []
    for key in (*positions.T, away):
        upper = np.zeros(len(nodes), dtype=bool)
        upper[np.argsort(key, kind="stable")[len(nodes) // 2 :]] = True
        above = links @ upper.astype(np.int64)
        ends = ~upper & (above > 0), upper & (above < np.diff(links.indptr))
        sides.append((min(int(end.sum()) for end in ends), upper, *ends))
    _, upper, low, high = min(sides, key=lambda side: side[0])
    cut = np.zeros(len(nodes), dtype=bool)
    rows, columns = np.flatnonzero(low), np.flatnonzero(high)
    covered, others = _vertex_cover(csr_array(links[rows][:, columns]))
    cut[rows[covered]] = cut[columns[others]] = True
    return nodes[cut], (nodes[~upper & ~cut], nodes[upper & ~cut])


def _vertex_cover(links: csr_array) -> tuple[np.ndarray, np.ndarray]:
    """Minimum vertex cover: the fewest rows and columns that cover all entries, as masks.

    Source
    ------
    König, Gráfok és mátrixok, Matematikai és Fizikai Lapok 38 (1931) 116: it is as large as a
    maximum matching, and is found along the alternating paths of such a matching.
    """
    partner = maximum_bipartite_matching(links, perm_type="column")
    row_of = np.full(links.shape[1], -1)
    row_of[partner[partner >= 0]] = np.flatnonzero(partner >= 0)
    back = csr_array(links.T)
    reached, columns = partner < 0, np.zeros(links.shape[1], dtype=bool)
    last = reached
    while last.any():
        new = (back @ last.astype(np.int64) > 0) & ~columns
        columns |= new
        last = np.zeros_like(reached)
        # Every column reached has a partner: otherwise there would be an augmenting path.
        last[row_of[new]] = True
        reached = reached | last
    return ~reached, columns


def _front(
    rows: csr_array,
    position: np.ndarray,
    eliminated: np.ndarray,
    later: np.ndarray,
    children: list[tuple[np.ndarray, np.ndarray]],
    work: np.ndarray,
) -> tuple[_Front, np.ndarray]:
    """Eliminate a front's own unknowns; also gives the Schur complement for its parent front.

    Only the upper triangle of a front's matrix is filled, except in the block of its own unknowns.
    """
    eliminated, later = components_of(eliminated), components_of(later)
    everything = np.concatenate([eliminated, later])
    position[everything] = np.arange(len(everything))
    size = len(everything)
    full = work[: size * size].reshape(size, size)
    full[len(eliminated) :] = 0.0
    full[: len(eliminated)] = rows[eliminated][:, everything].toarray()
    for nodes, added in children:
        _add_kernel(full, len(eliminated), position[components_of(nodes)], added)
    k = len(eliminated)
    try:
        lower = cholesky(full[:k, :k], lower=True, check_finite=False)
    except LinAlgError as error:
        raise SingularSystemError(
            "the stiffness matrix is not positive definite: the body is held at too few places to"
            " keep it from moving as a whole, or its material is not stable; hold more of it"
        ) from error
    if k == size:
        # The last one: BLAS refuses empty matrices.
        return _Front(eliminated, later, lower, np.empty((k, 0))), np.empty((0, 0))
    coupling = solve_triangular(lower, full[:k, k:], lower=True, check_finite=False)
    # Its upper triangle.
    schur = dsyrk(1.0, coupling, trans=True, lower=True).T
    np.subtract(full[k:, k:], schur, out=schur)
    return _Front(eliminated, later, lower, coupling), schur


@njit(cache=True, error_model="numpy")
def _add_kernel(full: np.ndarray, eliminated: int, at: np.ndarray, added: np.ndarray) -> None:
    """Add a symmetric matrix at indices `at`: to the upper triangle, and to the whole own block."""
    for i in range(len(at)):
        for j in range(i, len(at)):
            first, last = min(at[i], at[j]), max(at[i], at[j])
            full[first, last] += added[i, j]
            if last < eliminated and first < last:
                full[last, first] += added[i, j]
