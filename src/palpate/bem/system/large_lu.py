"""LU factorisation of matrices that are too large for the threaded one of OpenBLAS.

OpenBLAS packs the data of each thread into a buffer of fixed size and writes beyond its end where a
thread has more than some 10 900 columns: on two threads the process crashes from 22 000 unknowns
on. Here the same algorithm proceeds by panels and chunks of columns, so that no thread ever has
more columns than a chunk.

Source
------
Golub and Van Loan, Matrix Computations (2013), section 3.6.1: outer products by blocks with partial
pivoting.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_blas_funcs, get_lapack_funcs

# Unknowns up to which LAPACK's own is used; on two threads or more it is safe up to 21 800.
LARGEST_WHOLE = 15_000
_PANEL, _CHUNK = 1024, 2048


def lu_by_panels(
    matrix: Float[np.ndarray, "k k"], *, panel: int = _PANEL, chunk: int = _CHUNK
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
