"""Block GMRES: many right-hand sides of one large system at a time.

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
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError

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
class IterativeSolution:
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


def block_gmres(
    product: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    *,
    low_precision: Callable[[np.ndarray], np.ndarray] | None = None,
    scale: Float[np.ndarray, " c"] | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 150,
) -> IterativeSolution:
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
    IterativeSolution

    Raises
    ------
    NotConvergedError             the tolerance is not met
    """
    size = np.linalg.norm(right, axis=0) + _TINY if scale is None else scale
    parts = []
    for first in range(0, right.shape[1], _BLOCK_SIZE):
        own = slice(first, first + _BLOCK_SIZE)
        wanted = right[:, own] / size[own]
        if low_precision is None:
            found = _solve_block(product, inverse, wanted, tolerance, max_iterations)
        else:
            found = _refined(product, low_precision, inverse, wanted, tolerance, max_iterations)
        if found.residual.max(initial=0.0) > tolerance:
            raise NotConvergedError(
                f"a system of {len(right)} equations is not solved after {max_iterations}"
                f" iterations (residual {found.residual.max():.1e}, at most {tolerance:.0e} is"
                " allowed): a part that nothing holds makes this impossible (run `palpate check`),"
                " thin parts make it hard: simplify the surface until dense matrices serve"
            )
        parts.append(found)
    return IterativeSolution(
        np.concatenate([part.solution for part in parts], axis=1) * size,
        np.concatenate([part.product for part in parts], axis=1) * size,
        max(part.iterations for part in parts),
        np.concatenate([part.residual for part in parts]),
    )


def _refined(
    product: Callable[[np.ndarray], np.ndarray],
    low_precision: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    tolerance: float,
    max_iterations: int,
) -> IterativeSolution:
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
        own = np.flatnonzero(residual > tolerance)
        step = _solve_block(
            low_precision if use_low_precision else product,
            inverse,
            (right - known)[:, own],
            target,
            max_iterations - iterations,
        )
        solution[:, own] += step.solution
        known[:, own] += product(step.solution) if use_low_precision else step.product
        iterations += step.iterations
        residual = np.linalg.norm(right - known, axis=0)
        use_low_precision &= (
            step.iterations <= _MAX_ROUND_ITERATIONS and residual.max() <= _MAX_EXCESS * target
        )
    return IterativeSolution(solution, known, iterations, residual)


def _solve_block(
    product: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    tolerance: float,
    max_iterations: int,
) -> IterativeSolution:
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
    return IterativeSolution(inverse(combination), known, len(basis) - 1, residual)


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
