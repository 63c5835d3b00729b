"""Tractions over parts of the surface, and integrals over them.

A contact patch is often hardly wider than an element. Its traction is therefore integrated over the
patch itself: with small cells that end at its rim. The displacement kernel is integrated over the
traction of the load itself, too, not over nodal values of it; for collocation points on the patch,
in polar coordinates about them.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numba
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from palpate.bem.integrals.assembly import Collocation, lanes_of
from palpate.bem.integrals.kelvin import DISPLACEMENT, LANES, displacement_values, lane_fields
from palpate.bem.integrals.surface import BoundarySurface, triangle_rule
from palpate.bem.loads.half_space import PressureDisc, polar_points
from palpate.errors import InputError
from palpate.geometry import TriangleMesh, closest_points, element_points, quartered
from palpate.shapes import Vector3
from palpate.threads import in_threads

Density = Callable[
    [Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]],
    Float[np.ndarray, " n"],
]
# Most quarterings of a triangle until a cell is no larger than a round patch's radius.
_MAX_LEVELS = 10


@dataclass(frozen=True, slots=True)
class LoadCells:
    """Subdivision of the triangles under a load into cells; each level quarters a cell.

    Levels are counted from the coarsest cells whose edges are no longer than the radius of a round
    patch; for other loads, and where triangles are smaller, from the triangles.

    Attributes
    ----------
    degree : int                  of the quadrature rule on each cell
    rim_points : int              of the rule on the part of a cell that lies in a round patch where
                                  its rim crosses it (`polar_points`)
    polar_points : int            of that rule about collocation points on the patch
    coarsest : int                level of all cells
    finest : int                  level at which subdivision ends
    ratio : float                 least distance of the evaluation points from a cell, over its
                                  size, at which it needs no further subdivision
    """

    degree: int
    rim_points: int
    polar_points: int
    coarsest: int
    finest: int
    ratio: float = 4.0


# Unless others are asked for.
LOAD_CELLS = LoadCells(degree=5, rim_points=4, polar_points=8, coarsest=1, finest=1)
# Sources whose fields are computed before they are summed: they fit into the L1 cache.
_AT_ONCE = 16
# Largest relative error of a row's own integral of the density, above which its points do not
# resolve the patch, and those of the whole load serve it as well.
_LARGEST_ERROR = 0.2
_TINY = float(np.finfo(float).tiny)


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
                                  correction by the local indentation (`indentation_corrections`).
                                  It acts about the point of the surface nearest to its centre
    cells : LoadCells             of its quadrature
    """

    triangles: Int[np.ndarray, " k"]
    density: Density
    disc: PressureDisc | None = None
    cells: LoadCells = LOAD_CELLS


def find_foot(
    surface: BoundarySurface, triangles: Int[np.ndarray, " k"], centre: Vector3
) -> tuple[Vector3, Vector3, Vector3]:
    """The point of some triangles nearest to the centre of a patch.

    Parameters
    ----------
    surface : BoundarySurface
    triangles : (k,) int          those of the load
    centre : (3,) float [m]

    Returns
    -------
    flat : (3,) float [m]         on the flat triangle
    curved : (3,) float [m]       on its curved element
    normal : (3,) float [-]       outward, of the curved element: unlike that of the flat triangle,
                                  it varies continuously within an element
    """
    near = TriangleMesh(surface.mesh.vertices, surface.mesh.triangles[triangles])
    nearest = closest_points(near, centre[None])
    element = surface.element_nodes[triangles[nearest.triangle]]
    point = element_points(element, nearest.barycentric)[0, 0]
    return nearest.position[0], point[:3], point[3:] / np.linalg.norm(point[3:])


@dataclass(frozen=True, slots=True, eq=False)
class _LoadPoints:
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
    near: Float[np.ndarray, "p 3"] | None = None,
) -> _LoadPoints:
    """Quadrature points for integrals of smooth functions times the density of a load.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    near : (p, 3) float [m]       evaluation points: cells close to them are subdivided further

    Returns
    -------
    _LoadPoints

    Raises
    ------
    InputError                    the density vanishes on all its triangles
    """
    return _placed_points(surface, _placed_load(surface, load), near=near)


def integrate_loads(
    surface: BoundarySurface,
    loads: Sequence[SurfaceLoad],
    collocation: Collocation,
    rows: Int[np.ndarray, "b lanes"],
) -> Float[np.ndarray, "r k 6"]:
    """The six displacement fields integrated against loads, at every collocation point: in one pass
    over the points of all loads, but for collocation points that lie on them.

    Parameters
    ----------
    surface : BoundarySurface
    loads : sequence of k SurfaceLoad
    collocation : Collocation
    rows : (b, LANES) int         collocation points of each block (`point_blocks`)

    Returns
    -------
    (r, k, 6) float [1/m]         in the order of the blocks' rows

    Raises
    ------
    InputError                    the density of a load vanishes on all its triangles
    """
    placed = [_placed_load(surface, load) for load in loads]
    points = [_placed_points(surface, load) for load in placed]
    sources = _as_sources(
        np.concatenate([patch.position for patch in points]),
        np.concatenate([patch.weight for patch in points]),
    )
    first = np.cumsum([0, *(patch.triangle.size for patch in points)])
    out = np.zeros((rows.shape[0], len(loads), DISPLACEMENT * LANES))
    in_threads(_sum_points, rows.shape[0], lanes_of(collocation.point, rows), sources, first, out)
    count = collocation.point.shape[0]
    fields = out.reshape(-1, len(loads), DISPLACEMENT, LANES).transpose(0, 3, 1, 2)
    fields = fields.reshape(-1, len(loads), DISPLACEMENT)[:count].copy()
    corners = _corners_at_points(surface, collocation, rows.ravel()[:count])
    for k, (load, patch) in enumerate(zip(placed, points, strict=True)):
        _recompute_rows_on_patch(surface, load, patch, corners, fields[:, k])
    return fields


def _placed_load(surface: BoundarySurface, load: SurfaceLoad) -> SurfaceLoad:
    """A load about the point of the curved surface nearest to its centre, which is given on the
    flat triangles or close to them: a patch may be smaller than the distance between the two.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad

    Returns
    -------
    SurfaceLoad                   its disc is centred on the flat triangle
    """
    if load.disc is None:
        return load
    flat, curved, _ = find_foot(surface, load.triangles, load.disc.centre)
    shift = curved - load.disc.centre

    def density(
        triangle: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "n 3"],
        position: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, " n"]:
        return load.density(triangle, barycentric, position - shift)

    return replace(load, density=density, disc=replace(load.disc, centre=flat))


def _placed_points(
    surface: BoundarySurface,
    load: SurfaceLoad,
    *,
    near: Float[np.ndarray, "p 3"] | None = None,
) -> _LoadPoints:
    """As `load_points`, for a load that is placed already.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad            from `_placed_load`
    near                          as `load_points`

    Returns
    -------
    _LoadPoints

    Raises
    ------
    InputError                    the density vanishes on all its triangles
    """
    cells = load.cells
    triangle, corners = _coarsest_cells(surface, load)
    tree = None if near is None else cKDTree(near)
    positions, weights, owners = [np.zeros((0, 3))], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
    for level in range(cells.coarsest, cells.finest + 1):
        divide = np.zeros(triangle.size, dtype=bool)
        if tree is not None and level < cells.finest and triangle.size:
            middle, size = _cell_balls(surface, triangle, corners)
            divide = tree.query(middle)[0] < cells.ratio * size
        for owner, position, weight in _cell_points(
            surface, load, triangle[~divide], corners[~divide]
        ):
            loaded = weight > 0.0
            positions.append(position[loaded])
            weights.append(weight[loaded])
            owners.append(np.repeat(owner, loaded.sum(axis=1)))
        triangle, corners = quartered(triangle[divide], corners[divide])
    weight = np.concatenate(weights)
    total = float(weight.sum())
    if not total > 0:
        raise InputError(
            "the contact patch covers no part of the free surface; move its point or enlarge "
            "its radius"
        )
    return _LoadPoints(np.concatenate(positions), weight / total, np.concatenate(owners), total)


def _coarsest_cells(
    surface: BoundarySurface, load: SurfaceLoad
) -> tuple[Int[np.ndarray, " c"], Float[np.ndarray, "c 3 3"]]:
    """Triangle and barycentric corners of the coarsest cells (`LoadCells`), without those out of a
    round patch's reach."""
    triangle = np.asarray(load.triangles, dtype=np.int64)
    corners = np.tile(np.eye(3), (triangle.size, 1, 1))
    disc, level = load.disc, load.cells.coarsest
    if disc is not None:
        corner = surface.element_nodes[triangle, :3]
        edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max()
        level += int(np.clip(np.ceil(np.log2(edge / disc.radius)), -level, _MAX_LEVELS))
    for _ in range(level):
        triangle, corners = quartered(triangle, corners)
        if disc is not None:
            middle, size = _cell_balls(surface, triangle, corners)
            # Curved elements bulge by less than a cell's size.
            reached = np.linalg.norm(middle - disc.centre, axis=1) < disc.radius + 2.0 * size
            triangle, corners = triangle[reached], corners[reached]
    return triangle, corners


def _cell_balls(
    surface: BoundarySurface, triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> tuple[Float[np.ndarray, "c 3"], Float[np.ndarray, " c"]]:
    """Centre of each cell, and the distance of its farthest corner from it [m]."""
    position = _corner_places(surface, triangle, corners)
    middle = position.mean(axis=1)
    return middle, np.linalg.norm(position - middle[:, None], axis=2).max(axis=1)


def _corner_places(
    surface: BoundarySurface, triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> Float[np.ndarray, "c 3 3"]:
    """Corners of cells on flat triangles, (c, 3, 3) [m].

    Parameters
    ----------
    surface : BoundarySurface
    triangle : (c,) int
    corners : (c, 3, 3) float [-]     barycentric coordinates
    """
    return np.einsum("ckj,cja->cka", corners, surface.element_nodes[triangle, :3])


def _cell_points(
    surface: BoundarySurface,
    load: SurfaceLoad,
    triangle: Int[np.ndarray, " c"],
    corners: Float[np.ndarray, "c 3 3"],
) -> Iterator[tuple[Int[np.ndarray, " k"], Float[np.ndarray, "k q 3"], Float[np.ndarray, "k q"]]]:
    """Triangle, points and weights of the cells within a load, then of those across its rim."""
    rim = np.zeros(triangle.size, dtype=bool)
    if load.disc is not None:
        corner_position = _corner_places(surface, triangle, corners)
        away = np.linalg.norm(corner_position - load.disc.centre, axis=2)
        rim = away.max(axis=1) >= load.disc.radius
        count = load.cells.rim_points
        barycentric, weight = polar_points(corner_position[rim], corners[rim], load.disc, count)
        position, area, density = _traction_at(surface, load, triangle[rim], barycentric)
        yield triangle[rim], position, density * area * weight
    within, weight = triangle_rule(load.cells.degree)
    barycentric = np.einsum("qk,ckj->cqj", within, corners[~rim])
    position, area, density = _traction_at(surface, load, triangle[~rim], barycentric)
    size = np.abs(np.linalg.det(corners[~rim]))[:, None]
    yield triangle[~rim], position, density * area * size * weight


def _traction_at(
    surface: BoundarySurface,
    load: SurfaceLoad,
    triangle: Int[np.ndarray, " c"],
    barycentric: Float[np.ndarray, "c q 3"],
) -> tuple[Float[np.ndarray, "c q 3"], Float[np.ndarray, "c q"], Float[np.ndarray, "c q"]]:
    """The traction at given points of each triangle.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    triangle : (c,) int
    barycentric : (c, q, 3) float [-]

    Returns
    -------
    position : (c, q, 3) float [m]
    area : (c, q) float [m^2]         per reference area
    density : (c, q) float            >= 0, up to a factor
    """
    points = element_points(surface.element_nodes[triangle], barycentric)
    position = points[:, :, :3]
    shape = barycentric.shape[:2]
    density = load.density(
        np.repeat(triangle, shape[1]), barycentric.reshape(-1, 3), position.reshape(-1, 3)
    )
    return position, np.linalg.norm(points[:, :, 3:], axis=2), density.reshape(shape)


def _as_sources(
    position: Float[np.ndarray, "q 3"], weight: Float[np.ndarray, " q"]
) -> Float[np.ndarray, "q 6"]:
    """Points in the layout of the kernels: of the normal, the displacement kernel uses the length
    alone, here the weight."""
    return np.column_stack([position, weight, np.zeros((weight.size, 2))])


class _Corners(NamedTuple):
    """Where collocation points lie on the triangles: each a corner of subtriangles.

    Attributes
    ----------
    point : (r, 3) float [m]      of each row
    row : (p,) int
    triangle : (p,) int           a triangle on which it lies
    corners : (p, 3, 3) float     barycentric corners of a subtriangle, the point the first of them
    start : (m + 1,) int          where those of each triangle begin
    """

    point: Float[np.ndarray, "r 3"]
    row: Int[np.ndarray, " p"]
    triangle: Int[np.ndarray, " p"]
    corners: Float[np.ndarray, "p 3 3"]
    start: Int[np.ndarray, " m_1"]


def _corners_at_points(
    surface: BoundarySurface, collocation: Collocation, order: Int[np.ndarray, " r"]
) -> _Corners:
    """Subtriangles about all collocation points, whose rows are in a given order."""
    count = len(surface.mesh.triangles)
    row_of_point = np.empty(order.size, dtype=np.int64)
    row_of_point[order] = np.arange(order.size)
    row_of_vertex = np.full(len(surface.mesh.vertices), -1)
    at_vertex = np.flatnonzero(collocation.vertex >= 0)
    row_of_vertex[collocation.vertex[at_vertex]] = row_of_point[at_vertex]
    row = row_of_vertex[surface.mesh.triangles].ravel()
    turned = np.stack([np.roll(np.eye(3), -k, axis=0) for k in range(3)])
    corners = np.tile(turned, (count, 1, 1))[row >= 0]
    triangle = np.repeat(np.arange(count), 3)[row >= 0]
    inside = np.flatnonzero(collocation.vertex < 0)
    around = np.empty((inside.size, 3, 3, 3))
    around[:, :, 0] = collocation.barycentric[inside, None]
    around[:, :, 1], around[:, :, 2] = np.eye(3), np.roll(np.eye(3), -1, axis=0)
    row = np.concatenate([row[row >= 0], np.repeat(row_of_point[inside], 3)])
    triangle = np.concatenate([triangle, np.repeat(collocation.triangle[inside], 3)])
    corners = np.concatenate([corners, around.reshape(-1, 3, 3)])
    by_triangle = np.argsort(triangle, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(triangle, minlength=count))])
    ordered = row[by_triangle], triangle[by_triangle], corners[by_triangle]
    return _Corners(collocation.point[order], *ordered, start)


def _recompute_rows_on_patch(
    surface: BoundarySurface,
    load: SurfaceLoad,
    points: _LoadPoints,
    at: _Corners,
    fields: Float[np.ndarray, "r 6"],
) -> None:
    """Recompute the rows of collocation points on the patch in polar coordinates around them.

    Each row is divided by its own integral of the density: where the points of a rule straddle the
    rim of the patch, the shape of the load suffers, not its total.
    """
    loaded = np.unique(points.triangle)
    chosen = np.concatenate([np.arange(at.start[k], at.start[k + 1]) for k in loaded])
    if not chosen.size:
        return
    chosen = chosen[np.argsort(at.row[chosen], kind="stable")]
    triangle, corners = at.triangle[chosen], at.corners[chosen]
    rows, start, number = np.unique(at.row[chosen], return_index=True, return_inverse=True)
    corner_position = _corner_places(surface, triangle, corners)
    barycentric, polar_weight = polar_points(
        corner_position, corners, load.disc, load.cells.polar_points
    )
    position, area, density = _traction_at(surface, load, triangle, barycentric)
    weight = density * area * polar_weight / points.total
    around = np.concatenate([position.transpose(0, 2, 1), weight[:, None]], axis=1)
    recomputed = np.zeros((rows.size, DISPLACEMENT))
    whole = np.concatenate([points.position.T, points.weight[None]])
    # Too little for threads.
    _sum_around(
        0, rows.size, at.point[rows], around, triangle, np.append(start, chosen.size), whole,
        points.triangle, recomputed,
    )  # fmt: skip
    of_triangle = np.bincount(points.triangle, points.weight, triangle.max() + 1)
    pairs = np.unique(np.stack([number, triangle]), axis=1)
    beside = 1.0 - np.bincount(pairs[0], of_triangle[pairs[1]])
    total = beside + np.bincount(number, weight.sum(axis=1))
    accurate = np.abs(total - 1.0) < _LARGEST_ERROR
    fields[rows[accurate]] = recomputed[accurate] / total[accurate, None]


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _sum_points(begin, end, lanes, sources, start, out):
    """Displacement fields at some blocks of points, summed over the sources of each load."""
    width = DISPLACEMENT * LANES
    buffer = np.empty(_AT_ONCE * width)
    for b in range(begin, end):
        for k in range(start.size - 1):
            total = out[b, k]
            for first in range(start[k], start[k + 1], _AT_ONCE):
                last = min(first + _AT_ONCE, start[k + 1])
                lane_fields(DISPLACEMENT, lanes[b], sources[first:last], buffer)
                for q in range(last - first):
                    for i in range(width):
                        total[i] += buffer[q * width + i]


@numba.njit(nogil=True, error_model="numpy", cache=True)
def _sum_around(begin, end, points, around, triangle, start, sources, loaded, out):
    """Displacement fields at some points: from the sources around each, parts start[i] to
    start[i + 1], and from all sources that lie on none of the triangles of these parts. Sources
    are (4, q): places, then weights."""
    weight = np.empty(loaded.size)
    for i in range(begin, end):
        weight[:] = sources[3]
        for part in range(start[i], start[i + 1]):
            _add_displacement(points[i], around[part], around[part, 3], out[i])
            for q in range(loaded.size):
                if loaded[q] == triangle[part]:
                    weight[q] = 0.0
        _add_displacement(points[i], sources, weight, out[i])


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _add_displacement(point, places, weight, out):
    """Add the displacement fields at a point of sources at (3 or more, q) places."""
    xx = yy = zz = yz = zx = xy = 0.0
    for q in range(weight.size):
        x, y, z = places[0, q] - point[0], places[1, q] - point[1], places[2, q] - point[2]
        # Where a patch covers none of a part, its points may coincide with the point: weight 0.
        s = 1.0 / np.sqrt(max(x * x + y * y + z * z, _TINY))
        values = displacement_values(x, y, z, s * s * s * weight[q])
        xx += values[0]
        yy += values[1]
        zz += values[2]
        yz += values[3]
        zx += values[4]
        xy += values[5]
    out[0] += xx
    out[1] += yy
    out[2] += zz
    out[3] += yz
    out[4] += zx
    out[5] += xy
