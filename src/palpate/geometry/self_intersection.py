"""Self-intersections of a triangle surface."""

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.geometry.triangle_mesh import TriangleMesh, bounding_diagonal

_PAIRS_PER_BLOCK = 200_000
# Relative to the bounding diagonal: far above rounding (1e-16), far below any real element.
_TOLERANCE = 1e-10


def intersecting_pairs(mesh: TriangleMesh) -> Int[np.ndarray, "k 2"]:
    """Pairs of triangles that have more in common than shared vertices and edges.

    Triangles without a common vertex must not even touch; neighbours must not cross each other,
    nor be folded flat onto one another.

    Parameters
    ----------
    mesh : TriangleMesh             no triangle of zero area

    Returns
    -------
    (k, 2) int                      indices of triangles, the lower one first

    Source
    ------
    Separating axes of two triangles: their normals, the nine products of their edges and, where
    they lie in one plane, their edges' normals in it (Ericson, Real-Time Collision Detection,
    2005, section 5.2.1). Two neighbours merely touch if their projections on some axis have a
    single point in common.
    """
    corner = mesh.vertices[mesh.triangles] - mesh.vertices.mean(axis=0)
    tolerance = _TOLERANCE * bounding_diagonal(mesh)
    pairs = _box_pairs(corner, tolerance)
    found = [
        block[~_separated(mesh, corner, block, tolerance)]
        for block in np.split(pairs, np.arange(_PAIRS_PER_BLOCK, len(pairs), _PAIRS_PER_BLOCK))
    ]
    return np.concatenate(found)


def _box_pairs(corner: Float[np.ndarray, "m 3 3"], tolerance: float) -> Int[np.ndarray, "p 2"]:
    """Pairs of triangles whose boxes overlap, by a sweep along the longest axis."""
    low, high = corner.min(axis=1) - tolerance, corner.max(axis=1) + tolerance
    axis = int(np.ptp(corner.reshape(-1, 3), axis=0).argmax())
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    end = np.searchsorted(low[:, axis], high[:, axis], side="right")
    count = end - np.arange(len(order)) - 1
    found = [np.zeros((0, 2), dtype=np.int64)]
    begin = 0
    while begin < len(order):
        total = np.cumsum(count[begin:])
        size = max(1, int(np.searchsorted(total, 10 * _PAIRS_PER_BLOCK)))
        rows = np.arange(begin, min(begin + size, len(order)))
        first = np.repeat(rows, count[rows])
        start = np.cumsum(count[rows]) - count[rows]
        second = first + 1 + np.arange(len(first)) - np.repeat(start, count[rows])
        keep = ((low[second] <= high[first]) & (low[first] <= high[second])).all(axis=1)
        found.append(order[np.stack([first[keep], second[keep]], axis=1)])
        begin += size
    return np.sort(np.concatenate(found), axis=1)


def _separated(
    mesh: TriangleMesh,
    corner: Float[np.ndarray, "m 3 3"],
    pairs: Int[np.ndarray, "p 2"],
    tolerance: float,
) -> Bool[np.ndarray, " p"]:
    """True where two triangles have nothing in common but shared vertices and edges."""
    a, b = sides = corner[pairs[:, 0]], corner[pairs[:, 1]]
    ids_a, ids_b = mesh.triangles[pairs[:, 0]], mesh.triangles[pairs[:, 1]]
    neighbours = (ids_a[:, :, None] == ids_b[:, None, :]).any(axis=(1, 2))
    # Largest overlap that counts as apart: neighbours may touch, other triangles must not.
    limit = np.where(neighbours, tolerance, -tolerance)
    edge_a, edge_b = _edges(a), _edges(b)
    normal_a, normal_b = _normal(edge_a), _normal(edge_b)
    span_a = _overlap(a, b, normal_a)
    span_b = _overlap(a, b, normal_b)
    flat = (_thickness(b, normal_a) <= tolerance) & (_thickness(a, normal_b) <= tolerance)
    # Projections of coplanar triangles on their normals coincide, and separate nothing.
    separated = np.where(flat, span_a < -tolerance, (span_a <= limit) | (span_b <= limit))
    # Most are by now; the others are tested on the axes in their planes and normal to both edges.
    for i in range(3):
        left = np.flatnonzero(~separated)
        a, b, allowed = sides[0][left], sides[1][left], limit[left]
        along_a, along_b = edge_a[left, i], edge_b[left]
        found = _overlap(a, b, np.cross(normal_a[left], along_a)) <= allowed
        found |= _overlap(a, b, np.cross(normal_b[left], along_b[:, i])) <= allowed
        for j in range(3):
            across = _overlap(a, b, np.cross(along_a, along_b[:, j])) <= allowed
            found |= ~flat[left] & across
        separated[left] = found
    return separated


def _edges(corner: Float[np.ndarray, "p 3 3"]) -> Float[np.ndarray, "p 3 3"]:
    """Directions of the edges from each corner to the next."""
    return _unit(np.roll(corner, -1, axis=1) - corner)


def _normal(edge: Float[np.ndarray, "p 3 3"]) -> Float[np.ndarray, "p 3"]:
    """Normals of triangles with edges of these directions."""
    return _unit(np.cross(edge[:, 0], edge[:, 1]))


def _unit(vectors: Float[np.ndarray, "*batch 3"]) -> Float[np.ndarray, "*batch 3"]:
    """Unit vectors; NaN for vectors of length zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, np.nan)


def _overlap(
    a: Float[np.ndarray, "p 3 3"], b: Float[np.ndarray, "p 3 3"], axis: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, " p"]:
    """Overlap of two triangles' projections on an axis, negative for a gap; NaN for a zero axis."""
    unit = _unit(axis)
    on_a, on_b = np.einsum("pva,pa->pv", a, unit), np.einsum("pva,pa->pv", b, unit)
    (low_a, high_a), (low_b, high_b) = _ends(on_a), _ends(on_b)
    return np.minimum(high_a - low_b, high_b - low_a)


def _ends(
    projection: Float[np.ndarray, "p 3"],
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Smallest and largest of three numbers; `min` over so short an axis is ten times slower."""
    x, y, z = projection.T
    return np.minimum(np.minimum(x, y), z), np.maximum(np.maximum(x, y), z)


def _thickness(
    corner: Float[np.ndarray, "p 3 3"], unit: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, " p"]:
    """Extent of each triangle along a direction."""
    return np.ptp(np.einsum("pva,pa->pv", corner, unit), axis=1)
