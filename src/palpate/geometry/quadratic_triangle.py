"""The six-node triangle: shape functions, their derivatives, points and cells of it.

Nodes are the corners 0, 1, 2, then the midpoints of edges 01, 12, 20.
"""

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


def quadratic_slopes(barycentric: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "2 6 ..."]:
    """Derivatives of the six shape functions along edges 01 and 02.

    Parameters
    ----------
    barycentric : (..., 3) float [-]

    Returns
    -------
    (2, 6, ...) float [-]     with respect to the second and to the third barycentric coordinate,
                              the first following
    """
    a, b, c = np.moveaxis(barycentric, -1, 0)
    zero = np.zeros_like(a)
    along_b = np.stack([1 - 4 * a, 4 * b - 1, zero, 4 * (a - b), 4 * c, -4 * c])
    along_c = np.stack([1 - 4 * a, zero, 4 * c - 1, -4 * b, 4 * b, 4 * (a - c)])
    return np.stack([along_b, along_c])


def element_points(
    nodes: Float[np.ndarray, "m 6 3"], barycentric: Float[np.ndarray, "... q 3"]
) -> Float[np.ndarray, "m q 6"]:
    """Positions and area normals at points of six-node triangles.

    Parameters
    ----------
    nodes : (m, 6, 3) float [m]
    barycentric : (q, 3) or (m, q, 3) float [-]    the same points of each triangle, or its own

    Returns
    -------
    (m, q, 6) float           position [m], then outward normal times area per reference area [m^2]
    """
    shapes = np.concatenate([quadratic_shapes(barycentric)[None], quadratic_slopes(barycentric)])
    weights = np.moveaxis(shapes, 1, -1)
    if barycentric.ndim == 2:
        position, along_b, along_c = np.einsum("dqa,mai->dmqi", weights, nodes)
    else:
        position, along_b, along_c = weights @ nodes
    return np.concatenate([position, np.cross(along_b, along_c)], axis=2)


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
