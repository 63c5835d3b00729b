"""Block-diagonal preconditioner of the compressed system, one block per cluster, and the iterative
solution with it."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lu_factor, lu_solve

from palpate.bem.compressed.krylov import IterativeSolution, block_gmres
from palpate.bem.compressed.moments import KernelWeights
from palpate.bem.compressed.near_field import NearBlock
from palpate.bem.compressed.system import SLACK, CompressedSystem, scaled_weights
from palpate.threads import in_threads


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
                own = rows[self.points[k]].reshape(-1, rows.shape[2])
                found = lu_solve(self.factors[k], own, check_finite=False)
                out[self.unknowns[k]] = found.reshape(-1, 3, rows.shape[2])

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
    tree = system.operator.far.receivers.tree
    size = tree.stop - tree.start
    chosen = np.flatnonzero(size <= max_points)
    inner = tree.children[chosen].ravel()
    chosen = np.setdiff1d(chosen, inner[inner >= 0])
    points = [tree.members(int(one)) for one in chosen]
    pair = paired_unknowns(system)
    unknowns = [pair[own] for own in points]
    block_of = _blocks_by_point(system)
    factors: list[tuple[np.ndarray, np.ndarray]] = [(np.zeros(0), np.zeros(0))] * len(points)

    def factorise(begin: int, end: int) -> None:
        for k in range(begin, end):
            blocks = [system.operator.near.blocks[b] for b in np.unique(block_of[points[k]])]
            own = _diagonal_block(system, weights, blocks, points[k], unknowns[k])
            factors[k] = lu_factor(own, overwrite_a=True, check_finite=False)

    in_threads(factorise, len(points))
    no_slack = np.zeros((system.size - 3, 3)), np.eye(3)
    without_slack = ClusterInverse(system, poisson_ratio, points, unknowns, factors, *no_slack)
    slack_solutions = without_slack.solve_blocks(np.tile(SLACK * np.eye(3), (len(pair), 1, 1)))
    return replace(
        without_slack,
        slack_solutions=slack_solutions,
        slack_force=without_slack.force(slack_solutions),
    )


def solve_compressed(
    inverse: ClusterInverse,
    right: Float[np.ndarray, "k c"],
    *,
    scale: Float[np.ndarray, " c"] | None = None,
    tolerance: float = 1e-9,
) -> IterativeSolution:
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
    IterativeSolution

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


def _blocks_by_point(system: CompressedSystem) -> Int[np.ndarray, " r"]:
    number = np.empty(len(system.collocation.point), dtype=np.int64)
    for k, block in enumerate(system.operator.near.blocks):
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
            kept = np.flatnonzero(column >= 0)
            entries = np.ix_(row_of[block.points], range(3), column[kept])
            matrix[entries] = values[..., kept].transpose(0, 1, 3, 2)
    vertex = system.collocation.vertex[points]
    column = np.where(vertex >= 0, of_vertex[vertex], -1)
    own = np.flatnonzero(column >= 0)
    row_sums = (
        weights.skew * system.operator.row_sums[0] + weights.rest * system.operator.row_sums[1]
    )
    matrix[own, :, column[own], :] -= row_sums[points[own]]
    return matrix.reshape(3 * points.size, -1)
