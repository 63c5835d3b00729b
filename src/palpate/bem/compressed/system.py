"""The linear system of a large body without its matrix, and when it takes the place of a dense one.

The memory that the model of an object needs, dense or compressed, is checked before it is built.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.bem.compressed.far_field import KernelWeights
from palpate.bem.compressed.operator import LEAF_SIZE, CompressedOperator, compress
from palpate.bem.integrals.assembly import point_blocks
from palpate.bem.integrals.surface import BoundarySurface, Quadrature, integral_weights
from palpate.bem.system.system import (
    BoundarySystem,
    boundary_system,
    find_unknowns,
    place_collocation,
)
from palpate.checkpoints import Cache
from palpate.errors import InputError
from palpate.machine import check_memory_for, usable_memory
from palpate.progress import Progress, silent

# Coefficient of the slack in every integral equation (`system_matrix`).
SLACK = 8 * np.pi
# The program and its libraries [bytes].
_PROGRAM = 0.4e9
# Doubles per pair of vertices: nine of the matrix and four of its slope, and a fifth more for a
# support on an eighth of the surface, whose vertices have several unknowns; for rollers the matrix
# twice. Each further factorisation that is held at the same time takes another matrix.
_DOUBLES_PER_PAIR, _DOUBLES_PER_PAIR_WITH_ROLLERS, _DOUBLES_PER_FACTORS = 16, 27, 11
# Vectors of unknowns that are kept for each of a probing's three directions of force and three
# changes of its contact: right-hand sides, at most 80 basis vectors of the reduced model, and what
# is needed to find the next one.
_VECTORS_PER_COLUMN = 90
_COLUMNS_PER_PROBING = 6
# Above this many vertices a compressed operator takes less time than dense matrices, and far less
# memory; it handles only rigid supports that hold all directions.
LARGEST_DENSE = 5000
# Memory of the operator and its preconditioners per vertex [bytes], and vectors per column that the
# iteration and the reduced basis keep.
_BYTES_PER_VERTEX = 170e3
_COMPRESSED_VECTORS_PER_COLUMN = 110
# A surface of fewer vertices does not represent an object: other cures are offered then.
_MIN_VERTICES = 100


@dataclass(frozen=True, slots=True, eq=False)
class CompressedSystem(BoundarySystem):
    """A `BoundarySystem` whose matrix is a `CompressedOperator`.

    Attributes
    ----------
    operator : CompressedOperator
    """

    operator: CompressedOperator

    def product(
        self, poisson_ratio: float, unknowns: Float[np.ndarray, "k c"]
    ) -> Float[np.ndarray, "k c"]:
        """The matrix at one Poisson's ratio times vectors (`system_matrix`).

        Parameters
        ----------
        poisson_ratio : float [-]         -1 < nu <= 0.5
        unknowns : (k, c) float

        Returns
        -------
        (k, c) float
        """
        result, traction = self._applied(scaled_weights(self, poisson_ratio), unknowns)
        result += SLACK * unknowns[-3:]
        return np.concatenate([self.by_component(result), self._balance(traction)])

    def slope_product(self, unknowns: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "k c"]:
        """The derivative of the matrix with respect to Poisson's ratio times vectors.

        Parameters
        ----------
        unknowns : (k, c) float

        Returns
        -------
        (k, c) float
        """
        weights = KernelWeights(-2.0, 0.0, 0.0, -1.0 / self.traction_length)
        result, _ = self._applied(weights, unknowns)
        return np.concatenate([self.by_component(result), np.zeros((3, unknowns.shape[1]))])

    def held_columns(
        self, basis: Float[np.ndarray, "d c"] | csr_array
    ) -> Float[np.ndarray, "2 r c"]:
        """As of a `BoundarySystem`, by products with the operator.

        Parameters
        ----------
        basis : (3 h, c) float or sparse [m]

        Returns
        -------
        (2, r, c) float
        """
        columns = basis.shape[1]
        displacement = np.zeros((len(self.surface.mesh.vertices), 3, columns))
        displacement[self.unknowns.held_vertices] = (basis @ np.eye(columns)).reshape(
            -1, 3, columns
        )
        no_traction = np.zeros((self.unknowns.held_sides.size, 3, columns))
        # A and B of `traction_parts`.
        scaled, constant = (
            self.by_component(self.operator.apply(weights, displacement, no_traction))
            for weights in (KernelWeights(1.0, 0.0, 0.0, 0.0), KernelWeights(0.0, 1.0, 0.0, 0.0))
        )
        terms = np.zeros((2, len(scaled) + 3, columns))
        terms[0, :-3] = -(scaled + constant)
        terms[1, :-3] = 2 * scaled
        return terms

    def by_component(self, rows: Float[np.ndarray, "r 3 c"]) -> Float[np.ndarray, "n c"]:
        """Equations at the collocation points, (r, 3, c), in the order of right-hand sides,
        (3 r, c)."""
        return rows[self.order].transpose(1, 0, 2).reshape(3 * len(rows), -1)

    def by_point(self, right: Float[np.ndarray, "k c"]) -> Float[np.ndarray, "r 3 c"]:
        """The inverse of `by_component`, (r, 3, c); the rows of the force balance are dropped."""
        rows = np.empty((self.order.size, 3, right.shape[1]))
        rows[self.order] = right[:-3].reshape(3, -1, right.shape[1]).transpose(1, 0, 2)
        return rows

    def _applied(
        self, weights: KernelWeights, unknowns: Float[np.ndarray, "k c"]
    ) -> tuple[Float[np.ndarray, "r 3 c"], Float[np.ndarray, "h 3 c"]]:
        free, columns = self.unknowns.free_vertices, unknowns.shape[1]
        displacement = np.zeros((len(self.surface.mesh.vertices), 3, columns), dtype=unknowns.dtype)
        displacement[free] = unknowns[: 3 * free.size].reshape(-1, 3, columns)
        traction = unknowns[3 * free.size : -3].reshape(-1, 3, columns)
        return self.operator.apply(weights, displacement, traction), traction

    def _balance(self, traction: Float[np.ndarray, "h 3 c"]) -> Float[np.ndarray, "3 c"]:
        return np.einsum("h,hic->ic", self.balance_weights, traction)

    @property
    def balance_weights(self) -> Float[np.ndarray, " h"]:
        """Coefficient of each held side in the force balance."""
        weights = integral_weights(self.surface, np.flatnonzero(self.surface.held))
        return weights[self.unknowns.held_sides] / self.traction_length**2


def scaled_weights(system: BoundarySystem, poisson_ratio: float) -> KernelWeights:
    """Weights of the parts of a system's equations at one Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float [-]

    Returns
    -------
    KernelWeights
    """
    length = system.traction_length
    return KernelWeights(1 - 2 * poisson_ratio, 1.0, -1.0 / length, -poisson_ratio / length)


def compressed_system(
    surface: BoundarySurface,
    *,
    leaf_size: tuple[int, int] = LEAF_SIZE,
    quadrature: Quadrature = Quadrature(),
    progress: Progress = silent,
) -> CompressedSystem:
    """Compute the compressed integrals of an object on its support, once for all materials.

    Parameters
    ----------
    surface : BoundarySurface
    leaf_size : (int, int)    largest numbers of points and of triangles in a leaf (`compress`)
    quadrature : Quadrature
    progress : callable

    Returns
    -------
    CompressedSystem

    Raises
    ------
    InputError                a support holds some directions only
    """
    if not np.allclose(surface.held_directions[surface.held], np.eye(3)):
        raise InputError(
            f"the mesh has {len(surface.mesh.vertices)} vertices and a support that holds some"
            " directions only; meshes as large as this are solved with supports that hold all"
            " directions: simplify the surface, or hold all directions"
        )
    unknowns = find_unknowns(surface)
    collocation = place_collocation(surface, unknowns)
    operator = compress(
        surface, unknowns, collocation, leaf_size=leaf_size, quadrature=quadrature,
        progress=progress,
    )  # fmt: skip
    return CompressedSystem(
        surface=surface, unknowns=unknowns, collocation=collocation,
        rows=point_blocks(collocation.point), quadrature=quadrature,
        operator=operator,
    )  # fmt: skip


def held_system(
    surface: BoundarySurface,
    *,
    dense: bool = False,
    cache: Cache | None = None,
    progress: Progress = silent,
) -> BoundarySystem:
    """The equations of an object on its support, dense or compressed depending on its size.

    Parameters
    ----------
    surface : BoundarySurface
    dense : bool                  True: dense matrices at any size
    cache : Cache or None         see `boundary_system`; not used for a compressed system
    progress : callable           called with the current step and the fraction of the compression
                                  that is done, 0 to 1

    Returns
    -------
    BoundarySystem                a `CompressedSystem` where the object has more than
                                  `LARGEST_DENSE` vertices and its supports hold all directions

    Raises
    ------
    InputError                    a support of an object solved compressed holds some directions
                                  only
    """
    large = len(surface.mesh.vertices) > LARGEST_DENSE
    rolls = not np.allclose(surface.held_directions[surface.held], np.eye(3))
    if large and not dense and not rolls:
        return compressed_system(surface, progress=progress)
    return boundary_system(surface, cache=cache)


def check_memory(
    n_vertices: int,
    n_probings: int = 1,
    *,
    rollers: bool = False,
    dense: bool = False,
    n_factors: int = 1,
    available: float | None = None,
) -> None:
    """Refuse a mesh whose model does not fit into memory.

    Parameters
    ----------
    n_vertices : int
    n_probings : int                  probings fitted together, or pushes predicted
    rollers : bool                    whether a support holds some directions only
    dense : bool                      whether dense matrices are required at any size: for compliant
                                      supports, for Green's functions
    n_factors : int                   factorisations held at the same time
    available : float [byte]          memory of the machine; None: that reported by the operating
                                      system, unlimited if it reports none

    Raises
    ------
    InputError                        more than 90 % of the available memory is needed
    """
    needed_for = partial(
        memory_needed, n_probings=n_probings, rollers=rollers, dense=dense, n_factors=n_factors
    )
    model = "model"
    if rollers or dense:
        model = "dense matrices, as supports that roll or give take them,"
    max_vertices = _max_vertices(needed_for, usable_memory(available))
    cure = (
        f"simplify the surface to at most {max_vertices} vertices in a mesh program (decimate,"
        " remesh; 1000 to 3000 serve most objects)"
    )
    if max_vertices < _MIN_VERTICES:
        fewer = "choose fewer probings (--probe), or " if n_probings > 1 else ""
        cure = f"{fewer}decimate the surface, or use a machine with more memory"
    what = f"the mesh has {n_vertices} vertices, whose {model} {_for(n_probings)}"
    check_memory_for(what, needed_for(n_vertices), cure, available=available)


def memory_needed(
    n_vertices: int,
    n_probings: int,
    *,
    rollers: bool = False,
    dense: bool = False,
    n_factors: int = 1,
) -> float:
    """Peak memory of a fit of some probings.

    Parameters
    ----------
    n_vertices : int
    n_probings : int
    rollers, dense, n_factors         see `check_memory`

    Returns
    -------
    float [byte]
    """
    columns = 3.0 * n_vertices * _COLUMNS_PER_PROBING * n_probings
    if n_vertices > LARGEST_DENSE and not rollers and not dense:
        return (
            _PROGRAM
            + _BYTES_PER_VERTEX * n_vertices
            + 8.0 * _COMPRESSED_VECTORS_PER_COLUMN * columns
        )
    doubles = _DOUBLES_PER_PAIR_WITH_ROLLERS if rollers else _DOUBLES_PER_PAIR
    doubles += (n_factors - 1) * _DOUBLES_PER_FACTORS
    return _PROGRAM + 8.0 * (doubles * float(n_vertices) ** 2 + _VECTORS_PER_COLUMN * columns)


def _for(n_probings: int) -> str:
    return "for one probing" if n_probings == 1 else f"for {n_probings} probings"


def _max_vertices(needed_for: Callable[[int], float], usable: float) -> int:
    """The largest number of vertices that fits, in hundreds; zero: none.

    Memory grows up to the largest dense mesh, drops there, and grows again.
    """
    for low, high in ((LARGEST_DENSE, 10_000_000), (0, LARGEST_DENSE + 1)):
        first = low
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if needed_for(middle) <= usable else (low, middle)
        if low > first:
            return low // 100 * 100
    return 0
