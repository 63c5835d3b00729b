"""Symmetric positive definite systems of up to about twenty unknowns, for use inside kernels."""

import math

from numba import njit

# A pivot below this fraction of its diagonal entry is rounding error: the system is singular.
_MIN_PIVOT = 1e-9


@njit(cache=True, error_model="numpy")
def cholesky_kernel(a, min_pivot=_MIN_PIVOT):
    """Overwrite the lower triangle with the Cholesky factor; False if not positive definite.

    `a` (n, n) float is symmetric; only its lower triangle is read. A pivot below `min_pivot` (0 to
    1) times its original diagonal entry counts as zero.

    Source: Golub and Van Loan, Matrix Computations (2013), chapter 4.
    """
    n = len(a)
    for j in range(n):
        pivot = a[j, j]
        for k in range(j):
            pivot -= a[j, k] * a[j, k]
        if not pivot > min_pivot * a[j, j]:
            return False
        root = math.sqrt(pivot)
        a[j, j] = root
        for i in range(j + 1, n):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = total / root
    return True


@njit(cache=True, error_model="numpy")
def cholesky_solve_kernel(factor, right):
    """Overwrite the right-hand side, (n,) float, with the solution; see `cholesky_kernel`."""
    n = len(right)
    for i in range(n):
        total = right[i]
        for k in range(i):
            total -= factor[i, k] * right[k]
        right[i] = total / factor[i, i]
    for i in range(n - 1, -1, -1):
        total = right[i]
        for k in range(i + 1, n):
            total -= factor[k, i] * right[k]
        right[i] = total / factor[i, i]


@njit(cache=True, error_model="numpy")
def cholesky_inverse_kernel(factor, inverse):
    """Write the inverse of the matrix with the given Cholesky factor into `inverse`, (n, n)."""
    n = len(factor)
    for j in range(n):
        inverse[j, :] = 0.0
        inverse[j, j] = 1.0
        cholesky_solve_kernel(factor, inverse[j])


@njit(cache=True, error_model="numpy")
def add_transposed_kernel(matrix, vector, factor, total):
    """Add factor * matrix^T vector to `total`; `matrix` is (k, m) float, `vector` (k,).

    For so small matrices faster than numpy.dot, which also takes seconds to compile.
    """
    for k in range(len(vector)):
        for m in range(len(total)):
            total[m] += factor * matrix[k, m] * vector[k]


@njit(cache=True, error_model="numpy")
def add_congruence_kernel(inner, matrix, factor, total):
    """Add factor * matrix^T inner matrix to `total`, (m, m); `inner` is (k, k), `matrix` (k, m)."""
    for k in range(len(inner)):
        for m in range(len(total)):
            product = 0.0
            for h in range(len(inner)):
                product += inner[k, h] * matrix[h, m]
            for n in range(len(total)):
                total[n, m] += factor * matrix[k, n] * product


@njit(cache=True, error_model="numpy")
def product_kernel(matrix, vector, factor, out):
    """Write factor * matrix vector into `out`, (k,); `matrix` is (k, m) float, `vector` (m,)."""
    for k in range(len(out)):
        total = 0.0
        for m in range(len(vector)):
            total += matrix[k, m] * vector[m]
        out[k] = factor * total
