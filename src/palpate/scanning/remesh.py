"""New triangles for a surface, by Mmg, and the distance between two surfaces.

A closed surface is remeshed to a wanted number of vertices, finer near given points, or to given
edge lengths.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from palpate.errors import InputError, MeshError
from palpate.foreign import remeshed_by_mmg, result_in_child
from palpate.geometry import (
    CREASE_ANGLE,
    TriangleMesh,
    area_vectors,
    bounding_diagonal,
    checked_mesh,
    enclosed_volume,
    half_edges,
    place_text,
    random_points,
    triangle_areas,
    wall_thickness,
)
from palpate.optional_imports import late_import
from palpate.scanning.plane import Plane
from palpate.shapes import Points, PointScalars, Triangles, TriangleScalars, Vertices

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
# Largest ratio of neighbouring edges, Mmg's default.
_GRADATION = 1.3
# Distance from a plane below which a vertex lies in it, as a fraction of the diagonal.
_IN_PLANE = 1e-6
# Smallest angle allowed when vertices are projected onto the surface; rounds until none is smaller.
_FLAT, _ROUNDS = np.radians(12.0), 12
_SAMPLES = 20_000
_SEED = 1


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
        adapted_mesh = adapted(
            base, scale * _sizes(base.vertices, edge, near), surface=mesh, **keep
        )
        off = len(adapted_mesh.vertices) / vertices
        tries.append((abs(off - 1.0), adapted_mesh))
        if abs(off - 1.0) < _CLOSE:
            break
        scale *= np.sqrt(off)
    tries.sort(key=lambda attempt: attempt[0])
    try:
        return _accepted(tries[0][1])
    except MeshError as error:
        reason = error
    # A slightly finer or coarser mesh may not have the fold.
    for factor in _OTHERWISE:
        adapted_mesh = adapted(
            base, factor * scale * _sizes(base.vertices, edge, near), surface=mesh, **keep
        )
        with suppress(MeshError):
            return _accepted(adapted_mesh)
    raise reason


def _check_near(near: Points, mesh: TriangleMesh) -> None:
    gap = distances(near, mesh)
    far = gap > 0.25 * bounding_diagonal(mesh)
    if far.any():
        k = int(gap.argmax())
        raise InputError(
            f"{int(far.sum())} of {len(near)} points that the mesh is to be finer near (--near) are"
            f" away from it, the farthest {place_text(near[k])} by {1e3 * gap[k]:.4g} mm; check"
            " their unit and frame"
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


def _sizes(points: Vertices, edge: float, near: Points | None) -> Float[np.ndarray, " v"]:
    """Wanted edge length at points [m]."""
    if near is None:
        return np.full(len(points), edge)
    gap, _ = cKDTree(near).query(points)
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
        where = place_text(corner[k].mean(axis=0))
        raise MeshError(
            f"the body is {1e3 * thickness[k]:.2g} mm thin near {where}, where"
            f" the triangles' edges have {1e3 * edge[k]:.2g} mm: both sides would act as one;"
            f" {cure}, or use points finer there"
        )
    return sound


def adapted(
    mesh: TriangleMesh,
    size: Float[np.ndarray, " v"],
    *,
    surface: TriangleMesh | None = None,
    creases: bool = True,
    support: Plane | None = None,
) -> TriangleMesh:
    """Remesh a surface to given edge lengths, with vertices projected back onto it.

    Parameters
    ----------
    mesh : TriangleMesh             closed, manifold
    size : (v,) float [m]           wanted edge length at each vertex
    surface : TriangleMesh or None  surface to project the vertices onto; None: `mesh`
    creases : bool                  keep edges where triangles turn by more than 40 degrees
    support : Plane or None         plane whose boundary edges with the surface are kept; for
                                    `creases` False

    Returns
    -------
    TriangleMesh

    Raises
    ------
    MeshError                       Mmg fails
    InputError                      a package of the extra `surface` is not installed

    Source
    ------
    Dapogny, Dobrzynski, Frey, Three-dimensional adaptive domain remeshing, implicit domain meshing
    and applications to free and moving boundary problems, J. Comput. Phys. 262 (2014): Mmg.
    """
    rim = None if support is None else _rim(mesh, support)
    options = {"ar": float(np.degrees(CREASE_ANGLE))} if creases else {"angle": 0}
    # A large Hausdorff distance, so that curvature does not refine below the given sizes.
    options |= {"hgrad": _GRADATION, "hausd": float(size.max())}
    try:
        vertices, triangles = result_in_child(
            remeshed_by_mmg, mesh.vertices, mesh.triangles, size, rim, options
        )
    except RuntimeError as error:
        raise MeshError(
            f"the surface of {len(mesh.vertices)} vertices cannot be remeshed ({error}); smooth it"
            " in a mesh program first"
        ) from error
    # Mmg's own smooth surface deviates by up to an edge where sizes change quickly.
    return _projected(TriangleMesh(vertices=vertices, triangles=triangles), surface or mesh)


def _rim(mesh: TriangleMesh, support: Plane) -> Int[np.ndarray, "k 2"]:
    """Edges between a triangle in a plane and one outside it."""
    flat = abs(support.heights(mesh.vertices)) < _IN_PLANE * bounding_diagonal(mesh)
    return half_edges(mesh.triangles).rim(flat[mesh.triangles].all(axis=1))


def _projected(free: TriangleMesh, surface: TriangleMesh) -> TriangleMesh:
    """Project vertices onto a surface, except where that would flatten or invert triangles."""
    _, position = _nearest(free.vertices, surface)
    before = _smallest_angles(free.vertices, free.triangles)
    normal = area_vectors(free)
    for _ in range(_ROUNDS):
        moved = TriangleMesh(vertices=position, triangles=free.triangles)
        flat = _smallest_angles(position, free.triangles) < np.minimum(_FLAT, 0.5 * before)
        flat |= np.einsum("ea,ea->e", area_vectors(moved), normal) <= 0.0
        if not flat.any():
            break
        back = np.unique(free.triangles[flat])
        position[back] = free.vertices[back]
    return TriangleMesh(vertices=position, triangles=free.triangles)


def _smallest_angles(vertices: Vertices, triangles: Triangles) -> TriangleScalars:
    """Smallest angle of each triangle [rad]."""
    corner = vertices[triangles]
    edge = np.roll(corner, -1, axis=1) - corner
    unit = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    cosine = -np.einsum("eka,eka->ek", unit, np.roll(unit, 1, axis=1))
    return np.arccos(np.clip(cosine, -1.0, 1.0)).min(axis=1)


@dataclass(frozen=True, slots=True)
class Deviation:
    """Distance between two surfaces, sampled on both, and difference of their volumes.

    Attributes
    ----------
    median, percentile_95, largest : float [m]
    volume : float [-]              relative: 0.01 if the second surface's volume is 1 % larger
    """

    median: float
    percentile_95: float
    largest: float
    volume: float


def distances(points: Points, mesh: TriangleMesh) -> PointScalars:
    """Distance of points from a surface.

    Parameters
    ----------
    points : (n, 3) float [m]
    mesh : TriangleMesh

    Returns
    -------
    (n,) float [m]

    Raises
    ------
    InputError                      a package of the extra `surface` is not installed
    """
    return _nearest(points, mesh)[0]


def _nearest(points: Points, mesh: TriangleMesh) -> tuple[PointScalars, Points]:
    """Distance of points from a surface, and the closest points on it.

    Parameters
    ----------
    points : (n, 3) float [m]
    mesh : TriangleMesh

    Returns
    -------
    (n,) float [m], (n, 3) float [m]    distances, closest points

    Raises
    ------
    InputError                          a package of the extra `surface` is not installed
    """
    igl = late_import("igl", extra="surface", purpose="comparing surfaces")
    square, _, closest = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), mesh.vertices, mesh.triangles
    )
    gap = np.sqrt(np.maximum(np.asarray(square).ravel(), 0.0))
    return gap, np.array(closest).reshape(-1, 3)


def deviation(true: TriangleMesh, other: TriangleMesh) -> Deviation:
    """Two-sided distance between two closed surfaces.

    Parameters
    ----------
    true, other : TriangleMesh      closed, outward normals

    Returns
    -------
    Deviation

    Raises
    ------
    InputError                      a package of the extra `surface` is not installed
    """
    # The same at every call.
    rng = np.random.default_rng(_SEED)
    gap = np.concatenate(
        [
            distances(random_points(other, _SAMPLES, rng), true),
            distances(other.vertices, true),
            distances(random_points(true, _SAMPLES, rng), other),
        ]
    )
    return Deviation(
        median=float(np.median(gap)),
        percentile_95=float(np.quantile(gap, 0.95)),
        largest=float(gap.max()),
        volume=enclosed_volume(other) / enclosed_volume(true) - 1.0,
    )
