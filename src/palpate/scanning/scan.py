"""From the views of an object to its mesh, with a standard deviation for each vertex."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from palpate.errors import MeshError
from palpate.geometry import (
    MeshQuality,
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    mesh_quality,
    triangle_areas,
)
from palpate.progress import Progress, part_of, silent
from palpate.scanning.joining.agreement import Agreement, agreements
from palpate.scanning.joining.fusion import fused
from palpate.scanning.joining.poses import posed
from palpate.scanning.joining.vertex_fit import fitted
from palpate.scanning.mending.action import place_text
from palpate.scanning.mending.deviation import distances
from palpate.scanning.mending.solid import above
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import remeshed
from palpate.scanning.views.view import View
from palpate.shapes import Points

# Largest fraction of the surface that may be guessed without a support.
_MAX_GUESSED = 0.10
# A triangle counts as measured if a point is within this fraction of its edge, or of the object's
# size.
_NEAR_EDGE, _NEAR_SIZE = 0.5, 0.01


@dataclass(frozen=True, slots=True, eq=False)
class ScannedSurface:
    """A mesh made from views.

    Attributes
    ----------
    mesh : TriangleMesh             closed, manifold, outward normals
    sigma : (v,) float [m]          standard deviation of each vertex along its normal, from the
                                    scatter of the points, without errors common to all points of a
                                    view; NaN on the support and where the fit is undetermined, as
                                    in guessed parts and at creases
    guessed : (m,) bool             triangles that no view shows
    agreements : tuple of Agreement one per view
    views : tuple of View           in the object's frame
    distance : (float, float) [m]   of the points from the mesh: median, 95 % quantile
    volume_std : float [m^3]        standard deviation of the volume, from the vertices' sigmas
    quality : MeshQuality
    """

    mesh: TriangleMesh
    sigma: Float[np.ndarray, " v"]
    guessed: Bool[np.ndarray, " m"]
    agreements: tuple[Agreement, ...]
    views: tuple[View, ...]
    distance: tuple[float, float]
    volume_std: float
    quality: MeshQuality


def scan_surface(
    views: Sequence[View],
    *,
    vertices: int,
    near: Points | None = None,
    support: Plane | None = None,
    progress: Progress = silent,
) -> ScannedSurface:
    """Join views, close the parts they do not show, and remesh the surface evenly.

    Parameters
    ----------
    views : sequence of View        all with poses; or all without, which are then estimated
    vertices : int                  wanted number
    near : (n, 3) float [m] or None points near which triangles are to be finer
    support : Plane or None         plane on which the object stood
    progress : callable

    Returns
    -------
    ScannedSurface

    Raises
    ------
    InputError                      the views do not overlap or contradict each other, or `vertices`
                                    or `near` is out of range
    MeshError                       the surface does not close, or needs more triangles
    """
    views = posed(views, progress=part_of(progress, 0.0, 0.3))
    found = agreements(views)
    points = np.concatenate([view.points for view in views])
    normals = np.concatenate([view.normals for view in views])
    sigma = np.concatenate([view.sigma for view in views])
    number = np.repeat(np.arange(len(views)), [len(view.points) for view in views])
    correlation_length = np.array([view.correlation_length for view in views])
    if support is not None:
        if np.median(support.heights(points)) < 0.0:
            support = Plane(support.point, -support.normal)
        kept = support.heights(points) > -_NEAR_SIZE * float(np.ptp(points, axis=0).max())
        points, normals, sigma, number = points[kept], normals[kept], sigma[kept], number[kept]
    progress("joining", 0.3)
    skin = fused(points, normals, support=support)
    skin = skin if support is None else above(skin, support)
    _check_closed(skin, points, support)
    progress("remeshing", 0.7)
    even = remeshed(skin, vertices=vertices, near=near, creases=False, support=support)
    fixed = np.zeros(len(even.vertices), dtype=bool)
    if support is not None:
        fixed = abs(support.heights(even.vertices)) < 1e-4 * bounding_diagonal(even)
    progress("fitting", 0.9)
    result = fitted(
        even, points, normals, sigma, view=number, correlation_length=correlation_length[number],
        fixed=fixed,
    )  # fmt: skip
    mesh = checked_mesh(result.mesh)[0]
    gap = distances(points, mesh)
    return ScannedSurface(
        mesh=mesh,
        sigma=result.sigma,
        guessed=_guessed(mesh, points),
        agreements=found,
        views=tuple(views),
        distance=(float(np.median(gap)), float(np.quantile(gap, 0.95))),
        volume_std=_volume_std(mesh, result.sigma),
        quality=mesh_quality(mesh),
    )


def _guessed(mesh: TriangleMesh, points: Points) -> Bool[np.ndarray, " m"]:
    """True for triangles far from all points."""
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    gap, _ = cKDTree(points).query(centre)
    # The edge of an equilateral triangle is 1.52 times the square root of its area.
    edge = 1.52 * np.sqrt(triangle_areas(mesh))
    return gap > np.maximum(_NEAR_EDGE * edge, _NEAR_SIZE * bounding_diagonal(mesh))


def _check_closed(skin: TriangleMesh, points: Points, support: Plane | None) -> None:
    """Raise if too much of the surface is guessed and no support was given."""
    if support is not None:
        return
    guessed = _guessed(skin, points)
    areas = triangle_areas(skin)
    fraction = float(areas[guessed].sum() / areas.sum())
    if fraction > _MAX_GUESSED:
        centre = skin.vertices[skin.triangles[guessed]].mean(axis=1)
        middle = np.average(centre, axis=0, weights=areas[guessed])
        raise MeshError(
            f"the surface does not close: no view shows {100.0 * fraction:.0f} % of it, around"
            f" {place_text(middle)}, and at most {100.0 * _MAX_GUESSED:.0f} % is guessed; add"
            ' views of that side, or say support = "..." if the object stood there'
        )


def _volume_std(mesh: TriangleMesh, sigma: Float[np.ndarray, " v"]) -> float:
    """Standard deviation of the volume, from independent errors of the vertices."""
    area = np.zeros(len(mesh.vertices))
    np.add.at(area, mesh.triangles.ravel(), np.repeat(triangle_areas(mesh) / 3.0, 3))
    known = np.isfinite(sigma)
    return float(np.sqrt(((area * sigma)[known] ** 2).sum()))
