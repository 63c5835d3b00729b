"""Boundary conditions: what is unknown at each vertex, and where the integral equation is written.

The free surface has an unknown displacement at each vertex. The support has an unknown traction at
each side of each of its vertices; on its rim the free side is not the support's, so there is just
one. A vertex where two or three held faces meet has as many unknown tractions but a single place:
there the equation is written at points moved a little into each face (Beer, Smith and Duenser 2008;
MultiFEBE does the same).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals import BoundarySurface, Collocation
from palpate.geometry import quadratic_shapes

# How far a collocation point is moved off its vertex, as a barycentric coordinate.
_SHIFT = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Columns of the system.

    Attributes
    ----------
    free_vertices : (f,) int          vertices with an unknown displacement
    held_vertices : (h,) int          vertices with a given displacement
    held_sides : (s,) int             sides with an unknown traction
    """

    free_vertices: Int[np.ndarray, " f"]
    held_vertices: Int[np.ndarray, " h"]
    held_sides: Int[np.ndarray, " s"]


def find_unknowns(surface: BoundarySurface) -> Unknowns:
    """Sort vertices and sides by what is unknown there.

    Parameters
    ----------
    surface : BoundarySurface

    Returns
    -------
    Unknowns
    """
    held_vertices = np.unique(surface.mesh.triangles[surface.held])
    free_vertices = np.setdiff1d(np.arange(surface.mesh.vertices.shape[0]), held_vertices)
    held_sides = np.unique(surface.sides.corner[surface.held])
    return Unknowns(free_vertices, held_vertices, held_sides)


def place_collocation(surface: BoundarySurface, unknowns: Unknowns) -> Collocation:
    """Choose as many collocation points as there are unknown vectors.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns

    Returns
    -------
    Collocation               every vertex, but for those with several held sides: these have a
                              point inside each
    """
    n = surface.mesh.vertices.shape[0]
    side_vertex = surface.sides.vertex[unknowns.held_sides]
    several = np.bincount(side_vertex, minlength=n) > 1
    vertex = np.flatnonzero(~several)
    moved = unknowns.held_sides[several[side_vertex]]
    triangle, barycentric = _points_inside(surface, moved)
    inside = np.einsum("ak,kai->ki", quadratic_shapes(barycentric), surface.element_nodes[triangle])
    return Collocation(
        point=np.concatenate([surface.mesh.vertices[vertex], inside]),
        vertex=np.concatenate([vertex, np.full(moved.size, -1)]),
        triangle=np.concatenate([np.full(vertex.size, -1), triangle]),
        barycentric=np.concatenate([np.zeros((vertex.size, 3)), barycentric]),
    )


def _points_inside(
    surface: BoundarySurface, sides: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """A triangle of each side's fan and a point in it, a little away from the vertex."""
    corner = surface.sides.corner
    order = np.argsort(corner.ravel(), kind="stable")
    first = np.searchsorted(corner.ravel()[order], sides)
    last = np.searchsorted(corner.ravel()[order], sides, side="right")
    chosen = order[(first + last) // 2]
    barycentric = np.full((sides.size, 3), _SHIFT)
    barycentric[np.arange(sides.size), chosen % 3] = 1 - 2 * _SHIFT
    return chosen // 3, barycentric
