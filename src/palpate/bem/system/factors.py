"""LU factors of the system at one Poisson's ratio, and its solutions."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_lapack_funcs, lu_factor, lu_solve

from palpate.bem.system.large_lu import LARGEST_WHOLE, lu_by_panels
from palpate.bem.system.matrix import matrix_and_slope, system_matrix
from palpate.bem.system.rollers import Elimination, make_elimination
from palpate.bem.system.slope import SystemSlope
from palpate.bem.system.system import BoundarySystem, Precision
from palpate.errors import SingularSystemError

# An unsupported body has less than 3e-14, a sheet 80 times as long as thick more than 1e-12.
SMALLEST_RCOND = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class FactorisedSystem:
    """The system at one Poisson's ratio, ready to be solved.

    Attributes
    ----------
    poisson_ratio : float
    lu, pivots : arrays                   LAPACK's LU factors
    elimination : Elimination or None     reduction to the system that is factorised, where supports
                                          hold some directions only
    reciprocal_condition : float          estimate in the 1-norm
    """

    poisson_ratio: float
    lu: Float[np.ndarray, "k k"]
    pivots: Int[np.ndarray, " k"]
    elimination: Elimination | None
    reciprocal_condition: float


def system_elimination(system: BoundarySystem) -> Elimination | None:
    """Reduction to the square system that is factorised; None where supports hold all directions.

    Parameters
    ----------
    system : BoundarySystem
    """
    return make_elimination(system.surface, system.unknowns, system.collocation, system.order)


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
    elimination = system_elimination(system)
    if elimination is not None:
        matrix = elimination.matrix(matrix)
    return _factors(matrix, poisson_ratio, elimination)


def factorise_with_slope(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> tuple[FactorisedSystem, SystemSlope]:
    """`factorise` and the derivative of the matrix (`system_slope`), from the same integrals.

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
    elimination = system_elimination(system)
    if elimination is not None:
        matrix = elimination.matrix(matrix)
    return _factors(matrix, poisson_ratio, elimination), slope


def _factors(
    matrix: Float[np.ndarray, "k k"], poisson_ratio: float, elimination: Elimination | None
) -> FactorisedSystem:
    """LU factors of a square matrix, which they overwrite."""
    gecon, lange = get_lapack_funcs(("gecon", "lange"), (matrix,))
    norm = lange("1", matrix)
    if len(matrix) > LARGEST_WHOLE:
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
    given = right if elimination is None else elimination.right(right)
    # Of another type, the factors would be copied.
    given = given.astype(factorised.lu.dtype, copy=False)
    solution = lu_solve(pair, given, check_finite=False).astype(float, copy=False)
    return solution if elimination is None else elimination.unknowns(solution)
