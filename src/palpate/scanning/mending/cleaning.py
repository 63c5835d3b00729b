"""Removal of degenerate and duplicate triangles, and closing of cracks between triangles."""

from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    connected_components,
    half_edges,
    triangle_areas,
)
from palpate.scanning.mending.action import Action
from palpate.shapes import Triangles, Vertices

# Ratio of height to longest edge below which a triangle has no normal, as in `checked_mesh`.
_DEGENERATE_HEIGHT = 1e-6
# Rims closer than this form one seam, as a fraction of the diagonal (what printers and scanners
# resolve) and of the median edge (so that no triangle collapses).
_SEAM, _SEAM_EDGE = 1e-3, 0.2
_PASSES = 20
Faces = Int[np.ndarray, "_ 3"]


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
    _tell(actions, "degenerate triangle", flat, corner, "removed, their neighbours joined")
    return triangles[~flat]


def _without_copies(vertices: Vertices, triangles: Triangles, actions: list[Action]) -> Faces:
    """Keep one of all triangles with the same three vertices, whatever their orientation."""
    if len(triangles) == 0:
        return triangles
    _, first = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True)
    copy = np.ones(len(triangles), dtype=bool)
    copy[first] = False
    _tell(actions, "duplicate triangle", copy, vertices[triangles], "removed")
    return triangles[~copy]


def _tell(
    actions: list[Action],
    what: str,
    found: Bool[np.ndarray, " m"],
    corner: Float[np.ndarray, "m 3 3"],
    done: str,
) -> None:
    if found.any():
        place = corner[np.flatnonzero(found)[0]].mean(axis=0)
        actions.append(Action(what, int(found.sum()), place, done))


def _sewn(vertices: Vertices, triangles: Triangles, reach: float, actions: list[Action]) -> Faces:
    """Merge rim vertices that lie within `reach` of each other."""
    rim = rim_vertices(triangles)
    pairs = rim[cKDTree(vertices[rim]).query_pairs(reach, output_type="ndarray")]
    # The two ends of an edge are not to be merged.
    own = half_edges(triangles).ends
    is_edge = np.isin(pairs @ [len(vertices), 1], own @ [len(vertices), 1])
    is_edge |= np.isin(pairs[:, ::-1] @ [len(vertices), 1], own @ [len(vertices), 1])
    pairs = pairs[~is_edge]
    if len(pairs) == 0:
        return triangles
    _, group = connected_components(pairs, len(vertices))
    _, first = np.unique(group, return_index=True)
    joined = first[group][triangles]
    place = vertices[pairs[0, 0]]
    count = len(np.unique(pairs))
    actions.append(Action("unmerged vertex", count, place, "merged across their crack"))
    twice = (joined == np.roll(joined, -1, axis=1)).any(axis=1)
    return joined[~twice]


def _split_at_rims(
    vertices: Vertices, triangles: Triangles, reach: float, actions: list[Action]
) -> Faces:
    """Cut rim edges at vertices of other rims that lie on them (T-junctions)."""
    cut, place = 0, vertices[0]
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
            cut, place = cut + len(between), vertices[between[0]]
        triangles = np.concatenate([triangles[keep], np.array(fans, dtype=np.int64)])
    if cut:
        actions.append(Action("T-junction", cut, place, "edges cut where vertices lie on them"))
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
    found: dict[int, tuple[int, int, list[int]]] = {}
    for half in np.flatnonzero(halves.count[halves.edge] == 1):
        a, b = int(halves.tail[half]), int(halves.tail[halves.following[half]])
        along = vertices[b] - vertices[a]
        length = float(np.linalg.norm(along))
        near = rim[tree.query_ball_point(0.5 * (vertices[a] + vertices[b]), 0.5 * length)]
        near = near[~np.isin(near, triangles[half // 3])]
        t = (vertices[near] - vertices[a]) @ along / length**2
        gap = np.linalg.norm(vertices[a] + t[:, None] * along - vertices[near], axis=1)
        within = (gap <= reach) & (t > 0.0) & (t < 1.0)
        if within.any() and half // 3 not in found:
            between = near[within][np.argsort(t[within])].tolist()
            found[int(half // 3)] = (int(half // 3), int(half % 3), between)
    return list(found.values())
