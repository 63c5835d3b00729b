"""Quadratic tetrahedral meshes of the solid inside a closed triangle surface.

Existing mesh generators either have licences that this project does not accept, or use random
numbers that cannot be seeded. Here evenly spaced points on and in the body are connected by a
Delaunay tetrahedralisation without its outer cells: the same surface gives the same bytes.

Many candidate points are thinned to a minimum distance, a fraction of the wanted spacing; each
point kept is then moved to the centroid of the candidates nearest to it (Lloyd's algorithm). The
candidates are deterministic sequences.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import skfem
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay, cKDTree

from palpate.arrays import fix_fields, fixed_array
from palpate.errors import InputError, MeshError
from palpate.geometry import (
    CREASE_ANGLE,
    Sides,
    TriangleMesh,
    checked_mesh,
    closest_points,
    half_edges,
    inside,
    is_outer,
    split_sides,
    unit_normals,
)
from palpate.progress import Progress, part_of, silent
from palpate.shapes import Points, PointScalars
from palpate.solids.sizes import check_solid_size

# Corners of the edges with midside nodes 4 to 9, in the order of skfem.ElementTetP2.
EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
# Faces of a tetrahedron of positive volume, counter-clockwise from outside: corners, then the
# midside nodes of their edges 01, 12, 20.
FACES = np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [0, 3, 2, 7, 9, 6], [1, 2, 3, 5, 9, 8]])
# Tetrahedra between four surface points that are flatter than this (1 is regular) do not belong to
# the body: they fill the gap between the two triangulations of a quadrilateral.
_MIN_SHAPE = 0.1
_SMOOTHING_ROUNDS = 6
# Shares of the work, about: where all points are placed, and where tetrahedra fill the body; chunks
# in which interior points are tested.
_PLACED, _FILLED, _CHUNKS = 0.07, 0.95, 10
# Shape functions of a six-node triangle at its centre.
_CENTRE = np.array([-1.0, -1.0, -1.0, 4.0, 4.0, 4.0]) / 9.0
# Nodes of the four triangles into which the midside nodes divide a six-node triangle.
QUARTERS = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])
# Least Jacobian determinant of a curved element, relative to the straight one; otherwise it is
# left straight.
_MIN_VOLUME = 0.3
# Largest deviation from the surface, as a fraction of `edge`; more means too coarse a mesh.
_MAX_DEVIATION = 0.4
# Largest number of elements along a body: the candidate points are many times finer still.
_MAX_ELEMENTS_ACROSS = 2000
_NONE = np.zeros((0, 3))
_Spacing = Callable[[np.ndarray], np.ndarray]
# Least distance of points, as a fraction of the spacing: thinned points lie 1.0 to 2.0 times this
# apart, about 1.35 times after smoothing.
_NEAREST = 0.75
# Candidates per square of the spacing: enough for an accurate centroid.
_CANDIDATES = 40.0
_LLOYD_ROUNDS = 8
# Candidates on sharp edges lie at most this fraction of the spacing apart.
_PIECE = 0.25
# The spacing grows by this much per metre away from a refined region: neighbours differ little.
_GROWTH = 0.3
# Least distance of interior points from the surface, as a fraction of the spacing: a regular
# tetrahedron is 0.8 of its edge high, and a flatter first layer is better than slivers.
_OFF_SURFACE = 0.6
# Edge of the cubic cells of a body-centred lattice, as a multiple of the spacing: its nearest
# (0.87 cells) and second nearest neighbours (1 cell) are then about one spacing apart.
_CELL = 1.08
# Distance of candidates, as a fraction of the spacing, where the spacing varies: with fewer, the
# thinned points would be uneven.
_CHOICE = 0.5
_EIGHTHS = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """Quadratic tetrahedra with their outer faces; elements at a curved surface are curved too.

    Parameters
    ----------
    nodes : (n, 3) float [m]          corner nodes first, then one midside node per edge
    elements : (m, 10) int            four corners (positive volume), then the midside nodes of
                                      edges 01, 12, 02, 03, 13, 23
    facets : (f, 6) int               outer faces, counter-clockwise from outside: three corners,
                                      then the midside nodes of edges 01, 12, 20
    facet_triangle : (f,) int         triangle of the given surface nearest to each outer face
    deviation : float [m]             largest distance between the outer faces and the given surface
    """

    nodes: Float[np.ndarray, "n 3"]
    elements: Int[np.ndarray, "m 10"]
    facets: Int[np.ndarray, "f 6"]
    facet_triangle: Int[np.ndarray, " f"]
    deviation: float

    def __post_init__(self) -> None:
        fix_fields(self, nodes=(None, 3))
        fix_fields(
            self, integer=True, elements=(None, 10), facets=(None, 6), facet_triangle=(None,)
        )


def make_solid(
    mesh: TriangleMesh,
    *,
    edge: float,
    fine: Sequence[tuple[Float[np.ndarray, "3"], float, float]] = (),
    marked: Float[np.ndarray, "k 3"] = _NONE,
    walls: Sequence[TriangleMesh] = (),
    progress: Progress = silent,
) -> Solid:
    """Fill a closed surface with quadratic tetrahedra.

    Corners of outer faces lie on the surface; sharp edges (over 40 degrees) are preserved. Flat
    faces are reproduced exactly, curved ones by curved elements; `Solid.deviation` is the error.

    Parameters
    ----------
    mesh : TriangleMesh               closed, outward normals
    edge : float [m]                  wanted edge length of the elements
    fine : (point (3,), radius, edge) refined regions: elements of at most that edge [m] within
                                      `radius` [m] of `point`, growing by 0.3 m/m around it
    marked : (k, 3) float [m]         points that become surface nodes, unless they are closer to a
                                      sharp edge than about an element's edge
    walls : sequence of TriangleMesh  closed surfaces that elements follow where these are well
                                      inside the body: they cut nearly none
    progress : callable

    Returns
    -------
    Solid                             the same input gives the same bytes

    Raises
    ------
    InputError                        an edge or radius that is not positive, or an edge too small
                                      for the size of the body or for the memory
    MeshError                         the surface is open, intersects itself, bounds several
                                      solids, or has details finer than `edge`
    """
    for name, value in [("edge", edge)] + [("edge of a fine place", small) for *_, small in fine]:
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"{name} is {value}; must be positive, in metres")
    least = float(np.ptp(mesh.vertices, axis=0).max()) / _MAX_ELEMENTS_ACROSS
    finest = min([edge, *(small for *_, small in fine)])
    if finest < least:
        raise InputError(
            f"elements of {finest:.2g} m are too small for a body of this size, which takes"
            f" {least:.2g} m; under the tip: a larger tip, or a deeper or stronger push"
        )
    for point, radius, _ in fine:
        fixed_array(point, name="point of a fine place", shape=(3,))
        if not (np.isfinite(radius) and radius >= 0.0):
            raise InputError(f"radius of a fine place is {radius}; must not be negative")
    mesh, _ = checked_mesh(mesh)
    check_solid_size(mesh, edge)
    spacing = _make_spacing(edge, fine)
    shell = _surface_points(mesh, spacing, closest_points(mesh, marked).position)
    wall = np.concatenate([_NONE, *(_surface_points(surface, spacing, _NONE) for surface in walls)])
    wall = _thinned(_well_inside(mesh, wall, spacing), spacing)
    stage_progress = part_of(progress, 0.0, _PLACED)
    inner = _volume_points(mesh, spacing, np.concatenate([shell, wall]), walls, stage_progress)
    if len(shell) < 4 or not len(inner):
        raise MeshError(
            f"an edge of {1e3 * edge:.3g} mm leaves no point inside the body; use a smaller edge"
        )
    stage_progress = part_of(progress, _PLACED, _FILLED)
    points, tetrahedra = _tetrahedra(mesh, shell, wall, inner, spacing, stage_progress)
    return quadratic_solid(points, tetrahedra, mesh=mesh, largest=_MAX_DEVIATION * edge)


def quadratic_solid(
    points: Points,
    tetrahedra: Int[np.ndarray, "m 4"],
    *,
    mesh: TriangleMesh,
    largest: float = np.inf,
) -> Solid:
    """Quadratic tetrahedra from linear ones: adds midside nodes and finds the outer faces.

    Parameters
    ----------
    points : (n, 3) float [m]
    tetrahedra : (m, 4) int           of any orientation
    mesh : TriangleMesh               surface of the body
    largest : float [m]               largest permitted distance of the outer faces from the surface

    Returns
    -------
    Solid

    Raises
    ------
    MeshError                         a tetrahedron of zero volume, or outer faces farther away
    """
    tetrahedra = _positively_oriented(points, tetrahedra)
    ends = np.sort(tetrahedra[:, EDGES].reshape(-1, 2), axis=1)
    edge, where = np.unique(ends, axis=0, return_inverse=True)
    nodes = np.concatenate([points, points[edge].mean(axis=1)])
    elements = np.concatenate([tetrahedra, len(points) + where.reshape(-1, 6)], axis=1)
    faces = elements[:, FACES].reshape(-1, 6)
    facets = faces[is_outer(faces[:, :3])]
    nodes = _curved(nodes, elements, np.unique(facets[:, 3:]), mesh)
    centre = np.einsum("v,fva->fa", _CENTRE, nodes[facets])
    closest = closest_points(mesh, centre)
    corners = closest_points(boundary_surface(nodes, facets), mesh.vertices).distance
    deviation = float(max(closest.distance.max(), corners.max()))
    if deviation > largest:
        raise MeshError(
            f"the tetrahedra miss the surface by up to {1e3 * deviation:.3g} mm, more than"
            f" {1e3 * largest:.3g} mm: the body has details or walls thinner than the elements;"
            " use a smaller edge, or fine places there"
        )
    return Solid(nodes, elements, facets, closest.triangle, deviation)


def boundary_surface(nodes: Points, facets: Int[np.ndarray, "f 6"]) -> TriangleMesh:
    """Outer faces as linear triangles over all their nodes.

    Parameters
    ----------
    nodes : (n, 3) float [m]
    facets : (f, 6) int               as in `Solid`

    Returns
    -------
    TriangleMesh                      four triangles per facet, in the order of the facets
    """
    return TriangleMesh(nodes, facets[:, QUARTERS].reshape(-1, 3))


def _curved(
    nodes: Points,
    elements: Int[np.ndarray, "m 10"],
    sides: Int[np.ndarray, " s"],
    mesh: TriangleMesh,
) -> Points:
    """Nodes with midside nodes of outer edges moved to the surface, unless that would distort an
    element too much."""
    curved = nodes.copy()
    curved[sides] = closest_points(mesh, nodes[sides]).position
    straight = _volumes(nodes[elements[:, :4]])
    while True:
        distorted = elements[_least_determinant(curved[elements]) < 6.0 * _MIN_VOLUME * straight]
        reset = np.unique(distorted)
        reset = reset[(curved[reset] != nodes[reset]).any(axis=1)]
        if not len(reset):
            return curved
        curved[reset] = nodes[reset]


def _least_determinant(corner: Float[np.ndarray, "m 10 3"]) -> Float[np.ndarray, " m"]:
    """Least Jacobian determinant of the map from the unit tetrahedron, over the nodes [m^3]."""
    element = skfem.ElementTetP2()
    slopes = np.stack([element.lbasis(element.doflocs.T, i)[1] for i in range(10)])
    return np.linalg.det(np.einsum("mva,vdp->mpad", corner, slopes)).min(axis=1)


def _positively_oriented(
    points: Points, tetrahedra: Int[np.ndarray, "m 4"]
) -> Int[np.ndarray, "m 4"]:
    """Tetrahedra with corners reordered to positive volume."""
    volume = _volumes(points[tetrahedra])
    if np.any(volume == 0.0):
        raise MeshError(
            f"{int((volume == 0).sum())} tetrahedra have no volume, the first:"
            f" {int(np.flatnonzero(volume == 0)[0])}; remove them"
        )
    swapped = tetrahedra[:, [0, 2, 1, 3]]
    return np.where((volume < 0.0)[:, None], swapped, tetrahedra)


def _volumes(corner: Float[np.ndarray, "m 4 3"]) -> Float[np.ndarray, " m"]:
    """Signed volume of each tetrahedron [m^3]."""
    side = corner[:, 1:] - corner[:, :1]
    return np.einsum("ma,ma->m", side[:, 0], np.cross(side[:, 1], side[:, 2])) / 6.0


def _shape(corner: Float[np.ndarray, "m 4 3"]) -> Float[np.ndarray, " m"]:
    """Volume over that of the regular tetrahedron with the same mean square edge, 0 to 1."""
    length = np.linalg.norm(corner[:, EDGES[:, 0]] - corner[:, EDGES[:, 1]], axis=2)
    return 6.0 * np.sqrt(2.0) * np.abs(_volumes(corner)) / np.mean(length**2, axis=1) ** 1.5


def _tetrahedra(
    mesh: TriangleMesh,
    shell: Points,
    wall: Float[np.ndarray, "w 3"],
    inner: Float[np.ndarray, "k 3"],
    spacing: _Spacing,
    progress: Progress,
) -> tuple[Float[np.ndarray, "p 3"], Int[np.ndarray, "m 4"]]:
    """Delaunay tetrahedra that fill the body, with smoothed interior points."""
    count, fixed = len(shell), len(shell) + len(wall)
    points = np.concatenate([shell, wall, inner])
    for step in range(_SMOOTHING_ROUNDS + 1):
        progress("tetrahedra", step / (_SMOOTHING_ROUNDS + 1))
        cells = Delaunay(points).simplices.astype(np.int64)
        cells = _inner_cells(mesh, points, cells, count)
        if step == _SMOOTHING_ROUNDS:
            break
        points[fixed:] = _smoothed(points, cells, spacing)[fixed:]
    used, cells = np.unique(cells, return_inverse=True)
    return points[used], cells.reshape(-1, 4)


def _smoothed(points: Points, cells: Int[np.ndarray, "m 4"], spacing: _Spacing) -> Points:
    """Every point moved to the mean of its cells' centroids, weighted by volume over wanted volume.

    Source
    ------
    Chen and Xu, Optimal Delaunay triangulations, J. Comput. Math. 22 (2004) 299: the centroidal
    patch update, which cannot leave the patch as circumcentres can.
    """
    corner = points[cells]
    centre = corner.mean(axis=1)
    weight = np.abs(_volumes(corner)) / spacing(centre) ** 3
    total, moved = np.zeros(len(points)), np.zeros_like(points)
    for k in range(4):
        total += np.bincount(cells[:, k], weight, minlength=len(points))
        for i in range(3):
            moved[:, i] += np.bincount(cells[:, k], weight * centre[:, i], minlength=len(points))
    used = total > 0.0
    return np.where(used[:, None], moved / np.where(used, total, 1.0)[:, None], points)


def _inner_cells(
    mesh: TriangleMesh, points: Points, cells: Int[np.ndarray, "m 4"], count: int
) -> Int[np.ndarray, "r 4"]:
    """Cells inside the surface, without the flat ones that only lie against it.

    A flat element between four nearly coplanar points would be almost infinitely stiff in bending.
    """
    surface_only = np.flatnonzero((cells < count).all(axis=1))
    corner = points[cells[surface_only]]
    keep = np.ones(len(cells), dtype=bool)
    not_flat = _shape(corner) > 1e-6
    keep[surface_only[~not_flat]] = False
    centre = corner[not_flat].mean(axis=1)
    keep[surface_only[not_flat][~inside(mesh, centre)]] = False
    cells = cells[keep]
    while True:
        flat = np.flatnonzero((cells < count).all(axis=1))
        flat = flat[_shape(points[cells[flat]]) < _MIN_SHAPE]
        faces = cells[:, FACES[:, :3]].reshape(-1, 3)
        # Of faces between surface points alone: the others are no faces of flat cells.
        rows = np.flatnonzero((faces < count).all(axis=1))
        outer = np.unique(rows[is_outer(faces[rows])] // 4)
        peel = np.intersect1d(flat, outer)
        if not len(peel):
            return cells
        cells = np.delete(cells, peel, axis=0)


def _make_spacing(edge: float, fine: Sequence[tuple[np.ndarray, float, float]]) -> _Spacing:
    """Wanted spacing of points as a function of position.

    Parameters
    ----------
    edge : float [m]                    spacing far from the refined regions
    fine : (point (3,), radius, edge)   refined regions: at most `edge` [m] within `radius` [m] of
                                        `point`

    Returns
    -------
    (n, 3) -> (n,) float [m]            grows by 0.3 m/m outside a refined region
    """

    # A refined line is many regions with the same radius and edge: only the nearest one matters.
    kinds: dict[tuple[float, float], list[np.ndarray]] = {}
    for centre, radius, small in fine:
        kinds.setdefault((radius, small), []).append(centre)
    trees = [(cKDTree(np.array(centres)), *kind) for kind, centres in kinds.items()]

    def spacing(points: np.ndarray) -> np.ndarray:
        size = np.full(len(points), edge)
        for tree, radius, small in trees:
            beyond = np.clip(tree.query(points)[0] - radius, 0.0, None)
            size = np.minimum(size, small + _GROWTH * beyond)
        return size

    return spacing


def _surface_points(
    mesh: TriangleMesh, spacing: _Spacing, marked: Float[np.ndarray, "k 3"]
) -> Float[np.ndarray, "n 3"]:
    """Evenly spaced points on a surface, including points on its sharp edges and corners.

    Parameters
    ----------
    mesh : TriangleMesh                 closed
    spacing : (n, 3) -> (n,) [m]        of `_make_spacing`
    marked : (k, 3) float [m]           points of the surface that are included, except those too
                                        close to a sharp edge or to each other

    Returns
    -------
    (n, 3) float [m]
    """
    sharp = _crease_candidates(mesh, spacing)
    fixed = _thinned(np.concatenate([sharp, marked]), spacing)
    candidates, share = _surface_candidates(mesh, spacing)
    points = _thinned(np.concatenate([fixed, candidates]), spacing)
    for _ in range(_LLOYD_ROUNDS):
        _, owner = cKDTree(points).query(candidates)
        weight = np.bincount(owner, share, minlength=len(points))
        centre = np.stack(
            [np.bincount(owner, share * candidates[:, i], minlength=len(points)) for i in range(3)],
            axis=1,
        )
        moves = weight > 0.0
        moves[: len(fixed)] = False
        points[moves] = centre[moves] / weight[moves, None]
    points[len(fixed) :] = closest_points(mesh, points[len(fixed) :]).position
    return points


def _volume_points(
    mesh: TriangleMesh,
    spacing: _Spacing,
    shell: Points,
    walls: Sequence[TriangleMesh],
    progress: Progress,
) -> Float[np.ndarray, "k 3"]:
    """Points inside a closed surface, at a distance from the points on it and on walls.

    Parameters
    ----------
    mesh : TriangleMesh                 closed, outward normals
    spacing : (n, 3) -> (n,) [m]        of `_make_spacing`
    shell : (n, 3) float [m]            the points on the surface and on walls
    walls : sequence of TriangleMesh
    progress : callable

    Returns
    -------
    (k, 3) float [m]                    a body-centred lattice where the spacing is constant,
                                        thinned points of finer lattices where it decreases
    """
    largest = float(spacing(mesh.vertices).max())
    cell = _CELL * largest
    corner = _lattice(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0), cell)
    levels = []
    while len(corner):
        levels += [corner, corner + 0.5 * cell]
        size = spacing(levels[-1])
        split = (size < largest) & (cell > _CHOICE * (size - _GROWTH * cell))
        cell *= 0.5
        corner = (corner[split][:, None] + cell * _EIGHTHS).reshape(-1, 3)
    points = np.concatenate(levels)
    distance, _ = cKDTree(shell).query(points)
    # The cheap test first: testing whether points are inside is costly.
    points = _thinned(points[distance > _OFF_SURFACE * spacing(points)], spacing)
    for wall in walls:
        points = _off(wall, points, spacing)
    within = []
    for k, chunk in enumerate(np.array_split(points, _CHUNKS)):
        progress("points inside the body", k / _CHUNKS)
        within.append(_well_inside(mesh, chunk, spacing))
    return np.concatenate(within)


def _well_inside(
    mesh: TriangleMesh, points: Float[np.ndarray, "k 3"], spacing: _Spacing
) -> Float[np.ndarray, "r 3"]:
    return _off(mesh, points[inside(mesh, points)], spacing) if len(points) else points


def _off(
    mesh: TriangleMesh, points: Float[np.ndarray, "k 3"], spacing: _Spacing
) -> Float[np.ndarray, "r 3"]:
    """Points at a distance from a surface."""
    gap = closest_points(mesh, points).distance
    return points[gap > _OFF_SURFACE * spacing(points)]


def _crease_candidates(mesh: TriangleMesh, spacing: _Spacing) -> Points:
    """Corners, where sharp edges end or turn, followed by points along the sharp edges."""
    normals = unit_normals(mesh)
    sides = _sides(mesh)
    edge = half_edges(mesh.triangles).ends[sides.cut]
    along = mesh.vertices[edge[:, 1]] - mesh.vertices[edge[:, 0]]
    along /= np.linalg.norm(along, axis=1)[:, None]
    degree = np.bincount(edge.ravel(), minlength=len(mesh.vertices))
    straight = np.zeros((len(mesh.vertices), 3))
    np.add.at(straight, edge[:, 0], along)
    np.add.at(straight, edge[:, 1], -along)
    sharp = np.linalg.norm(straight, axis=1) > 2.0 * np.sin(0.5 * CREASE_ANGLE)
    ends_or_turns = (degree > 0) & ((degree != 2) | sharp)
    corners = mesh.vertices[ends_or_turns | ((degree == 0) & _pointed(mesh, normals))]
    piece, points = mesh.vertices[edge], [corners]
    while len(piece):
        points.append(piece.reshape(-1, 3))
        middle = piece.mean(axis=1)
        long = np.linalg.norm(piece[:, 1] - piece[:, 0], axis=1) > _PIECE * spacing(middle)
        start, middle, end = piece[long, 0], middle[long], piece[long, 1]
        piece = np.concatenate(
            [np.stack(ends, axis=1) for ends in ((start, middle), (middle, end))]
        )
    return np.concatenate(points)


def _sides(mesh: TriangleMesh) -> Sides:
    """Edges of a mesh, with the sharp ones marked."""
    return split_sides(mesh, np.zeros(len(mesh.triangles), dtype=np.int64))


def _pointed(mesh: TriangleMesh, normals: Float[np.ndarray, "m 3"]) -> Bool[np.ndarray, " v"]:
    """Vertices like the apex of a cone: pointed, although none of their edges is sharp."""
    mean = np.zeros_like(mesh.vertices)
    np.add.at(mean, mesh.triangles, normals[:, None])
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    level = np.einsum("mva,ma->mv", mean[mesh.triangles], normals)
    pointed = np.zeros(len(mesh.vertices), dtype=bool)
    pointed[mesh.triangles[level < np.cos(CREASE_ANGLE)]] = True
    return pointed


def _surface_candidates(mesh: TriangleMesh, spacing: _Spacing) -> tuple[Points, PointScalars]:
    """Candidate points on a surface, and the fraction of a wanted point that each represents."""
    corner, small = mesh.vertices[mesh.triangles], []
    while len(corner):
        longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
        large = longest > spacing(corner.mean(axis=1))
        small.append(corner[~large])
        a, b, c = corner[large].transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))
        corner = np.concatenate([np.stack(part, axis=1) for part in quarters])
    corner = np.concatenate(small)
    side = corner[:, 1:] - corner[:, :1]
    share = 0.5 * np.linalg.norm(np.cross(side[:, 0], side[:, 1]), axis=1)
    share /= spacing(corner.mean(axis=1)) ** 2
    count = np.maximum(1, np.ceil(_CANDIDATES * share)).astype(np.int64)
    row = np.repeat(np.arange(len(share)), count)
    k = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    # Roberts' two-dimensional low-discrepancy sequence, with another start in each triangle.
    u = (0.5 + 0.7548776662466927 * k + 0.6180339887498949 * row) % 1.0
    v = (0.5 + 0.5698402909980532 * k + 0.4142135623730951 * row) % 1.0
    fold = u + v > 1.0
    u, v = np.where(fold, 1.0 - u, u), np.where(fold, 1.0 - v, v)
    points = corner[row, 0] + u[:, None] * side[row, 0] + v[:, None] * side[row, 1]
    return points, (share / count)[row]


def _lattice(low: np.ndarray, high: np.ndarray, cell: float) -> Points:
    """Corners of a cubic lattice that covers a box and is centred on it."""
    count = np.ceil((high - low) / cell).astype(int) + 1
    start = 0.5 * (low + high) - 0.5 * cell * count
    axes = [start[i] + cell * np.arange(count[i] + 1) for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _thinned(points: Points, spacing: _Spacing) -> Float[np.ndarray, "k 3"]:
    """Greedy thinning in the given order: drops points too close to one already kept."""
    if not len(points):
        return points
    tree = cKDTree(points)
    reach = _NEAREST * spacing(points)
    alive = np.ones(len(points), dtype=bool)
    chosen = []
    for i in range(len(points)):
        if alive[i]:
            chosen.append(i)
            alive[tree.query_ball_point(points[i], reach[i], return_sorted=False)] = False
    return points[chosen]
