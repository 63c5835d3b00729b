"""Displacement of any point of the surface, as accurate as that of a vertex.

Under a tool the displacement varies within an element, and interpolation between the vertices
smooths it. The integral equation collocated at the point itself contains the load there, and yields
the displacement once the vertices' displacements and the support's tractions are known.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals.assembly import Collocation
from palpate.bem.integrals.kelvin import TRACTION, traction_parts
from palpate.bem.integrals.quadrature import Quadrature
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.system.matrix import matrix_to_fill
from palpate.bem.system.system import BoundarySystem, equations_at, for_each_block
from palpate.geometry import quadratic_shapes

# A point with a barycentric coordinate above this is treated as the vertex.
_AT_VERTEX = 1 - 1e-6
# Smallest distance from an edge, as a barycentric coordinate: polar coordinates require one.
_MIN_FROM_EDGE = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class PointEquations:
    """The integral equation at points of the surface, linear in Poisson's ratio.

    For each point, own(nu) u = matrix(nu) x - right(nu) / G, with u its displacement and x the
    unknowns of the system.

    Attributes
    ----------
    system : BoundarySystem               the equations at the points, for their right-hand sides
    matrix : (2, p, 3, k) float           constant and slope in nu
    own : (2, p, 3, 3) float              constant and slope in nu
    """

    system: BoundarySystem
    matrix: Float[np.ndarray, "2 p 3 k"]
    own: Float[np.ndarray, "2 p 3 3"]

    def by_point(self, rows: Float[np.ndarray, "r c"]) -> Float[np.ndarray, "p 3 c"]:
        """Regroup the rows of a right-hand side by point.

        Parameters
        ----------
        rows : (3 p + 3, c) float         in the order of right-hand sides of `system`

        Returns
        -------
        (p, 3, c) float
        """
        return _sorted_rows(self.system, rows)


def point_equations(
    system: BoundarySystem,
    triangle: Int[np.ndarray, " p"],
    barycentric: Float[np.ndarray, "p 3"],
    *,
    quadrature: Quadrature = Quadrature(),
) -> PointEquations:
    """Write the integral equation at points of the free surface.

    Parameters
    ----------
    system : BoundarySystem
    triangle : (p,) int
    barycentric : (p, 3) float [-]        points closer to an edge than 2 % of their triangle are
                                          moved inward; vertices stay
    quadrature : Quadrature

    Returns
    -------
    PointEquations
    """
    collocation = _collocation_at(system.surface, triangle, barycentric)
    equations = equations_at(system.surface, system.unknowns, collocation, quadrature=quadrature)
    to_fill = [matrix_to_fill(equations, nu) for nu in (0.0, 1.0)]
    fields = np.empty((TRACTION.count, triangle.size))

    def fill(rows: slice, traction: np.ndarray, displacement: np.ndarray) -> None:
        for _, fill_matrix in to_fill:
            fill_matrix(rows, traction, displacement)
        fields[:, equations.order[rows]] = traction.sum(axis=0)

    for_each_block(equations, fill)
    at_zero, at_one = (_sorted_rows(equations, matrix) for matrix, _ in to_fill)
    a, b = (part.transpose(2, 0, 1) for part in traction_parts(fields))
    return PointEquations(
        equations, np.stack([at_zero, at_one - at_zero]), np.stack([a + b, -2 * a])
    )


def _collocation_at(
    surface: BoundarySurface,
    triangle: Int[np.ndarray, " p"],
    barycentric: Float[np.ndarray, "p 3"],
) -> Collocation:
    at_vertex = barycentric.max(axis=1) > _AT_VERTEX
    corner = surface.mesh.triangles[triangle, barycentric.argmax(axis=1)]
    inner = np.clip(barycentric, _MIN_FROM_EDGE, None)
    inner /= inner.sum(axis=1)[:, None]
    point = np.einsum("ap,pai->pi", quadratic_shapes(inner), surface.element_nodes[triangle])
    point[at_vertex] = surface.mesh.vertices[corner[at_vertex]]
    return Collocation(
        point,
        np.where(at_vertex, corner, -1),
        np.where(at_vertex, -1, triangle),
        np.where(at_vertex[:, None], 0.0, inner),
    )


def _sorted_rows(
    system: BoundarySystem, rows: Float[np.ndarray, "r c"]
) -> Float[np.ndarray, "p 3 c"]:
    count = system.n_points
    out = np.empty((count, 3, rows.shape[1]))
    out[system.order] = rows[: 3 * count].reshape(3, count, -1).transpose(1, 0, 2)
    return out
