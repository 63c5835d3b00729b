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
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

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
# Relative residual that a compressed system's model leaves over the range.
SNAPSHOT_RESIDUAL = 5e-7
_TINY = np.finfo(float).tiny


@runtime_checkable
class SolutionModel(Protocol):
    """Directions in which the solutions for all Poisson's ratios lie, for each of c right-hand
    sides its own: `ReducedModel` from one factorisation, `SnapshotModel` from a few solutions."""

    @property
    def directions(self) -> Float[np.ndarray, "j k c"]:
        """(j, k, c): j directions of k unknowns."""
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
    directions : (j, k, c) float      for each of c right-hand sides: x_0, x_1, then an orthonormal
                                      basis of the Krylov space
    hessenberg : (c, j - 1, j - 2) float    M in that basis; its last row leads out of it
    start : (c,) float                norm of x_2
    scale : (c,) float                norm of x_0, the solution at the centre
    """

    centre: float
    directions: Float[np.ndarray, "j k c"]
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
        distance = poisson_ratio - self.centre
        hessenberg = self.hessenberg[columns]
        matrix = np.eye(*hessenberg.shape[1:]) + distance * hessenberg
        right = np.zeros(matrix.shape[:2])
        right[:, 0] = distance**2 * self.start[columns]
        q, r = np.linalg.qr(matrix)
        inner = np.linalg.solve(r, np.einsum("cij,ci->cj", q, right)[:, :, None])[:, :, 0]
        left = right - np.einsum("cij,cj->ci", matrix, inner)
        residual = np.linalg.norm(left, axis=1) / self.scale[columns]
        first = np.broadcast_to([1.0, distance], (inner.shape[0], 2))
        weights = np.concatenate([first, inner], axis=1)
        return weights.T, float(residual.max(initial=0.0))


def make_reduced_model(
    system: BoundarySystem,
    right: RightHand,
    *,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float = 1e-8,
    snapshot_residual: float = SNAPSHOT_RESIDUAL,
) -> SolutionModel:
    """Factorise once and gather directions until they serve the whole range.

    A compressed system is not factorised: it is solved at a few Poisson's ratios.

    Parameters
    ----------
    system : BoundarySystem
    right : RightHand                 c columns
    poisson_range : (float, float)    Poisson's ratios that will be asked for
    tolerance : float                 largest relative residual at both ends, where it is largest;
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
    tolerance: float = 1e-8,
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


def _gathered(
    solved: Callable[[np.ndarray], np.ndarray],
    sloped: Callable[[np.ndarray], np.ndarray],
    right: RightHand,
    poisson_range: tuple[float, float],
    tolerance: float,
) -> ReducedModel:
    """Directions by the inverse of the matrix at the centre, and by its derivative."""
    _, slope, curvature = right.terms
    slope = slope + 2 * CENTRE * curvature
    first = solved(right.at(CENTRE))
    second = solved(slope - sloped(first))
    third = solved(curvature - sloped(second))
    scale, start = (np.linalg.norm(term, axis=0) + _TINY for term in (first, third))
    basis, steps = [third / start], []
    while len(basis) <= MOST_DIRECTIONS:
        direction, step = orthogonalised(solved(sloped(basis[-1])), basis)
        steps.append(step)
        # Residuals rest on the Hessenberg matrices alone; directions are large, and copied once.
        none = np.zeros((2 + len(basis), 0, len(start)))
        model = ReducedModel(CENTRE, none, _hessenberg(steps), start, scale)
        residual = max(model.coefficients(nu)[1] for nu in poisson_range)
        if residual <= tolerance:
            return replace(model, directions=np.stack([first, second, *basis]))
        basis.append(direction)
    raise NotConvergedError(
        f"the reduced model leaves a residual of {residual:.1e} over Poisson's ratios "
        f"{poisson_range[0]} to {poisson_range[1]}, at most {tolerance:.0e} is allowed; narrow the "
        "range, or use the method nelder-mead"
    )


def _hessenberg(steps: list[Float[np.ndarray, "_ c"]]) -> Float[np.ndarray, "c rows rank"]:
    """The matrices whose columns these are, zero below."""
    whole = np.zeros((steps[0].shape[1], len(steps) + 1, len(steps)))
    for j, step in enumerate(steps):
        whole[:, : len(step), j] = step.T
    return whole
