"""One closed surface through the points of all views, and its vertices fitted to these points.

The fit gives each vertex its standard deviation along the normal.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import median_filter
from scipy.spatial import cKDTree

from palpate.arrays import STD_OVER_MEDIAN, tangents_of
from palpate.errors import MeshError
from palpate.geometry import TriangleMesh, half_edges, vertex_normals
from palpate.optional_imports import late_import
from palpate.scanning.cleaning import compacted
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import adapted
from palpate.scanning.solid import largest_piece
from palpate.shapes import PointIndices, Points, PointScalars, Vector3

# Cells of the grid along the diagonal of the points, and neighbours that define a node's field.
_CELLS = 130
_NEIGHBOURS = 24
# Up to this distance from a point, in cells, the field is the distance from tangent planes; beyond
# twice that, it is the winding number.
_BAND = 2.0
_MARGIN = 6
# Edge length of the triangles, in cells.
_EDGE = 1.5
# Depth of the tray below the support, as a fraction of the height; it extends the surface downwards
# and is cut off later.
_DEPTH = 0.12
# The base outline has one corner per sector, at the points below the lowest of these fractions of
# the height that has any in the sector.
_SECTORS, _LOW = 96, (0.015, 0.03, 0.06, 0.12, 0.25)
# Points below this fraction of the height are extended to the support along their tangent planes;
# otherwise an overhanging object would get too large a base. Normals must point outward enough.
_TANGENT, _MIN_OUTWARD = 0.05, 0.3
# Points from the centre of the floor to each side.
_FLOOR = 30
# Largest and smallest number of points for the fit of a quadratic surface.
_MAX_NEIGHBOURS, _MIN_NEIGHBOURS = 60, 15
# Constant of Tukey's biweight: 95 % efficiency for normal noise.
_TUKEY = 4.685
_ROUNDS = 3
# Vertices processed at once, which limits the memory for their pairs of points.
_AT_ONCE = 256


def fused(points: Points, normals: Points, *, support: Plane | None = None) -> TriangleMesh:
    """Reconstruct a closed surface through points with normals, closing gaps smoothly.

    The surface is the zero level of a field on a grid. Near points the field is the weighted mean
    distance from their tangent planes; away from them it is the winding number of the points, which
    bridges gaps.

    Parameters
    ----------
    points, normals : (n, 3) float  positions [m], unit outward normals
    support : Plane or None         plane on which the object stood, on the side of its normal

    Returns
    -------
    TriangleMesh                    closed; with a support it extends below it, to be cut off there

    Raises
    ------
    MeshError                       no surface closes around the points
    InputError                      a package of the extra `surface` is not installed

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
    # An odd number of nodes per side, so that every second one forms a coarse grid of equal extent.
    count = [2 * int((b - a) / (2.0 * cell) + _MARGIN) + 1 for a, b in zip(low, high, strict=True)]
    node = low + cell * _grid(count)
    inside = _winding(points, normals, area, low, cell, count)
    field = _field(points, normals, node, inside, cell)
    # If the surface passed through a node, triangles there would have no area.
    min_distance = 0.02 * cell
    field = np.where(
        abs(field) < min_distance, np.where(field < 0.0, -min_distance, min_distance), field
    )
    igl = late_import("igl", extra="surface", purpose="joining scans")
    surface = igl.marching_cubes(field, node, *count, 0.0)
    if len(surface[1]) == 0:
        raise MeshError(
            "no surface closes around the points; do their normals point outward? The viewpoint of"
            " every view must be outside the object"
        )
    skin = largest_piece(compacted(np.asarray(surface[0]), surface[1].astype(np.int64)))
    size = np.full(len(skin.vertices), _EDGE * cell)
    return adapted(skin, size, creases=False)


def _areas(points: Points) -> PointScalars:
    """Surface area that each point represents [m^2]."""
    gap, _ = cKDTree(points).query(points, k=min(9, len(points)))
    return np.pi * gap[:, -1] ** 2 / (gap.shape[1] - 1)


def _grid(count: list[int]) -> Float[np.ndarray, "q 3"]:
    """Nodes of a grid in units of its cell; the first coordinate varies fastest."""
    z, y, x = np.indices(count[::-1], dtype=np.float64)
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


def _winding(
    points: Points, normals: Points, area: PointScalars, low: Vector3, cell: float, count: list[int]
) -> Float[np.ndarray, " q"]:
    """Winding number at all nodes, interpolated from every second one: it is only used far from
    points."""
    igl = late_import("igl", extra="surface", purpose="joining scans")
    half = [(c + 1) // 2 for c in count]
    nodes = low + 2.0 * cell * _grid(half)
    arrays = (np.ascontiguousarray(a) for a in (*_thinned(points, normals, area, cell), nodes))
    coarse = np.asarray(igl.fast_winding_number(*arrays)).reshape(half[::-1])
    for axis in range(3):
        size = coarse.shape[axis]
        middle = 0.5 * (coarse.take(range(1, size), axis) + coarse.take(range(size - 1), axis))
        # Interleave old and new nodes.
        coarse = np.insert(coarse, range(1, size), middle, axis)
    return coarse.ravel()


def _thinned(
    points: Points, normals: Points, area: PointScalars, cell: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge points within boxes of half a cell: coincident points would make an octree endless."""
    box = np.floor(points / (0.5 * cell)).astype(np.int64)
    _, group, count = np.unique(box, axis=0, return_inverse=True, return_counts=True)
    group = group.ravel()

    def total(value: np.ndarray) -> np.ndarray:
        return np.bincount(group, value, len(count))

    middle = np.stack([total(points[:, k]) for k in range(3)], axis=1) / count[:, None]
    whole = np.stack([total(area * normals[:, k]) for k in range(3)], axis=1)
    size = np.linalg.norm(whole, axis=1)
    nonzero = size > 0.0
    return middle[nonzero], whole[nonzero] / size[nonzero, None], size[nonzero]


def _field(
    points: Points,
    normals: Points,
    node: Float[np.ndarray, "q 3"],
    inside: Float[np.ndarray, " q"],
    cell: float,
) -> Float[np.ndarray, " q"]:
    """Signed distance near the points, negative inside; away from them, scaled winding number."""
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
    """Add the points of a tray below the support, with the outline of the base."""
    height = support.heights(points)
    frame = tangents_of(support.normal)
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
    """Corners of the base outline, one per sector: at the lowest points seen in it or, if these are
    low, where their tangent planes (normals `across` and `upward`) meet the support."""
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    offset = flat - centre
    radius = np.linalg.norm(offset, axis=1)
    outward = np.einsum("ni,ni->n", across, offset) / np.maximum(radius, 1e-300)
    faces = outward > _MIN_OUTWARD
    leans = faces & (height < _TANGENT * float(height.max()))
    radius += np.where(leans, height * upward / np.maximum(outward, _MIN_OUTWARD), 0.0)
    angle = np.arctan2(offset[:, 1], offset[:, 0])
    sector = np.floor((angle / (2.0 * np.pi) % 1.0) * _SECTORS).astype(np.int64) % _SECTORS
    reach = np.full(_SECTORS, np.nan)
    # From the highest fraction to the lowest, so that the lowest points override.
    for fraction in reversed(_LOW):
        low = faces & (height <= fraction * float(height.max()))
        for number in np.unique(sector[low]):
            reach[number] = np.median(radius[low & (sector == number)])
    known = np.flatnonzero(np.isfinite(reach))
    if len(known) == 0:
        raise MeshError(
            "no view shows the object down to its support, nor its lower quarter: what closes it"
            " cannot be guessed; take views from lower down"
        )
    # Sectors without low points are interpolated; the median filter removes spikes.
    reach = np.interp(np.arange(_SECTORS), known, reach[known], period=_SECTORS)
    reach = median_filter(reach, size=5, mode="wrap")
    direction = 2.0 * np.pi * (np.arange(_SECTORS) + 0.5) / _SECTORS
    reach = np.interp(np.arange(_SECTORS), known, reach[known], period=_SECTORS)
    return centre + reach[:, None] * np.stack([np.cos(direction), np.sin(direction)], axis=1)


def _tray(
    outline: Float[np.ndarray, "b 2"], depth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, outward normals and areas of a tray: a floor, and walls up to height 0."""
    ends = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
    step = 0.5 * float(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).mean())
    centre = outline.mean(axis=0)
    # The floor is divided into triangles about its centre, with a row of points in each.
    weights = (np.arange(_FLOOR) + 0.5) / _FLOOR
    area_fraction = (2.0 * np.arange(_FLOOR) + 1.0) / _FLOOR**2
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
        [(area_fraction[:, None] * triangle).ravel(), np.repeat(length * step, len(levels))]
    )
    return places, facing, areas


def fitted(
    mesh: TriangleMesh,
    points: Points,
    normals: Points,
    sigma: PointScalars,
    *,
    view: PointIndices,
    correlation_length: Float[np.ndarray, " n"],
    fixed: Bool[np.ndarray, " v"] | None = None,
) -> tuple[TriangleMesh, Float[np.ndarray, " v"]]:
    """Move vertices along their normals onto a smooth surface fitted to the surrounding points.

    A robust quadratic fit to the nearest points is not biased by curvature, as the mean of tangent
    planes would be.

    Parameters
    ----------
    mesh : TriangleMesh             of v vertices, near the points
    points, normals : (n, 3) float  positions [m], unit normals
    sigma : (n,) float [m]          standard deviation of the points along their normals
    view : (n,) int                 index of each point's view
    correlation_length : (n,) float [m]     distance within which errors of points of a view are
                                    correlated, fully at distance 0; if residuals show more
                                    correlation, all standard deviations are inflated
    fixed : (v,) bool or None       vertices not to be moved

    Returns
    -------
    mesh : TriangleMesh
    sigma : (v,) float [m]          standard deviation of each vertex along its normal, from the
                                    scatter of the points; NaN where the vertex was not fitted
    """
    normal = vertex_normals(mesh.vertices, mesh.triangles)
    ends = half_edges(mesh.triangles).ends
    edge = float(np.linalg.norm(np.diff(mesh.vertices[ends], axis=1)[:, 0], axis=1).mean())
    k = min(_MAX_NEIGHBOURS, len(points))
    gap, index = cKDTree(points).query(mesh.vertices, k=k, distance_upper_bound=edge)
    near = np.isfinite(gap)
    index = np.where(near, index, 0)
    near &= np.einsum("vka,va->vk", normals[index], normal) > 0.5
    offset = points[index] - mesh.vertices[:, None]
    height = np.einsum("vka,va->vk", offset, normal)
    base = _fit_rows(offset, normal, edge)
    # Weights decrease with distance, and with the variance of each point.
    radius = np.maximum(np.where(near, gap, 0.0).max(axis=1), 1e-12)[:, None]
    weight = np.where(near, (1.0 - (np.where(near, gap, 0.0) / (1.0001 * radius)) ** 2) ** 2, 0.0)
    weight /= sigma[index] ** 2
    move, error, contribution = _solved(base, height, weight, sigma[index])
    std = _deviation(error, points[index], view[index], correlation_length[index])
    # Inflate by the correlation seen in residuals; a lower bound, for the fit absorbs part of it.
    independent = float((error**2).sum())
    if independent > 0.0:
        std *= max(
            1.0, _correlation(contribution, view[index]) / np.sqrt((std**2).sum() / independent)
        )
    known = (near.sum(axis=1) >= _MIN_NEIGHBOURS) & (abs(move) < 0.5 * edge)
    # With points on one side only, the fit would extrapolate.
    middle = np.linalg.norm((weight[..., None] * offset).sum(axis=1), axis=1)
    known &= middle < 0.6 * radius[:, 0] * np.maximum(weight.sum(axis=1), 1e-300)
    if fixed is not None:
        known &= ~fixed
    vertices = mesh.vertices + np.where(known, move, 0.0)[:, None] * normal
    return (TriangleMesh(vertices=vertices, triangles=mesh.triangles), np.where(known, std, np.nan))


def _fit_rows(
    offset: Float[np.ndarray, "v k 3"], normal: Float[np.ndarray, "v 3"], scale: float
) -> Float[np.ndarray, "v k 6"]:
    """Terms 1, s, t, s^2, s t, t^2 in tangent coordinates, in units of `scale`."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(normal, first)
    s = np.einsum("vka,va->vk", offset, first) / scale
    t = np.einsum("vka,va->vk", offset, second) / scale
    return np.stack([np.ones_like(s), s, t, s * s, s * t, t * t], axis=2)


def _solved(
    base: Float[np.ndarray, "v k 6"],
    height: Float[np.ndarray, "v k"],
    weight: Float[np.ndarray, "v k"],
    sigma: Float[np.ndarray, "v k"],
) -> tuple[Float[np.ndarray, " v"], Float[np.ndarray, "v k"], Float[np.ndarray, "v k"]]:
    """Height of the fitted surface at each vertex, and the contributions to it of each point's
    standard deviation and residual [m]."""
    robust = weight.copy()
    damping = 1e-9 * np.eye(6)
    for _ in range(_ROUNDS):
        rows = robust[..., None] * base
        total = np.maximum(robust.sum(axis=1), 1e-300)[:, None, None]
        matrix = np.einsum("vki,vkj->vij", rows, base) / total + damping
        right = np.einsum("vki,vk->vi", rows, height) / total[:, :, 0]
        inverse = np.linalg.inv(matrix)
        coefficients = np.einsum("vij,vj->vi", inverse, right)
        residual = height - np.einsum("vki,vi->vk", base, coefficients)
        unit = residual / sigma
        level = STD_OVER_MEDIAN * np.ma.median(np.ma.array(abs(unit), mask=weight <= 0.0), axis=1)
        level = np.maximum(level.filled(1.0), 1e-6)[:, None]
        u = unit / (_TUKEY * level)
        robust = weight * np.where(abs(u) < 1.0, (1.0 - u**2) ** 2, 0.0)
    # Weight of each point's height in the result; its noise is the larger of claimed and observed.
    gain = np.einsum("vi,vki,vk->vk", inverse[:, 0], base, robust) / total[:, :, 0]
    noise = sigma * np.maximum(level, 1.0)
    return coefficients[:, 0], gain * noise, gain * residual


def _deviation(
    error: Float[np.ndarray, "v k"],
    position: Float[np.ndarray, "v k 3"],
    view: Int[np.ndarray, "v k"],
    correlation_length: Float[np.ndarray, "v k"],
) -> Float[np.ndarray, " v"]:
    """Standard deviation of sums of errors, correlated between nearby points of the same view.

    The correlation decreases linearly to zero at distance `correlation_length`, as the overlap of
    windows does.
    """
    variance = np.empty(len(error))
    for rows in np.array_split(np.arange(len(error)), len(error) // _AT_ONCE + 1):
        distance = np.linalg.norm(position[rows, :, None] - position[rows, None], axis=3)
        width = np.maximum(correlation_length[rows][:, :, None], 1e-12)
        same = view[rows][:, :, None] == view[rows][:, None]
        common = np.where(same, np.maximum(1.0 - distance / width, 0.0), 0.0)
        common[:, np.arange(error.shape[1]), np.arange(error.shape[1])] = 1.0
        variance[rows] = np.einsum("vi,vij,vj->v", error[rows], common, error[rows])
    return np.sqrt(np.maximum(variance, 0.0))


def _correlation(contribution: Float[np.ndarray, "v k"], view: Int[np.ndarray, "v k"]) -> float:
    """Rms of the residuals' sums over each view relative to that of independent ones, >= 1."""
    independent = float((contribution**2).sum())
    together = 0.0
    for number in range(int(view.max()) + 1):
        together += float((np.where(view == number, contribution, 0.0).sum(axis=1) ** 2).sum())
    return max(float(np.sqrt(together / independent)), 1.0) if independent > 0.0 else 1.0
