"""The boundary integral equations of a held object, linear in Poisson's ratio.

The free surface has an unknown displacement at each vertex. The support has an unknown traction at
each held side of each of its vertices: one on its rim, where the other side is free. A vertex where
two or three held faces meet has as many unknown tractions, but a single position: there the
collocation points are moved a little into each face (Beer, Smith and Duenser 2008; MultiFEBE does
the same). A roller holds some directions only: its vertices have an unknown displacement along the
others, its sides an unknown traction along those that it holds.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import csr_array

from palpate.bem.integrals.assembly import (
    Collocation,
    add_rigid_body_sum,
    kernel_integrals,
    point_blocks,
)
from palpate.bem.integrals.kelvin import DISPLACEMENT, LANES, TRACTION, traction_parts
from palpate.bem.integrals.surface import BoundarySurface, Quadrature
from palpate.checkpoints import Cache, Checkpoints, content_digest
from palpate.geometry import QuadraticNodes, quadratic_shapes
from palpate.threads import in_threads

# To be increased with every change of what is kept of a system or how it is computed.
_FORMAT = 6
# Type of the entries of a matrix.
Precision = type[np.float64] | type[np.float32]
# What is done with the integrals of one block: its rows, the traction kernel's (v, 9, rows) for
# every vertex, the displacement kernel's (s, 6, rows) for every held side.
BlockUse = Callable[
    [slice, Float[np.ndarray, "v fields rows"], Float[np.ndarray, "s fields rows"]], None
]
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


@dataclass(frozen=True, slots=True, eq=False)
class BoundarySystem:
    """The integral equations of one object on its supports, for all materials.

    The system for the unknowns x = (displacement of the free vertices [m], traction of the held
    sides times `traction_length` over the shear modulus [m], slack [m]) is matrix(nu) x =
    right-hand side, with the integral equations multiplied by 8 pi (1 - nu).

    Collocation does not satisfy global force equilibrium by itself. Three more equations require
    the support's tractions to balance the load, and three more unknowns keep the system square: a
    slack for each component, the same in all integral equations. The slack is zero in the exact
    solution and about 1e-4 of the displacement in a discrete one.

    The integrals are computed anew by whatever needs them (`for_each_block`), a second or two for
    2500 vertices: kept, they would be larger than the matrix.

    Attributes
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    rows : (b, LANES) int                 collocation points in the order of the equations, by
                                          blocks, the last one padded (`point_blocks`)
    quadrature : Quadrature
    checkpoints : Checkpoints             where what follows from the equations alone is kept
    """

    surface: BoundarySurface
    unknowns: Unknowns
    collocation: Collocation
    rows: Int[np.ndarray, "b lanes"]
    quadrature: Quadrature
    checkpoints: Checkpoints = field(default=Checkpoints(None), kw_only=True)

    @property
    def traction_length(self) -> float:
        """Size of the held triangles [m]: scales tractions to displacements, so that all columns
        have similar norms."""
        return self.surface.held_length

    @property
    def size(self) -> int:
        """Number of scalar unknowns, the three of the slack included."""
        return 3 * (self.unknowns.free_vertices.size + self.unknowns.held_sides.size + 1)

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return self.collocation.point.shape[0]

    @property
    def order(self) -> Int[np.ndarray, " r"]:
        """Collocation point of each row of one component."""
        return self.rows.ravel()[: self.n_points]

    def held_columns(
        self, basis: Float[np.ndarray, "d c"] | csr_array
    ) -> Float[np.ndarray, "2 r c"]:
        """What displacements of the held vertices add to the right-hand side of the equations.

        Parameters
        ----------
        basis : (3 h, c) float or sparse [m]    displacements of the held vertices, three rows each

        Returns
        -------
        (2, r, c) float           constant and slope in nu, for a shear modulus of one pascal; rows
                                  as in `system_matrix`
        """
        held, columns = self.unknowns.held_vertices, basis.shape[1]
        terms = np.zeros((2, 3 * self.n_points + 3, columns))
        equations = terms[:, :-3].reshape(2, 3, self.n_points, columns)

        def add(rows: slice, traction: np.ndarray, _: np.ndarray) -> None:
            scaled, constant = (
                (part.transpose(0, 3, 2, 1).reshape(-1, 3 * held.size) @ basis).reshape(
                    3, -1, columns
                )
                for part in traction_parts(np.moveaxis(traction[held], 1, 0))
            )
            equations[0, :, rows] = -(scaled + constant)
            equations[1, :, rows] = 2 * scaled

        for_each_block(self, add)
        return terms


def boundary_system(
    surface: BoundarySurface, *, quadrature: Quadrature = Quadrature(), cache: Cache | None = None
) -> BoundarySystem:
    """The equations of an object on its support, for dense matrices.

    Parameters
    ----------
    surface : BoundarySurface
    quadrature : Quadrature
    cache : Cache or None         folder in which what follows from the equations alone is kept for
                                  later systems of the same object: factors, reduced models (some
                                  100 MB for 1000 vertices); created if absent; nothing is kept
                                  where it cannot be written

    Returns
    -------
    BoundarySystem
    """
    unknowns = find_unknowns(surface)
    collocation = place_collocation(surface, unknowns)
    checkpoints = Checkpoints(None)
    if cache is not None:
        checkpoints = Checkpoints(cache, _digest(surface, quadrature), cache=True)
    rows = point_blocks(collocation.point)
    return BoundarySystem(surface, unknowns, collocation, rows, quadrature, checkpoints=checkpoints)


def for_each_block(system: BoundarySystem, use: BlockUse) -> None:
    """Compute the integrals of a system, block by block of collocation points, in threads.

    Parameters
    ----------
    system : BoundarySystem
    use : callable            what is done with each block, called by several threads at once
    """
    surface, unknowns, quadrature = system.surface, system.unknowns, system.quadrature
    h = kernel_integrals(
        surface, system.collocation, surface.displacement, TRACTION, quadrature=quadrature
    )
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    g = kernel_integrals(
        surface, system.collocation, restricted_nodes(surface.traction, held, index), DISPLACEMENT,
        triangles=held, quadrature=quadrature,
    )  # fmt: skip

    def work(begin: int, end: int) -> None:
        for number in range(begin, end):
            traction, displacement = h.block(number), g.block(number)
            add_rigid_body_sum(
                traction, system.rows[number], system.collocation, surface.displacement
            )
            rows = slice(number * LANES, min((number + 1) * LANES, system.n_points))
            count = rows.stop - rows.start
            use(rows, traction[:, :, :count], displacement[:, :, :count])

    in_threads(work, len(system.rows))


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
    numbered = np.flatnonzero(index >= 0)
    order = numbered[np.argsort(index[numbered])]
    return QuadraticNodes(np.concatenate([corner, middle], axis=1), count, nodes.weights[:, order])


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


def _digest(surface: BoundarySurface, quadrature: Quadrature) -> str:
    """Digest of everything that the equations depend on."""
    nodes = [
        (node_set.element, node_set.weights.indptr, node_set.weights.indices, node_set.weights.data)
        for node_set in (surface.displacement, surface.traction)
    ]
    shape = surface.mesh.triangles, surface.element_nodes
    held = surface.held, surface.held_directions
    return content_digest((_FORMAT, *shape, *held, nodes, quadrature))


def _span(total: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3 3"]:
    """Orthogonal projector onto the range of a sum of projectors."""
    value, vector = np.linalg.eigh(total)
    directions = vector * (value > _SAME_DIRECTION)[:, None, :]
    return np.einsum("nik,njk->nij", directions, vector)


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
