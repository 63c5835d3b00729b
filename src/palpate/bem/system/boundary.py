"""Boundary conditions: the unknowns at each vertex, and the collocation points.

The free surface has an unknown displacement at each vertex. The support has an unknown traction at
each held side of each of its vertices: one on its rim, where the other side is free. A vertex where
two or three held faces meet has as many unknown tractions, but a single position: there the
collocation points are moved a little into each face (Beer, Smith and Duenser 2008; MultiFEBE does
the same). A roller holds some directions only: its vertices have an unknown displacement along the
others, its sides an unknown traction along those that it holds.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem.integrals.assembly import Collocation
from palpate.bem.integrals.surface import BoundarySurface
from palpate.geometry import quadratic_shapes

# How far a collocation point is moved off its vertex, as a barycentric coordinate.
_SHIFT = 0.1
# Eigenvalue of a sum of projectors up to which its direction counts as not held: two rollers hold
# the same direction where their normals differ by less than 0.8 degrees.
_SAME_DIRECTION = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Unknowns:
    """Unknowns of the system, by vertex and by side.

    Attributes
    ----------
    free_vertices : (f,) int          vertices with an unknown displacement along at least one
                                      direction
    held_vertices : (h,) int          vertices with a prescribed displacement along at least one
                                      direction
    held_sides : (s,) int             sides with an unknown traction
    vertex_directions : (h, 3, 3) float    projector onto the directions in which each held vertex
                                           is held
    side_directions : (s, 3, 3) float      the same for the held sides
    """

    free_vertices: Int[np.ndarray, " f"]
    held_vertices: Int[np.ndarray, " h"]
    held_sides: Int[np.ndarray, " s"]
    vertex_directions: Float[np.ndarray, "h 3 3"]
    side_directions: Float[np.ndarray, "s 3 3"]

    def shares_one_point(self, side_vertex: Int[np.ndarray, " s"]) -> Bool[np.ndarray, " h"]:
        """Whether the three equations of one collocation point suffice for each held vertex and its
        held sides.

        Parameters
        ----------
        side_vertex : (s,) int            vertex of each held side

        Returns
        -------
        (h,) bool
        """
        index = np.searchsorted(self.held_vertices, side_vertex)
        tractions = np.bincount(index, ranks(self.side_directions), self.held_vertices.size)
        return ranks(self.vertex_directions) == tractions


def find_unknowns(surface: BoundarySurface) -> Unknowns:
    """Classify vertices and sides by their unknowns.

    Parameters
    ----------
    surface : BoundarySurface

    Returns
    -------
    Unknowns
    """
    held_vertices = np.unique(surface.mesh.triangles[surface.held])
    held_sides, first = np.unique(surface.sides.corner[surface.held], return_index=True)
    side_directions = surface.held_directions[np.flatnonzero(surface.held)[first // 3]]
    index = np.searchsorted(held_vertices, surface.sides.vertex[held_sides])
    total = np.zeros((held_vertices.size, 3, 3))
    np.add.at(total, index, side_directions)
    vertex_directions = _span(total)
    rolling = held_vertices[ranks(vertex_directions) < 3]
    fixed = np.setdiff1d(held_vertices, rolling)
    free_vertices = np.setdiff1d(np.arange(surface.mesh.vertices.shape[0]), fixed)
    return Unknowns(free_vertices, held_vertices, held_sides, vertex_directions, side_directions)


def ranks(projectors: Float[np.ndarray, "n 3 3"]) -> Int[np.ndarray, " n"]:
    """Rank of each projector.

    Parameters
    ----------
    projectors : (n, 3, 3) float

    Returns
    -------
    (n,) int
    """
    return np.rint(np.trace(projectors, axis1=1, axis2=2)).astype(np.int64)


def _span(total: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Orthogonal projector onto the range of a sum of projectors."""
    value, vector = np.linalg.eigh(total)
    kept = vector * (value > _SAME_DIRECTION)[:, None, :]
    return np.einsum("nik,njk->nij", kept, vector)


def place_collocation(surface: BoundarySurface, unknowns: Unknowns) -> Collocation:
    """Choose the collocation points: as many as there are unknown vectors.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns

    Returns
    -------
    Collocation               every vertex, except those whose held sides need more equations than
                              one point supplies: these get a point inside each held side instead,
                              and keep the vertex only if its displacement is partly unknown
    """
    side_vertex = surface.sides.vertex[unknowns.held_sides]
    several = np.zeros(surface.mesh.vertices.shape[0], dtype=bool)
    several[unknowns.held_vertices] = ~unknowns.shares_one_point(side_vertex)
    dropped = several.copy()
    dropped[unknowns.free_vertices] = False
    vertex = np.flatnonzero(~dropped)
    shifted = unknowns.held_sides[several[side_vertex]]
    triangle, barycentric = _points_inside(surface, shifted)
    inside = np.einsum("ak,kai->ki", quadratic_shapes(barycentric), surface.element_nodes[triangle])
    return Collocation(
        point=np.concatenate([surface.mesh.vertices[vertex], inside]),
        vertex=np.concatenate([vertex, np.full(shifted.size, -1)]),
        triangle=np.concatenate([np.full(vertex.size, -1), triangle]),
        barycentric=np.concatenate([np.zeros((vertex.size, 3)), barycentric]),
    )


def _points_inside(
    surface: BoundarySurface, sides: Int[np.ndarray, " k"]
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """A triangle of each side's fan, and a point in it close to the vertex."""
    corner = surface.sides.corner
    order = np.argsort(corner.ravel(), kind="stable")
    first = np.searchsorted(corner.ravel()[order], sides)
    last = np.searchsorted(corner.ravel()[order], sides, side="right")
    chosen = order[(first + last) // 2]
    barycentric = np.full((sides.size, 3), _SHIFT)
    barycentric[np.arange(sides.size), chosen % 3] = 1 - 2 * _SHIFT
    return chosen // 3, barycentric
