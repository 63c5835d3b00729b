"""The solution at every Poisson's ratio from one factorisation.

The system is linear in nu: (K + d K') x = b + d b' + d^2 b'', with d the distance of nu from a
centre. The first two terms of the power series of x are x_0 and d x_1; the rest y solves

    (1 + d M) y = d^2 x_2,        M = K^-1 K',

a shifted system: the Krylov space of M and x_2 is the same for all d, and in its orthonormal basis
the least-squares solution at any nu is that of a Hessenberg matrix of a few rows (GMRES), far
outside the radius of convergence of the series itself. The residual is known exactly.

Source
------
Frommer and Glaessner, Restarted GMRES for shifted linear systems, SIAM J. Sci. Comput. 19 (1998);
Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 6.2 with reorthogonalisation.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem import (
    BoundarySystem,
    CompressedSystem,
    RightHand,
    SpringFactors,
    SpringSlope,
    factorise,
    make_spring_system,
    orthogonalised,
    snapshot_model,
    solve,
    system_slope,
)
from palpate.errors import NotConvergedError

CENTRE = 0.3
MOST_DIRECTIONS = 80
# Relative residual at both ends of the range.
DENSE_RESIDUAL = 1e-8
# Relative residual that a compressed system's model leaves over the range.
SNAPSHOT_RESIDUAL = 5e-7
_TINY = np.finfo(float).tiny


@runtime_checkable
class SolutionModel(Protocol):
    """Directions in which the solutions for all Poisson's ratios lie, for each of c right-hand
    sides its own: `ReducedModel` from one factorisation, `SnapshotModel` from a few solutions."""

    @property
    def directions(self) -> tuple[Float[np.ndarray, "k c"], ...]:
        """j directions of k unknowns."""
        ...

    def coefficients(
        self, poisson_ratio: float, columns: Int[np.ndarray, " c"] | slice = slice(None)
    ) -> tuple[Float[np.ndarray, "j c"], float]:
        """Weights of the directions at one Poisson's ratio, for all or some right-hand sides, and
        the largest relative residual that they leave."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """A `SolutionModel` from one factorisation.

    Attributes
    ----------
    centre : float                    Poisson's ratio of the factorisation
    directions : tuple of j (k, c) float    for each of c right-hand sides: x_0, x_1, then an
                                      orthonormal basis of the Krylov space, zero from where a
                                      right-hand side needs no more
    identity, hessenberg : (c, j - 1, j - 2) float    1 and M from that basis into it and one
                                      direction more, into which all leads that leaves it
    start : (c,) float                norm of x_2
    scale : (c,) float                norm of x_0, the solution at the centre
    """

    centre: float
    directions: tuple[Float[np.ndarray, "k c"], ...]
    identity: Float[np.ndarray, "c rows rank"]
    hessenberg: Float[np.ndarray, "c rows rank"]
    start: Float[np.ndarray, " c"]
    scale: Float[np.ndarray, " c"]

    def coefficients(
        self, poisson_ratio: float, columns: Int[np.ndarray, " c"] | slice = slice(None)
    ) -> tuple[Float[np.ndarray, "j c"], float]:
        """Weights of the directions that give the solution at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float
        columns : (c,) int        right-hand sides asked for, all by default

        Returns
        -------
        (j, c) float
        float                     largest residual over the columns, relative to the solution at the
                                  centre
        """
        weights, residual = self.weights(poisson_ratio, columns)
        return weights.T, float(residual.max(initial=0.0))

    def weights(
        self, poisson_ratio: float, columns: Int[np.ndarray, " c"] | slice = slice(None)
    ) -> tuple[Float[np.ndarray, "c j"], Float[np.ndarray, " c"]]:
        """The same by right-hand side, and the residual of each."""
        distance = poisson_ratio - self.centre
        matrix = self.identity[columns] + distance * self.hessenberg[columns]
        right = np.zeros(matrix.shape[:2])
        right[:, 0] = distance**2 * self.start[columns]
        q, r = np.linalg.qr(matrix)
        inner = np.linalg.solve(r, np.einsum("cij,ci->cj", q, right)[:, :, None])[:, :, 0]
        left = right - np.einsum("cij,cj->ci", matrix, inner)
        residual = np.linalg.norm(left, axis=1) / self.scale[columns]
        first = np.broadcast_to([1.0, distance], (inner.shape[0], 2))
        return np.concatenate([first, inner], axis=1), residual


def make_reduced_model(
    system: BoundarySystem,
    right: RightHand,
    *,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float | Float[np.ndarray, " c"] = DENSE_RESIDUAL,
    snapshot_residual: float = SNAPSHOT_RESIDUAL,
) -> SolutionModel:
    """Factorise once and gather directions until they serve the whole range.

    A compressed system is not factorised: it is solved at a few Poisson's ratios.

    Parameters
    ----------
    system : BoundarySystem
    right : RightHand                 c columns
    poisson_range : (float, float)    Poisson's ratios that will be asked for
    tolerance : float or (c,) float   largest relative residual at both ends, where it is largest;
                                      thin bodies make up to 1000 times as large an error of it
    snapshot_residual : float         the same for a compressed system, over the whole range

    Returns
    -------
    SolutionModel                     a `SnapshotModel` for a compressed system

    Raises
    ------
    SingularSystemError               the support does not hold the object
    NotConvergedError                 the tolerance is not met with `MOST_DIRECTIONS`
    """
    if isinstance(system, CompressedSystem):
        return snapshot_model(
            system, right.terms, poisson_range=poisson_range, tolerance=snapshot_residual
        )
    factorised = factorise(system, CENTRE)
    return _gathered(
        lambda terms: solve(factorised, terms), system_slope(system).apply, right, poisson_range,
        tolerance,
    )  # fmt: skip


def make_spring_model(
    system: BoundarySystem,
    factors: SpringFactors,
    right: RightHand,
    give: Float[np.ndarray, " e"],
    changes: Float[np.ndarray, "d e"],
    *,
    known: Float[np.ndarray, "e c"] | None = None,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float = DENSE_RESIDUAL,
) -> ReducedModel:
    """The same for an object on springs, with the derivatives of its solutions (`SpringSystem`).

    Parameters
    ----------
    system : BoundarySystem
    factors : SpringFactors           at the Poisson's ratio `CENTRE`
    right : RightHand                 c columns, of the object on a rigid support
    give : (e,) float
    changes : (d, e) float            of the give
    known : (e, c) float or None      traction on each spring beside the unknown one, times
                                      `traction_length`; None: none
    poisson_range : (float, float)
    tolerance : float

    Returns
    -------
    ReducedModel                      its directions are 1 + d blocks: the unknowns and the springs,
                                      then the derivatives of both

    Raises
    ------
    NotConvergedError                 as `make_reduced_model`
    """
    solver = make_spring_system(factors, give, changes)
    slope = SpringSlope(system_slope(system), factors.columns[1], 1 + len(changes))
    right = right.on_springs(give, changes, known)
    return _gathered(solver.solve, slope.apply, right, poisson_range, tolerance)


def _placed(
    columns: Float[np.ndarray, "k o"], where: Bool[np.ndarray, " c"]
) -> Float[np.ndarray, "k c"]:
    """Columns at their places among others, which are zero."""
    placed = np.zeros((len(columns), len(where)))
    placed[:, where] = columns
    return placed


def _gathered(
    solved: Callable[[np.ndarray], np.ndarray],
    sloped: Callable[[np.ndarray], np.ndarray],
    right: RightHand,
    poisson_range: tuple[float, float],
    tolerance: float | Float[np.ndarray, " c"],
) -> ReducedModel:
    """Directions by the inverse of the matrix at the centre, and by its derivative: of every
    right-hand side as many as it needs."""
    _, slope, curvature = right.terms
    slope = slope + 2 * CENTRE * curvature
    first = solved(right.at(CENTRE))
    second = solved(slope - sloped(first))
    third = solved(curvature - sloped(second))
    scale, start = (np.linalg.norm(term, axis=0) + _TINY for term in (first, third))
    identity, hessenberg = np.zeros((2, len(start), MOST_DIRECTIONS + 1, MOST_DIRECTIONS))
    directions = [first, second, third / start]
    # Of those right-hand sides only that need more.
    basis, open_ = directions[2:], np.ones(len(start), dtype=bool)
    for rank in range(1, MOST_DIRECTIONS + 1):
        direction, step = orthogonalised(solved(sloped(basis[-1])), basis)
        hessenberg[open_, : rank + 1, rank - 1] = step.T
        # Where a basis has ended, what would come leads to nothing but itself.
        identity[open_, rank - 1, rank - 1] = identity[~open_, rank, rank - 1] = 1.0
        known = identity[:, : rank + 1, :rank].copy(), hessenberg[:, : rank + 1, :rank].copy()
        model = ReducedModel(CENTRE, tuple(directions), *known, start, scale)
        residual = np.maximum(*(model.weights(nu)[1] for nu in poisson_range))
        more = open_ & ~(residual <= tolerance)
        if not more.any():
            return model
        basis = [*basis, direction]
        if not more[open_].all():
            basis, open_ = [one[:, more[open_]] for one in basis], more
        directions.append(basis[-1] if open_.all() else _placed(basis[-1], open_))
    raise NotConvergedError(
        f"the reduced model leaves a residual of {residual.max():.1e} over Poisson's ratios "
        f"{poisson_range[0]} to {poisson_range[1]}, at most {np.min(tolerance):.0e} is allowed;"
        " narrow the range, or use the method nelder-mead"
    )
