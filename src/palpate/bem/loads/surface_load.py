"""Displacement kernel integrated over the traction of a load itself, not over nodal values of it.

A contact patch is often hardly wider than an element. Its traction is therefore integrated over the
patch itself: with small cells, refined at the rim of the patch, and in polar coordinates around
every collocation point on it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from palpate.bem.integrals import (
    DISPLACEMENT,
    LANES,
    BoundarySurface,
    Collocation,
    FieldBlocks,
    add_point_fields,
    lane_fields,
    lanes_of,
    triangle_rule,
    unit_gauss,
)
from palpate.bem.loads.half_space import PressureDisc
from palpate.errors import InputError
from palpate.geometry import element_points, quartered
from palpate.threads import in_threads

Density = Callable[
    [Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]],
    Float[np.ndarray, " n"],
]

_N_FIELDS = DISPLACEMENT.count
# Quarterings of a triangle: at most so many everywhere, and so many more at the rim of the patch.
_MAX_LEVELS, _RIM_LEVELS = 2, 3
# Panels, and Gauss points of each, along the radius and along the angle.
_POLAR_PANELS, _POLAR_POINTS = 3, 4
# Sources whose fields are computed before they are summed: they fit into the L1 cache.
_AT_ONCE = 16


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceLoad:
    """A traction of constant direction, spread over some triangles; its total is one newton along
    any axis.

    Attributes
    ----------
    triangles : (k,) int          triangles on which it may be non-zero
    density : callable            (triangle (n,), barycentric (n, 3), position (n, 3) [m]) -> (n,)
                                  >= 0, up to a factor: it is divided by its surface integral
    disc : PressureDisc or None   the load as a round patch, where it is one; required for the
                                  correction by the local indentation (`indentation_corrections`)
    """

    triangles: Int[np.ndarray, " k"]
    density: Density
    disc: PressureDisc | None = None


@dataclass(frozen=True, slots=True)
class LoadCells:
    """Subdivision of the triangles under a load into cells; each level quarters a cell.

    Attributes
    ----------
    degree : int                  of the quadrature rule on each cell
    coarsest : int                level of all cells
    finest_rim : int              level of the cells that the rim of the load crosses
    finest : int                  level at which subdivision ends
    ratio : float                 least distance of the evaluation points from a cell, over its
                                  size, at which it needs no further subdivision
    """

    degree: int
    coarsest: int
    finest_rim: int
    finest: int
    ratio: float = 4.0


@dataclass(frozen=True, slots=True, eq=False)
class LoadPoints:
    """Quadrature points of a load.

    Attributes
    ----------
    position : (q, 3) float [m]
    weight : (q,) float           sum to 1
    triangle : (q,) int           triangle of each point
    total : float [m^2]           surface integral of the unscaled density, times the density's unit
    """

    position: Float[np.ndarray, "q 3"]
    weight: Float[np.ndarray, " q"]
    triangle: Int[np.ndarray, " q"]
    total: float


def load_points(
    surface: BoundarySurface,
    load: SurfaceLoad,
    *,
    cells: LoadCells | None = None,
    near: Float[np.ndarray, "p 3"] | None = None,
) -> LoadPoints:
    """Quadrature points for integrals of smooth functions times the density of a load.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    cells : LoadCells or None     subdivision of the triangles; None: one or two levels, to cells of
                                  about a quarter of the patch's radius, and three more at its rim
    near : (p, 3) float [m]       evaluation points: cells close to them are subdivided further

    Returns
    -------
    LoadPoints

    Raises
    ------
    InputError                    the density vanishes on all its triangles
    """
    cells = cells or _cells_of(surface, load)
    rule = triangle_rule(cells.degree)
    corners = np.tile(np.eye(3), (load.triangles.size, 1, 1))
    triangle = np.asarray(load.triangles, dtype=np.int64)
    for _ in range(cells.coarsest):
        triangle, corners = quartered(triangle, corners)
    tree = None if near is None else cKDTree(near)
    positions, weights, owners = [], [], []
    for level in range(cells.coarsest, cells.finest + 1):
        if not triangle.size:
            break
        barycentric = np.einsum("qk,ckj->cqj", rule.barycentric, corners)
        position, area, density = _load_at(surface, load, triangle, barycentric)
        loaded = density > 0
        is_loaded = loaded.any(axis=1)
        divide = is_loaded & ~loaded.all(axis=1) & np.array(level < cells.finest_rim)
        if tree is not None and level < cells.finest:
            centre = position.mean(axis=1)
            size = np.linalg.norm(position - centre[:, None], axis=2).max(axis=1)
            divide |= is_loaded & (tree.query(centre)[0] < cells.ratio * size)
        kept = loaded & ~divide[:, None]
        positions.append(position[kept])
        weights.append((density * area * rule.weight)[kept] * 0.25**level)
        owners.append(np.repeat(triangle, kept.sum(axis=1)))
        triangle, corners = quartered(triangle[divide], corners[divide])
    weight = np.concatenate(weights)
    total = float(weight.sum())
    if not total > 0:
        raise InputError(
            "the contact patch covers no part of the free surface; move its point or enlarge "
            "its radius"
        )
    return LoadPoints(np.concatenate(positions), weight / total, np.concatenate(owners), total)


def _cells_of(surface: BoundarySurface, load: SurfaceLoad) -> LoadCells:
    coarsest = _MAX_LEVELS
    if load.disc is not None:
        corner = surface.element_nodes[load.triangles, :3]
        edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max()
        coarsest = int(np.clip(np.ceil(np.log2(4 * edge / load.disc.radius)), 1, _MAX_LEVELS))
    finest = coarsest + _RIM_LEVELS
    return LoadCells(degree=5, coarsest=coarsest, finest_rim=finest, finest=finest)


def _load_at(
    surface: BoundarySurface,
    load: SurfaceLoad,
    triangle: Int[np.ndarray, " c"],
    barycentric: Float[np.ndarray, "c q 3"],
) -> tuple[Float[np.ndarray, "c q 3"], Float[np.ndarray, "c q"], Float[np.ndarray, "c q"]]:
    """Positions, areas per reference area and densities at given points of each triangle."""
    points = element_points(surface.element_nodes[triangle], barycentric)
    position = points[:, :, :3]
    shape = barycentric.shape[:2]
    density = load.density(
        np.repeat(triangle, shape[1]), barycentric.reshape(-1, 3), position.reshape(-1, 3)
    )
    return position, np.linalg.norm(points[:, :, 3:], axis=2), density.reshape(shape)


def loaded_triangles(surface: BoundarySurface, load: SurfaceLoad) -> Int[np.ndarray, " k"]:
    """Triangles on which a load is non-zero, tested at a few points of each.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad

    Returns
    -------
    (k,) int
    """
    triangle = np.asarray(load.triangles, dtype=np.int64)
    barycentric = np.tile(triangle_rule(7).barycentric, (triangle.size, 1, 1))
    _, _, density = _load_at(surface, load, triangle, barycentric)
    return triangle[(density > 0).any(axis=1)]


def integrate_load(
    surface: BoundarySurface,
    load: SurfaceLoad,
    collocation: Collocation,
    blocks: FieldBlocks,
    *,
    cells: LoadCells | None = None,
) -> Float[np.ndarray, "r 6"]:
    """The six displacement fields integrated against a load, at every collocation point.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    collocation : Collocation
    blocks : FieldBlocks          of that collocation, for the order of its rows
    cells : LoadCells or None     see `load_points`

    Returns
    -------
    (r, 6) float [1/m]            in the order of the blocks' rows
    """
    points = load_points(surface, load, cells=cells)
    rows = blocks.rows
    order = rows.ravel()[: blocks.n_rows]
    sources = _as_sources(points.position, points.weight)
    out = np.zeros((rows.shape[0], DISPLACEMENT.count * LANES))
    in_threads(_sum_points, rows.shape[0], lanes_of(collocation.point, rows), sources, out)
    fields = out.reshape(-1, DISPLACEMENT.count, LANES).transpose(0, 2, 1)
    fields = fields.reshape(-1, DISPLACEMENT.count)[: blocks.n_rows].copy()
    _recompute_rows_on_patch(surface, load, points, sources, collocation, order, fields)
    return fields


def _as_sources(
    position: Float[np.ndarray, "q 3"], weight: Float[np.ndarray, " q"]
) -> Float[np.ndarray, "q 6"]:
    """Points in the layout of the kernels: of the normal, the displacement kernel uses the length
    alone, here the weight."""
    return np.column_stack([position, weight, np.zeros((weight.size, 2))])


def _recompute_rows_on_patch(
    surface: BoundarySurface,
    load: SurfaceLoad,
    points: LoadPoints,
    sources: Float[np.ndarray, "q 6"],
    collocation: Collocation,
    order: Int[np.ndarray, " r"],
    fields: Float[np.ndarray, "r 6"],
) -> None:
    """Recompute the rows of collocation points on the patch in polar coordinates around them."""
    row, triangle, corners = _subtriangles_on_patch(surface, points.triangle, collocation, order)
    if not row.size:
        return
    s, t, polar_weight = _polar_panels()
    opposite = np.einsum("q,pj->pqj", 1 - t, corners[:, 1]) + np.einsum(
        "q,pj->pqj", t, corners[:, 2]
    )
    barycentric = np.einsum("q,pj->pqj", 1 - s, corners[:, 0]) + s[:, None] * opposite
    position, area, density = _load_at(surface, load, triangle, barycentric)
    scale = np.abs(np.linalg.det(corners))[:, None] * polar_weight / points.total
    weight = density * area * scale
    around = _as_sources(position.reshape(-1, 3), weight.ravel()).reshape(*weight.shape, 6)
    by_row = np.argsort(row, kind="stable")
    rows, start = np.unique(row[by_row], return_index=True)
    recomputed = np.zeros((rows.size, 1, DISPLACEMENT.count))
    in_threads(
        _sum_around, rows.size, collocation.point[order[rows]], around[by_row], triangle[by_row],
        np.append(start, row.size), sources, points.triangle, recomputed,
    )  # fmt: skip
    fields[rows] = recomputed[:, 0]


def _subtriangles_on_patch(
    surface: BoundarySurface,
    loaded: Int[np.ndarray, " q"],
    collocation: Collocation,
    order: Int[np.ndarray, " r"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, "p 3 3"]]:
    """Rows, in this order, whose collocation point lies on a loaded triangle; that triangle; and
    barycentric corners of each of its subtriangles with the point as first corner."""
    triangles = np.unique(loaded)
    row_of_point = np.full(collocation.point.shape[0], -1)
    row_of_point[order] = np.arange(order.size)
    row_of_vertex = np.full(surface.mesh.vertices.shape[0], -1)
    at_vertex = np.flatnonzero(collocation.vertex >= 0)
    row_of_vertex[collocation.vertex[at_vertex]] = row_of_point[at_vertex]
    row = row_of_vertex[surface.mesh.triangles[triangles]].ravel()
    turned = np.stack([np.roll(np.eye(3), -k, axis=0) for k in range(3)])
    corners = np.tile(turned, (triangles.size, 1, 1))
    triangle = np.repeat(triangles, 3)
    found = row >= 0
    parts = [(row[found], triangle[found], corners[found])]
    unit = np.eye(3)
    for inner in np.flatnonzero(np.isin(collocation.triangle, triangles)):
        point = collocation.barycentric[inner]
        around = np.stack([np.stack([point, unit[k], unit[(k + 1) % 3]]) for k in range(3)])
        parts.append(
            (np.full(3, row_of_point[inner]), np.full(3, collocation.triangle[inner]), around)
        )
    row, triangle, corners = (np.concatenate(part) for part in zip(*parts, strict=True))
    return row, triangle, corners


def _polar_panels() -> tuple[Float[np.ndarray, " p"], ...]:
    x, w = unit_gauss(_POLAR_POINTS)
    start = np.arange(_POLAR_PANELS)[:, None] / _POLAR_PANELS
    points, weights = (start + x / _POLAR_PANELS).ravel(), np.tile(w / _POLAR_PANELS, _POLAR_PANELS)
    s, t = (grid.ravel() for grid in np.meshgrid(points, points, indexing="ij"))
    return s, t, np.outer(weights * points, weights).ravel()


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _sum_points(begin, end, lanes, sources, out):
    """Displacement fields of some blocks of load points, summed over the sources."""
    width = _N_FIELDS * LANES
    buffer = np.empty(_AT_ONCE * width)
    for b in range(begin, end):
        total = out[b]
        for first in range(0, sources.shape[0], _AT_ONCE):
            last = min(first + _AT_ONCE, sources.shape[0])
            lane_fields(_N_FIELDS, lanes[b], sources[first:last], buffer)
            for q in range(last - first):
                for i in range(width):
                    total[i] += buffer[q * width + i]


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _sum_around(begin, end, points, around, triangle, start, sources, loaded, out):
    """Displacement fields at some points: from the sources around each, parts start[i] to
    start[i + 1], and from all sources that lie on none of the triangles of these parts."""
    factor = np.ones(1)
    for i in range(begin, end):
        for part in range(start[i], start[i + 1]):
            for q in range(around.shape[1]):
                add_point_fields(_N_FIELDS, points[i], around[part, q], 1.0, factor, out[i])
        for q in range(sources.shape[0]):
            counts = True
            for part in range(start[i], start[i + 1]):
                counts = counts and loaded[q] != triangle[part]
            if counts:
                add_point_fields(_N_FIELDS, points[i], sources[q], 1.0, factor, out[i])
