"""Rollers, supports that hold some directions only: the remaining unknowns and equations.

Along the directions that a roller holds, the displacement is prescribed and the traction unknown;
along the others it is the other way round. The full system has both as unknowns, and their known
components are eliminated before it is solved: the columns are combined to those that remain, the
rows to as many.

Rigid-body motions that no support restrains, such as sliding along a plane or a rotation about an
axis, are constrained to a mean of zero over the surface; callers that measure them add them again.
The constraint on a translation replaces the force balance along it, which the load must satisfy by
itself. That on a rotation stands for a moment balance, with a slack as for the forces.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import orth
from scipy.sparse import block_diag, csr_array, eye_array

from palpate.bem.integrals.assembly import Collocation
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.system.boundary import Unknowns, find_unknowns

# Singular value, relative to the largest, up to which a rigid-body motion counts as not held.
_UNRESTRAINED = 1e-6
# The equations are multiplied by 8 pi (1 - nu): added rows and columns are scaled alike.
_SCALE = 8 * np.pi
_CHUNK = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Elimination:
    """Reduction of the full system, r rows and k unknowns, to the square one that is solved.

    The square matrix is [[rows M columns, slack], [constraints columns, 0]], its right-hand side
    [rows b, 0]; `columns` times its first n unknowns solves the full system.

    Attributes
    ----------
    rows : (m, r) sparse
    columns : (k, n) sparse               orthonormal
    slack : (m, e) float                  of the moment balances that no support provides
    constraints : (q, k) float            mean of each rigid-body motion that is not held, up to a
                                          factor
    """

    rows: csr_array
    columns: csr_array
    slack: Float[np.ndarray, "m e"]
    constraints: Float[np.ndarray, "q k"]

    def matrix(self, full: Float[np.ndarray, "r k"]) -> Float[np.ndarray, "s s"]:
        """The square matrix, in Fortran order and in the precision of the full one.

        Parameters
        ----------
        full : (r, k) float

        Returns
        -------
        (s, s) float
        """
        m, n = self.rows.shape[0], self.columns.shape[1]
        size = n + self.slack.shape[1], m + len(self.constraints)
        square = np.zeros(size, dtype=full.dtype).T
        rows, columns = self.rows.astype(full.dtype), self.columns.astype(full.dtype)
        # By blocks of columns: the product as a whole would double the memory.
        for first in range(0, n, _CHUNK):
            part = slice(first, min(first + _CHUNK, n))
            square[:m, part] = rows @ (columns[:, part].T @ full.T).T
        square[:m, n:] = self.slack
        square[m:, :n] = (self.columns.T @ self.constraints.T).T
        return square

    def right(self, full: Float[np.ndarray, "r c"]) -> Float[np.ndarray, "s c"]:
        """Right-hand sides of the square system, (s, c), from those of the full one, (r, c)."""
        return np.concatenate([self.rows @ full, np.zeros((len(self.constraints), full.shape[1]))])

    def unknowns(self, solution: Float[np.ndarray, "s c"]) -> Float[np.ndarray, "k c"]:
        """All unknowns, (k, c), from a solution of the square system, (s, c)."""
        return self.columns @ solution[: self.columns.shape[1]]


def unrestrained_motions(surface: BoundarySurface) -> Float[np.ndarray, "v 3 q"]:
    """Infinitesimal rigid-body motions that no support restrains.

    Parameters
    ----------
    surface : BoundarySurface

    Returns
    -------
    (v, 3, q) float [-]           displacement of every vertex; translations first, then rotations
    """
    unknowns = find_unknowns(surface)
    modes = _rigid_modes(surface.mesh.vertices, surface.mesh.vertices[unknowns.held_vertices])
    return modes @ _unrestrained(modes, unknowns)


def make_elimination(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    order: Int[np.ndarray, " p"],
) -> Elimination | None:
    """Reduction of the full system where supports hold some directions only.

    Parameters
    ----------
    surface : BoundarySurface
    unknowns : Unknowns
    collocation : Collocation
    order : (p,) int              collocation point of each row of one component

    Returns
    -------
    Elimination or None           None where all supports hold all directions
    """
    n_free, n_points = unknowns.free_vertices.size, order.size
    if unknowns.free_vertices.size + unknowns.held_vertices.size == len(surface.mesh.vertices):
        return None
    free_directions = np.tile(np.eye(3), (len(surface.mesh.vertices), 1, 1))
    free_directions[unknowns.held_vertices] -= unknowns.vertex_directions
    free_basis = bases(free_directions[unknowns.free_vertices])
    columns = block_diag([free_basis, bases(unknowns.side_directions), eye_array(3)], format="csr")
    supported = orth(unknowns.side_directions.sum(axis=0), rcond=_UNRESTRAINED)
    by_point = bases(_equations(surface, unknowns, collocation, free_directions)[order])
    # Rows of the full system are ordered by component first.
    rows_of_points = (np.arange(n_points)[:, None] + n_points * np.arange(3)).ravel()
    permutation = csr_array(
        (np.ones(3 * n_points), (np.arange(3 * n_points), rows_of_points)),
        shape=(3 * n_points,) * 2,
    )
    rows = block_diag([by_point.T @ permutation, supported.T], format="csr")
    unrestrained = unrestrained_motions(surface)
    rotations = _slack(surface, unknowns, collocation.point[order], 3 - supported.shape[1])
    slack = np.zeros((rows.shape[0], rotations.shape[2]))
    slack[: -supported.shape[1]] = by_point.T @ rotations.reshape(3 * n_points, -1)
    constraints = np.zeros((unrestrained.shape[2], columns.shape[0]))
    constraints[:, : 3 * n_free] = unrestrained[unknowns.free_vertices].reshape(3 * n_free, -1).T
    norm = np.linalg.norm(constraints, axis=1, keepdims=True)
    return Elimination(
        csr_array(rows), csr_array(columns), _SCALE * slack, _SCALE * constraints / norm
    )


def _equations(
    surface: BoundarySurface,
    unknowns: Unknowns,
    collocation: Collocation,
    free_directions: Float[np.ndarray, "v 3 3"],
) -> Float[np.ndarray, "p 3 3"]:
    """Projector onto the components of the integral equation that are used at each point."""
    side_vertex = surface.sides.vertex[unknowns.held_sides]
    several = np.zeros(len(surface.mesh.vertices), dtype=bool)
    several[unknowns.held_vertices] = ~unknowns.shares_one_point(side_vertex)
    at_vertex = collocation.vertex >= 0
    used = np.tile(np.eye(3), (at_vertex.size, 1, 1))
    vertex = collocation.vertex[at_vertex]
    used[at_vertex] = np.where(several[vertex, None, None], free_directions[vertex], np.eye(3))
    used[~at_vertex] = unknowns.side_directions[several[side_vertex]]
    return used


def _slack(
    surface: BoundarySurface, unknowns: Unknowns, point: Float[np.ndarray, "p 3"], translations: int
) -> Float[np.ndarray, "p 3 e"]:
    """The unrestrained rigid-body motions other than translations, at points."""
    held = surface.mesh.vertices[unknowns.held_vertices]
    unrestrained = _unrestrained(_rigid_modes(surface.mesh.vertices, held), unknowns)
    return _rigid_modes(point, held) @ unrestrained[:, translations:]


def _rigid_modes(
    points: Float[np.ndarray, "n 3"], held: Float[np.ndarray, "h 3"]
) -> Float[np.ndarray, "n 3 6"]:
    """Three translations, and three rotations about the centroid of the held vertices, scaled to
    move these by about one."""
    offset = points - held.mean(axis=0)
    length = np.sqrt(((held - held.mean(axis=0)) ** 2).sum(axis=1).mean())
    rotations = np.cross(np.eye(3)[None], offset[:, None]) / length
    translations = np.tile(np.eye(3), (len(points), 1, 1))
    return np.concatenate([translations, rotations.transpose(0, 2, 1)], axis=2)


def _unrestrained(
    modes: Float[np.ndarray, "v 3 6"], unknowns: Unknowns
) -> Float[np.ndarray, "6 q"]:
    """Combinations of rigid-body modes that no support restrains, translations first."""
    held = unknowns.vertex_directions @ modes[unknowns.held_vertices]
    motions = _null_space(held.reshape(-1, 6))
    translations = _null_space(unknowns.side_directions.sum(axis=0))
    translations = np.concatenate([translations, np.zeros((3, translations.shape[1]))])
    others = np.linalg.svd(
        motions - translations @ (translations.T @ motions), full_matrices=False
    )[0]
    return np.concatenate(
        [translations, others[:, : motions.shape[1] - translations.shape[1]]], axis=1
    )


def _null_space(matrix: Float[np.ndarray, "n k"]) -> Float[np.ndarray, "k q"]:
    """Orthonormal basis of the null space of a matrix of k rows or more."""
    _, size, vectors = np.linalg.svd(matrix, full_matrices=False)
    return vectors[size <= _UNRESTRAINED * size.max()].T


def bases(projectors: Float[np.ndarray, "n 3 3"]) -> csr_array:
    """Orthonormal bases of the ranges of projectors, as a block-diagonal matrix.

    Parameters
    ----------
    projectors : (n, 3, 3) float

    Returns
    -------
    (3 n, q) sparse               the coordinate axes where a projector is the identity
    """
    value, vector = np.linalg.eigh(projectors)
    kept = value > 0.5
    is_identity = np.isclose(projectors, np.eye(3), atol=1e-12).all(axis=(1, 2))
    vector[is_identity] = np.eye(3)
    block, column = np.nonzero(kept)
    data = vector[block, :, column].ravel()
    row = (3 * block[:, None] + np.arange(3)).ravel()
    number = np.repeat(np.arange(block.size), 3)
    return csr_array((data, (row, number)), shape=(3 * len(projectors), block.size))
