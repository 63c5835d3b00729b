"""One closed surface through the points of all views."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import ConvexHull, QhullError, cKDTree

from palpate.errors import MeshError
from palpate.geometry import TriangleMesh
from palpate.optional_imports import late_import
from palpate.scanning.mending import adapted, compacted, largest_piece
from palpate.scanning.plane import Plane
from palpate.shapes import Points, PointScalars, Vector3

# Cells of the grid along the diagonal of the points, and neighbours that tell the field of a node.
_CELLS = 130
_NEIGHBOURS = 24
# Nodes nearer than this to a point, in cells, take the distance from its tangent plane; from twice
# that on the winding number alone says where the surface closes.
_BAND = 2.0
_MARGIN = 6
# Edges of the triangles, in cells.
_EDGE = 1.5
# Points lower than these shares of the height may show the outline of the base; they do where no
# gap between their directions is larger than this.
# Of the layer below the support, of the height: its rim is cut off with it.
_DEPTH = 0.1
_LOW, _GAP = (0.015, 0.03, 0.06, 0.12), np.radians(60.0)


def fused(points: Points, normals: Points, *, support: Plane | None = None) -> TriangleMesh:
    """The closed surface through points with normals; where there are none it closes smoothly.

    Near points the field is their distance from the tangent planes around, weighted; away from
    them it is the winding number of the points, which leads from rim to rim.

    Parameters
    ----------
    points, normals : (n, 3) float [m]  unit, outward
    support : Plane or None         the object stood on it, on the side of its normal

    Returns
    -------
    TriangleMesh                    closed; with a support it reaches below it, to be cut off there

    Raises
    ------
    MeshError                       no surface closes around the points

    Source
    ------
    Barill and others, Fast winding numbers for soups and clouds, ACM Trans. Graph. 37 (2018);
    Kolluri, Provably good moving least squares, ACM Trans. Algorithms 4 (2008).
    """
    area = _areas(points)
    if support is not None:
        points, normals, area = _with_base(points, normals, area, support)
    low, high = points.min(axis=0), points.max(axis=0)
    cell = float(np.linalg.norm(high - low)) / _CELLS
    low = low - _MARGIN * cell
    # An odd number of nodes a side, so that every second is a coarse grid that ends with it.
    count = [2 * int((b - a) / (2.0 * cell) + _MARGIN) + 1 for a, b in zip(low, high, strict=True)]
    node = low + cell * _grid(count)
    inside = _winding(points, normals, area, low, cell, count)
    field = _field(points, normals, node, inside, cell)
    # A surface through a node would have triangles without area there.
    least = 0.02 * cell
    field = np.where(abs(field) < least, np.where(field < 0.0, -least, least), field)
    igl = late_import("igl", extra="surface", purpose="joining scans")
    found = igl.marching_cubes(field, node, *count, 0.0)
    if len(found[1]) == 0:
        raise MeshError(
            "no surface closes around the points; do their normals point outward? The viewpoint of"
            " every view must be outside the object"
        )
    skin = largest_piece(compacted(np.asarray(found[0]), found[1].astype(np.int64)))
    size = np.full(len(skin.vertices), _EDGE * cell)
    return adapted(skin, size, creases=False)


def _areas(points: Points) -> PointScalars:
    """Area that each point stands for [m^2]."""
    gap, _ = cKDTree(points).query(points, k=min(9, len(points)))
    return np.pi * gap[:, -1] ** 2 / (gap.shape[1] - 1)


def _grid(count: list[int]) -> Float[np.ndarray, "q 3"]:
    """Nodes of a grid in units of its cell; the first coordinate runs fastest."""
    z, y, x = np.indices(count[::-1], dtype=np.float64)
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _winding(
    points: Points, normals: Points, area: PointScalars, low: Vector3, cell: float, count: list[int]
) -> Float[np.ndarray, " q"]:
    """Winding number at all nodes, linear between every second one: it counts away from points."""
    igl = late_import("igl", extra="surface", purpose="joining scans")
    half = [(c + 1) // 2 for c in count]
    place = low + 2.0 * cell * _grid(half)
    arrays = (np.ascontiguousarray(a) for a in (points, normals, area, place))
    coarse = np.asarray(igl.fast_winding_number(*arrays)).reshape(half[::-1])
    for axis in range(3):
        size = coarse.shape[axis]
        middle = 0.5 * (coarse.take(range(1, size), axis) + coarse.take(range(size - 1), axis))
        # Old and new ones in turn.
        coarse = np.insert(coarse, range(1, size), middle, axis)
    return coarse.ravel()


def _field(
    points: Points,
    normals: Points,
    node: Float[np.ndarray, "q 3"],
    inside: Float[np.ndarray, " q"],
    cell: float,
) -> Float[np.ndarray, " q"]:
    """Signed distance near the points, negative inside; away from them what the winding says."""
    far = (0.5 - inside) * 4.0 * _BAND * cell
    tree = cKDTree(points)
    gap, _ = tree.query(node, distance_upper_bound=2.0 * _BAND * cell)
    near = np.flatnonzero(np.isfinite(gap))
    field = far.copy()
    for block in np.array_split(near, max(1, len(near) // 50_000)):
        distance, index = tree.query(node[block], k=min(_NEIGHBOURS, len(points)))
        width = np.maximum(cell, distance[:, 5])[:, None]
        weight = np.exp(-((distance / width) ** 2))
        height = np.einsum("qka,qka->qk", node[block][:, None] - points[index], normals[index])
        plane = (weight * height).sum(axis=1) / weight.sum(axis=1)
        t = np.clip(gap[block] / (_BAND * cell) - 1.0, 0.0, 1.0)
        mix = t * t * (3.0 - 2.0 * t)
        field[block] = (1.0 - mix) * plane + mix * far[block]
    return field


def _with_base(
    points: Points, normals: Points, area: PointScalars, support: Plane
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points and an even layer of others below the object, a little under its support."""
    height = support.heights(points)
    frame = np.linalg.svd(support.normal[None])[2][1:]
    flat = (points - support.point) @ frame.T
    try:
        hull = ConvexHull(flat[_outline(height, flat)])
    except QhullError as error:
        raise MeshError("the points stand on end above the support; is its plane right?") from error
    step = float(np.sqrt(hull.volume / 3000.0))
    span = [np.arange(a, b + step, step) for a, b in zip(flat.min(0), flat.max(0), strict=True)]
    grid = np.stack([g.ravel() for g in np.meshgrid(*span)], axis=1)
    outline = hull.equations
    grid = grid[(grid @ outline[:, :2].T + outline[:, 2] <= 0.0).all(axis=1)]
    depth = _DEPTH * float(height.max())
    base = support.point + grid @ frame - depth * support.normal
    down = np.broadcast_to(-support.normal, base.shape)
    layer = np.full(len(base), step**2)
    return (
        np.concatenate([points, base]),
        np.concatenate([normals, down]),
        np.concatenate([area, layer]),
    )


def _outline(height: PointScalars, flat: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, " n"]:
    """The lowest points that go all around; all points where none do, as of a single view."""
    for share in _LOW:
        low = height < share * float(height.max())
        if low.sum() < 20:
            continue
        offset = flat[low] - 0.5 * (flat[low].min(axis=0) + flat[low].max(axis=0))
        angle = np.sort(np.arctan2(offset[:, 1], offset[:, 0]))
        if np.diff(angle, append=angle[0] + 2.0 * np.pi).max() < _GAP:
            return low
    return np.ones(len(height), dtype=bool)
