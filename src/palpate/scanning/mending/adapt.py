"""Remeshing of a surface to wanted edge lengths, by Mmg."""

import numpy as np
from jaxtyping import Float, Int

from palpate.errors import MeshError
from palpate.geometry import CREASE_ANGLE, TriangleMesh, area_vectors, bounding_diagonal, half_edges
from palpate.optional_imports import late_import
from palpate.scanning.mending.deviation import nearest
from palpate.scanning.plane import Plane
from palpate.shapes import Triangles, TriangleScalars, Vertices

# Largest ratio of neighbouring edges, Mmg's default.
_GRADATION = 1.3
# Distance from a plane below which a vertex lies in it, as a fraction of the diagonal.
_IN_PLANE = 1e-6
# Smallest angle allowed when vertices are projected onto the surface; rounds until none is smaller.
_FLAT, _ROUNDS = np.radians(12.0), 12


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
    mmg = late_import("mmgpy", extra="surface", purpose="remeshing a surface")
    body = mmg.MmgMeshS(mesh.vertices.copy(), mesh.triangles.astype(np.int32))
    body["metric"] = np.ascontiguousarray(size[:, None])
    ridges = {"ar": float(np.degrees(CREASE_ANGLE))} if creases else {"angle": 0}
    if support is not None:
        rim = _rim(mesh, support)
        body.set_mesh_size(
            vertices=len(mesh.vertices), triangles=len(mesh.triangles), edges=len(rim)
        )
        body.set_vertices(mesh.vertices.copy())
        body.set_triangles(mesh.triangles.astype(np.int32))
        body.set_edges(rim.astype(np.int32))
        body.set_ridge_edges(np.arange(len(rim), dtype=np.int32))
    # A large Hausdorff distance, so that curvature does not refine below the given sizes.
    try:
        body.remesh(hgrad=_GRADATION, hausd=float(size.max()), verbose=-1, **ridges)
    except RuntimeError as error:
        raise MeshError(
            f"the surface of {len(mesh.vertices)} vertices cannot be remeshed ({error}); smooth it"
            " in a mesh program first"
        ) from error
    free = TriangleMesh(
        vertices=np.array(body.get_vertices(), dtype=np.float64),
        triangles=np.array(body.get_triangles(), dtype=np.int64),
    )
    # Mmg's own smooth surface deviates by up to an edge where sizes change quickly.
    return _projected(free, surface or mesh)


def _rim(mesh: TriangleMesh, support: Plane) -> Int[np.ndarray, "k 2"]:
    """Edges between a triangle in a plane and one outside it."""
    flat = abs(support.heights(mesh.vertices)) < _IN_PLANE * bounding_diagonal(mesh)
    return half_edges(mesh.triangles).rim(flat[mesh.triangles].all(axis=1))


def _projected(free: TriangleMesh, surface: TriangleMesh) -> TriangleMesh:
    """Project vertices onto a surface, except where that would flatten or invert triangles."""
    _, place = nearest(free.vertices, surface)
    before = _smallest_angles(free.vertices, free.triangles)
    normal = area_vectors(free)
    for _ in range(_ROUNDS):
        moved = TriangleMesh(vertices=place, triangles=free.triangles)
        flat = _smallest_angles(place, free.triangles) < np.minimum(_FLAT, 0.5 * before)
        flat |= np.einsum("ea,ea->e", area_vectors(moved), normal) <= 0.0
        if not flat.any():
            break
        back = np.unique(free.triangles[flat])
        place[back] = free.vertices[back]
    return TriangleMesh(vertices=place, triangles=free.triangles)


def _smallest_angles(vertices: Vertices, triangles: Triangles) -> TriangleScalars:
    """Smallest angle of each triangle [rad]."""
    corner = vertices[triangles]
    edge = np.roll(corner, -1, axis=1) - corner
    unit = edge / np.maximum(np.linalg.norm(edge, axis=2, keepdims=True), 1e-300)
    cosine = -np.einsum("eka,eka->ek", unit, np.roll(unit, 1, axis=1))
    return np.arccos(np.clip(cosine, -1.0, 1.0)).min(axis=1)
