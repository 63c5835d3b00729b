"""The six-node triangle: shape functions, points on it, subdivision.

Nodes are the corners 0, 1, 2, then the midpoints of edges 01, 12, 20.
"""

import numba
import numpy as np
from jaxtyping import Float, Int

ELEMENT_NODES = np.array(
    [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]]
)


def quadratic_shapes(barycentric: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "6 ..."]:
    """Shape functions of the six-node triangle.

    Parameters
    ----------
    barycentric : (..., 3) float [-]

    Returns
    -------
    (6, ...) float [-]        one at its own node and zero at the others; they sum to 1
    """
    a, b, c = np.moveaxis(barycentric, -1, 0)
    return np.stack(
        [a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a]
    )


def element_points(
    nodes: Float[np.ndarray, "m 6 3"], barycentric: Float[np.ndarray, "... q 3"]
) -> Float[np.ndarray, "m q 6"]:
    """Positions and area normals at points of six-node triangles.

    Parameters
    ----------
    nodes : (m, 6, 3) float [m]
    barycentric : (q, 3) or (m, q, 3) float [-]    the same points for all triangles, or for each

    Returns
    -------
    (m, q, 6) float           position [m], then outward normal times area per reference area [m^2]
    """
    own = np.broadcast_to(barycentric, (len(nodes), *barycentric.shape[-2:]))
    points = np.empty((*own.shape[:2], 6))
    _fill_points(np.ascontiguousarray(nodes), np.ascontiguousarray(own), points)
    return points


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _fill_points(nodes, barycentric, out):
    """Positions and area normals at given points of each element."""
    shape, along = np.empty(6), np.empty((2, 3))
    for e in range(nodes.shape[0]):
        for q in range(barycentric.shape[1]):
            a, b, c = barycentric[e, q]
            shape[0], shape[1], shape[2] = a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1)
            shape[3], shape[4], shape[5] = 4 * a * b, 4 * b * c, 4 * c * a
            for i in range(3):
                corner, other, last = nodes[e, 0, i], nodes[e, 1, i], nodes[e, 2, i]
                ab, bc, ca = nodes[e, 3, i], nodes[e, 4, i], nodes[e, 5, i]
                position = shape[0] * corner + shape[1] * other + shape[2] * last
                out[e, q, i] = position + shape[3] * ab + shape[4] * bc + shape[5] * ca
                start = (1 - 4 * a) * corner
                along[0, i] = start + (4 * b - 1) * other + 4 * ((a - b) * ab + c * (bc - ca))
                along[1, i] = start + (4 * c - 1) * last + 4 * (b * (bc - ab) + (a - c) * ca)
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                out[e, q, 3 + i] = along[0, j] * along[1, k] - along[0, k] * along[1, j]


def element_spheres(
    nodes: Float[np.ndarray, "m 6 3"],
) -> tuple[Float[np.ndarray, "m 3"], Float[np.ndarray, " m"]]:
    """Centre and radius of a sphere around each six-node triangle.

    Parameters
    ----------
    nodes : (m, 6, 3) float [m]

    Returns
    -------
    (m, 3) float [m], (m,) float [m]
    """
    centre = nodes[:, :3].mean(axis=1)
    return centre, np.linalg.norm(nodes - centre[:, None], axis=2).max(axis=1)


def quartered(
    triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> tuple[Int[np.ndarray, " d"], Float[np.ndarray, "d 3 3"]]:
    """The four quarters of each cell of a triangle.

    Parameters
    ----------
    triangle : (c,) int               triangle of each cell
    corners : (c, 3, 3) float [-]     barycentric coordinates of the corners of each cell

    Returns
    -------
    (4 c,) int, (4 c, 3, 3) float [-]
    """
    a, b, c = corners.transpose(1, 0, 2)
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.tile(triangle, 4), np.concatenate([np.stack(part, axis=1) for part in parts])
