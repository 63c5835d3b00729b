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
from scipy.linalg.blas import dtrsm
from scipy.linalg.lapack import dgetrf, dlaswp

# Unknowns up to which LAPACK's own is used; on two threads or more it is safe up to 21 800.
LARGEST_WHOLE = 15_000
_PANEL, _CHUNK = 1024, 2048


def lu_by_panels(
    matrix: Float[np.ndarray, "k k"], *, panel: int = _PANEL, chunk: int = _CHUNK
) -> tuple[Float[np.ndarray, "k k"], Int[np.ndarray, " k"]]:
    """Factorise a matrix as `scipy.linalg.lu_factor` does, whatever its size.

    Parameters
    ----------
    matrix : (k, k) float         in Fortran order; overwritten
    panel : int                   columns that are factorised together
    chunk : int                   columns that are updated together

    Returns
    -------
    lu : (k, k) float             the same array: L below its diagonal of ones, U above
    pivots : (k,) int             row with which each row was exchanged
    """
    size = len(matrix)
    pivots = np.empty(size, dtype=np.int32)
    for begin in range(0, size, panel):
        end = min(begin + panel, size)
        block, order, _ = dgetrf(matrix[begin:, begin:end].copy(order="F"), overwrite_a=True)
        matrix[begin:, begin:end] = block
        pivots[begin:end] = begin + order
        _exchange(matrix[:, :begin], pivots, begin, end)
        for first in range(end, size, chunk):
            columns = matrix[:, first : first + chunk]
            _exchange(columns, pivots, begin, end)
            upper = dtrsm(1.0, block[: end - begin], columns[begin:end], lower=True, diag=True)
            columns[begin:end] = upper
            columns[end:] -= block[end - begin :] @ upper
    return matrix, pivots


def _exchange(
    columns: Float[np.ndarray, "k c"], pivots: Int[np.ndarray, " k"], begin: int, end: int
) -> None:
    """Exchange rows of some columns in place by the pivots from begin to end."""
    if columns.size:
        dlaswp(columns, pivots[:end], k1=begin, k2=end - 1, overwrite_a=True)
