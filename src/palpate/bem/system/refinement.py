"""Solutions in double precision from a factorisation in single precision.

The factors take half the memory and half the time; what single precision lacks comes from the
residual in double precision, solved for again and again.

Source
------
Golub and Van Loan, Matrix Computations (2013), section 3.5.3: fixed precision iterative
improvement, with the residual in double.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float32, Int
from scipy.linalg import lu_solve

from palpate.errors import NotConvergedError

# Residual over right-hand side; double precision alone leaves about 1e-13 of it.
TOLERANCE = 1e-11
# A step that leaves more than this of the residual is not worth its product: the factors are too
# coarse for the matrix.
SLOWEST_STEP = 0.1
_MOST_STEPS = 15

Product = Callable[[Float[np.ndarray, "k c"]], Float[np.ndarray, "k c"]]


def refined_solution(
    product: Product,
    lu: Float32[np.ndarray, "k k"],
    pivots: Int[np.ndarray, " k"],
    right: Float[np.ndarray, "k c"],
) -> Float[np.ndarray, "k c"]:
    """Solve a system for several right-hand sides.

    Parameters
    ----------
    product : callable        the matrix, in double precision, times vectors
    lu, pivots : arrays       its factorisation, in single precision
    right : (k, c) float

    Returns
    -------
    (k, c) float              residual of every column at most `TOLERANCE` of its right-hand side

    Raises
    ------
    NotConvergedError         the factors are too coarse for the matrix
    """
    size = np.linalg.norm(right, axis=0)
    size[size == 0.0] = 1.0
    solution, residual, worst = np.zeros_like(right), right, 1.0
    for _ in range(_MOST_STEPS):
        # Columns of length one: single precision has no small numbers.
        scale = np.linalg.norm(residual, axis=0)
        scale[scale == 0.0] = 1.0
        step = lu_solve((lu, pivots), (residual / scale).astype(np.float32), check_finite=False)
        solution = solution + scale * step
        residual = right - product(solution)
        before, worst = worst, float((np.linalg.norm(residual, axis=0) / size).max())
        if worst <= TOLERANCE:
            return solution
        if not worst <= SLOWEST_STEP * before:
            break
    raise NotConvergedError(
        f"refinement of a solution in single precision stops at a residual of {worst:.1e}, at most"
        f" {TOLERANCE:.0e} is allowed"
    )


def refines(product: Product, lu: np.ndarray, pivots: np.ndarray) -> bool:
    """Whether factors in single precision are good enough for their matrix.

    Parameters
    ----------
    product : callable        the matrix, in double precision, times vectors
    lu, pivots : arrays       its factorisation, in single precision
    """
    right = np.random.default_rng(0).normal(size=(len(lu), 2))
    try:
        refined_solution(product, lu, pivots, right)
    except NotConvergedError:
        return False
    return True
