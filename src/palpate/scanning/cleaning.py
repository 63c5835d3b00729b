"""Cleaning of a surface: degenerate and duplicate triangles, cracks, and its connected pieces.

Pieces are oriented, and those removed that are not of the object: dust, duplicate shells, inner
walls.
"""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    connected_components,
    enclosed_volume,
    half_edges,
    place_text,
    triangle_areas,
)
from palpate.optional_imports import late_import
from palpate.scanning.plane import Action
from palpate.scanning.remesh import distances
from palpate.shapes import Triangles, Vertices

# Ratio of height to longest edge below which a triangle has no normal, as in `checked_mesh`.
_DEGENERATE_HEIGHT = 1e-6
# Rims closer than this form one seam, as a fraction of the diagonal (what printers and scanners
# resolve) and of the median edge (so that no triangle collapses).
_SEAM, _SEAM_EDGE = 1e-3, 0.2
_PASSES = 20
Faces = Int[np.ndarray, "_ 3"]
# Smaller pieces are dust of a scan: fractions of the largest piece's size and of the total area.
_DUST_SIZE, _DUST_AREA = 0.1, 0.01
# Winding number above which a point is inside; it is 1 inside, 0 outside.
_INSIDE = 0.75
_PURPOSE = "mending a surface"


def cleaned(mesh: TriangleMesh) -> tuple[TriangleMesh, list[Action]]:
    """Remove degenerate and duplicate triangles, and close cracks.

    Parameters
    ----------
    mesh : TriangleMesh             welded

    Returns
    -------
    mesh : TriangleMesh             may be open, or more than one piece
    actions : list of Action        repairs made

    Raises
    ------
    MeshError                       nothing is left
    """
    actions: list[Action] = []
    reach = seam_width(mesh)
    vertices, triangles = mesh.vertices, mesh.triangles
    triangles = _without_flat(vertices, triangles, actions)
    triangles = _without_copies(vertices, triangles, actions)
    triangles = _sewn(vertices, triangles, reach, actions)
    triangles = _split_at_rims(vertices, triangles, reach, actions)
    triangles = _without_copies(vertices, triangles, [])
    if len(triangles) == 0:
        raise MeshError("no triangle of the surface has an area; write the mesh file again")
    return compacted(vertices, triangles), actions


def seam_width(mesh: TriangleMesh) -> float:
    """Distance below which two rims are taken as the two sides of one crack.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    float [m]
    """
    corner = mesh.vertices[mesh.triangles]
    edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2)
    return min(_SEAM * bounding_diagonal(mesh), _SEAM_EDGE * float(np.median(edge)))


def compacted(vertices: Vertices, triangles: Triangles) -> TriangleMesh:
    """Remove vertices that no triangle uses.

    Parameters
    ----------
    vertices : (v, 3) float [m]
    triangles : (m, 3) int          m > 0

    Returns
    -------
    TriangleMesh
    """
    used, compact = np.unique(triangles, return_inverse=True)
    return TriangleMesh(vertices=vertices[used], triangles=compact.reshape(-1, 3))


def rim_vertices(triangles: Triangles) -> Int[np.ndarray, " k"]:
    """Vertices on boundary edges, i.e. edges of only one triangle.

    Parameters
    ----------
    triangles : (m, 3) int

    Returns
    -------
    (k,) int                        ascending
    """
    halves = half_edges(triangles)
    return np.unique(halves.ends[halves.count == 1])


def _without_flat(vertices: Vertices, triangles: Triangles, actions: list[Action]) -> Faces:
    """Remove triangles of zero area; the cracks they leave are closed later."""
    if len(triangles) == 0:
        return triangles
    corner = vertices[triangles]
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
    areas = triangle_areas(TriangleMesh(vertices=vertices, triangles=triangles))
    flat = 2.0 * areas <= _DEGENERATE_HEIGHT * longest**2
    _record(actions, "degenerate triangle", flat, corner, "removed, their neighbours joined")
    return triangles[~flat]


def _without_copies(vertices: Vertices, triangles: Triangles, actions: list[Action]) -> Faces:
    """Keep one of all triangles with the same three vertices, whatever their orientation."""
    if len(triangles) == 0:
        return triangles
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    copy = np.ones(len(triangles), dtype=bool)
    copy[first] = False
    _record(actions, "duplicate triangle", copy, vertices[triangles], "removed")
    return triangles[~copy]


def _record(
    actions: list[Action],
    what: str,
    defective: Bool[np.ndarray, " m"],
    corner: Float[np.ndarray, "m 3 3"],
    done: str,
) -> None:
    if defective.any():
        position = corner[np.flatnonzero(defective)[0]].mean(axis=0)
        actions.append(Action(what, int(defective.sum()), position, done))


def _sewn(vertices: Vertices, triangles: Triangles, reach: float, actions: list[Action]) -> Faces:
    """Merge rim vertices that lie within `reach` of each other."""
    rim = rim_vertices(triangles)
    pairs = rim[cKDTree(vertices[rim]).query_pairs(reach, output_type="ndarray")]
    # The two ends of an edge are not to be merged.
    ends = half_edges(triangles).ends
    is_edge = np.isin(pairs @ [len(vertices), 1], ends @ [len(vertices), 1])
    is_edge |= np.isin(pairs[:, ::-1] @ [len(vertices), 1], ends @ [len(vertices), 1])
    pairs = pairs[~is_edge]
    if len(pairs) == 0:
        return triangles
    _, group = connected_components(pairs, len(vertices))
    _, first = np.unique(group, return_index=True)
    joined = first[group][triangles]
    position = vertices[pairs[0, 0]]
    count = len(np.unique(pairs))
    actions.append(Action("unmerged vertex", count, position, "merged across their crack"))
    twice = (joined == np.roll(joined, -1, axis=1)).any(axis=1)
    return joined[~twice]


def _split_at_rims(
    vertices: Vertices, triangles: Triangles, reach: float, actions: list[Action]
) -> Faces:
    """Cut rim edges at vertices of other rims that lie on them (T-junctions)."""
    cut, position = 0, vertices[0]
    for _ in range(_PASSES):
        splits = _splits(vertices, triangles, reach)
        if not splits:
            break
        keep = np.ones(len(triangles), dtype=bool)
        fans = []
        for triangle, corner, between in splits:
            a, b, c = np.roll(triangles[triangle], -corner)
            chain = [a, *between, b]
            fans += [(p, q, c) for p, q in pairwise(chain)]
            keep[triangle] = False
            cut, position = cut + len(between), vertices[between[0]]
        triangles = np.concatenate([triangles[keep], np.array(fans, dtype=np.int64)])
    if cut:
        actions.append(Action("T-junction", cut, position, "edges cut where vertices lie on them"))
    return triangles


def _splits(
    vertices: Vertices, triangles: Triangles, reach: float
) -> list[tuple[int, int, list[int]]]:
    """Triangles with a rim edge that passes rim vertices: index, corner, and those vertices."""
    halves = half_edges(triangles)
    rim = np.unique(halves.ends[halves.count == 1])
    if len(rim) == 0:
        return []
    tree = cKDTree(vertices[rim])
    splits: dict[int, tuple[int, int, list[int]]] = {}
    for half in np.flatnonzero(halves.count[halves.edge] == 1):
        a, b = int(halves.tail[half]), int(halves.tail[halves.following[half]])
        along = vertices[b] - vertices[a]
        length = float(np.linalg.norm(along))
        near = rim[tree.query_ball_point(0.5 * (vertices[a] + vertices[b]), 0.5 * length)]
        near = near[~np.isin(near, triangles[half // 3])]
        t = (vertices[near] - vertices[a]) @ along / length**2
        gap = np.linalg.norm(vertices[a] + t[:, None] * along - vertices[near], axis=1)
        within = (gap <= reach) & (t > 0.0) & (t < 1.0)
        if within.any() and half // 3 not in splits:
            between = near[within][np.argsort(t[within])].tolist()
            splits[int(half // 3)] = (int(half // 3), int(half % 3), between)
    return list(splits.values())


def pieces(triangles: Triangles) -> Int[np.ndarray, " m"]:
    """Label the connected pieces of a surface; pieces share no vertex.

    Parameters
    ----------
    triangles : (m, 3) int

    Returns
    -------
    (m,) int                        number of each triangle's piece, from 0
    """
    links = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    _, group = connected_components(links, int(triangles.max()) + 1)
    _, label = np.unique(group[triangles[:, 0]], return_inverse=True)
    return label.astype(np.int64)


def oriented(mesh: TriangleMesh) -> tuple[TriangleMesh, Bool[np.ndarray, " m"]]:
    """Orient the triangles consistently, with every patch facing outward.

    Parameters
    ----------
    mesh : TriangleMesh             patches are separated by edges of more than two triangles

    Returns
    -------
    mesh : TriangleMesh
    turned : (m,) bool              triangles whose orientation was reversed

    Raises
    ------
    MeshError                       the surface is one-sided
    """
    triangles, patch = _consistent(mesh)
    for label in range(int(patch.max()) + 1):
        mine = patch == label
        part = compacted(mesh.vertices, triangles[mine])
        if enclosed_volume(part) < 0.0:
            triangles[mine] = triangles[mine][:, ::-1]
    turned = _is_reversed(mesh.triangles, triangles)
    return TriangleMesh(vertices=mesh.vertices, triangles=triangles), turned


def _consistent(mesh: TriangleMesh) -> tuple[Triangles, Int[np.ndarray, " m"]]:
    """Triangles oriented consistently across edges of two, and the patch number of each."""
    igl = late_import("igl", extra="surface", purpose=_PURPOSE)
    oriented, patch = igl.bfs_orient(mesh.triangles)
    # libigl's 64-bit integer type is not NumPy's int64.
    triangles = oriented.astype(np.int64)
    halves = half_edges(triangles)
    a, b = halves.pairs().T
    clash = np.flatnonzero(halves.tail[a] == halves.tail[b])
    if len(clash):
        where = place_text(mesh.vertices[halves.tail[a[clash[0]]]])
        raise MeshError(
            f"the surface is one-sided, like a Moebius strip: inside and outside meet near {where};"
            " cut it there and make it the skin of a solid in a mesh program"
        )
    return triangles, patch.ravel().astype(np.int64)


def _is_reversed(before: Triangles, after: Triangles) -> Bool[np.ndarray, " m"]:
    """True where the same three vertices are in reverse cyclic order."""
    first = (before[:, :1] == after).argmax(axis=1)
    following = after[np.arange(len(after)), (first + 1) % 3]
    return following != before[:, 1]


def without_dust(mesh: TriangleMesh) -> tuple[TriangleMesh, list[Action]]:
    """Remove pieces too small to be an object, and duplicate shells.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    mesh : TriangleMesh
    actions : list of Action
    """
    label = pieces(mesh.triangles)
    if label.max() == 0:
        return mesh, []
    parts = [compacted(mesh.vertices, mesh.triangles[label == k]) for k in range(label.max() + 1)]
    area = np.array([float(triangle_areas(part).sum()) for part in parts])
    size = np.array([bounding_diagonal(part) for part in parts])
    dust = (size < _DUST_SIZE * size.max()) & (area < _DUST_AREA * area.sum())
    actions = []
    if dust.any():
        position = parts[int(np.flatnonzero(dust)[0])].vertices.mean(axis=0)
        actions.append(Action("stray piece", int(dust.sum()), position, "removed"))
    remaining = [int(k) for k in np.argsort(-area) if not dust[k]]
    reach, copies = seam_width(mesh), []
    for k in list(remaining[1:]):
        others = [j for j in remaining if j != k]
        if any(distances(parts[k].vertices, parts[j]).max() <= reach for j in others):
            remaining.remove(k)
            copies.append(k)
    if copies:
        position = parts[copies[0]].vertices.mean(axis=0)
        actions.append(Action("duplicate shell", len(copies), position, "removed"))
    return compacted(mesh.vertices, mesh.triangles[np.isin(label, remaining)]), actions


def without_walls(mesh: TriangleMesh) -> tuple[TriangleMesh, list[Action]]:
    """Remove sheets attached at edges of more than two triangles: inner walls and outer fins.

    Parameters
    ----------
    mesh : TriangleMesh

    Returns
    -------
    mesh : TriangleMesh
    actions : list of Action

    Raises
    ------
    MeshError                       the surface is one-sided
    InputError                      a package of the extra `surface` is not installed
    """
    halves = half_edges(mesh.triangles)
    if halves.count.max() <= 2:
        return mesh, []
    igl = late_import("igl", extra="surface", purpose=_PURPOSE)
    facing, _ = oriented(mesh)
    _, patch = _consistent(mesh)
    edge = halves.edge.reshape(-1, 3)
    drop = np.zeros(len(patch), dtype=bool)
    fins = walls = 0
    for label in range(int(patch.max()) + 1):
        mine = patch == label
        count = halves.count[edge[mine]]
        if (count <= 2).all():
            continue
        if count.min() == 1:
            fins, drop = fins + 1, drop | mine
            continue
        centre = mesh.vertices[mesh.triangles[mine]].mean(axis=1)
        others = np.ascontiguousarray(facing.triangles[~mine & ~drop])
        inside = igl.fast_winding_number(facing.vertices, others, centre)
        if (inside > _INSIDE).mean() > 0.5:
            walls, drop = walls + 1, drop | mine
    if not drop.any():
        return mesh, []
    position = mesh.vertices[mesh.triangles[np.flatnonzero(drop)[0]]].mean(axis=0)
    names = {"dangling sheet": fins, "inner wall": walls}
    actions = [Action(name, count, position, "removed") for name, count in names.items() if count]
    return compacted(mesh.vertices, mesh.triangles[~drop]), actions
