"""Right-hand sides of the system, polynomials in Poisson's ratio of degree two at most.

A constant body force, such as gravity, has a particular solution, which spares a volume integral.
With b the force per volume and y the position, the hydrostatic stress -(b.y) times the unit tensor
balances b. Its strain is isotropic and linear in y, and belongs to the displacement

    u_p = -(1 - 2 nu) / (2 G (1 + nu)) [(b.y) y - b |y|^2 / 2],      traction  t_p = -(b.y) n.

The remaining displacement has no body force: its traction is +(b.y) n on the free surface, for any
material, and its displacement -u_p on the support. Both are right-hand sides of the same system.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.integrals.assembly import kernel_integrals
from palpate.bem.integrals.kelvin import DISPLACEMENT, displacement_parts
from palpate.bem.integrals.surface import BoundarySurface, Quadrature, triangle_rule
from palpate.bem.system.system import BoundarySystem
from palpate.geometry import ELEMENT_NODES, QuadraticNodes, element_points, quadratic_shapes


@dataclass(frozen=True, slots=True, eq=False)
class RightHand:
    """Columns for a shear modulus of one pascal, quadratic in Poisson's ratio.

    Attributes
    ----------
    terms : (3, k, c) float       constant, factor of nu, factor of nu^2
    """

    terms: Float[np.ndarray, "3 k c"]

    def at(self, poisson_ratio: float) -> Float[np.ndarray, "k c"]:
        """The columns at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float

        Returns
        -------
        (k, c) float
        """
        constant, slope, curvature = self.terms
        return constant + poisson_ratio * (slope + poisson_ratio * curvature)

    def of(self, columns: Int[np.ndarray, " m"]) -> "RightHand":
        """Some of the columns."""
        return RightHand(self.terms[:, :, columns])

    def on_springs(
        self,
        compliance: Float[np.ndarray, " e"],
        compliance_derivatives: Float[np.ndarray, "d e"],
        known: Float[np.ndarray, "e c"] | None = None,
    ) -> "RightHand":
        """These loads for an object on springs (`SpringSystem`).

        Parameters
        ----------
        compliance : (e,) float         dimensionless compliance of each spring
        compliance_derivatives : (d, e) float    with respect to that of each support
        known : (e, c) float or None    known traction on each spring in addition to the unknown
                                        one, times `traction_length`; None: none

        Returns
        -------
        RightHand                 1 + d blocks of rows: the equations, then those of the springs
        """
        count, columns = self.terms.shape[1:]
        terms = np.zeros((3, 1 + len(compliance_derivatives), count + compliance.size, columns))
        terms[:, 0, :count] = self.terms
        if known is not None:
            terms[0, :, count:] = (
                -np.vstack([compliance, compliance_derivatives])[:, :, None] * known
            )
        return RightHand(terms.reshape(3, -1, columns))


def load_columns(
    fields: Float[np.ndarray, "r k 6"], balance: Float[np.ndarray, "3 3"]
) -> RightHand:
    """Three columns for each of some loads, of one newton along each axis.

    Parameters
    ----------
    fields : (r, k, 6) float [1/m]    from `integrate_loads`
    balance : (3, 3) float [1/m]      minus the total load of each column over `traction_length`

    Returns
    -------
    RightHand                         3 r + 3 rows, 3 k columns
    """
    n_rows, count = fields.shape[:2]
    terms = np.zeros((3, 3 * n_rows + 3, 3 * count))
    for k in range(count):
        columns = slice(3 * k, 3 * k + 3)
        constant, slope = displacement_parts(fields[:, k].T)
        terms[0, :-3, columns] = constant.transpose(0, 2, 1).reshape(-1, 3)
        terms[1, :-3, columns] = slope.transpose(0, 2, 1).reshape(-1, 3)
        terms[0, -3:, columns] = balance
    return RightHand(terms)


def support_columns(system: BoundarySystem, displacement: Float[np.ndarray, "v 3 c"]) -> RightHand:
    """One column for each of some prescribed displacements of the held vertices.

    Parameters
    ----------
    system : BoundarySystem
    displacement : (v, 3, c) float [m]    of every vertex; only that of held vertices is used, along
                                          the directions in which they are held

    Returns
    -------
    RightHand                         3 r + 3 rows, c columns, for a shear modulus of one pascal
    """
    held, columns = system.unknowns.held_vertices, displacement.shape[2]
    terms = np.zeros((3, 3 * system.n_points + 3, columns))
    if not columns:
        return RightHand(terms)
    prescribed = np.einsum("hij,hjc->hic", system.unknowns.vertex_directions, displacement[held])
    terms[:2] = system.held_columns(prescribed.reshape(-1, columns))
    return RightHand(terms)


def traction_column(
    system: BoundarySystem,
    triangles: Int[np.ndarray, " k"],
    traction: Float[np.ndarray, "k 6 3"],
    *,
    quadrature: Quadrature = Quadrature(),
) -> RightHand:
    """One column for a traction that is quadratic on each of some triangles and may jump between
    them.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int              triangles of the free surface
    traction : (k, 6, 3) float [Pa]   at their corners and at the midpoints of their edges 01, 12,
                                      20
    quadrature : Quadrature

    Returns
    -------
    RightHand                         3 r + 3 rows, one column
    """
    surface = system.surface
    # Three auxiliary nodes, one per axis, whose shape functions are the traction's components.
    element = 3 + np.arange(6 * triangles.size).reshape(-1, 6)
    nodes = QuadraticNodes(element, 3, csr_array(traction.reshape(-1, 3)))
    blocks = kernel_integrals(
        surface, system.collocation, nodes, DISPLACEMENT, triangles=triangles, quadrature=quadrature
    ).all_blocks()
    total = total_traction(surface.element_nodes[triangles], traction)
    balance = np.diag(-total / system.traction_length)
    fields = np.stack([blocks.by_row(axis) for axis in range(3)], axis=1)
    # Of the columns of each, that along its own axis.
    terms = load_columns(fields, balance).terms[:, :, ::4]
    return RightHand(terms.sum(axis=2, keepdims=True))


def face_columns(system: BoundarySystem, triangles: Int[np.ndarray, " k"]) -> RightHand:
    """Columns of a uniform traction over some triangles, one newton in total along each axis.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int              of the free surface

    Returns
    -------
    RightHand                         three columns
    """
    surface = system.surface
    nodes = surface.element_nodes[triangles]
    ones = np.ones((triangles.size, 6, 3))
    density = 1.0 / total_traction(nodes, ones)[0]
    element = 1 + np.arange(6 * triangles.size).reshape(-1, 6)
    field = QuadraticNodes(element, 1, csr_array(np.full((element.size, 1), density)))
    blocks = kernel_integrals(
        surface, system.collocation, field, DISPLACEMENT, triangles=triangles
    ).all_blocks()
    return load_columns(blocks.by_row(0)[:, None], -np.eye(3) / system.traction_length)


def pressure_column(system: BoundarySystem, triangles: Int[np.ndarray, " k"]) -> RightHand:
    """One column for a uniform pressure of one pascal on some triangles.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int              of the free surface

    Returns
    -------
    RightHand
    """
    points = element_points(system.surface.element_nodes[triangles], ELEMENT_NODES)
    outward = points[:, :, 3:] / np.linalg.norm(points[:, :, 3:], axis=2)[:, :, None]
    return traction_column(system, triangles, -outward)


def joined(parts: list[RightHand]) -> RightHand:
    """Right-hand sides side by side.

    Parameters
    ----------
    parts : list of RightHand

    Returns
    -------
    RightHand
    """
    return RightHand(np.concatenate([part.terms for part in parts], axis=2))


def total_traction(
    nodes: Float[np.ndarray, "k 6 3"], traction: Float[np.ndarray, "k 6 3"]
) -> Float[np.ndarray, "3"]:
    """Resultant of a traction that is quadratic on each of some triangles.

    Parameters
    ----------
    nodes : (k, 6, 3) float [m]
    traction : (k, 6, 3) float [Pa]

    Returns
    -------
    (3,) float [N]
    """
    barycentric, weight = triangle_rule(7)
    area = np.linalg.norm(element_points(nodes, barycentric)[:, :, 3:], axis=2)
    shape = quadratic_shapes(barycentric)
    return np.einsum("q,kq,aq,kai->i", weight, area, shape, traction)


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
