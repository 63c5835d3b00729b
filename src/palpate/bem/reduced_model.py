"""The solution at every Poisson's ratio from one factorisation.

The system is linear in nu: (K + d K') x = b + d b' + d^2 b'', with d the distance of nu from a
centre. The first two terms of the power series of x are x_0 and d x_1; the rest y solves

    (1 + d M) y = d^2 x_2,        M = K^-1 K',

a shifted system: the Krylov space of M and x_2 is the same for all d, and in its orthonormal basis
the least-squares solution at any nu follows from a small Hessenberg matrix (GMRES), even far
outside the radius of convergence of the series. The residual is known exactly.

Source
------
Frommer and Glaessner, Restarted GMRES for shifted linear systems, SIAM J. Sci. Comput. 19 (1998);
Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 6.2 with reorthogonalisation.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.compressed.snapshots import orthogonalised, reduced_basis
from palpate.bem.compressed.system import CompressedSystem
from palpate.bem.loads.right_hand import RightHand
from palpate.bem.system.centred_system import CentredSystem
from palpate.bem.system.factors import solve
from palpate.bem.system.slope import SystemSlope
from palpate.bem.system.springs import SpringFactors, SpringSlope, make_spring_system
from palpate.bem.system.system import BoundarySystem
from palpate.errors import NotConvergedError
from palpate.parts import Parts, content_digest

CENTRE = 0.3
MOST_DIRECTIONS = 80
# Largest relative residual allowed at both ends of the range.
DENSE_RESIDUAL = 1e-8
# The same over the range for a compressed system, which iteration solves: no less.
_SNAPSHOT_RESIDUAL = 5e-7
# Right-hand sides that are solved for together: enough for the full speed of matrix products, and
# not all of them, as it takes several times the memory of their solutions.
_SLICE = 64
_TINY = np.finfo(float).tiny


@runtime_checkable
class SolutionModel(Protocol):
    """Reduced basis of the solutions at all Poisson's ratios, one for each of c right-hand sides:
    `ReducedModel` from one factorisation, `ReducedBasis` from a few solutions."""

    def basis(self, columns: Int[np.ndarray, " c"]) -> Iterator[Float[np.ndarray, "k c"]]:
        """j basis vectors of k unknowns for each of some right-hand sides: j times (k, c)."""
        ...

    def coefficients(self, poisson_ratio: float) -> tuple[Float[np.ndarray, "j c"], float]:
        """Coefficients of the basis, (j, c), at one Poisson's ratio, and the largest relative
        residual."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class ReducedModel:
    """A `SolutionModel` from one factorisation.

    Attributes
    ----------
    centre : float                    Poisson's ratio of the factorisation
    directions : tuple of j (k, m) float    x_0, x_1, then an orthonormal basis of the Krylov space,
                                      for each of c right-hand sides or the m that need as many
    columns : tuple of j (m,) int     which right-hand sides these are, ascending
    identity, hessenberg : (c, j - 1, j - 2) float    1 and M as maps from that basis to the basis
                                      extended by one vector (Arnoldi relation)
    start : (c,) float                norm of x_2
    scale : (c,) float                norm of x_0, the solution at the centre
    """

    centre: float
    directions: tuple[Float[np.ndarray, "k _"], ...]
    columns: tuple[Int[np.ndarray, " _"], ...]
    identity: Float[np.ndarray, "c rows rank"]
    hessenberg: Float[np.ndarray, "c rows rank"]
    start: Float[np.ndarray, " c"]
    scale: Float[np.ndarray, " c"]

    def basis(self, columns: Int[np.ndarray, " c"]) -> Iterator[Float[np.ndarray, "k c"]]:
        """Basis vectors for some right-hand sides, one after the other.

        Parameters
        ----------
        columns : (c,) int        right-hand sides wanted

        Yields
        ------
        (k, c) float              zero where a right-hand side needs fewer vectors
        """
        for direction, present in zip(self.directions, self.columns, strict=True):
            vectors = np.zeros((len(direction), len(columns)))
            (wanted,) = np.nonzero(np.isin(columns, present))
            vectors[:, wanted] = direction[:, np.searchsorted(present, columns[wanted])]
            yield vectors

    def coefficients(self, poisson_ratio: float) -> tuple[Float[np.ndarray, "j c"], float]:
        """Coefficients of the basis that give the solution at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float [-]

        Returns
        -------
        (j, c) float
        float                     largest residual over the right-hand sides, relative to the
                                  solution at the centre
        """
        weights, residual = self.weights(poisson_ratio)
        return weights.T, float(residual.max(initial=0.0))

    def weights(
        self, poisson_ratio: float
    ) -> tuple[Float[np.ndarray, "c j"], Float[np.ndarray, " c"]]:
        """As `coefficients`, but (c, j); the relative residual of each right-hand side, (c,)."""
        distance = poisson_ratio - self.centre
        matrix = self.identity + distance * self.hessenberg
        right = np.zeros(matrix.shape[:2])
        right[:, 0] = distance**2 * self.start
        q, r = np.linalg.qr(matrix)
        inner = np.linalg.solve(r, np.einsum("cij,ci->cj", q, right)[:, :, None])[:, :, 0]
        remainder = right - np.einsum("cij,cj->ci", matrix, inner)
        residual = np.linalg.norm(remainder, axis=1) / self.scale
        first = np.broadcast_to([1.0, distance], (inner.shape[0], 2))
        return np.concatenate([first, inner], axis=1), residual


def make_reduced_model(
    system: BoundarySystem | CentredSystem,
    right: RightHand,
    *,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float | Float[np.ndarray, " c"] = DENSE_RESIDUAL,
) -> SolutionModel:
    """Factorise once and extend the Krylov basis until it covers the whole range.

    A compressed system is not factorised: it is solved at a few Poisson's ratios instead.

    Parameters
    ----------
    system : BoundarySystem or CentredSystem    centred at `CENTRE`
    right : RightHand                 c columns
    poisson_range : (float, float)    range of Poisson's ratio that the model must cover
    tolerance : float or (c,) float   largest relative residual allowed at both ends of the range,
                                      where it peaks; in thin bodies the relative error of the
                                      solution may be 1000 times as large. For a compressed system
                                      the smallest of them, but no less than 5e-7, over the range

    Returns
    -------
    SolutionModel                     a `ReducedBasis` for a compressed system

    Raises
    ------
    SingularSystemError               the support does not hold the object
    NotConvergedError                 the tolerance is not met with `MOST_DIRECTIONS`
    """
    if isinstance(system, CompressedSystem):
        return reduced_basis(
            system, right.terms, poisson_range=poisson_range,
            tolerance=max(float(np.min(tolerance)), _SNAPSHOT_RESIDUAL),
        )  # fmt: skip
    if isinstance(system, CentredSystem):
        parts, centred = system.system.parts, system
    else:
        # Factors that are not shared serve this model alone, which is kept itself.
        parts, centred = system.parts, CentredSystem(replace(system, parts=Parts(None)), CENTRE)
    given = centred.single, right.terms, poisson_range, tolerance

    def make() -> ReducedModel:
        solve_at_centre = partial(solve, centred.factorised)
        return _krylov_model(solve_at_centre, centred.slope.apply, right, poisson_range, tolerance)

    return parts.load_or_make(content_digest(("reduced model", given)), make)


def make_spring_model(
    slope: SystemSlope,
    factors: SpringFactors,
    right: RightHand,
    compliance: Float[np.ndarray, " e"],
    changes: Float[np.ndarray, "d e"],
    *,
    known_traction: Float[np.ndarray, "e c"] | None = None,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float = DENSE_RESIDUAL,
) -> ReducedModel:
    """A reduced model of an object on springs, with derivatives of its solutions (`SpringSystem`).

    Parameters
    ----------
    slope : SystemSlope               of the system on a rigid support
    factors : SpringFactors           at the Poisson's ratio `CENTRE`
    right : RightHand                 c columns, for the object on a rigid support
    compliance : (e,) float           dimensionless, of each spring (`bem.SpringFactors`)
    changes : (d, e) float            directions in it along which solutions are differentiated
    known_traction : (e, c) float or None    known part of the traction on each spring, times
                                      `traction_length`; None: there is none
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
    solver = make_spring_system(factors, compliance, changes)
    on_springs = SpringSlope(slope, factors.columns[1], 1 + len(changes))
    right = right.on_springs(compliance, changes, known_traction)
    return _krylov_model(solver.solve, on_springs.apply, right, poisson_range, tolerance)


def _power_series(
    solve_at_centre: Callable[[np.ndarray], np.ndarray],
    apply_slope: Callable[[np.ndarray], np.ndarray],
    right: RightHand,
) -> list[Float[np.ndarray, "k c"]]:
    """The first three terms of the power series of the solution about the centre."""
    _, slope, curvature = right.terms
    first = solve_at_centre(right.at(CENTRE))
    second = solve_at_centre(slope + 2 * CENTRE * curvature - apply_slope(first))
    return [first, second, solve_at_centre(curvature - apply_slope(second))]


def _krylov_model(
    solve_at_centre: Callable[[np.ndarray], np.ndarray],
    apply_slope: Callable[[np.ndarray], np.ndarray],
    right: RightHand,
    poisson_range: tuple[float, float],
    tolerance: float | Float[np.ndarray, " c"],
) -> ReducedModel:
    """Krylov basis from the inverse of the matrix at the centre and the matrix's derivative, with
    as many vectors for each right-hand side as it needs."""
    directions = _power_series(solve_at_centre, apply_slope, right)
    scale, start = (np.linalg.norm(directions[k], axis=0) + _TINY for k in (0, 2))
    directions[2] /= start
    identity, hessenberg = np.zeros((2, len(start), MOST_DIRECTIONS + 1, MOST_DIRECTIONS))
    every, tolerance = np.arange(len(start)), np.broadcast_to(tolerance, start.shape)
    # Vectors of the Krylov space from the third on; the right-hand sides that need each of them.
    columns = [every, every, every]
    for rank in range(1, MOST_DIRECTIONS + 1):
        active, complete = columns[-1], np.setdiff1d(every, columns[-1])
        places = [np.searchsorted(present, active) for present in columns[2:]]
        next_ones = np.empty(directions[-1].shape, order="F")
        for begin in range(0, len(active), _SLICE):
            part = slice(begin, begin + _SLICE)
            vectors = solve_at_centre(apply_slope(directions[-1][:, part]))
            own_places = [place[part] for place in places]
            next_ones[:, part], step = orthogonalised(vectors, directions[2:], own_places)
            hessenberg[active[part], : rank + 1, rank - 1] = step.T
        # Where a basis is complete, rows of the identity make all further coefficients zero.
        identity[active, rank - 1, rank - 1] = identity[complete, rank, rank - 1] = 1.0
        arnoldi = identity[:, : rank + 1, :rank].copy(), hessenberg[:, : rank + 1, :rank].copy()
        model = ReducedModel(CENTRE, tuple(directions), tuple(columns), *arnoldi, start, scale)
        residual = np.maximum(*(model.weights(nu)[1] for nu in poisson_range))
        more = ~(residual[active] <= tolerance[active])
        if not more.any():
            return model
        directions.append(next_ones[:, more])
        columns.append(active[more])
    raise NotConvergedError(
        f"the reduced model leaves a residual of {residual.max():.1e} over Poisson's ratios "
        f"{poisson_range[0]} to {poisson_range[1]}, at most {np.min(tolerance):.0e} is allowed;"
        " narrow the range, or use the method nelder-mead"
    )
