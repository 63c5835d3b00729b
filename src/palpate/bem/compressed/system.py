"""The linear system of a held object as a matrix-free operator."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.bem.compressed.moments import KernelWeights
from palpate.bem.compressed.operator import CompressedOperator, Compression, compress
from palpate.bem.integrals.assembly import point_blocks
from palpate.bem.integrals.quadrature import Quadrature
from palpate.bem.integrals.surface import BoundarySurface, integral_weights
from palpate.bem.system.boundary import find_unknowns, place_collocation
from palpate.bem.system.system import BoundarySystem
from palpate.errors import InputError
from palpate.progress import Progress, silent

# Coefficient of the slack in every integral equation (`system_matrix`).
SLACK = 8 * np.pi


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
        found, traction = self._applied(scaled_weights(self, poisson_ratio), unknowns)
        found += SLACK * unknowns[-3:]
        return np.concatenate([self.by_component(found), self._balance(traction)])

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
        found, _ = self._applied(weights, unknowns)
        return np.concatenate([self.by_component(found), np.zeros((3, unknowns.shape[1]))])

    def given_products(
        self, displacement: Float[np.ndarray, "v 3 c"]
    ) -> tuple[Float[np.ndarray, "k c"], Float[np.ndarray, "k c"]]:
        """Contributions of prescribed vertex displacements to the integral equations.

        Parameters
        ----------
        displacement : (v, 3, c) float [m]    zero where it is unknown

        Returns
        -------
        (k, c) float, (k, c) float        for A and for B (`traction_parts`), without the rows of
                                          the force balance
        """
        no_traction = np.zeros((self.unknowns.held_sides.size, 3, displacement.shape[2]))
        parts = (KernelWeights(1.0, 0.0, 0.0, 0.0), KernelWeights(0.0, 1.0, 0.0, 0.0))
        a, b = (
            self.by_component(self.operator.apply(weights, displacement, no_traction))
            for weights in parts
        )
        return a, b

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
    compression: Compression = Compression(),
    quadrature: Quadrature = Quadrature(),
    progress: Progress = silent,
) -> CompressedSystem:
    """Compute the compressed integrals of an object on its support, once for all materials.

    Parameters
    ----------
    surface : BoundarySurface
    compression : Compression
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
        surface, unknowns, collocation, compression=compression, quadrature=quadrature,
        progress=progress,
    )  # fmt: skip
    return CompressedSystem(
        surface=surface, unknowns=unknowns, collocation=collocation,
        rows=point_blocks(collocation.point), quadrature=quadrature, rigid_body_sum=True,
        operator=operator,
    )  # fmt: skip
