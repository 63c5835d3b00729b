"""Reduced basis: solutions for every Poisson's ratio from those at a few.

The system is linear in nu, its right-hand side quadratic. In the span of the solutions at some
ratios (snapshots), the least-squares solution at any other ratio follows from a few small matrices.
The next snapshot is computed where the residual is largest, until it is small everywhere.

Source
------
Quarteroni, Manzoni and Negri, Reduced Basis Methods for Partial Differential Equations (2016),
sections 3.2 and 7.1: least-squares reduced bases, greedy choice by the residual itself.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.compressed.preconditioner import ClusterInverse, cluster_inverse, solve_compressed
from palpate.bem.compressed.system import CompressedSystem
from palpate.errors import NotConvergedError

# Poisson's ratios over the range at which the residual is evaluated.
_TRAINING_RATIOS = 41
_MAX_SNAPSHOTS = 20
# Poisson's ratio of the first snapshot, typical of most materials.
_CENTRE = 0.3
# Tolerance of a snapshot over that of the model.
_SNAPSHOT_TOLERANCE = 0.1
_TINY = np.finfo(float).tiny
# Rounding of a vector per basis vector subtracted from it, relative to its length.
_ROUNDING = 4 * np.finfo(float).eps


@dataclass(frozen=True, slots=True, eq=False)
class ReducedBasis:
    """Basis vectors that span the solutions for all Poisson's ratios; used as `ReducedModel` is.

    Attributes
    ----------
    directions : tuple of j (k, c) float    orthonormal for each of c right-hand sides
    constant, slope : (c, m, j) float constant and slope of the matrix times these, in a basis of
                                      the preconditioned residuals
    right : (3, c, m) float           right-hand sides in that basis: constant, slope, curvature
    ratios : (j,) float               Poisson's ratios of the snapshots
    iterations : (j,) int             products with the matrix that each took
    """

    directions: tuple[Float[np.ndarray, "k c"], ...]
    constant: Float[np.ndarray, "c m j"]
    slope: Float[np.ndarray, "c m j"]
    right: Float[np.ndarray, "3 c m"]
    ratios: tuple[float, ...]
    iterations: tuple[int, ...]

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
        for k, (one, wanted) in enumerate(zip(matrix, right, strict=True)):
            weights[k] = np.linalg.lstsq(one, wanted)[0]
            residual[k] = np.linalg.norm(one @ weights[k] - wanted) / size[k]
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
    snapshots = _Snapshots(system, cluster_inverse(system, _CENTRE), right)
    ratio, found = _CENTRE, None
    while len(snapshots.ratios) < _MAX_SNAPSHOTS:
        snapshots.add(ratio, found, _SNAPSHOT_TOLERANCE * tolerance)
        found = snapshots.basis()
        residuals = [found.coefficients(float(nu))[1] for nu in ratios]
        if max(residuals) <= tolerance:
            return found
        ratio = float(ratios[int(np.argmax(residuals))])
    raise NotConvergedError(
        f"{_MAX_SNAPSHOTS} solutions leave a residual of {max(residuals):.1e} over Poisson's"
        f" ratios {poisson_range[0]} to {poisson_range[1]}, at most {tolerance:.0e} is allowed;"
        " narrow the range"
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
        self._iterations: list[int] = []
        # Preconditioned, residuals are approximate errors of the unknowns.
        self._preconditioned = [inverse.solve(term) for term in right]

    def add(self, ratio: float, basis: ReducedBasis | None, tolerance: float) -> None:
        """Add the snapshot at one ratio, which is solved for the residual of the model."""
        constant, slope, curvature = self.right
        wanted = constant + ratio * (slope + ratio * curvature)
        size = np.linalg.norm(wanted, axis=0) + _TINY
        residual = wanted
        if basis is not None:
            weights, _ = basis.coefficients(ratio)
            for weight, (first, second) in zip(weights, self._products, strict=True):
                residual = residual - weight * (first + ratio * second)
        inverse = cluster_inverse(self.system, ratio)
        found = solve_compressed(inverse, residual, scale=size, tolerance=tolerance)
        sloped = self.system.slope_product(found.solution)
        direction, coefficients = orthogonalised(found.solution, self.directions)
        products = self._products_of_direction(found.product - ratio * sloped, sloped, coefficients)
        self.directions.append(direction)
        self._products.append(products)
        self.ratios.append(ratio)
        self._iterations.append(found.iterations)
        self._preconditioned += [self._inverse.solve(one) for one in products]

    def basis(self) -> ReducedBasis:
        """The model of the snapshots so far."""
        count = len(self.directions)
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
            tuple(self.ratios),
            tuple(self._iterations[:count]),
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
