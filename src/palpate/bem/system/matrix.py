"""The matrix of the system at one Poisson's ratio, and its derivative, from the integrals."""

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.bem.integrals.kelvin import displacement_parts, traction_parts
from palpate.bem.integrals.surface import integral_weights
from palpate.bem.system.slope import SystemSlope, slope_to_fill
from palpate.bem.system.system import BlockUse, BoundarySystem, Precision, for_each_block


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
                              order of the system; the last three are the force balance
    """
    matrix, fill = matrix_to_fill(system, poisson_ratio, precision)
    for_each_block(system, fill)
    return matrix


def matrix_and_slope(
    system: BoundarySystem, poisson_ratio: float, *, precision: Precision = np.float64
) -> tuple[Float[np.ndarray, "r k"], SystemSlope]:
    """`system_matrix` and its derivative (`system_slope`), from the same integrals.

    Parameters
    ----------
    system, poisson_ratio, precision    as in `system_matrix`

    Returns
    -------
    (r, k) float
    SystemSlope
    """
    matrix, fill_matrix = matrix_to_fill(system, poisson_ratio, precision)
    slope, fill_slope = slope_to_fill(system, precision)

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        fill_matrix(rows, traction, displacement)
        fill_slope(rows, traction, displacement)

    for_each_block(system, fill)
    return matrix, slope


def matrix_to_fill(
    system: BoundarySystem, poisson_ratio: float, precision: Precision = np.float64
) -> tuple[Float[np.ndarray, "r k"], BlockUse]:
    """A matrix that lacks its integral equations, and what fills in those of each block.

    Parameters
    ----------
    system, poisson_ratio, precision    as in `system_matrix`

    Returns
    -------
    (r, k) float              with the force balance and the slack
    callable                  for `for_each_block`
    """
    n_rows, length = system.n_points, system.traction_length
    free, held_sides = system.unknowns.free_vertices, system.unknowns.held_sides
    matrix = np.zeros((system.size, 3 * n_rows + 3), dtype=precision)
    weights = integral_weights(system.surface, np.flatnonzero(system.surface.held))
    for axis in range(3):
        balance = weights[held_sides] / length**2
        matrix[3 * free.size + axis : -3 : 3, 3 * n_rows + axis] = balance
        matrix[axis - 3, axis * n_rows : (axis + 1) * n_rows] = 8 * np.pi
    # The transpose is filled: by node and component, then by component and collocation point.
    entries = matrix[:-3, :-3].reshape(-1, 3, 3, n_rows)

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        scaled, constant = traction_parts(np.moveaxis(traction[free], 1, 0))
        from_displacement = (1 - 2 * poisson_ratio) * scaled + constant
        entries[: free.size, :, :, rows] = from_displacement.transpose(2, 1, 0, 3)
        constant, slope = displacement_parts(np.moveaxis(displacement, 1, 0))
        from_traction = -(constant + poisson_ratio * slope) / length
        entries[free.size :, :, :, rows] = from_traction.transpose(2, 1, 0, 3)

    return matrix.T, fill


def held_columns(
    system: BoundarySystem, basis: Float[np.ndarray, "d c"] | csr_array
) -> Float[np.ndarray, "2 r c"]:
    """What displacements of the held vertices add to the right-hand side of the equations.

    Parameters
    ----------
    system : BoundarySystem
    basis : (3 h, c) float or sparse [m]    displacements of the held vertices, three rows each

    Returns
    -------
    (2, r, c) float           constant and slope in nu, for a shear modulus of one pascal; rows as
                              in `system_matrix`
    """
    held, columns = system.unknowns.held_vertices, basis.shape[1]
    terms = np.zeros((2, 3 * system.n_points + 3, columns))
    equations = terms[:, :-3].reshape(2, 3, system.n_points, columns)

    def add(rows: slice, traction: np.ndarray, _: np.ndarray) -> None:
        scaled, constant = (
            (part.transpose(0, 3, 2, 1).reshape(-1, 3 * held.size) @ basis).reshape(3, -1, columns)
            for part in traction_parts(np.moveaxis(traction[held], 1, 0))
        )
        equations[0, :, rows] = -(scaled + constant)
        equations[1, :, rows] = 2 * scaled

    for_each_block(system, add)
    return terms
