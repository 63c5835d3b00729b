"""The solution at every Poisson's ratio, from one factorisation or from solutions at a few ratios.

The system is linear in nu: (K + d K') x = b + d b' + d^2 b'', with d the distance of nu from a
centre. The first two terms of the power series of x are x_0 and d x_1; the rest y solves

    (1 + d M) y = d^2 x_2,        M = K^-1 K',

a shifted system: the Krylov space of M and x_2 is the same for all d, and in its orthonormal basis
the least-squares solution at any nu follows from a small Hessenberg matrix (GMRES), even far
outside the radius of convergence of the series. The residual is known exactly.

A compressed system has no factorisation. There the basis is one of solutions at some ratios
(snapshots): in their span, too, the least-squares solution at any other ratio follows from a few
small matrices. The next snapshot is computed where the residual is largest, until it is small
everywhere.

Source
------
Frommer and Glaessner, Restarted GMRES for shifted linear systems, SIAM J. Sci. Comput. 19 (1998);
Saad, Iterative Methods for Sparse Linear Systems (2003), algorithm 6.2 with reorthogonalisation;
Quarteroni, Manzoni and Negri, Reduced Basis Methods for Partial Differential Equations (2016),
sections 3.2 and 7.1: least-squares reduced bases, greedy choice by the residual itself.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.compressed.iterative import ClusterInverse, cluster_inverse, solve_compressed
from palpate.bem.compressed.system import CompressedSystem
from palpate.bem.loads.right_hand import RightHand
from palpate.bem.system.factors import CentredSystem, solve
from palpate.bem.system.matrix import SystemSlope
from palpate.bem.system.springs import SpringFactors, SpringSlope, make_spring_system
from palpate.bem.system.system import BoundarySystem
from palpate.checkpoints import Checkpoints, content_digest
from palpate.errors import NotConvergedError

# Poisson's ratio of the factorisation or of the first snapshot, typical of most materials.
CENTRE = 0.3
MOST_DIRECTIONS = 80
# Largest relative residual allowed at both ends of the range.
DENSE_RESIDUAL = 1e-8
# Right-hand sides that are solved for together: enough for the full speed of matrix products, and
# not all of them, as it takes several times the memory of their solutions.
MODEL_COLUMNS = 64
_TINY = np.finfo(float).tiny
# Poisson's ratios over the range at which the residual is evaluated.
_TRAINING_RATIOS = 41
_MAX_SNAPSHOTS = 20
# Tolerance of a snapshot over that of the model.
_SNAPSHOT_TOLERANCE = 0.1
# Rounding of a vector per basis vector subtracted from it, relative to its length.
_ROUNDING = 4 * np.finfo(float).eps


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
) -> ReducedModel:
    """Factorise once and extend the Krylov basis until it covers the whole range.

    Parameters
    ----------
    system : BoundarySystem or CentredSystem    centred at `CENTRE`
    right : RightHand                 c columns
    poisson_range : (float, float)    range of Poisson's ratio that the model must cover
    tolerance : float or (c,) float   largest relative residual allowed at both ends of the range,
                                      where it peaks; in thin bodies the relative error of the
                                      solution may be 1000 times as large

    Returns
    -------
    ReducedModel

    Raises
    ------
    SingularSystemError               the support does not hold the object
    NotConvergedError                 the tolerance is not met with `MOST_DIRECTIONS`
    """
    if isinstance(system, CentredSystem):
        checkpoints, centred = system.system.checkpoints, system
    elif system.checkpoints.in_memory:
        checkpoints, centred = system.checkpoints, CentredSystem(system, CENTRE)
    else:
        # Factors that are not shared serve this model alone, which is kept itself.
        unshared = replace(system, checkpoints=Checkpoints(None))
        checkpoints, centred = system.checkpoints, CentredSystem(unshared, CENTRE)
    depends_on = centred.single, right.terms, poisson_range, tolerance

    def make() -> ReducedModel:
        solve_at_centre = partial(solve, centred.factorised)
        return _krylov_model(solve_at_centre, centred.slope.apply, right, poisson_range, tolerance)

    # In memory are the factors, which other contacts need, too.
    if checkpoints.in_memory:
        return make()
    return checkpoints.load_or_make(content_digest(("reduced model", depends_on)), make)


def make_spring_model(
    slope: SystemSlope,
    factors: SpringFactors,
    right: RightHand,
    compliance: Float[np.ndarray, " e"],
    changes: Float[np.ndarray, "d e"],
    *,
    known_traction: Float[np.ndarray, "e c"] | None = None,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
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
    return _krylov_model(solver.solve, on_springs.apply, right, poisson_range, DENSE_RESIDUAL)


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasis:
    """Basis vectors that span the solutions for all Poisson's ratios; used as `ReducedModel` is.

    Attributes
    ----------
    directions : tuple of j (k, c) float    orthonormal for each of c right-hand sides
    constant, slope : (c, m, j) float constant and slope of the matrix times these, in a basis of
                                      the preconditioned residuals
    right : (3, c, m) float           right-hand sides in that basis: constant, slope, curvature
    """

    directions: tuple[Float[np.ndarray, "k c"], ...]
    constant: Float[np.ndarray, "c m j"]
    slope: Float[np.ndarray, "c m j"]
    right: Float[np.ndarray, "3 c m"]

    def coefficients(self, poisson_ratio: float) -> tuple[Float[np.ndarray, "j c"], float]:
        """Coefficients of the basis vectors for the solution at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float

        Returns
        -------
        (j, c) float
        float                     largest preconditioned residual over the columns, relative to the
                                  preconditioned right-hand side
        """
        matrix = self.constant + poisson_ratio * self.slope
        constant, slope, curvature = self.right
        right = constant + poisson_ratio * (slope + poisson_ratio * curvature)
        size = np.linalg.norm(right, axis=1) + _TINY
        weights = np.zeros((len(matrix), matrix.shape[2]))
        residual = np.zeros(len(matrix))
        for k, (reduced, wanted) in enumerate(zip(matrix, right, strict=True)):
            weights[k] = np.linalg.lstsq(reduced, wanted)[0]
            residual[k] = np.linalg.norm(reduced @ weights[k] - wanted) / size[k]
        return weights.T, float(residual.max(initial=0.0))

    def basis(self, columns: Int[np.ndarray, " c"]) -> Iterator[Float[np.ndarray, "k c"]]:
        """Basis vectors for some right-hand sides, one (k, c) after the other."""
        for direction in self.directions:
            yield direction[:, columns]


def reduced_basis(
    system: CompressedSystem,
    right: Float[np.ndarray, "3 k c"],
    *,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    tolerance: float = 5e-7,
) -> ReducedBasis:
    """Solve at a few Poisson's ratios until their span contains the solutions of the whole range.

    Parameters
    ----------
    system : CompressedSystem
    right : (3, k, c) float           right-hand sides: constant, factors of nu and nu^2
    poisson_range : (float, float)    range of Poisson's ratio that the model is to cover
    tolerance : float                 largest relative residual within it

    Returns
    -------
    ReducedBasis

    Raises
    ------
    NotConvergedError                 an iteration does not converge, or the tolerance is not met
    """
    ratios = np.linspace(*poisson_range, _TRAINING_RATIOS)
    snapshots = _Snapshots(system, cluster_inverse(system, CENTRE), right)
    ratio, basis = CENTRE, None
    while len(snapshots.ratios) < _MAX_SNAPSHOTS:
        snapshots.add(ratio, basis, _SNAPSHOT_TOLERANCE * tolerance)
        basis = snapshots.basis()
        residuals = [basis.coefficients(float(nu))[1] for nu in ratios]
        if max(residuals) <= tolerance:
            return basis
        ratio = float(ratios[int(np.argmax(residuals))])
    raise NotConvergedError(
        f"{_MAX_SNAPSHOTS} solutions leave a residual of {max(residuals):.1e} over Poisson's"
        f" ratios {poisson_range[0]} to {poisson_range[1]}, at most {tolerance:.0e} is allowed;"
        " narrow the range"
    )


def orthogonalised(
    vectors: Float[np.ndarray, "k c"],
    basis: Sequence[Float[np.ndarray, "k _"]],
    places: Sequence[Int[np.ndarray, " c"]] | None = None,
) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "rows c"]]:
    """Normalised components of vectors orthogonal to a basis, each column by itself.

    Parameters
    ----------
    vectors : (k, c) float
    basis : sequence of j (k, m) float      orthonormal; m may differ from one to the next
    places : sequence of j (c,) int or None columns of each that belong to the vectors; None: all

    Returns
    -------
    (k, c) float                            of length 1; 0 where a vector lies in the span to
                                            rounding
    (j + 1, c) float                        products with the basis, then the length of the
                                            orthogonal component, 0 likewise
    """
    scale = np.linalg.norm(vectors, axis=0)
    coefficients = np.zeros((len(basis) + 1, vectors.shape[1]))
    # Twice: the first pass leaves rounding errors in proportion to what it subtracts.
    for _ in range(2):
        for i, vector in enumerate(basis):
            # A copy of one of them at a time: of all, it would take as much memory as the basis.
            direction = vector if places is None else vector[:, places[i]]
            along = np.einsum("kc,kc->c", direction, vectors)
            vectors = vectors - along * direction
            coefficients[i] += along
    length = np.linalg.norm(vectors, axis=0)
    # What rounding leaves of a vector in the span is not a direction: it would not be orthogonal to
    # the others, and its products with the matrix would be rounding errors as well.
    outside = length > _ROUNDING * (len(basis) + 1) * scale
    coefficients[-1] = np.where(outside, length, 0.0)
    return np.where(outside, vectors / (length + _TINY), 0.0), coefficients


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
        for begin in range(0, len(active), MODEL_COLUMNS):
            part = slice(begin, begin + MODEL_COLUMNS)
            vectors = solve_at_centre(apply_slope(directions[-1][:, part]))
            own_places = [index[part] for index in places]
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


class _Snapshots:
    """Snapshots so far, and their products with the matrix."""

    def __init__(
        self,
        system: CompressedSystem,
        inverse: ClusterInverse,
        right: Float[np.ndarray, "3 k c"],
    ) -> None:
        self.system, self.right = system, right
        self._inverse = inverse
        self.directions: list[np.ndarray] = []
        # For each: the matrix at a ratio of zero times it, and the slope of the matrix times it.
        self._products: list[tuple[np.ndarray, np.ndarray]] = []
        self.ratios: list[float] = []
        # Preconditioned, residuals are approximate errors of the unknowns.
        self._preconditioned = [inverse.solve(term) for term in right]

    def add(self, ratio: float, basis: ReducedBasis | None, tolerance: float) -> None:
        """Add the snapshot at one ratio, which is solved for the residual of the model."""
        constant, slope, curvature = self.right
        right = constant + ratio * (slope + ratio * curvature)
        size = np.linalg.norm(right, axis=0) + _TINY
        residual = right
        if basis is not None:
            weights, _ = basis.coefficients(ratio)
            for weight, (first, second) in zip(weights, self._products, strict=True):
                residual = residual - weight * (first + ratio * second)
        inverse = cluster_inverse(self.system, ratio)
        snapshot = solve_compressed(inverse, residual, scale=size, tolerance=tolerance)
        sloped = self.system.slope_product(snapshot.solution)
        direction, coefficients = orthogonalised(snapshot.solution, self.directions)
        products = self._products_of_direction(
            snapshot.product - ratio * sloped, sloped, coefficients
        )
        self.directions.append(direction)
        self._products.append(products)
        self.ratios.append(ratio)
        self._preconditioned += [self._inverse.solve(product) for product in products]

    def basis(self) -> ReducedBasis:
        """The model of the snapshots so far."""
        upper = np.stack(
            [
                np.linalg.qr(
                    np.stack([term[:, c] for term in self._preconditioned], axis=1), mode="r"
                )
                for c in range(self.right.shape[2])
            ]
        )
        return ReducedBasis(
            tuple(self.directions),
            upper[:, :, 3::2],
            upper[:, :, 4::2],
            upper[:, :, :3].transpose(2, 0, 1),
        )

    def _products_of_direction(
        self,
        first: Float[np.ndarray, "k c"],
        second: Float[np.ndarray, "k c"],
        coefficients: Float[np.ndarray, "rows c"],
    ) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "k c"]]:
        """Products of a new basis vector, from those of the vectors given to `orthogonalised`."""
        for along, (known, sloped) in zip(coefficients[:-1], self._products, strict=True):
            first, second = first - along * known, second - along * sloped
        length = coefficients[-1]
        first, second = (
            np.divide(product, length, out=np.zeros_like(product), where=length > 0.0)
            for product in (first, second)
        )
        return first, second
