"""The linear system of a held object, linear in Poisson's ratio, and its factorisation."""

from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import get_lapack_funcs, lu_factor, lu_solve

from palpate.bem.integrals import (
    DISPLACEMENT,
    LANES,
    TRACTION,
    BoundarySurface,
    Collocation,
    FieldBlocks,
    Quadrature,
    assemble,
    displacement_parts,
    integral_weights,
    traction_parts,
    with_rigid_body_sum,
)
from palpate.bem.system.boundary import Unknowns, find_unknowns, place_collocation
from palpate.bem.system.large_lu import LARGEST_WHOLE, lu_by_panels
from palpate.bem.system.rollers import Elimination, make_elimination
from palpate.errors import SingularSystemError
from palpate.geometry import QuadraticNodes
from palpate.parts import Parts
from palpate.threads import in_threads

# Type of the entries of a matrix.
Precision = type[np.float64] | type[np.float32]
# An unsupported body has less than 3e-14, a sheet 80 times as long as thick more than 1e-12.
SMALLEST_RCOND = 1e-13


@dataclass(frozen=True, slots=True, eq=False)
class BoundarySystem:
    """Material-independent matrices of one object on its supports.

    The system for the unknowns x = (displacement of the free vertices [m], traction of the held
    sides times `traction_length` over the shear modulus [m], slack [m]) is matrix(nu) x =
    right-hand side, with the integral equations multiplied by 8 pi (1 - nu).

    Collocation does not satisfy global force equilibrium by itself. Three more equations require
    the support's tractions to balance the load, and three more unknowns keep the system square: a
    slack for each component, the same in all integral equations. The slack is zero in the exact
    solution and about 1e-4 of the displacement in a discrete one.

    Attributes
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    traction_kernel : FieldBlocks         multiplies the displacement of every vertex
    displacement_kernel : FieldBlocks     multiplies the traction of every held side
    traction_length : float [m]           scales tractions to displacements, so that all columns
                                          have similar norms
    parts : Parts                         where what follows from these matrices alone is kept
    """

    surface: BoundarySurface
    unknowns: Unknowns
    collocation: Collocation
    traction_kernel: FieldBlocks
    displacement_kernel: FieldBlocks
    parts: Parts = field(default=Parts(None), kw_only=True)

    @property
    def traction_length(self) -> float:
        """Size of the held triangles [m]: scales tractions to displacements, so that all columns
        have similar norms."""
        return self.surface.held_length

    @property
    def size(self) -> int:
        """Number of scalar unknowns, the three of the slack included."""
        return 3 * (self.unknowns.free_vertices.size + self.unknowns.held_sides.size + 1)


@dataclass(frozen=True, slots=True, eq=False)
class FactorisedSystem:
    """The system at one Poisson's ratio, ready to be solved.

    Attributes
    ----------
    poisson_ratio : float
    lu, pivots : arrays                   LAPACK's LU factors
    elimination : Elimination or None     reduction to the system that is factorised, where supports
                                          hold some directions only
    reciprocal_condition : float          estimate in the 1-norm
    """

    poisson_ratio: float
    lu: Float[np.ndarray, "k k"]
    pivots: Int[np.ndarray, " k"]
    elimination: Elimination | None
    reciprocal_condition: float


def assemble_system(
    surface: BoundarySurface, *, quadrature: Quadrature = Quadrature()
) -> BoundarySystem:
    """Compute all integrals of an object on its support, once for all materials.

    Parameters
    ----------
    surface : BoundarySurface
    quadrature : Quadrature

    Returns
    -------
    BoundarySystem
    """
    unknowns = find_unknowns(surface)
    collocation = place_collocation(surface, unknowns)
    raw = integral_equations(surface, unknowns, collocation, quadrature=quadrature)
    h = with_rigid_body_sum(raw.traction_kernel, collocation, surface.displacement)
    return replace(raw, traction_kernel=h)


def integral_equations(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    *,
    quadrature: Quadrature = Quadrature(),
) -> BoundarySystem:
    """Boundary integral equations at given points, without the term of the displacement at the
    point itself.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    quadrature : Quadrature

    Returns
    -------
    BoundarySystem                        as many rows as points; the traction kernel lacks the
                                          rigid-body sum
    """
    h = assemble(surface, collocation, surface.displacement, TRACTION, quadrature=quadrature)
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    g = assemble(
        surface, collocation, restricted_nodes(surface.traction, held, index), DISPLACEMENT,
        triangles=held, quadrature=quadrature,
    )  # fmt: skip
    return BoundarySystem(surface, unknowns, collocation, h, g)


def restricted_nodes(
    nodes: QuadraticNodes, elements: Int[np.ndarray, " k"], index: Int[np.ndarray, " n"]
) -> QuadraticNodes:
    """Restrict nodes to some elements and renumber those with values of their own.

    Parameters
    ----------
    nodes : QuadraticNodes
    elements : (k,) int
    index : (n,) int          new number of each node, -1 where it is not needed

    Returns
    -------
    QuadraticNodes
    """
    count = int(index.max()) + 1
    corner = index[nodes.element[elements, :3]]
    middle = nodes.element[elements, 3:] - nodes.n_nodes + count
    kept = np.flatnonzero(index >= 0)
    order = kept[np.argsort(index[kept])]
    return QuadraticNodes(np.concatenate([corner, middle], axis=1), count, nodes.weights[:, order])


def system_matrix(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> Float[np.ndarray, "r k"]:
    """The matrix at one Poisson's ratio, multiplied by 8 pi (1 - nu).

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float
    precision : type          of its entries

    Returns
    -------
    (r, k) float              Fortran order; rows by component, then by collocation point in the
                              order of the blocks; the last three are the force balance
    """
    n_rows = system.collocation.point.shape[0]
    n_free = system.unknowns.free_vertices.size
    matrix = np.zeros((system.size, 3 * n_rows + 3), dtype=precision)
    # The transpose is filled: by node and component, then by component and collocation point.
    entries = matrix[:-3, :-3].reshape(-1, 3, 3, n_rows)
    n_blocks = len(system.traction_kernel.rows)
    in_threads(_fill_rows, n_blocks, system, poisson_ratio, entries)
    weights = integral_weights(system.surface, np.flatnonzero(system.surface.held))
    balance = weights[system.unknowns.held_sides] / system.traction_length**2
    for axis in range(3):
        matrix[3 * n_free + axis : -3 : 3, 3 * n_rows + axis] = balance
        matrix[axis - 3, axis * n_rows : (axis + 1) * n_rows] = 8 * np.pi
    return matrix.T


def _fill_rows(
    begin: int,
    end: int,
    system: BoundarySystem,
    poisson_ratio: float,
    entries: Float[np.ndarray, "n 3 3 r"],
) -> None:
    """Fill in the integral equations of some blocks of collocation points."""
    free = system.unknowns.free_vertices
    for b in range(begin, end):
        rows = slice(b * LANES, min((b + 1) * LANES, entries.shape[3]))
        lanes = slice(0, rows.stop - rows.start)
        h = np.moveaxis(system.traction_kernel.values[b, free][..., lanes], 1, 0)
        scaled, constant = traction_parts(h)
        traction = (1 - 2 * poisson_ratio) * scaled + constant
        entries[: free.size, :, :, rows] = traction.transpose(2, 1, 0, 3)
        g = np.moveaxis(system.displacement_kernel.values[b][..., lanes], 1, 0)
        constant, slope = displacement_parts(g)
        displacement = -(constant + poisson_ratio * slope) / system.traction_length
        entries[free.size :, :, :, rows] = displacement.transpose(2, 1, 0, 3)


def system_elimination(system: BoundarySystem) -> Elimination | None:
    """Reduction to the square system that is factorised; None where supports hold all directions.

    Parameters
    ----------
    system : BoundarySystem
    """
    order = system.traction_kernel.rows.ravel()[: system.traction_kernel.n_rows]
    return make_elimination(system.surface, system.unknowns, system.collocation, order)


def factorise(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> FactorisedSystem:
    """Factorise the system at one Poisson's ratio.

    Parameters
    ----------
    system : BoundarySystem
    poisson_ratio : float     -1 < nu <= 0.5
    precision : type          of the factors

    Returns
    -------
    FactorisedSystem

    Raises
    ------
    SingularSystemError       the reciprocal condition is below 1e-13, most often because of
                              coinciding or degenerate parts of the mesh
    """
    matrix = system_matrix(system, poisson_ratio, precision=precision)
    elimination = system_elimination(system)
    if elimination is not None:
        matrix = elimination.matrix(matrix)
    gecon, lange = get_lapack_funcs(("gecon", "lange"), (matrix,))
    norm = lange("1", matrix)
    if len(matrix) > LARGEST_WHOLE:
        lu, pivots = lu_by_panels(matrix)
    else:
        lu, pivots = lu_factor(matrix, overwrite_a=True, check_finite=False)
    rcond = float(gecon(lu, norm)[0])
    if not rcond > SMALLEST_RCOND:
        raise SingularSystemError(
            f"the system of {system.size} equations is singular (reciprocal condition {rcond:.1e}, "
            f"at least {SMALLEST_RCOND:.0e} is needed); the mesh has coinciding or degenerate "
            "parts: run `palpate check`"
        )
    return FactorisedSystem(poisson_ratio, lu, pivots, elimination, rcond)


def solve(
    factorised: FactorisedSystem, right: Float[np.ndarray, "r c"]
) -> Float[np.ndarray, "k c"]:
    """Solve the factorised system for several right-hand sides.

    Parameters
    ----------
    factorised : FactorisedSystem
    right : (r, c) float      rows in the order of `system_matrix`

    Returns
    -------
    (k, c) float [m]          unknowns as in `BoundarySystem`
    """
    pair, elimination = (factorised.lu, factorised.pivots), factorised.elimination
    given = right if elimination is None else elimination.right(right)
    # Of another type, the factors would be copied.
    given = given.astype(factorised.lu.dtype, copy=False)
    solution = lu_solve(pair, given, check_finite=False).astype(float, copy=False)
    return solution if elimination is None else elimination.unknowns(solution)
