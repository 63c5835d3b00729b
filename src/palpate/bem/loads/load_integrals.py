"""Displacement kernel integrated over the traction of a load itself, not over nodal values of it.

Rows of collocation points on the patch are integrated in polar coordinates about these points.
"""

import numba
import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals.assembly import Collocation, lanes_of
from palpate.bem.integrals.kelvin import DISPLACEMENT, LANES, add_point_fields, lane_fields
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.loads.polar_rule import polar_points
from palpate.bem.loads.surface_load import (
    LOAD_CELLS,
    LoadCells,
    LoadPoints,
    SurfaceLoad,
    corner_places,
    placed_load,
    placed_points,
    traction_at,
)
from palpate.threads import in_threads

_N_FIELDS = DISPLACEMENT.count
# Sources whose fields are computed before they are summed: they fit into the L1 cache.
_AT_ONCE = 16
# Largest relative error of a row's own integral of the density, above which its points do not
# resolve the patch, and those of the whole load serve it as well.
_LARGEST_ERROR = 0.2


def integrate_load(
    surface: BoundarySurface,
    load: SurfaceLoad,
    collocation: Collocation,
    rows: Int[np.ndarray, "b lanes"],
    *,
    cells: LoadCells = LOAD_CELLS,
) -> Float[np.ndarray, "r 6"]:
    """The six displacement fields integrated against a load, at every collocation point.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    collocation : Collocation
    rows : (b, LANES) int         collocation points of each block (`point_blocks`)
    cells : LoadCells             see `load_points`, also for its errors

    Returns
    -------
    (r, 6) float [1/m]            in the order of the blocks' rows
    """
    load = placed_load(surface, load)
    points = placed_points(surface, load, cells=cells)
    n_rows = collocation.point.shape[0]
    order = rows.ravel()[:n_rows]
    sources = _as_sources(points.position, points.weight)
    out = np.zeros((rows.shape[0], DISPLACEMENT.count * LANES))
    in_threads(_sum_points, rows.shape[0], lanes_of(collocation.point, rows), sources, out)
    fields = out.reshape(-1, DISPLACEMENT.count, LANES).transpose(0, 2, 1)
    fields = fields.reshape(-1, DISPLACEMENT.count)[:n_rows].copy()
    _recompute_rows_on_patch(
        surface, load, points, sources, collocation, order, fields, cells.polar_points
    )
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
    count: int,
) -> None:
    """Recompute the rows of collocation points on the patch in polar coordinates around them.

    Each row is divided by its own integral of the density: where the points of a rule straddle the
    rim of the patch, the shape of the load suffers, not its total.
    """
    row, triangle, corners = _subtriangles_on_patch(surface, points.triangle, collocation, order)
    if not row.size:
        return
    place = corner_places(surface, triangle, corners)
    barycentric, polar_weight = polar_points(place, corners, load.disc, count)
    position, area, density = traction_at(surface, load, triangle, barycentric)
    weight = density * area * polar_weight / points.total
    around = _as_sources(position.reshape(-1, 3), weight.ravel()).reshape(*weight.shape, 6)
    by_row = np.argsort(row, kind="stable")
    rows, start = np.unique(row[by_row], return_index=True)
    recomputed = np.zeros((rows.size, 1, DISPLACEMENT.count))
    total = np.bincount(row, weight.sum(axis=1))[rows]
    of_triangle = np.bincount(points.triangle, points.weight, triangle.max() + 1)
    pairs = np.unique(np.stack([row, triangle]), axis=1)
    total += 1.0 - np.bincount(pairs[0], of_triangle[pairs[1]])[rows]
    in_threads(
        _sum_around, rows.size, collocation.point[order[rows]], around[by_row], triangle[by_row],
        np.append(start, row.size), sources, points.triangle, recomputed,
    )  # fmt: skip
    resolved = np.abs(total - 1.0) < _LARGEST_ERROR
    fields[rows[resolved]] = recomputed[resolved, 0] / total[resolved, None]


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
                # Where a patch covers none of a part, its points may coincide with the point.
                if around[part, q, 3] > 0.0:
                    add_point_fields(_N_FIELDS, points[i], around[part, q], 1.0, factor, out[i])
        for q in range(sources.shape[0]):
            counts = True
            for part in range(start[i], start[i + 1]):
                counts = counts and loaded[q] != triangle[part]
            if counts:
                add_point_fields(_N_FIELDS, points[i], sources[q], 1.0, factor, out[i])
