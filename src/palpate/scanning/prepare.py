"""A surface mended and remeshed for the boundary element model, with what that cost."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from palpate.geometry import MeshQuality, TriangleMesh, mesh_quality, triangle_areas
from palpate.progress import Progress, silent
from palpate.scanning.mending import Action, Deviation, deviation, distances, mend
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import remeshed
from palpate.shapes import Points


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSurface:
    """A surface ready for a session.

    Attributes
    ----------
    given : TriangleMesh            as it came
    mended : TriangleMesh           closed, manifold, outward
    mesh : TriangleMesh             the same with even triangles
    actions : tuple of Action       what was mended
    guessed : (m,) bool             triangles of `mesh` that nobody measured
    deviation : Deviation           of `mesh` from `mended`
    quality : MeshQuality           of `mesh`
    """

    given: TriangleMesh
    mended: TriangleMesh
    mesh: TriangleMesh
    actions: tuple[Action, ...]
    guessed: Bool[np.ndarray, " m"]
    deviation: Deviation
    quality: MeshQuality


def prepare_surface(
    given: TriangleMesh,
    *,
    vertices: int,
    near: Points | None = None,
    support: Plane | None = None,
    progress: Progress = silent,
) -> PreparedSurface:
    """Mend a surface and cover it with even triangles.

    Parameters
    ----------
    given : TriangleMesh            welded; open, turned, folded, in pieces
    vertices : int                  wanted
    near : (n, 3) float [m] or None where triangles are to be finer
    support : Plane or None         that the object stood on
    progress : callable

    Returns
    -------
    PreparedSurface

    Raises
    ------
    InputError                      vertices out of range, `near` away from the surface
    MeshError                       the surface cannot be mended: why, and where
    """
    progress("mending", 0.0)
    mended = mend(given, support)
    progress("remeshing", 0.4)
    mesh = remeshed(mended.mesh, vertices=vertices, near=near)
    progress("comparing", 0.9)
    return PreparedSurface(
        given=given,
        mended=mended.mesh,
        mesh=mesh,
        actions=mended.actions,
        guessed=_guessed(mesh, mended.guessed),
        deviation=deviation(mended.mesh, mesh),
        quality=mesh_quality(mesh),
    )


def _guessed(mesh: TriangleMesh, patches: TriangleMesh | None) -> Bool[np.ndarray, " m"]:
    """Triangles that lie on patches; nearer than a chord of theirs may be off a bent surface."""
    if patches is None:
        return np.zeros(len(mesh.triangles), dtype=bool)
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    return distances(centre, patches) < 0.1 * np.sqrt(triangle_areas(mesh))
