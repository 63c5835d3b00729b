"""Kernels for linear systems of a few unknowns.

Purpose    : factorise and solve the normal equations of a match or a fit, one of thousands.
Takes      : small symmetric matrices, from kernels of the other rooms.
Gives      : Cholesky factors, solutions and inverses; sums of products.
Depends on : nothing but the ground floor.
Read first : `cholesky.py`.
"""
