"""Displacement kernel integrated against a given traction: the load's own integral, not its nodal
values.

A contact patch is often hardly wider than an element. Its traction is therefore integrated over the
patch itself: fine cells, finer where the patch ends, and polar coordinates around every collocation
point inside it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Float, Int

from palpate.bem.integrals import (
    DISPLACEMENT_FIELDS,
    LANES,
    BoundarySurface,
    Collocation,
    FieldBlocks,
    displacement_fields,
    quadratic_shapes,
    quadratic_slopes,
    triangle_rule,
    unit_gauss,
)
from palpate.bem.loads.half_space import PressureDisc
from palpate.errors import InputError
from palpate.threads import in_threads

Density = Callable[
    [Int[np.ndarray, " n"], Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]],
    Float[np.ndarray, " n"],
]

MOST_LEVELS = 2
RIM_LEVELS = 3
CELL_DEGREE = 5
POLAR_PANELS = 3
POLAR_POINTS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceLoad:
    """A traction of constant direction, spread over some triangles; its total is one newton along
    any axis.

    Attributes
    ----------
    triangles : (k,) int          triangles that it may touch
    density : callable            (triangle (n,), barycentric (n, 3), position (n, 3) [m]) -> (n,)
                                  >= 0, of any scale: it is divided by its own surface integral
    disc : PressureDisc or None   the load as a round patch, where it is one: it sharpens the
                                  elements around it
    """

    triangles: Int[np.ndarray, " k"]
    density: Density
    disc: PressureDisc | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LoadPoints:
    """Quadrature points of a load.

    Attributes
    ----------
    position : (q, 3) float [m]
    weight : (q,) float           sum to 1
    triangle : (q,) int           triangle of each point
    total : float [m^2]           integral of the density before it was scaled, times the density's
                                  unit
    """

    position: Float[np.ndarray, "q 3"]
    weight: Float[np.ndarray, " q"]
    triangle: Int[np.ndarray, " q"]
    total: float


def load_points(surface: BoundarySurface, load: SurfaceLoad) -> LoadPoints:
    """Quadrature points that integrate smooth functions against a load.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad

    Returns
    -------
    LoadPoints

    Raises
    ------
    InputError                    the density vanishes on all its triangles
    """
    nodes = surface.element_nodes
    rule = triangle_rule(CELL_DEGREE)
    corners = np.tile(np.eye(3), (load.triangles.size, 1, 1))
    triangle = np.asarray(load.triangles, dtype=np.int64)
    for _ in range(_cell_level(surface, load)):
        triangle, corners = _divided(triangle, corners)
    positions, weights, owners = [], [], []
    for level in range(RIM_LEVELS + 1):
        if not triangle.size:
            break
        barycentric = np.einsum("qk,ckj->cqj", rule.barycentric, corners)
        position, area = _points_of(nodes, triangle, barycentric)
        size = np.abs(np.linalg.det(corners))
        density = load.density(
            np.repeat(triangle, rule.weight.size), barycentric.reshape(-1, 3), position
        ).reshape(triangle.size, -1)
        rim = (density == 0).any(axis=1) & (density > 0).any(axis=1) & (level < RIM_LEVELS)
        weight = density * area.reshape(density.shape) * rule.weight * size[:, None]
        keep = ((density > 0) & ~rim[:, None]).ravel()
        positions.append(position[keep])
        weights.append(weight.ravel()[keep])
        owners.append(np.repeat(triangle, rule.weight.size)[keep])
        triangle, corners = _divided(triangle[rim], corners[rim])
    weight = np.concatenate(weights)
    total = float(weight.sum())
    if not total > 0:
        raise InputError(
            "the contact patch covers no part of the free surface; move its point or enlarge "
            "its radius"
        )
    return LoadPoints(np.concatenate(positions), weight / total, np.concatenate(owners), total)


def _cell_level(surface: BoundarySurface, load: SurfaceLoad) -> int:
    """How often triangles are divided: cells of at most a quarter of the patch's radius."""
    if load.disc is None:
        return MOST_LEVELS
    corner = surface.element_nodes[load.triangles, :3]
    edge = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max()
    return int(np.clip(np.ceil(np.log2(4 * edge / load.disc.radius)), 1, MOST_LEVELS))


def loaded_triangles(surface: BoundarySurface, load: SurfaceLoad) -> Int[np.ndarray, " k"]:
    """Those of a load's triangles on which it does not vanish, by a few points of each.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad

    Returns
    -------
    (k,) int
    """
    rule = triangle_rule(7)
    triangle = np.asarray(load.triangles, dtype=np.int64)
    barycentric = np.tile(rule.barycentric, (triangle.size, 1, 1))
    position, _ = _points_of(surface.element_nodes, triangle, barycentric)
    repeated = np.repeat(triangle, rule.weight.size)
    density = load.density(repeated, barycentric.reshape(-1, 3), position)
    return triangle[(density.reshape(triangle.size, -1) > 0).any(axis=1)]


def integrate_load(
    surface: BoundarySurface, load: SurfaceLoad, collocation: Collocation, blocks: FieldBlocks
) -> Float[np.ndarray, "r 6"]:
    """The six displacement fields integrated against a load, at every collocation point.

    Parameters
    ----------
    surface : BoundarySurface
    load : SurfaceLoad
    collocation : Collocation
    blocks : FieldBlocks          of that collocation, for the order of its rows

    Returns
    -------
    (r, 6) float [1/m]            in the order of the blocks' rows
    """
    points = load_points(surface, load)
    rows = blocks.rows
    lanes = collocation.point[rows].transpose(0, 2, 1).reshape(rows.shape[0], 3 * LANES).copy()
    sources = np.zeros((points.weight.size, 6))
    sources[:, :3], sources[:, 3] = points.position, points.weight
    out = np.zeros((rows.shape[0], DISPLACEMENT_FIELDS * LANES))
    in_threads(_sum_points, lanes.shape[0], lanes, sources, out)
    fields = out.reshape(-1, DISPLACEMENT_FIELDS, LANES).transpose(0, 2, 1).reshape(-1, 6)
    fields = fields[: blocks.n_rows].copy()
    _mend_touching_rows(surface, load, points, collocation, rows.ravel()[: blocks.n_rows], fields)
    return fields


def _mend_touching_rows(
    surface: BoundarySurface,
    load: SurfaceLoad,
    points: LoadPoints,
    collocation: Collocation,
    order: Int[np.ndarray, " r"],
    fields: Float[np.ndarray, "r 6"],
) -> None:
    """Replace what the cells give for the collocation points on the patch by polar coordinates
    around them."""
    place, triangle, corners = _touching_parts(surface, points.triangle, collocation, order)
    if not place.size:
        return
    s, t, polar_weight = _polar_panels()
    far_side = np.einsum("q,pj->pqj", 1 - t, corners[:, 1]) + np.einsum(
        "q,pj->pqj", t, corners[:, 2]
    )
    barycentric = np.einsum("q,pj->pqj", 1 - s, corners[:, 0]) + s[:, None] * far_side
    position, area = _points_of(surface.element_nodes, triangle, barycentric)
    repeated = np.repeat(triangle, s.size)
    density = load.density(repeated, barycentric.reshape(-1, 3), position)
    scale = np.abs(np.linalg.det(corners))[:, None] * polar_weight / points.total
    weight = density * area * scale.ravel()
    centre = collocation.point[order[place]]
    r = position.reshape(place.size, -1, 3) - centre[:, None]
    share = _fields(r, weight.reshape(place.size, -1))
    for row in np.unique(place):
        mine = place == row
        away = ~np.isin(points.triangle, triangle[mine])
        r = points.position[away] - collocation.point[order[row]]
        fields[row] = share[mine].sum(axis=0) + _fields(r[None], points.weight[None, away])[0]


def _touching_parts(
    surface: BoundarySurface,
    loaded: Int[np.ndarray, " q"],
    collocation: Collocation,
    order: Int[np.ndarray, " r"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Float[np.ndarray, "p 3 3"]]:
    """Places in the order whose collocation point lies on a loaded triangle, that triangle, and
    barycentric corners of
    the part of it that starts at the point."""
    triangles = np.unique(loaded)
    place_of = np.full(collocation.point.shape[0], -1)
    place_of[order] = np.arange(order.size)
    row_of = np.full(surface.mesh.vertices.shape[0], -1)
    at_vertex = np.flatnonzero(collocation.vertex >= 0)
    row_of[collocation.vertex[at_vertex]] = place_of[at_vertex]
    place = row_of[surface.mesh.triangles[triangles]].ravel()
    turned = np.stack([np.roll(np.eye(3), -k, axis=0) for k in range(3)])
    corners = np.tile(turned, (triangles.size, 1, 1))
    triangle = np.repeat(triangles, 3)
    found = place >= 0
    parts = [(place[found], triangle[found], corners[found])]
    unit = np.eye(3)
    for row in np.flatnonzero(np.isin(collocation.triangle, triangles)):
        point = collocation.barycentric[row]
        around = np.stack([np.stack([point, unit[k], unit[(k + 1) % 3]]) for k in range(3)])
        parts.append((np.full(3, place_of[row]), np.full(3, collocation.triangle[row]), around))
    place, triangle, corners = (np.concatenate(part) for part in zip(*parts, strict=True))
    return place, triangle, corners


def _polar_panels() -> tuple[Float[np.ndarray, " p"], ...]:
    x, w = unit_gauss(POLAR_POINTS)
    start = np.arange(POLAR_PANELS)[:, None] / POLAR_PANELS
    points, weights = (start + x / POLAR_PANELS).ravel(), np.tile(w / POLAR_PANELS, POLAR_PANELS)
    s, t = (grid.ravel() for grid in np.meshgrid(points, points, indexing="ij"))
    return s, t, np.outer(weights * points, weights).ravel()


def _fields(
    r: Float[np.ndarray, "p n 3"], weight: Float[np.ndarray, "p n"]
) -> Float[np.ndarray, "p 6"]:
    x, y, z = r[..., 0], r[..., 1], r[..., 2]
    scaled = weight / (x * x + y * y + z * z) ** 1.5
    pairs = (x * x, y * y, z * z, y * z, z * x, x * y)
    return np.stack([np.einsum("pn,pn->p", scaled, pair) for pair in pairs], axis=1)


def _points_of(
    nodes: Float[np.ndarray, "m 6 3"],
    triangle: Int[np.ndarray, " c"],
    barycentric: Float[np.ndarray, "c q 3"],
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, " n"]]:
    """Positions and areas per reference area at points of their own in each triangle, flattened."""
    flat = barycentric.reshape(-1, 3)
    values = np.stack([quadratic_shapes(flat), *quadratic_slopes(flat)])
    values = values.reshape(3, 6, triangle.size, -1).transpose(2, 0, 3, 1)
    combined = values.reshape(triangle.size, -1, 6) @ nodes[triangle]
    position, along_b, along_c = combined.reshape(triangle.size, 3, -1, 3).transpose(1, 0, 2, 3)
    area = np.linalg.norm(np.cross(along_b, along_c), axis=2)
    return position.reshape(-1, 3), area.ravel()


def _divided(
    triangle: Int[np.ndarray, " c"], corners: Float[np.ndarray, "c 3 3"]
) -> tuple[Int[np.ndarray, " d"], Float[np.ndarray, "d 3 3"]]:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.tile(triangle, 4), np.concatenate([np.stack(part, axis=1) for part in parts])


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def _sum_points(begin, end, lanes, sources, out):
    for b in range(begin, end):
        row = np.empty(DISPLACEMENT_FIELDS * LANES)
        for q in range(sources.shape[0]):
            displacement_fields(lanes[b], sources[q], row)
            target = out[b]
            for i in range(row.size):
                target[i] += row[i]
