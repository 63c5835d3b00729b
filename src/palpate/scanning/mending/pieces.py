"""Connected pieces of a surface: their orientation, and removal of those not of the object."""

import numpy as np
from jaxtyping import Bool, Int

from palpate.errors import MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    connected_components,
    enclosed_volume,
    half_edges,
    triangle_areas,
)
from palpate.optional_imports import late_import
from palpate.scanning.mending.action import Action, place_text
from palpate.scanning.mending.cleaning import compacted, seam_width
from palpate.scanning.mending.deviation import distances
from palpate.shapes import Triangles

# Smaller pieces are dust of a scan: fractions of the largest piece's size and of the total area.
_DUST_SIZE, _DUST_AREA = 0.1, 0.01
# Winding number above which a point is inside; it is 1 inside, 0 outside.
_INSIDE = 0.75
_PURPOSE = "mending a surface"


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
    found, patch = igl.bfs_orient(mesh.triangles)
    # libigl's 64-bit integer type is not NumPy's int64.
    triangles = found.astype(np.int64)
    halves = half_edges(triangles)
    a, b = halves.pairs().T
    clash = np.flatnonzero(halves.tail[a] == halves.tail[b])
    if len(clash):
        place = place_text(mesh.vertices[halves.tail[a[clash[0]]]])
        raise MeshError(
            f"the surface is one-sided, like a Moebius strip: inside and outside meet near {place};"
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
        place = parts[int(np.flatnonzero(dust)[0])].vertices.mean(axis=0)
        actions.append(Action("stray piece", int(dust.sum()), place, "removed"))
    kept = [int(k) for k in np.argsort(-area) if not dust[k]]
    reach, copies = seam_width(mesh), []
    for k in list(kept[1:]):
        others = [j for j in kept if j != k]
        if any(distances(parts[k].vertices, parts[j]).max() <= reach for j in others):
            kept.remove(k)
            copies.append(k)
    if copies:
        place = parts[copies[0]].vertices.mean(axis=0)
        actions.append(Action("duplicate shell", len(copies), place, "removed"))
    return compacted(mesh.vertices, mesh.triangles[np.isin(label, kept)]), actions


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
    place = mesh.vertices[mesh.triangles[np.flatnonzero(drop)[0]]].mean(axis=0)
    names = {"dangling sheet": fins, "inner wall": walls}
    actions = [Action(name, count, place, "removed") for name, count in names.items() if count]
    return compacted(mesh.vertices, mesh.triangles[~drop]), actions
