"""Mending and remeshing a surface for the boundary element model, with the deviation caused."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from palpate.geometry import MeshQuality, TriangleMesh, mesh_quality, triangle_areas
from palpate.progress import Progress, silent
from palpate.scanning.mending.action import Action
from palpate.scanning.mending.deviation import Deviation, deviation, distances
from palpate.scanning.mending.mend import mend
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import remeshed
from palpate.shapes import Points


@dataclass(frozen=True, slots=True, eq=False)
class PreparedSurface:
    """A surface ready for a session.

    Attributes
    ----------
    given : TriangleMesh            the input
    mended : TriangleMesh           closed, manifold, outward normals
    mesh : TriangleMesh             the mended surface, remeshed evenly
    actions : tuple of Action       repairs
    guessed : (m,) bool             triangles of `mesh` that close holes and were not measured
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
    """Mend a surface and remesh it evenly.

    Parameters
    ----------
    given : TriangleMesh            welded; may be open, inconsistently oriented, folded, in pieces
    vertices : int                  wanted number
    near : (n, 3) float [m] or None points near which triangles are to be finer
    support : Plane or None         plane on which the object stood
    progress : callable

    Returns
    -------
    PreparedSurface

    Raises
    ------
    InputError                      vertices out of range, `near` away from the surface
    MeshError                       the surface cannot be mended or remeshed; says why, and where
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
    """Triangles that lie on patches, within the distance by which chords miss a curved surface."""
    if patches is None:
        return np.zeros(len(mesh.triangles), dtype=bool)
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    return distances(centre, patches) < 0.1 * np.sqrt(triangle_areas(mesh))
