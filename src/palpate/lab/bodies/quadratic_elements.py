"""Shape functions of ten-node tetrahedra and six-node triangles, and sums over elements."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import bsr_array

from palpate.lab.bodies.tetrahedra import Solid
from palpate.optional_imports import late_import

# Every facet is integrated on this many parts a side: pressures have rims.
_PARTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class Gradients:
    """Derivatives of the shape functions at the quadrature points, and the volume each stands for.

    Parameters
    ----------
    gradient : (m, q, 10, 3) float [1/m]
    volume : (m, q) float [m^3]     weights; they add up to the elements' volumes
    """

    gradient: Float[np.ndarray, "m q 10 3"]
    volume: Float[np.ndarray, "m q"]


@dataclass(frozen=True, slots=True, eq=False)
class NodePairs:
    """Where the 100 blocks of every element go in a sparse matrix of 3 by 3 blocks.

    Parameters
    ----------
    slot : (m, 10, 10) int          index of the block
    column : (p,) int               node of each block's column
    start : (n + 1,) int            first block of each node's row
    """

    slot: Int[np.ndarray, "m 10 10"]
    column: Int[np.ndarray, " p"]
    start: Int[np.ndarray, " r"]


def shape_gradients(solid: Solid) -> Gradients:
    """Gradients of the shape functions of every element at the four points of degree 2.

    Four points integrate straight elements exactly and leave a ten-node tetrahedron no motion
    without energy.

    Raises
    ------
    InputError                      scikit-fem is not installed
    """
    skfem = late_import("skfem", extra="fem", purpose="the finite elements of a specimen")
    place, weight = skfem.quadrature.get_quadrature(skfem.ElementTetP2, 2)
    element = skfem.ElementTetP2()
    slope = np.stack([element.lbasis(place, i)[1].T for i in range(10)], axis=1)
    gradient = np.empty((len(solid.elements), len(weight), 10, 3))
    volume = np.empty((len(solid.elements), len(weight)))
    corner = solid.nodes[solid.elements]
    for q in range(len(weight)):
        along = np.einsum("mva,vd->mad", corner, slope[q])
        volume[:, q] = weight[q] * np.linalg.det(along)
        gradient[:, q] = np.einsum("vd,mda->mva", slope[q], np.linalg.inv(along))
    return Gradients(gradient, volume)


def node_pairs(solid: Solid) -> NodePairs:
    """Pairs of nodes that share an element, in the order of a sparse matrix."""
    count = len(solid.nodes)
    key = solid.elements[:, :, None] * count + solid.elements[:, None, :]
    pair, slot = np.unique(key, return_inverse=True)
    start = np.searchsorted(pair // count, np.arange(count + 1))
    return NodePairs(slot.reshape(key.shape), pair % count, start)


def block_matrix(pairs: NodePairs, block: Float[np.ndarray, "m 10 3 10 3"]) -> bsr_array:
    """Sum of element matrices (node, component, node, component) into one of all nodes."""
    slot, total = pairs.slot.ravel(), np.empty((len(pairs.column), 3, 3))
    for a in range(3):
        for b in range(3):
            entry = block[:, :, a, :, b].ravel()
            total[:, a, b] = np.bincount(slot, entry, minlength=len(pairs.column))
    size = 3 * (len(pairs.start) - 1)
    return bsr_array((total, pairs.column, pairs.start), shape=(size, size))


def triangle_shapes(
    place: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n 6"], Float[np.ndarray, "n 6 2"]]:
    """Shape functions of a six-node triangle (corners, middles of edges 01, 12, 20) at barycentric
    coordinates, and their slopes along the first two of them."""
    a, b, c = place.T
    value = np.stack(
        [a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=1
    )
    zero = np.zeros_like(a)
    first = np.stack([4 * a - 1, zero, 1 - 4 * c, 4 * b, -4 * b, 4 * (c - a)], axis=1)
    second = np.stack([zero, 4 * b - 1, 1 - 4 * c, 4 * a, 4 * (c - b), -4 * a], axis=1)
    return value, np.stack([first, second], axis=2)


def triangle_rule() -> tuple[Float[np.ndarray, "q 3"], Float[np.ndarray, " q"]]:
    """Points (barycentric) and weights (sum 1) over a triangle cut in 16, degree 2 on each part.

    Source
    ------
    Strang and Fix, An analysis of the finite element method (1973): the three-point rule.
    """
    steps = np.arange(_PARTS)
    up = [(i, j) for i in steps for j in steps if i + j < _PARTS]
    down = [(i, j) for i, j in up if i + j < _PARTS - 1]
    corner = np.array(
        [[(i, j), (i + 1, j), (i, j + 1)] for i, j in up]
        + [[(i + 1, j + 1), (i, j + 1), (i + 1, j)] for i, j in down]
    )
    rule = np.full((3, 3), 1 / 6) + 0.5 * np.eye(3)
    pair = np.einsum("qv,kva->kqa", rule, corner).reshape(-1, 2) / _PARTS
    place = np.column_stack([pair, 1.0 - pair.sum(axis=1)])
    return place, np.full(len(place), 1.0 / len(place))
