"""Kernels for linear systems of a few unknowns.

Purpose    : factorise and solve the normal equations of a match or a fit, one of thousands.
Takes      : small symmetric matrices, from kernels of the other rooms.
Gives      : Cholesky factors, solutions and inverses; sums of products.
Depends on : nothing but the ground floor.
Read first : `cholesky.py`.
"""

from palpate.vision.small_systems.cholesky import (
    add_congruence_kernel as add_congruence_kernel,
    add_transposed_kernel as add_transposed_kernel,
    cholesky_inverse_kernel as cholesky_inverse_kernel,
    cholesky_kernel as cholesky_kernel,
    cholesky_solve_kernel as cholesky_solve_kernel,
    product_kernel as product_kernel,
)
