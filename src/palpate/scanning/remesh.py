"""Even remeshing of a closed surface to a wanted number of vertices, finer near given points."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree

from palpate.errors import InputError, MeshError
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    triangle_areas,
    wall_thickness,
)
from palpate.scanning.mending.action import place_text
from palpate.scanning.mending.adapt import adapted
from palpate.scanning.mending.deviation import distances
from palpate.scanning.plane import Plane
from palpate.shapes import Points, Vertices

# Ratio of edge lengths at the given points and far away, and growth of edges per distance.
FINER = 1.0 / 3.0
_GROWTH = 0.25
# Ratio of triangles before and after the last pass: wanted sizes are sampled at their vertices.
_OVERSAMPLING = 4.0
_TRIES, _CLOSE = 6, 0.03
_OTHERWISE = (0.97, 1.03, 0.92)
_MIN_VERTICES, _MAX_VERTICES = 50, 50_000
# A wall thinner than this, in edges of its own triangles, cannot be distinguished from a sheet.
_THINNEST = 0.5


def remeshed(
    mesh: TriangleMesh,
    *,
    vertices: int,
    near: Points | None = None,
    creases: bool = True,
    support: Plane | None = None,
) -> TriangleMesh:
    """Remesh a surface evenly with about a given number of vertices, preserving creases.

    Parameters
    ----------
    mesh : TriangleMesh             closed, manifold, outward normals
    vertices : int                  wanted number, 50 to 50000; reached within some per cent
    near : (n, 3) float [m] or None points at which edges are to be a third as long as far away
    creases : bool                  keep edges where the surface turns by more than 40 degrees; on
                                    a scan these are noise
    support : Plane or None         plane whose boundary edges with the surface are kept; for
                                    `creases` False

    Returns
    -------
    TriangleMesh                    closed, manifold, outward, without self-intersection

    Raises
    ------
    InputError                      `vertices` out of range, or `near` far from the surface
    MeshError                       too few triangles to follow the surface; names the place

    Source
    ------
    Dapogny, Dobrzynski, Frey, Three-dimensional adaptive domain remeshing, implicit domain meshing
    and applications to free and moving boundary problems, J. Comput. Phys. 262 (2014): Mmg.
    """
    if not _MIN_VERTICES <= vertices <= _MAX_VERTICES:
        raise InputError(
            f"{vertices} vertices are asked for; must be {_MIN_VERTICES} to {_MAX_VERTICES}"
        )
    if near is not None:
        _check_near(near, mesh)
    # Edge of equilateral triangles, with two triangles per vertex.
    edge = np.sqrt(2.0 * float(triangle_areas(mesh).sum()) / (np.sqrt(3.0) * vertices))
    keep: dict[str, Any] = {"creases": creases, "support": support}
    base = _base(mesh, edge, near, keep)
    tries, scale = [], 1.0
    for _ in range(_TRIES):
        found = adapted(base, scale * _sizes(base.vertices, edge, near), surface=mesh, **keep)
        off = len(found.vertices) / vertices
        tries.append((abs(off - 1.0), found))
        if abs(off - 1.0) < _CLOSE:
            break
        scale *= np.sqrt(off)
    tries.sort(key=lambda one: one[0])
    try:
        return _accepted(tries[0][1])
    except MeshError as error:
        reason = error
    # A slightly finer or coarser mesh may not have the fold.
    for factor in _OTHERWISE:
        found = adapted(
            base, factor * scale * _sizes(base.vertices, edge, near), surface=mesh, **keep
        )
        with suppress(MeshError):
            return _accepted(found)
    raise reason


def _check_near(near: Points, mesh: TriangleMesh) -> None:
    gap = distances(near, mesh)
    far = gap > 0.25 * bounding_diagonal(mesh)
    if far.any():
        k = int(gap.argmax())
        raise InputError(
            f"{int(far.sum())} of {len(near)} points that the mesh is to be finer near are away"
            f" from it, the farthest {place_text(near[k])} by {1e3 * gap[k]:.4g} mm; check their"
            " unit and frame"
        )


def _base(
    mesh: TriangleMesh, edge: float, near: Points | None, keep: Mapping[str, Any]
) -> TriangleMesh:
    """The surface with triangles small enough to sample the wanted sizes."""
    smallest = edge * (1.0 if near is None else FINER)
    wanted = smallest / np.sqrt(_OVERSAMPLING)
    corner = mesh.vertices[mesh.triangles]
    longest = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).max(axis=1)
    if float(np.quantile(longest, 0.95)) <= 1.5 * wanted:
        return mesh
    # Varying sizes are sampled at vertices, so these must be dense enough first.
    fine = np.sqrt(_OVERSAMPLING)
    even = adapted(mesh, np.full(len(mesh.vertices), edge / fine), **keep)
    if near is None:
        return even
    return adapted(even, _sizes(even.vertices, edge, near) / fine, surface=mesh, **keep)


def _sizes(place: Vertices, edge: float, near: Points | None) -> Float[np.ndarray, " v"]:
    """Wanted edge length at points [m]."""
    if near is None:
        return np.full(len(place), edge)
    gap, _ = cKDTree(near).query(place)
    return np.minimum(edge, FINER * edge + _GROWTH * gap)


def _accepted(mesh: TriangleMesh) -> TriangleMesh:
    """The checked surface; raises if it is invalid or a wall is too thin for its triangles."""
    try:
        sound = checked_mesh(mesh)[0]
    except MeshError as error:
        raise MeshError(
            f"{len(mesh.vertices)} vertices are too few for this surface: remeshed, {error}; ask"
            " for more vertices"
        ) from error
    corner = sound.vertices[sound.triangles]
    edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean(axis=1)
    thickness = wall_thickness(sound)
    ratio = thickness / edge
    k = int(ratio.argmin())
    if ratio[k] < _THINNEST:
        more = len(sound.vertices) * (_THINNEST / ratio[k]) ** 2
        cure = f"ask for {1.2 * more:.2g} vertices" if more < _MAX_VERTICES else "thicken it"
        place = place_text(corner[k].mean(axis=0))
        raise MeshError(
            f"the body is {1e3 * thickness[k]:.2g} mm thin near {place}, where"
            f" the triangles' edges have {1e3 * edge[k]:.2g} mm: both sides would act as one;"
            f" {cure}, or use points finer there"
        )
    return sound
