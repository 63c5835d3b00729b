"""Many right-hand sides of one large system at a time (GMRES).

Every right-hand side has a Krylov space of its own; all products are made together, which is what
makes them fast.

Source
------
Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 9.5: preconditioned from the
right, so that the residual is that of the system itself.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError

_TINY = np.finfo(float).tiny


@dataclass(frozen=True, slots=True, eq=False)
class IterativeSolution:
    """Solutions, and what they took.

    Attributes
    ----------
    solution : (k, c) float
    iterations : int              products with the matrix, all right-hand sides at once
    residual : (c,) float         relative to the right-hand side
    """

    solution: Float[np.ndarray, "k c"]
    iterations: int
    residual: Float[np.ndarray, " c"]


def solve_together(
    product: Callable[[np.ndarray], np.ndarray],
    inverse: Callable[[np.ndarray], np.ndarray],
    right: Float[np.ndarray, "k c"],
    *,
    scale: Float[np.ndarray, " c"] | None = None,
    tolerance: float = 1e-9,
    most: int = 150,
) -> IterativeSolution:
    """Solve one system for many right-hand sides.

    Parameters
    ----------
    product : callable            (k, c) -> (k, c): the matrix times vectors
    inverse : callable            (k, c) -> (k, c): roughly its inverse times vectors
    right : (k, c) float
    scale : (c,) float or None    what residuals are relative to; None: each right-hand side
    tolerance : float             of the residual, relative to the scale
    most : int                    iterations

    Returns
    -------
    IterativeSolution

    Raises
    ------
    NotConvergedError             the tolerance is not met
    """
    size = np.linalg.norm(right, axis=0)
    scale = size + _TINY if scale is None else scale
    basis = [right / (size + _TINY)]
    steps: list[np.ndarray] = []
    residual, weights = size / scale, np.zeros((right.shape[1], 0))
    while residual.max(initial=0.0) > tolerance and len(steps) < most:
        direction, step = _orthogonalised(product(inverse(basis[-1])), basis)
        steps.append(step)
        weights, left = _least_squares(steps, size)
        residual = left / scale
        basis.append(direction)
    if residual.max(initial=0.0) > tolerance:
        raise NotConvergedError(
            f"the system of {len(right)} equations is not solved after {most} iterations (residual"
            f" {residual.max():.1e}, at most {tolerance:.0e} is allowed); thin parts make this"
            " hard: simplify the surface until the dense matrices fit into memory"
        )
    mixed = np.zeros_like(right)
    for j in range(len(steps)):
        mixed += weights[:, j] * basis[j]
    return IterativeSolution(inverse(mixed), len(steps), residual)


def _orthogonalised(
    vectors: Float[np.ndarray, "k c"], basis: list[Float[np.ndarray, "k c"]]
) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "rows c"]]:
    """Unit vectors orthogonal to the basis, and what was taken away, then the length of the rest
    (modified Gram-Schmidt)."""
    step = np.empty((len(basis) + 1, vectors.shape[1]))
    for i, direction in enumerate(basis):
        step[i] = np.einsum("kc,kc->c", direction, vectors)
        vectors = vectors - step[i] * direction
    step[-1] = np.linalg.norm(vectors, axis=0)
    return vectors / (step[-1] + _TINY), step


def _least_squares(
    steps: list[Float[np.ndarray, "_ c"]], size: Float[np.ndarray, " c"]
) -> tuple[Float[np.ndarray, "c rank"], Float[np.ndarray, " c"]]:
    """Weights of the basis that leave the least residual, and that residual."""
    rank = len(steps)
    hessenberg = np.zeros((size.size, rank + 1, rank))
    for j, step in enumerate(steps):
        hessenberg[:, : len(step), j] = step.T
    # Where the right-hand side is zero, so are all its directions.
    hessenberg[size == 0.0, :rank, :] = np.eye(rank)
    right = np.zeros((size.size, rank + 1))
    right[:, 0] = size
    q, r = np.linalg.qr(hessenberg)
    along = np.einsum("cij,ci->cj", q, right)
    weights = np.linalg.solve(r, along[:, :, None])[:, :, 0]
    left = right - np.einsum("cij,cj->ci", hessenberg, weights)
    return weights, np.linalg.norm(left, axis=1)
