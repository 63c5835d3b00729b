"""A constant body force, such as gravity, by a particular solution, without a volume integral.

With b the force per volume and y the position, the hydrostatic stress -(b.y) times the unit tensor
balances b. Its strain is isotropic and linear in y, and belongs to the displacement

    u_p = -(1 - 2 nu) / (2 G (1 + nu)) [(b.y) y - b |y|^2 / 2],      traction  t_p = -(b.y) n.

The remaining displacement has no body force: its traction is +(b.y) n on the free surface, for any
material, and its displacement -u_p on the support. Both are right-hand sides of the same system.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals.quadrature import Quadrature
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.loads.right_hand import RightHand, joined, support_columns, traction_column
from palpate.bem.system.system import BoundarySystem
from palpate.geometry import ELEMENT_NODES, element_points


@dataclass(frozen=True, slots=True, eq=False)
class BodyForce:
    """Right-hand sides of a constant body force.

    With x_0 and x_1 the solutions for the two columns, the displacement times the shear modulus is
    x_0 + factor(nu) (x_1 + particular).

    Attributes
    ----------
    right : RightHand                     two columns: traction on the free surface; displacement
                                          of the support
    particular : (v, 3) float [m Pa]      particular displacement of every vertex times the shear
                                          modulus, over factor(nu), the `dilation_factor`
    support_traction : (s, 3) float [Pa]  particular traction at the held sides
    """

    right: RightHand
    particular: Float[np.ndarray, "v 3"]
    support_traction: Float[np.ndarray, "s 3"]


def dilation_factor(poisson_ratio: float) -> float:
    """(1 - 2 nu) / (2 (1 + nu)), the material's factor in the particular displacement.

    Parameters
    ----------
    poisson_ratio : float [-]

    Returns
    -------
    float [-]
    """
    return (1 - 2 * poisson_ratio) / (2 * (1 + poisson_ratio))


def body_force_columns(
    system: BoundarySystem,
    force_density: Float[np.ndarray, "3"],
    *,
    quadrature: Quadrature = Quadrature(),
) -> BodyForce:
    """Right-hand sides for a constant force per volume.

    Parameters
    ----------
    system : BoundarySystem
    force_density : (3,) float [N/m^3]    density times acceleration
    quadrature : Quadrature

    Returns
    -------
    BodyForce
    """
    surface = system.surface
    held = surface.mesh.vertices[system.unknowns.held_vertices]
    origin = held.mean(axis=0)
    y = surface.mesh.vertices - origin
    square = np.einsum("vi,vi->v", y, y)[:, None]
    particular = 0.5 * square * force_density - (y @ force_density)[:, None] * y
    # Along held directions the support carries the traction of the particular solution.
    free_directions = np.eye(3) - surface.held_directions
    free = np.flatnonzero(free_directions.any(axis=(1, 2)))
    traction = _hydrostatic_traction(surface, free, force_density, origin)
    traction = np.einsum("kij,kqj->kqi", free_directions[free], traction)
    traction_part = traction_column(system, free, traction, quadrature=quadrature)
    held_traction = _at_sides(system, force_density, origin)
    return BodyForce(
        joined([traction_part, support_columns(system, -particular[:, :, None])]),
        particular,
        held_traction,
    )


def _at_sides(
    system: BoundarySystem, force_density: Float[np.ndarray, "3"], origin: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "s 3"]:
    """-(b.y) n at every held side, n the mean normal of its triangles."""
    surface, sides = system.surface, system.unknowns.held_sides
    held = np.flatnonzero(surface.held)
    total = np.zeros((surface.traction.n_nodes, 3))
    traction = _hydrostatic_traction(surface, held, force_density, origin)[:, :3]
    np.add.at(total, surface.sides.corner[held], traction)
    count = np.bincount(surface.sides.corner[held].ravel(), minlength=len(total))
    return -total[sides] / count[sides][:, None]


def _hydrostatic_traction(
    surface: BoundarySurface,
    triangles: Int[np.ndarray, " k"],
    force_density: Float[np.ndarray, "3"],
    origin: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "k 6 3"]:
    """(b.y) n at the six nodes of each triangle."""
    points = element_points(surface.element_nodes[triangles], ELEMENT_NODES)
    normal = points[:, :, 3:] / np.linalg.norm(points[:, :, 3:], axis=2)[:, :, None]
    return ((points[:, :, :3] - origin) @ force_density)[:, :, None] * normal
