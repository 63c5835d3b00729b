"""Iterative solution of the compressed system: block GMRES, preconditioned by blocks of clusters.

All right-hand sides share one Krylov space, which contains all solutions after far fewer products
than each would need by itself, and every product is one with a block of vectors.

Source
------
Saad, Iterative Methods for Sparse Linear Systems (2003), section 6.12 and algorithm 9.5:
preconditioned from the right, so that the residual is that of the system itself. Higham, Accuracy
and Stability of Numerical Algorithms (2002), chapter 12: iterative refinement, with approximate
corrections for residuals in full precision.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lu_factor, lu_solve

from palpate.bem.compressed.far_field import KernelWeights
from palpate.bem.compressed.operator import NearBlock
from palpate.bem.compressed.system import SLACK, CompressedSystem, scaled_weights
from palpate.errors import NotConvergedError
from palpate.threads import in_threads

_TINY = np.finfo(float).tiny
# Right-hand sides that share a Krylov space; more would cost more memory than they save.
_BLOCK_SIZE = 24
# Reduction of the residual per round of low-precision products; their rounding of 3e-7 stays below
# it, as amplified by the iteration in slender bodies.
_LOW_PRECISION_REDUCTION = 1e-5
# Low-precision products are given up once the residual exceeds its target by this factor, or a
# round took more than so many iterations: each round starts with an empty Krylov space.
_MAX_EXCESS, _MAX_ROUND_ITERATIONS = 10.0, 20


@dataclass(frozen=True, slots=True, eq=False)
class ClusterInverse:
    """Approximate inverse: the diagonal blocks of clusters, with the global force balance.

    Attributes
    ----------
    system : CompressedSystem
    poisson_ratio : float
    points : list of (m,) int             collocation points of each cluster
    unknowns : list of (m,) int           unknown vectors that are paired with them
    factors : list                        LAPACK's LU factors of each block
    slack_solutions : (k - 3, 3) float    block solutions for a unit slack
    slack_force : (3, 3) float            force balance of `slack_solutions`
    """

    system: CompressedSystem
    poisson_ratio: float
    points: list[Int[np.ndarray, " _"]]
    unknowns: list[Int[np.ndarray, " _"]]
    factors: list[tuple[np.ndarray, np.ndarray]]
    slack_solutions: Float[np.ndarray, "k 3"]
    slack_force: Float[np.ndarray, "3 3"]

    def solve(self, right: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        """An approximate solution.

        Parameters
        ----------
        right : (k, c) float

        Returns
        -------
        (k, c) float
        """
        block_solutions = self.solve_blocks(self.system.by_point(right))
        residual = right[-3:] - self.force(block_solutions)
        slack = np.linalg.solve(-self.slack_force, residual)
        return np.concatenate([block_solutions - self.slack_solutions @ slack, slack])

    def solve_blocks(self, rows: Float[np.ndarray, "r 3 c"]) -> Float[np.ndarray, "k c"]:
        """Solve the equations of every cluster, (r, 3, c), without slack; (k - 3, c)."""
        out = np.empty_like(rows)

        def solve(begin: int, end: int) -> None:
            for k in range(begin, end):
                right = rows[self.points[k]].reshape(-1, rows.shape[2])
                solution = lu_solve(self.factors[k], right, check_finite=False)
                out[self.unknowns[k]] = solution.reshape(-1, 3, rows.shape[2])

        in_threads(solve, len(self.points))
        return out.reshape(-1, rows.shape[2])

    def force(self, unknowns: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "3 c"]:
        """Left-hand side of the force balance, (3, c), for unknowns without slack, (k - 3, c)."""
        first = 3 * self.system.unknowns.free_vertices.size
        traction = unknowns[first:].reshape(-1, 3, unknowns.shape[1])
        return np.einsum("h,hic->ic", self.system.balance_weights, traction)


def cluster_inverse(
    system: CompressedSystem, poisson_ratio: float, *, max_points: int = 256
) -> ClusterInverse:
    """Factorise the diagonal blocks of all clusters at one Poisson's ratio.

    Parameters
    ----------
    system : CompressedSystem
    poisson_ratio : float
    max_points : int              largest number of collocation points in a block

    Returns
    -------
    ClusterInverse
    """
    weights = scaled_weights(system, poisson_ratio)
    tree = system.operator.far.receivers
    size = tree.stop - tree.start
    chosen = np.flatnonzero(size <= max_points)
    inner = tree.children[chosen].ravel()
    chosen = np.setdiff1d(chosen, inner[inner >= 0])
    points = [tree.members(int(cluster)) for cluster in chosen]
    pair = paired_unknowns(system)
    unknowns = [pair[members] for members in points]
    block_of = _blocks_by_point(system)
    factors: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(0), np.zeros(0))] * len(points)

    def factorise(begin: int, end: int) -> None:
        for k in range(begin, end):
            blocks = [system.operator.near[b] for b in np.unique(block_of[points[k]])]
            block = _diagonal_block(system, weights, blocks, points[k], unknowns[k])
            factors[k] = lu_factor(block, overwrite_a=True, check_finite=False)

    in_threads(factorise, len(points))
    no_slack = np.zeros((system.size - 3, 3)), np.eye(3)
    without_slack = ClusterInverse(system, poisson_ratio, points, unknowns, factors, *no_slack)
    slack_solutions = without_slack.solve_blocks(np.tile(SLACK * np.eye(3), (len(pair), 1, 1)))
    return replace(
        without_slack,
        slack_solutions=slack_solutions,
        slack_force=without_slack.force(slack_solutions),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _IterativeSolution:
    """Solutions, with their cost and residuals.

    Attributes
    ----------
    solution : (k, c) float
    product : (k, c) float        the matrix times the solutions
    iterations : int              products of the matrix with a block of vectors, of the block of
                                  right-hand sides that took most
    residual : (c,) float         norm, relative to the scale
    """

    solution: Float[np.ndarray, "k c"]
    product: Float[np.ndarray, "k c"]
    iterations: int
    residual: Float[np.ndarray, " c"]


def solve_compressed(
    inverse: ClusterInverse,
    right: Float[np.ndarray, "k c"],
    *,
    scale: Float[np.ndarray, " c"] | None = None,
    tolerance: float = 1e-9,
) -> _IterativeSolution:
    """Solve a compressed system for several right-hand sides.

    Parameters
    ----------
    inverse : ClusterInverse          of the system at the Poisson's ratio in question
    right : (k, c) float              rows in the order of `system_matrix`
    scale : (c,) float or None        norms to which residuals are relative; None: those of the
                                      right-hand sides
    tolerance : float                 of the residual, relative to the scale

    Returns
    -------
    _IterativeSolution

    Raises
    ------
    NotConvergedError                 the tolerance is not met
    """

    def product(vectors: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        return inverse.system.product(inverse.poisson_ratio, vectors)

    def low_precision(vectors: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        # Half the time. Used alone, its rounding errors, different in every product, would change
        # the deflection of a slender body by up to 1e-4.
        return product(vectors.astype(np.float32)).astype(np.float64)

    return block_gmres(
        product, inverse.solve, right, low_precision=low_precision, scale=scale, tolerance=tolerance
    )


def paired_unknowns(system: CompressedSystem) -> Int[np.ndarray, " r"]:
    """The unknown vector that is paired with each collocation point, numbered as in the system.

    Parameters
    ----------
    system : CompressedSystem

    Returns
    -------
    (r,) int
    """
    surface, unknowns, collocation = system.surface, system.unknowns, system.collocation
    free, side_vertex = unknowns.free_vertices, surface.sides.vertex[unknowns.held_sides]
    of_vertex = np.full(len(surface.mesh.vertices), -1)
    of_vertex[side_vertex] = free.size + np.arange(side_vertex.size)
    of_vertex[free] = np.arange(free.size)
    pair = of_vertex[collocation.vertex]
    several = np.bincount(side_vertex, minlength=of_vertex.size) > 1
    pair[collocation.vertex < 0] = free.size + np.flatnonzero(several[side_vertex])
    return pair


def block_gmres(
    product: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    *,
    low_precision: Callable[[np.ndarray], np.ndarray] | None = None,
    scale: Float[np.ndarray, " c"] | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 150,
) -> _IterativeSolution:
    """Solve one system for many right-hand sides.

    Parameters
    ----------
    product : callable            (k, c) -> (k, c): the matrix times vectors
    inverse : callable            (k, c) -> (k, c): preconditioner, its approximate inverse times
                                  vectors
    right : (k, c) float
    low_precision : callable or None    cheaper `product` of lower precision for the iteration,
                                  while `product` itself gives the residuals; None: `product` for
                                  both
    scale : (c,) float or None    norms to which residuals are relative; None: those of the
                                  right-hand sides
    tolerance : float             of the residual, relative to the scale
    max_iterations : int          largest number of iterations, over all rounds of refinement

    Returns
    -------
    _IterativeSolution

    Raises
    ------
    NotConvergedError             the tolerance is not met
    """
    size = np.linalg.norm(right, axis=0) + _TINY if scale is None else scale
    parts = []
    for first in range(0, right.shape[1], _BLOCK_SIZE):
        columns = slice(first, first + _BLOCK_SIZE)
        wanted = right[:, columns] / size[columns]
        if low_precision is None:
            solution = _solve_block(product, inverse, wanted, tolerance, max_iterations)
        else:
            solution = _refined(product, low_precision, inverse, wanted, tolerance, max_iterations)
        if solution.residual.max(initial=0.0) > tolerance:
            raise NotConvergedError(
                f"a system of {len(right)} equations is not solved after {max_iterations}"
                f" iterations (residual {solution.residual.max():.1e}, at most {tolerance:.0e} is"
                " allowed): a part that nothing holds makes this impossible (run `palpate check`),"
                " thin parts make it hard: simplify the surface until dense matrices serve"
            )
        parts.append(solution)
    return _IterativeSolution(
        np.concatenate([part.solution for part in parts], axis=1) * size,
        np.concatenate([part.product for part in parts], axis=1) * size,
        max(part.iterations for part in parts),
        np.concatenate([part.residual for part in parts]),
    )


def _blocks_by_point(system: CompressedSystem) -> Int[np.ndarray, " r"]:
    number = np.empty(len(system.collocation.point), dtype=np.int64)
    for k, block in enumerate(system.operator.near):
        number[block.points] = k
    return number


def _diagonal_block(
    system: CompressedSystem,
    weights: KernelWeights,
    blocks: list[NearBlock],
    points: Int[np.ndarray, " m"],
    unknowns: Int[np.ndarray, " m"],
) -> Float[np.ndarray, "k k"]:
    """Diagonal block of a cluster: the near-field coefficients of its own unknowns."""
    index = np.full(system.size // 3, -1)
    index[unknowns] = np.arange(points.size)
    row_of = np.full(len(system.collocation.point), -1)
    row_of[points] = np.arange(points.size)
    free = system.unknowns.free_vertices
    of_vertex = np.full(len(system.surface.mesh.vertices), -1)
    of_vertex[free] = index[: free.size]
    of_side = index[free.size : free.size + system.unknowns.held_sides.size]
    matrix = np.zeros((points.size, 3, points.size, 3))
    for block in blocks:
        parts = [(of_vertex[block.nodes], block.traction_matrix(weights))]
        parts.append((of_side[block.sides], block.displacement_matrix(weights)))
        for column, values in parts:
            inside = np.flatnonzero(column >= 0)
            entries = np.ix_(row_of[block.points], range(3), column[inside])
            matrix[entries] = values[..., inside].transpose(0, 1, 3, 2)
    vertex = system.collocation.vertex[points]
    column = np.where(vertex >= 0, of_vertex[vertex], -1)
    at_unknown = np.flatnonzero(column >= 0)
    row_sums = (
        weights.skew * system.operator.row_sums[0] + weights.rest * system.operator.row_sums[1]
    )
    matrix[at_unknown, :, column[at_unknown], :] -= row_sums[points[at_unknown]]
    return matrix.reshape(3 * points.size, -1)


def _refined(
    product: Callable[[np.ndarray], np.ndarray],
    low_precision: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    tolerance: float,
    max_iterations: int,
) -> _IterativeSolution:
    """Iterative refinement: every round solves for the remaining residual, with low-precision
    products as long as these suffice."""
    solution, known, iterations = np.zeros_like(right), np.zeros_like(right), 0
    residual, use_low_precision = np.linalg.norm(right, axis=0), True
    while (worst := residual.max(initial=0.0)) > tolerance and iterations < max_iterations:
        rounds = (
            np.ceil(np.log(tolerance / worst) / np.log(_LOW_PRECISION_REDUCTION))
            if use_low_precision
            else 1.0
        )
        # Half, as a margin: rounding must not cost another round.
        target = 0.5 * worst * (tolerance / worst) ** (1.0 / rounds)
        unconverged = np.flatnonzero(residual > tolerance)
        step = _solve_block(
            low_precision if use_low_precision else product,
            inverse,
            (right - known)[:, unconverged],
            target,
            max_iterations - iterations,
        )
        solution[:, unconverged] += step.solution
        known[:, unconverged] += product(step.solution) if use_low_precision else step.product
        iterations += step.iterations
        residual = np.linalg.norm(right - known, axis=0)
        use_low_precision &= (
            step.iterations <= _MAX_ROUND_ITERATIONS and residual.max() <= _MAX_EXCESS * target
        )
    return _IterativeSolution(solution, known, iterations, residual)


def _solve_block(
    product: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    tolerance: float,
    max_iterations: int,
) -> _IterativeSolution:
    """Block GMRES, with one Krylov space for all right-hand sides."""
    count = right.shape[1]
    block, start = np.linalg.qr(right)
    basis, hessenberg = [block], np.zeros((count, 0))
    residual, weights = np.linalg.norm(start, axis=0), np.zeros((0, count))
    while residual.max(initial=0.0) > tolerance and len(basis) <= max_iterations:
        block, coefficients = _orthogonalised(product(inverse(block)), basis)
        basis.append(block)
        hessenberg = np.hstack([np.pad(hessenberg, ((0, count), (0, 0))), coefficients])
        projected = np.zeros((len(hessenberg), count))
        projected[:count] = start
        q, r = np.linalg.qr(hessenberg)
        weights = np.linalg.solve(r, q.T @ projected)
        residual = np.linalg.norm(projected - hessenberg @ weights, axis=0)
    combination = _combined(basis[:-1], weights, right)
    known = _combined(basis, hessenberg @ weights, right)
    return _IterativeSolution(inverse(combination), known, len(basis) - 1, residual)


def _combined(
    basis: list[Float[np.ndarray, "k b"]],
    weights: Float[np.ndarray, "w c"],
    like: Float[np.ndarray, "k c"],
) -> Float[np.ndarray, "k c"]:
    """Blocks of vectors times weights."""
    out, count = np.zeros_like(like), like.shape[1]
    for j, block in enumerate(basis):
        out += block @ weights[count * j : count * (j + 1)]
    return out


def _orthogonalised(
    vectors: Float[np.ndarray, "k c"], basis: list[Float[np.ndarray, "k c"]]
) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "rows c"]]:
    """Vectors orthonormalised against the basis, and their coefficients: products with the basis,
    then the triangular factor."""
    coefficients = np.zeros((len(basis) * vectors.shape[1], vectors.shape[1]))
    # Twice: the first pass leaves rounding errors in proportion to what it subtracts.
    for _ in range(2):
        for i, block in enumerate(basis):
            along = block.T @ vectors
            vectors = vectors - block @ along
            coefficients[i * vectors.shape[1] : (i + 1) * vectors.shape[1]] += along
    block, rest = np.linalg.qr(vectors)
    return block, np.concatenate([coefficients, rest])
