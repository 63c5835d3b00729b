"""LU factors of a system, and its solutions: at one Poisson's ratio, or about it.

Along the directions that a roller holds, the displacement is prescribed and the traction unknown;
along the others it is the other way round. The full system has both as unknowns, and their known
components are eliminated before it is solved: the columns are combined to those that remain, the
rows to as many. Rigid-body motions that no support restrains, such as sliding along a plane or a
rotation about an axis, are constrained to a mean of zero over the surface; callers that measure
them add them again. The constraint on a translation replaces the force balance along it, which the
load must satisfy by itself. That on a rotation stands for a moment balance, with a slack as for the
forces.

Large matrices are factorised by panels (`lu_by_panels`): OpenBLAS packs the data of each thread
into a buffer of fixed size and writes beyond its end where a thread has more than some 10 900
columns; on two threads the process crashes from 22 000 unknowns on.

Source
------
Golub and Van Loan, Matrix Computations (2013), section 3.6.1: outer products by blocks with partial
pivoting.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_blas_funcs, get_lapack_funcs, lu_factor, lu_solve, orth
from scipy.sparse import block_diag, csr_array, eye_array

from palpate.arrays import components_of
from palpate.bem.integrals.assembly import Collocation
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.system.matrix import SystemSlope, matrix_and_slope, system_matrix
from palpate.bem.system.system import BoundarySystem, Precision, Unknowns, find_unknowns
from palpate.checkpoints import content_digest
from palpate.errors import SingularSystemError
from palpate.threads import parallel_algebra

# An unsupported body has less than 3e-14, a sheet 80 times as long as thick more than 1e-12.
SMALLEST_RCOND = 1e-13
# Unknowns above which factors in single precision, half the work, save time worth mentioning, and
# up to which the condition usually allows them: that of a lump of 31 000 did not.
_SMALLEST_SINGLE, _LARGEST_SINGLE = 3000, 15_000
# Reciprocal condition above which their solutions have errors below 1e-4. A beam of 24 by 24 by
# 120 mm has 5e-8 and an error of 6e-6; plates of 60 by 40 mm that are held at an end have 3e-8 and
# 4e-5 (5 mm thick), 6e-10 and 6e-4 (2 mm).
_SMALLEST_SINGLE_RCOND = 1e-8
# Singular value, relative to the largest, up to which a rigid-body motion counts as not held.
_UNRESTRAINED = 1e-6
# The equations are multiplied by 8 pi (1 - nu): added rows and columns are scaled alike.
_SCALE = 8 * np.pi
_CHUNK = 1000
# Unknowns up to which LAPACK's own is used; on two threads or more it is safe up to 21 800.
_LARGEST_WHOLE = 15_000
_PANEL, _COLUMNS_AT_A_TIME = 1024, 2048


@dataclass(frozen=True, slots=True, eq=False)
class _Elimination:
    """Reduction of the full system, r rows and k unknowns, to the square one that is solved.

    The square matrix is [[rows M columns, slack], [constraints columns, 0]], its right-hand side
    [rows b, 0]; `columns` times its first n unknowns solves the full system.

    Attributes
    ----------
    rows : (m, r) sparse
    columns : (k, n) sparse               orthonormal
    slack : (m, e) float                  of the moment balances that no support provides
    constraints : (q, k) float            mean of each rigid-body motion that is not held, up to a
                                          factor
    """

    rows: csr_array
    columns: csr_array
    slack: Float[np.ndarray, "m e"]
    constraints: Float[np.ndarray, "q k"]

    def matrix(self, full: Float[np.ndarray, "r k"]) -> Float[np.ndarray, "s s"]:
        """The square matrix, in Fortran order and in the precision of the full one.

        Parameters
        ----------
        full : (r, k) float

        Returns
        -------
        (s, s) float
        """
        m, n = self.rows.shape[0], self.columns.shape[1]
        size = n + self.slack.shape[1], m + len(self.constraints)
        square = np.zeros(size, dtype=full.dtype).T
        rows, columns = self.rows.astype(full.dtype), self.columns.astype(full.dtype)
        # By blocks of columns: the product as a whole would double the memory.
        for first in range(0, n, _CHUNK):
            part = slice(first, min(first + _CHUNK, n))
            square[:m, part] = rows @ (columns[:, part].T @ full.T).T
        square[:m, n:] = self.slack
        square[m:, :n] = (self.columns.T @ self.constraints.T).T
        return square

    def right(self, full: Float[np.ndarray, "r c"]) -> Float[np.ndarray, "s c"]:
        """Right-hand sides of the square system, (s, c), from those of the full one, (r, c)."""
        return np.concatenate([self.rows @ full, np.zeros((len(self.constraints), full.shape[1]))])

    def unknowns(self, solution: Float[np.ndarray, "s c"]) -> Float[np.ndarray, "k c"]:
        """All unknowns, (k, c), from a solution of the square system, (s, c)."""
        return self.columns @ solution[: self.columns.shape[1]]


@dataclass(frozen=True, slots=True, eq=False)
class FactorisedSystem:
    """The system at one Poisson's ratio, ready to be solved.

    Attributes
    ----------
    poisson_ratio : float
    lu, pivots : arrays                   LAPACK's LU factors
    elimination : _Elimination or None    reduction to the system that is factorised, where
                                          supports hold some directions only
    reciprocal_condition : float          estimate in the 1-norm
    """

    poisson_ratio: float
    lu: Float[np.ndarray, "k k"]
    pivots: Int[np.ndarray, " k"]
    elimination: _Elimination | None
    reciprocal_condition: float


def factorise(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> FactorisedSystem:
    """Factorise the system at one Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float     -1 < nu <= 0.5
    precision : type          of the factors

    Returns
    -------
    FactorisedSystem

    Raises
    ------
    SingularSystemError       the reciprocal condition is below 1e-13, most often because of
                              coinciding or degenerate parts of the mesh
    """
    matrix = system_matrix(system, poisson_ratio, precision=precision)
    elimination = _system_elimination(system)
    if elimination is not None:
        matrix = elimination.matrix(matrix)
    return _factors(matrix, poisson_ratio, elimination)


def solve(
    factorised: FactorisedSystem, right: Float[np.ndarray, "r c"]
) -> Float[np.ndarray, "k c"]:
    """Solve the factorised system for several right-hand sides.

    Parameters
    ----------
    factorised : FactorisedSystem
    right : (r, c) float      rows in the order of `system_matrix`

    Returns
    -------
    (k, c) float [m]          unknowns as in `BoundarySystem`
    """
    pair, elimination = (factorised.lu, factorised.pivots), factorised.elimination
    scaled = right if elimination is None else elimination.right(right)
    # Of another type, the factors would be copied.
    scaled = scaled.astype(factorised.lu.dtype, copy=False)
    with parallel_algebra(len(factorised.lu)):
        solution = lu_solve(pair, scaled, check_finite=False).astype(float, copy=False)
    return solution if elimination is None else elimination.unknowns(solution)


@dataclass(frozen=True, eq=False)
class CentredSystem:
    """A dense system with its factors at one Poisson's ratio and the derivative of its matrix, both
    computed when they are first needed, or read from the system's `checkpoints`.

    Attributes
    ----------
    system : BoundarySystem
    poisson_ratio : float       -1 < nu <= 0.5
    single : bool               True: solutions may have relative errors of 1e-4; in single
                                precision, then, where that is faster and the condition of the
                                system allows it

    Raises
    ------
    SingularSystemError         as `factorise`, when the factors are first needed
    """

    system: BoundarySystem
    poisson_ratio: float
    single: bool = False

    @property
    def factorised(self) -> FactorisedSystem:
        """The factors."""
        return self._factors_and_slope[0]

    @property
    def slope(self) -> SystemSlope:
        """The derivative of the matrix with respect to Poisson's ratio."""
        return self._factors_and_slope[1]

    @cached_property
    def _factors_and_slope(self) -> tuple[FactorisedSystem, SystemSlope]:
        name = content_digest(("factors", self.poisson_ratio, self.single))
        factorised, slope = self.system.checkpoints.load_or_make(name, self._compute)
        return replace(factorised, elimination=_system_elimination(self.system)), slope

    def _compute(self) -> tuple[FactorisedSystem, SystemSlope]:
        """Both, without the elimination, which holds sparse matrices and is made in no time."""
        if self.single and _SMALLEST_SINGLE < self.system.size <= _LARGEST_SINGLE:
            factors = self._compute_in(np.float32)
            if factors[0].reciprocal_condition > _SMALLEST_SINGLE_RCOND:
                return factors
            del factors
        return self._compute_in(np.float64)

    def _compute_in(self, precision: Precision) -> tuple[FactorisedSystem, SystemSlope]:
        factors, slope = _factorise_with_slope(self.system, self.poisson_ratio, precision=precision)
        return replace(factors, elimination=None), slope


def unrestrained_motions(surface: BoundarySurface) -> Float[np.ndarray, "v 3 q"]:
    """Infinitesimal rigid-body motions that no support restrains.

    Parameters
    ----------
    surface : BoundarySurface

    Returns
    -------
    (v, 3, q) float [-]           displacement of every vertex; translations first, then rotations
    """
    unknowns = find_unknowns(surface)
    modes = _rigid_modes(surface.mesh.vertices, surface.mesh.vertices[unknowns.held_vertices])
    return modes @ _unrestrained(modes, unknowns)


def bases(projectors: Float[np.ndarray, "n 3 3"]) -> csr_array:
    """Orthonormal bases of the ranges of projectors, as a block-diagonal matrix.

    Parameters
    ----------
    projectors : (n, 3, 3) float

    Returns
    -------
    (3 n, q) sparse               the coordinate axes where a projector is the identity
    """
    value, vector = np.linalg.eigh(projectors)
    in_range = value > 0.5
    is_identity = np.isclose(projectors, np.eye(3), atol=1e-12).all(axis=(1, 2))
    vector[is_identity] = np.eye(3)
    block, column = np.nonzero(in_range)
    data = vector[block, :, column].ravel()
    row = components_of(block)
    number = np.repeat(np.arange(block.size), 3)
    return csr_array((data, (row, number)), shape=(3 * len(projectors), block.size))


def lu_by_panels(
    matrix: Float[np.ndarray, "k k"], *, panel: int = _PANEL, chunk: int = _COLUMNS_AT_A_TIME
) -> tuple[Float[np.ndarray, "k k"], Int[np.ndarray, " k"]]:
    """Factorise a matrix as `scipy.linalg.lu_factor` does, whatever its size.

    Parameters
    ----------
    matrix : (k, k) float         in Fortran order, in single or double precision; overwritten
    panel : int                   columns that are factorised together
    chunk : int                   columns that are updated together

    Returns
    -------
    lu : (k, k) float             the same array: L below its diagonal of ones, U above
    pivots : (k,) int             row with which each row was exchanged
    """
    getrf, laswp = get_lapack_funcs(("getrf", "laswp"), (matrix,))
    trsm, gemm = get_blas_funcs(("trsm", "gemm"), (matrix,))
    size = len(matrix)
    pivots = np.empty(size, dtype=np.int32)

    def exchange(columns: Float[np.ndarray, "k c"], begin: int, end: int) -> None:
        """Exchange rows of some columns in place by the pivots from begin to end."""
        if columns.size:
            laswp(columns, pivots[:end], k1=begin, k2=end - 1, overwrite_a=True)

    for begin in range(0, size, panel):
        end = min(begin + panel, size)
        block, order, _ = getrf(matrix[begin:, begin:end].copy(order="F"), overwrite_a=True)
        matrix[begin:, begin:end] = block
        pivots[begin:end] = begin + order
        exchange(matrix[:, :begin], begin, end)
        unit, lower = (np.asfortranarray(part) for part in np.split(block, [end - begin]))
        for first in range(end, size, chunk):
            columns = matrix[:, first : first + chunk]
            exchange(columns, begin, end)
            upper = trsm(1.0, unit, columns[begin:end], lower=True, diag=True)
            columns[begin:end] = upper
            # By the library that solves: idle threads of numpy's would take its processors.
            columns[end:] -= gemm(1.0, lower, upper)
    return matrix, pivots


def _system_elimination(system: BoundarySystem) -> _Elimination | None:
    """Reduction to the square system that is factorised; None where supports hold all directions.

    Parameters
    ----------
    system : BoundarySystem
    """
    return _make_elimination(system.surface, system.unknowns, system.collocation, system.order)


def _factorise_with_slope(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> tuple[FactorisedSystem, SystemSlope]:
    """`factorise` and the derivative of the matrix (`matrix_and_slope`), from the same integrals.

    Parameters
    ----------
    system, poisson_ratio, precision    as in `factorise`

    Returns
    -------
    FactorisedSystem
    SystemSlope

    Raises
    ------
    SingularSystemError       as `factorise`
    """
    matrix, slope = matrix_and_slope(system, poisson_ratio, precision=precision)
    elimination = _system_elimination(system)
    if elimination is not None:
        matrix = elimination.matrix(matrix)
    return _factors(matrix, poisson_ratio, elimination), slope


def _factors(
    matrix: Float[np.ndarray, "k k"], poisson_ratio: float, elimination: _Elimination | None
) -> FactorisedSystem:
    """LU factors of a square matrix, which they overwrite."""
    gecon, lange = get_lapack_funcs(("gecon", "lange"), (matrix,))
    norm = lange("1", matrix)
    with parallel_algebra(len(matrix)):
        if len(matrix) > _LARGEST_WHOLE:
            lu, pivots = lu_by_panels(matrix)
        else:
            lu, pivots = lu_factor(matrix, overwrite_a=True, check_finite=False)
    rcond = float(gecon(lu, norm)[0])
    if not rcond > SMALLEST_RCOND:
        raise SingularSystemError(
            f"the system of {len(matrix)} equations is singular (reciprocal condition {rcond:.1e}, "
            f"at least {SMALLEST_RCOND:.0e} is needed); the mesh has coinciding or degenerate "
            "parts: run `palpate check`"
        )
    return FactorisedSystem(poisson_ratio, lu, pivots, elimination, rcond)


def _make_elimination(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    order: Int[np.ndarray, " p"],
) -> _Elimination | None:
    """Reduction of the full system where supports hold some directions only.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    order : (p,) int              collocation point of each row of one component

    Returns
    -------
    Elimination or None           None where all supports hold all directions
    """
    n_free, n_points = unknowns.free_vertices.size, order.size
    if unknowns.free_vertices.size + unknowns.held_vertices.size == len(surface.mesh.vertices):
        return None
    free_directions = np.tile(np.eye(3), (len(surface.mesh.vertices), 1, 1))
    free_directions[unknowns.held_vertices] -= unknowns.vertex_directions
    free_basis = bases(free_directions[unknowns.free_vertices])
    columns = block_diag([free_basis, bases(unknowns.side_directions), eye_array(3)], format="csr")
    supported = orth(unknowns.side_directions.sum(axis=0), rcond=_UNRESTRAINED)
    by_point = bases(_equations(surface, unknowns, collocation, free_directions)[order])
    # Rows of the full system are ordered by component first.
    rows_of_points = (np.arange(n_points)[:, None] + n_points * np.arange(3)).ravel()
    permutation = csr_array(
        (np.ones(3 * n_points), (np.arange(3 * n_points), rows_of_points)),
        shape=(3 * n_points,) * 2,
    )
    rows = block_diag([by_point.T @ permutation, supported.T], format="csr")
    unrestrained = unrestrained_motions(surface)
    rotations = _slack(surface, unknowns, collocation.point[order], 3 - supported.shape[1])
    slack = np.zeros((rows.shape[0], rotations.shape[2]))
    slack[: -supported.shape[1]] = by_point.T @ rotations.reshape(3 * n_points, -1)
    constraints = np.zeros((unrestrained.shape[2], columns.shape[0]))
    constraints[:, : 3 * n_free] = unrestrained[unknowns.free_vertices].reshape(3 * n_free, -1).T
    norm = np.linalg.norm(constraints, axis=1, keepdims=True)
    return _Elimination(
        csr_array(rows), csr_array(columns), _SCALE * slack, _SCALE * constraints / norm
    )


def _equations(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    free_directions: Float[np.ndarray, "v 3 3"],
) -> Float[np.ndarray, "p 3 3"]:
    """Projector onto the components of the integral equation that are used at each point."""
    side_vertex = surface.sides.vertex[unknowns.held_sides]
    several = np.zeros(len(surface.mesh.vertices), dtype=bool)
    several[unknowns.held_vertices] = ~unknowns.shares_one_point(side_vertex)
    at_vertex = collocation.vertex >= 0
    used = np.tile(np.eye(3), (at_vertex.size, 1, 1))
    vertex = collocation.vertex[at_vertex]
    used[at_vertex] = np.where(several[vertex, None, None], free_directions[vertex], np.eye(3))
    used[~at_vertex] = unknowns.side_directions[several[side_vertex]]
    return used


def _slack(
    surface: BoundarySurface, unknowns: Unknowns, point: Float[np.ndarray, "p 3"], translations: int
) -> Float[np.ndarray, "p 3 e"]:
    """The unrestrained rigid-body motions other than translations, at points."""
    held = surface.mesh.vertices[unknowns.held_vertices]
    unrestrained = _unrestrained(_rigid_modes(surface.mesh.vertices, held), unknowns)
    return _rigid_modes(point, held) @ unrestrained[:, translations:]


def _rigid_modes(
    points: Float[np.ndarray, "n 3"], held: Float[np.ndarray, "h 3"]
) -> Float[np.ndarray, "n 3 6"]:
    """Three translations, and three rotations about the centroid of the held vertices, scaled to
    move these by about one."""
    offset = points - held.mean(axis=0)
    length = np.sqrt(((held - held.mean(axis=0)) ** 2).sum(axis=1).mean())
    rotations = np.cross(np.eye(3)[None], offset[:, None]) / length
    translations = np.tile(np.eye(3), (len(points), 1, 1))
    return np.concatenate([translations, rotations.transpose(0, 2, 1)], axis=2)


def _unrestrained(
    modes: Float[np.ndarray, "v 3 6"], unknowns: Unknowns
) -> Float[np.ndarray, "6 q"]:
    """Combinations of rigid-body modes that no support restrains, translations first."""
    held = unknowns.vertex_directions @ modes[unknowns.held_vertices]
    motions = _null_space(held.reshape(-1, 6))
    translations = _null_space(unknowns.side_directions.sum(axis=0))
    translations = np.concatenate([translations, np.zeros((3, translations.shape[1]))])
    others = np.linalg.svd(
        motions - translations @ (translations.T @ motions), full_matrices=False
    )[0]
    return np.concatenate(
        [translations, others[:, : motions.shape[1] - translations.shape[1]]], axis=1
    )


def _null_space(matrix: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k q"]:
    """Orthonormal basis of the null space of a matrix of k rows or more."""
    _, size, vectors = np.linalg.svd(matrix, full_matrices=False)
    return vectors[size <= _UNRESTRAINED * size.max()].T
