"""Checks that a surface is the closed boundary of one solid; the quality of its triangles, and the
thickness of its walls.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.errors import MeshError
from palpate.geometry.triangle_mesh import (
    HalfEdges,
    TriangleMesh,
    bounding_diagonal,
    connected_components,
    enclosed_volume,
    half_edges,
    place_text,
    triangle_areas,
    unit_normals,
)
from palpate.shapes import PointScalars

# Height over longest edge below which a triangle has no usable normal in double precision.
_DEGENERATE_HEIGHT = 1e-6
_NEEDLE_ANGLE = np.radians(5.0)
_SHOWN = 5
# Cosine from which two normals count as opposite; cosine of the normals at an edge of 70 degrees.
_FACING, _KNIFE = 0.7, -0.34
_WALL_NEIGHBOURS = 40
_PAIRS_PER_BLOCK = 200_000
# Relative to the bounding diagonal: far above rounding (1e-16), far below any real element.
_INTERSECTION_TOLERANCE = 1e-10


@dataclass(frozen=True, slots=True)
class MeshQuality:
    """Size of a surface and quality of its triangles.

    Parameters
    ----------
    vertices, triangles : int
    area : float [m^2]
    volume : float [m^3]
    size : (float, float, float) [m]                edges of the bounding box
    edge_shortest, edge_mean, edge_longest : float [m]
    worst_aspect : float [-]        longest edge over smallest height; 1.15 for equal sides
    smallest_angle : float [rad]
    """

    vertices: int
    triangles: int
    area: float
    volume: float
    size: tuple[float, float, float]
    edge_shortest: float
    edge_mean: float
    edge_longest: float
    worst_aspect: float
    smallest_angle: float


def mesh_quality(mesh: TriangleMesh) -> MeshQuality:
    """Size, edge lengths and shape of the triangles of a surface.

    Parameters
    ----------
    mesh : TriangleMesh             without degenerate triangles

    Returns
    -------
    MeshQuality
    """
    corner = mesh.vertices[mesh.triangles]
    edge = np.roll(corner, -1, axis=1) - corner
    length = np.linalg.norm(edge, axis=2)
    areas = triangle_areas(mesh)
    unit = edge / length[:, :, None]
    cosine = -np.einsum("eka,eka->ek", unit, np.roll(unit, 1, axis=1))
    size = np.ptp(corner.reshape(-1, 3), axis=0)
    return MeshQuality(
        vertices=len(mesh.vertices),
        triangles=len(mesh.triangles),
        area=float(areas.sum()),
        volume=enclosed_volume(mesh),
        size=(float(size[0]), float(size[1]), float(size[2])),
        edge_shortest=float(length.min()),
        edge_mean=float(length.mean()),
        edge_longest=float(length.max()),
        worst_aspect=float((length.max(axis=1) ** 2 / (2.0 * areas)).max()),
        smallest_angle=float(np.arccos(np.clip(cosine, -1.0, 1.0)).min()),
    )


def checked_mesh(mesh: TriangleMesh) -> tuple[TriangleMesh, tuple[str, ...]]:
    """Check that a surface bounds one solid, and correct its orientation where it is wrong.

    Parameters
    ----------
    mesh : TriangleMesh             welded

    Returns
    -------
    mesh : TriangleMesh             closed, manifold, outward
    notes : tuple of str            corrections, and warnings about poor triangles, in sentences

    Raises
    ------
    MeshError                       unused vertices, degenerate or double triangles, open edges,
                                    edges or vertices where more than one sheet meets, several
                                    components, one-sided, self-intersecting
    """
    _check_vertices_used(mesh)
    _check_degenerate(mesh)
    _check_duplicates(mesh)
    halves = half_edges(mesh.triangles)
    _check_edges(mesh, halves)
    _check_vertex_fans(mesh, halves)
    _check_one_component(mesh, halves)
    mesh, notes = _outward(mesh, halves)
    _check_self_intersection(mesh)
    angle = mesh_quality(mesh).smallest_angle
    if angle < _NEEDLE_ANGLE:
        note = (
            f"The sharpest triangle of the mesh has an angle of {np.degrees(angle):.1f} degrees;"
            " such needles cost accuracy: remesh the surface with even triangles if you can."
        )
        notes = (*notes, note)
    return mesh, notes


def _first(indices: np.ndarray) -> str:
    """The first few indices, for a message."""
    shown = np.asarray(indices)[:_SHOWN].tolist()
    return f"{shown}" if len(indices) <= _SHOWN else f"{str(shown)[:-1]}, ...]"


def _check_vertices_used(mesh: TriangleMesh) -> None:
    unused = np.setdiff1d(np.arange(len(mesh.vertices)), mesh.triangles)
    if len(unused):
        raise MeshError(
            f"{len(unused)} vertices belong to no triangle, the first: {_first(unused)};"
            " remove them (reading the mesh from a file does so)"
        )


def _check_degenerate(mesh: TriangleMesh) -> None:
    corner = mesh.vertices[mesh.triangles]
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
    flat = np.flatnonzero(2.0 * triangle_areas(mesh) <= _DEGENERATE_HEIGHT * longest**2)
    if len(flat):
        where = corner[flat[0]].mean(axis=0)
        raise MeshError(
            f"{len(flat)} triangles are degenerate (no area), the first: {_first(flat)} near"
            f" {place_text(where)}; remove them in a mesh program (merge close vertices, then"
            " remesh)"
        )


def _check_duplicates(mesh: TriangleMesh) -> None:
    _, where, count = np.unique(
        np.sort(mesh.triangles, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    double = np.flatnonzero(count[where.ravel()] > 1)
    if len(double):
        raise MeshError(
            f"{len(double)} triangles share all three vertices with another, the first:"
            f" {_first(double)}; delete duplicate faces in a mesh program"
        )


def _check_edges(mesh: TriangleMesh, halves: HalfEdges) -> None:
    """Refuse an edge of one triangle (open) or of more than two."""
    crowded = np.flatnonzero(halves.count > 2)
    if len(crowded):
        a, b = halves.ends[crowded[0]]
        raise MeshError(
            f"{len(crowded)} edges belong to more than two triangles, the first between vertices"
            f" {a} and {b} near {place_text(mesh.vertices[a])}; the surface must be a single skin:"
            " delete inner walls and make the parts one solid (boolean union)"
        )
    lonely = np.flatnonzero(halves.count == 1)
    if len(lonely):
        a, b = halves.ends[lonely[0]]
        raise MeshError(
            f"the surface is open: {len(lonely)} edges belong to one triangle only, the first"
            f" between vertices {a} and {b} near {place_text(mesh.vertices[a])};"
            " close the holes in a mesh program (fill holes), the support's side included"
        )


def _check_vertex_fans(mesh: TriangleMesh, halves: HalfEdges) -> None:
    """Refuse a vertex at which two sheets of triangles touch."""
    opposite, following = halves.opposite(), halves.following
    along = halves.tail == halves.tail[opposite]
    # A corner has the number of the half-edge leaving it; an edge joins the corners at its ends.
    start = np.where(along, opposite, following[opposite])
    end = np.where(along, following[opposite], opposite)
    leaving = np.arange(len(opposite))
    links = np.stack([np.concatenate([leaving, following]), np.concatenate([start, end])], axis=1)
    count, component = connected_components(links, len(opposite))
    if count == len(mesh.vertices):
        return
    fans = np.unique(np.stack([halves.tail, component], axis=1), axis=0)[:, 0]
    pinched = np.flatnonzero(np.bincount(fans) > 1)
    raise MeshError(
        f"at {len(pinched)} vertices separate parts of the surface touch in a point, the first:"
        f" {_first(pinched)} near {place_text(mesh.vertices[pinched[0]])};"
        f" pull the parts apart or join them over a whole edge"
    )


def _check_one_component(mesh: TriangleMesh, halves: HalfEdges) -> None:
    count, component = connected_components(halves.pairs() // 3, len(mesh.triangles))
    if count > 1:
        sizes = np.bincount(component)
        firsts = np.unique(component, return_index=True)[1]
        raise MeshError(
            f"the surface has {count} separate components of {_first(np.sort(sizes)[::-1])}"
            f" triangles, their first triangles: {_first(firsts)}; keep one object: delete stray"
            " pieces and inner shells, or unite touching parts (boolean union)"
        )


def _outward(mesh: TriangleMesh, halves: HalfEdges) -> tuple[TriangleMesh, tuple[str, ...]]:
    """The surface with all triangles counter-clockwise from outside, and a note of any change."""
    turned = _turned(mesh, halves)
    triangles = np.where(turned[:, None], mesh.triangles[:, ::-1], mesh.triangles)
    mended = TriangleMesh(vertices=mesh.vertices, triangles=triangles)
    if enclosed_volume(mended) < 0.0:
        turned = ~turned
        mended = TriangleMesh(vertices=mesh.vertices, triangles=triangles[:, ::-1])
    if not turned.any():
        return mesh, ()
    if turned.all():
        note = "All triangles of the mesh faced inward; they were turned outward."
    else:
        note = (
            f"{int(turned.sum())} of {len(turned)} triangles of the mesh faced inward, the first:"
            f" {_first(np.flatnonzero(turned))}; they were turned outward."
        )
    return mended, (note,)


def _turned(mesh: TriangleMesh, halves: HalfEdges) -> Bool[np.ndarray, " m"]:
    """Which triangles must turn so that all agree with the first.

    Two copies of every triangle, as given and turned, are linked where they agree; the copies in
    the connected component of the first triangle as given form the consistent surface.
    """
    m = len(mesh.triangles)
    a, b = halves.pairs().T
    clash = halves.tail[a] == halves.tail[b]
    a, b = a // 3, b // 3
    links = np.concatenate(
        [np.stack([a, b + m * clash], axis=1), np.stack([a + m, b + m * ~clash], axis=1)]
    )
    _, component = connected_components(links, 2 * m)
    if component[0] == component[m]:
        raise MeshError(
            "the surface is one-sided (like a Moebius strip): no choice of outward normals is"
            " consistent; make it the boundary of a solid in a mesh program"
        )
    return component[:m] != component[0]


def _check_self_intersection(mesh: TriangleMesh) -> None:
    pairs = intersecting_pairs(mesh)
    if len(pairs):
        where = mesh.vertices[mesh.triangles[pairs[0, 0]]].mean(axis=0)
        raise MeshError(
            f"the surface intersects itself: {len(pairs)} pairs of triangles, the first:"
            f" {_first(pairs)} near {place_text(where)};"
            " mend it in a mesh program (boolean union with itself, or remesh)"
        )


def wall_thickness(mesh: TriangleMesh) -> PointScalars:
    """Distance of each triangle's centroid to the nearest opposite one behind it.

    Parameters
    ----------
    mesh : TriangleMesh             closed, outward, m triangles

    Returns
    -------
    (m,) float [m]                  infinite where none of the 40 nearest triangles is opposite, so
                                    that walls are found up to about two edge lengths thick, and
                                    close to a knife edge, where both faces meet

    Raises
    ------
    MeshError                       a triangle of zero area
    """
    centre, normal = mesh.vertices[mesh.triangles].mean(axis=1), unit_normals(mesh)
    gap, other = cKDTree(centre).query(centre, k=min(_WALL_NEIGHBOURS, len(centre)))
    away = centre[other] - centre[:, None]
    behind = np.einsum("kja,ka->kj", away, normal) < -_FACING * gap
    opposite = np.einsum("kja,ka->kj", normal[other], normal) < -_FACING
    thickness = np.where(behind & opposite, gap, np.inf).min(axis=1)
    # The two faces of a knife edge meet there: this is not a thin wall.
    halves = half_edges(mesh.triangles)
    a, b = halves.pairs().T
    knife = np.einsum("ka,ka->k", normal[a // 3], normal[b // 3]) < _KNIFE
    if knife.any():
        middle = mesh.vertices[halves.ends[halves.edge[a[knife]]]].mean(axis=1)
        length = np.linalg.norm(np.diff(mesh.vertices[halves.ends], axis=1)[:, 0], axis=1)
        close, _ = cKDTree(middle).query(centre)
        thickness[close < 3.0 * float(np.median(length))] = np.inf
    return thickness


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
    tolerance = _INTERSECTION_TOLERANCE * bounding_diagonal(mesh)
    pairs = _box_pairs(corner, tolerance)
    crossing = [
        block[~_separated(mesh, corner, block, tolerance)]
        for block in np.split(pairs, np.arange(_PAIRS_PER_BLOCK, len(pairs), _PAIRS_PER_BLOCK))
    ]
    return np.concatenate(crossing)


def _box_pairs(corner: Float[np.ndarray, "m 3 3"], tolerance: float) -> Int[np.ndarray, "p 2"]:
    """Pairs of triangles whose boxes overlap, by a sweep along the longest axis."""
    low, high = corner.min(axis=1) - tolerance, corner.max(axis=1) + tolerance
    axis = int(np.ptp(corner.reshape(-1, 3), axis=0).argmax())
    order = np.argsort(low[:, axis], kind="stable")
    low, high = low[order], high[order]
    end = np.searchsorted(low[:, axis], high[:, axis], side="right")
    count = end - np.arange(len(order)) - 1
    pairs = [np.zeros((0, 2), dtype=np.int64)]
    begin = 0
    while begin < len(order):
        total = np.cumsum(count[begin:])
        size = max(1, int(np.searchsorted(total, 10 * _PAIRS_PER_BLOCK)))
        rows = np.arange(begin, min(begin + size, len(order)))
        first = np.repeat(rows, count[rows])
        start = np.cumsum(count[rows]) - count[rows]
        second = first + 1 + np.arange(len(first)) - np.repeat(start, count[rows])
        keep = ((low[second] <= high[first]) & (low[first] <= high[second])).all(axis=1)
        pairs.append(order[np.stack([first[keep], second[keep]], axis=1)])
        begin += size
    return np.sort(np.concatenate(pairs), axis=1)


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
        apart = _overlap(a, b, np.cross(normal_a[left], along_a)) <= allowed
        apart |= _overlap(a, b, np.cross(normal_b[left], along_b[:, i])) <= allowed
        for j in range(3):
            across = _overlap(a, b, np.cross(along_a, along_b[:, j])) <= allowed
            apart |= ~flat[left] & across
        separated[left] = apart
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
