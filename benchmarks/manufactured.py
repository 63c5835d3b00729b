"""Boundary value problems whose solution is known everywhere: what the solver makes of them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import BoundarySurface, boundary_system, factorise, solve, support_columns
from palpate.bem.elastic_map import sorted_state
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.right_hand import traction_column
from palpate.geometry import TriangleMesh

Normals = Callable[[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]], Float[np.ndarray, "k 3"]]


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """An exact solution of elasticity without body forces.

    Parameters
    ----------
    displacement : position (k, 3) -> (k, 3) [m]
    traction : position (k, 3), normal (k, 3) -> (k, 3) [Pa]
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    """

    displacement: Callable[[Float[np.ndarray, "k 3"]], Float[np.ndarray, "k 3"]]
    traction: Callable[
        [Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3"]], Float[np.ndarray, "k 3"]
    ]
    poisson_ratio: float
    shear_modulus: float


@dataclass(frozen=True, slots=True, eq=False)
class Outcome:
    """Found and exact values of the unknowns of one problem.

    Parameters
    ----------
    displacement, exact_displacement : (f, 3) float [m]     free vertices
    traction, exact_traction : (s, 3) float [Pa]            sides of the support
    """

    displacement: Float[np.ndarray, "f 3"]
    exact_displacement: Float[np.ndarray, "f 3"]
    traction: Float[np.ndarray, "s 3"]
    exact_traction: Float[np.ndarray, "s 3"]

    @property
    def relative(self) -> float:
        """Relative L2 error of the displacement over the free vertices."""
        exact = self.exact_displacement
        return float(np.linalg.norm(self.displacement - exact) / np.linalg.norm(exact))


def linear_field(
    strain: Float[np.ndarray, "3 3"], poisson_ratio: float, shear_modulus: float
) -> Field:
    """Homogeneous strain."""
    lame = 2 * shear_modulus * poisson_ratio / (1 - 2 * poisson_ratio)
    stress = 2 * shear_modulus * strain + lame * np.trace(strain) * np.eye(3)
    return Field(
        lambda position: position @ strain,
        lambda position, normal: normal @ stress,
        poisson_ratio,
        shear_modulus,
    )


def kelvin_field(
    source: Float[np.ndarray, "3"],
    force: Float[np.ndarray, "3"],
    poisson_ratio: float,
    shear_modulus: float,
) -> Field:
    """Point force at a place outside the object, in unbounded space."""

    def displacement(position):
        kernel = kelvin_displacement(position - source, shear_modulus, poisson_ratio)
        return np.einsum("i,nij->nj", force, kernel)

    def traction(position, normal):
        kernel = kelvin_traction(position - source, normal, poisson_ratio)
        return np.einsum("i,nij->nj", force, kernel)

    return Field(displacement, traction, poisson_ratio, shear_modulus)


def kelvin_displacement(
    r: Float[np.ndarray, "n 3"], shear_modulus: float, poisson_ratio: float
) -> Float[np.ndarray, "n 3 3"]:
    """Displacement at x per unit point force at y in unbounded elastic space.

    Parameters
    ----------
    r : (n, 3) float [m]            x - y, non-zero
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    (n, 3, 3) float [m/N]           entry [n, i, j]: force along i, component j; symmetric

    Source
    ------
    Lang and Pai (2001), eq. 3
    """
    distance = np.linalg.norm(r, axis=1)[:, None, None]
    outer = r[:, :, None] * r[:, None, :]
    part = (3 - 4 * poisson_ratio) * np.eye(3) / distance + outer / distance**3
    return part / (16 * np.pi * shear_modulus * (1 - poisson_ratio))


def kelvin_traction(
    r: Float[np.ndarray, "n 3"], normal: Float[np.ndarray, "n 3"], poisson_ratio: float
) -> Float[np.ndarray, "n 3 3"]:
    """Traction at x on a plane of given normal per unit point force at y in unbounded elastic
    space.

    Parameters
    ----------
    r : (n, 3) float [m]            x - y, non-zero
    normal : (n, 3) float [-]       unit normals at x
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    (n, 3, 3) float [1/m^2]         entry [n, i, j]: force along i, component j

    Source
    ------
    Lang and Pai (2001), eq. 2
    """
    distance = np.linalg.norm(r, axis=1)[:, None, None]
    outer = r[:, :, None] * r[:, None, :]
    skew = r[:, :, None] * normal[:, None, :] - normal[:, :, None] * r[:, None, :]
    flux = np.einsum("ni,ni->n", r, normal)[:, None, None]
    a = (skew - np.eye(3) * flux) / distance**3
    b = -3 * outer * flux / distance**5
    return ((1 - 2 * poisson_ratio) * a + b) / (8 * np.pi * (1 - poisson_ratio))


def flat_normals(mesh: TriangleMesh) -> Normals:
    """Unit normals of the facets themselves, as `solved` asks for them."""
    corner = mesh.vertices[mesh.triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return lambda triangle, position: normal[triangle]


def solved(
    surface: BoundarySurface,
    field: Field,
    normals: Normals,
    *,
    quadrature: Quadrature,
) -> Outcome:
    """Prescribe the exact displacement on the support, the exact traction elsewhere, and solve.

    Parameters
    ----------
    surface : BoundarySurface
    field : Field
    normals : triangle (k,), position (k, 3) -> (k, 3)      outward unit normals of the true object
    quadrature : Quadrature

    Returns
    -------
    Outcome
    """
    system = boundary_system(surface, quadrature=quadrature)
    known = field.displacement(surface.mesh.vertices)
    free = np.flatnonzero(~surface.held)
    position = surface.element_nodes[free].reshape(-1, 3)
    given = field.traction(position, normals(np.repeat(free, 6), position)).reshape(-1, 6, 3)
    right = traction_column(system, free, given / field.shear_modulus, quadrature=quadrature)
    right = right + support_columns(system, known[:, :, None])
    nu = field.poisson_ratio
    solution = solve(factorise(system, nu), right.at(nu))[:, 0]
    state = sorted_state(system, solution, field.shear_modulus)
    vertices, sides = system.unknowns.free_vertices, system.unknowns.held_sides
    of_side = np.zeros(surface.traction.n_nodes, dtype=np.int64)
    of_side[surface.sides.corner.ravel()] = np.repeat(np.arange(surface.held.size), 3)
    at_side = surface.mesh.vertices[surface.sides.vertex[sides]]
    return Outcome(
        displacement=state.displacement[vertices],
        exact_displacement=known[vertices],
        traction=state.support_traction,
        exact_traction=field.traction(at_side, normals(of_side[sides], at_side)),
    )
