"""One closed surface through the points of all views."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

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
# Depth of the tray below the support, of the height: it leads the surface down, and is cut off.
_DEPTH = 0.12
# The outline of the base, a corner in each of so many sectors: where the points are that are lower
# than these shares of the height, the lowest share that has any.
_SECTORS, _LOW = 96, (0.015, 0.03, 0.06, 0.12, 0.25)
# From points lower than this share of the height the surface goes on as it leans there: an
# overhanging object would have too large a foot. Normals that hardly point outward say nothing.
_TANGENT, _LEAST_OUTWARD = 0.05, 0.3
# Points from the middle of the floor to each side.
_FLOOR = 30


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
    arrays = (np.ascontiguousarray(a) for a in (*_thinned(points, normals, area, cell), place))
    coarse = np.asarray(igl.fast_winding_number(*arrays)).reshape(half[::-1])
    for axis in range(3):
        size = coarse.shape[axis]
        middle = 0.5 * (coarse.take(range(1, size), axis) + coarse.take(range(size - 1), axis))
        # Old and new ones in turn.
        coarse = np.insert(coarse, range(1, size), middle, axis)
    return coarse.ravel()


def _thinned(
    points: Points, normals: Points, area: PointScalars, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One point for all in half a cell: points that coincide have no end in a tree of boxes."""
    box = np.floor(points / (0.5 * cell)).astype(np.int64)
    _, group, count = np.unique(box, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()

    def total(value: np.ndarray) -> np.ndarray:
        return np.bincount(group, value, len(count))

    place = np.stack([total(points[:, k]) for k in range(3)], axis=1) / count[:, None]
    whole = np.stack([total(area * normals[:, k]) for k in range(3)], axis=1)
    size = np.linalg.norm(whole, axis=1)
    kept = size > 0.0
    return place[kept], whole[kept] / size[kept, None], size[kept]


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
    """The points and those of a tray below the support, as wide as the base."""
    height = support.heights(points)
    frame = np.linalg.svd(support.normal[None])[2][1:]
    flat = (points - support.point) @ frame.T
    outline = _outline(height, flat, normals @ frame.T, normals @ support.normal)
    base, facing, size = _tray(outline, _DEPTH * float(height.max()))
    frame = np.vstack([frame, support.normal])
    return (
        np.concatenate([points, support.point + base @ frame]),
        np.concatenate([normals, facing @ frame]),
        np.concatenate([area, size]),
    )


def _outline(
    height: PointScalars,
    flat: Float[np.ndarray, "n 2"],
    across: Float[np.ndarray, "n 2"],
    upward: PointScalars,
) -> Float[np.ndarray, "b 2"]:
    """Corners of the base, one a direction: where the lowest points seen in it lie, or where their
    tangent planes (normals along the support and off it) meet the support."""
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    offset = flat - centre
    radius = np.linalg.norm(offset, axis=1)
    outward = np.einsum("ni,ni->n", across, offset) / np.maximum(radius, 1e-300)
    faces = outward > _LEAST_OUTWARD
    leans = faces & (height < _TANGENT * float(height.max()))
    radius += np.where(leans, height * upward / np.maximum(outward, _LEAST_OUTWARD), 0.0)
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    sector = np.floor((angle / (2.0 * np.pi) % 1.0) * _SECTORS).astype(np.int64) % _SECTORS
    reach = np.full(_SECTORS, np.nan)
    # From the highest share to the lowest: what is seen lower tells more.
    for share in reversed(_LOW):
        low = faces & (height <= share * float(height.max()))
        for one in np.unique(sector[low]):
            reach[one] = np.median(radius[low & (sector == one)])
    known = np.flatnonzero(np.isfinite(reach))
    if len(known) == 0:
        raise MeshError(
            "no view shows the object down to its support, nor its lower quarter: what closes it"
            " cannot be guessed; take views from lower down"
        )
    # Where nothing low is seen, the base goes on as on both sides of it; no corner sticks out.
    reach = np.interp(np.arange(_SECTORS), known, reach[known], period=_SECTORS)
    reach = median_filter(reach, size=5, mode="wrap")
    direction = 2.0 * np.pi * (np.arange(_SECTORS) + 0.5) / _SECTORS
    reach = np.interp(np.arange(_SECTORS), known, reach[known], period=_SECTORS)
    return centre + reach[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)


def _tray(
    outline: Float[np.ndarray, "b 2"], depth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward normals and areas of a floor and of walls up to height 0, over an outline."""
    ends = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    step = 0.5 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())
    centre = outline.mean(axis=0)
    # The floor in triangles about the middle, each a few points.
    weights = (np.arange(_FLOOR) + 0.5) / _FLOOR
    share = (2.0 * np.arange(_FLOOR) + 1.0) / _FLOOR**2
    middle = ends.mean(axis=1)
    floor = (centre + weights[:, None, None] * (middle - centre)).reshape(-1, 2)
    first, second = (ends - centre).swapaxes(0, 1)
    triangle = 0.5 * abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    along = ends[:, 1] - ends[:, 0]
    length = np.linalg.norm(along, axis=1)
    outward = np.stack([along[:, 1], -along[:, 0]], axis=1) / length[:, None]
    levels = -np.arange(0.5 * step, depth, step)
    wall = np.repeat(middle, len(levels), axis=0)
    places = np.concatenate(
        [
            np.column_stack([floor, np.full(len(floor), -depth)]),
            np.column_stack([wall, np.tile(levels, len(middle))]),
        ]
    )
    facing = np.concatenate(
        [
            np.tile([0.0, 0.0, -1.0], (len(floor), 1)),
            np.column_stack([np.repeat(outward, len(levels), axis=0), np.zeros(len(wall))]),
        ]
    )
    areas = np.concatenate(
        [(share[:, None] * triangle).ravel(), np.repeat(length * step, len(levels))]
    )
    return places, facing, areas
