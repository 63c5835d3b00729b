"""From the views of an object to its mesh, with a standard deviation for each vertex.

Every view must agree with the others on the position of the surface. The result is written as
mesh.ply, surface.json and vertex_sigma.csv; a mended surface as the first two.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial import cKDTree

from palpate.errors import InputError, MeshError
from palpate.geometry import (
    MeshQuality,
    TriangleMesh,
    bounding_diagonal,
    checked_mesh,
    mesh_quality,
    place_text,
    triangle_areas,
    write_mesh,
)
from palpate.progress import Progress, part_of, silent
from palpate.records import json_text, write_text
from palpate.scanning.fusion import fitted, fused
from palpate.scanning.mend import PreparedSurface
from palpate.scanning.plane import Plane
from palpate.scanning.poses import posed
from palpate.scanning.remesh import distances, remeshed
from palpate.scanning.scan_file import View
from palpate.scanning.solid import above
from palpate.shapes import Points

# Largest fraction of the surface that may be guessed without a support.
_MAX_GUESSED = 0.10
# A triangle counts as measured if a point is within this fraction of its edge, or of the object's
# size.
_NEAR_EDGE, _NEAR_SIZE = 0.5, 0.01
# Points of a view that are compared with the others.
_SAMPLES = 4000
# Minimum fraction of a view's points with points of others nearby; the distance that counts as
# nearby, as a fraction of the object's size.
_OVERLAP, _NEAR = 0.1, 0.03
# Largest offset of a view from the others, in standard deviations of a point, or as a fraction of
# the size if that is larger.
_OFF, _OFF_SIZE = 4.0, 2e-3
MESH_FORMAT = "palpate-mesh/1"


@dataclass(frozen=True, slots=True)
class Agreement:
    """Agreement of a view with the others.

    Attributes
    ----------
    name : str
    points : int                    number of points
    overlap : float [-]             fraction of its points that other views show too
    offset : float [m]              median absolute distance from the others' surface there
    """

    name: str
    points: int
    overlap: float
    offset: float


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
    agreements = _agreements(views)
    points = np.concatenate([view.points for view in views])
    normals = np.concatenate([view.normals for view in views])
    sigma = np.concatenate([view.sigma for view in views])
    number = np.repeat(np.arange(len(views)), [len(view.points) for view in views])
    correlation_length = np.array([view.correlation_length for view in views])
    if support is not None:
        if np.median(support.heights(points)) < 0.0:
            support = Plane(support.point, -support.normal)
        standing = support.heights(points) > -_NEAR_SIZE * float(np.ptp(points, axis=0).max())
        points, normals, sigma, number = (
            values[standing] for values in (points, normals, sigma, number)
        )
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
    moved, std = fitted(
        even, points, normals, sigma, view=number, correlation_length=correlation_length[number],
        fixed=fixed,
    )  # fmt: skip
    mesh = checked_mesh(moved)[0]
    gap = distances(points, mesh)
    return ScannedSurface(
        mesh=mesh,
        sigma=std,
        guessed=_guessed(mesh, points),
        agreements=agreements,
        views=tuple(views),
        distance=(float(np.median(gap)), float(np.quantile(gap, 0.95))),
        volume_std=_volume_std(mesh, std),
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


def _agreements(views: Sequence[View]) -> tuple[Agreement, ...]:
    """Check the agreement of views, all in one frame, with each other.

    Parameters
    ----------
    views : sequence of View        in the object's frame

    Returns
    -------
    tuple of Agreement              overlap 0 and offset 0 for a single view

    Raises
    ------
    InputError                      a view overlaps the others too little, or contradicts them
    """
    if len(views) == 1:
        return (Agreement(views[0].name, len(views[0].points), 0.0, 0.0),)
    everything = np.concatenate([view.points for view in views])
    size = float(np.linalg.norm(np.ptp(everything, axis=0)))
    agreements = tuple(_agreement(views, k, _NEAR * size) for k in range(len(views)))
    for agreement, view in zip(agreements, views, strict=True):
        if agreement.overlap < _OVERLAP:
            raise InputError(
                f"view '{agreement.name}' shows {100.0 * agreement.overlap:.0f} % of what others"
                f" show, too little to be joined ({100.0 * _OVERLAP:.0f} % at least): take views"
                " between, or check its pose and unit"
            )
        allowed = max(_OFF * float(np.median(view.sigma)), _OFF_SIZE * size)
        if agreement.offset > allowed:
            raise InputError(
                f"view '{agreement.name}' contradicts the others: half of its points are"
                f" {1e3 * agreement.offset:.2g} mm or more off their surface, {1e3 * allowed:.2g}"
                " mm are in the noise; the object moved between the views, or its pose is wrong:"
                " leave it out, or leave all poses out to have them estimated"
            )
    return agreements


def _agreement(views: Sequence[View], k: int, near: float) -> Agreement:
    view = views[k]
    step = max(1, len(view.points) // _SAMPLES)
    points, normals = view.points[::step], view.normals[::step]
    others = [other for j, other in enumerate(views) if j != k]
    other_points = np.concatenate([other.points for other in others])
    facing = np.concatenate([other.normals for other in others])
    gap, index = cKDTree(other_points).query(points, k=8, distance_upper_bound=near)
    both = np.isfinite(gap)
    index = np.where(both, index, 0)
    both &= np.einsum("nka,na->nk", facing[index], normals) > 0.7
    seen = both.any(axis=1)
    height = np.einsum("nka,nka->nk", points[:, None] - other_points[index], facing[index])
    height = np.ma.median(np.ma.array(height, mask=~both), axis=1).filled(0.0)
    off = float(np.median(abs(height[seen]))) if seen.any() else 0.0
    return Agreement(view.name, len(view.points), float(seen.mean()), off)


def write_surface(
    folder: Path, surface: PreparedSurface | ScannedSurface, *, metres_per_unit: float = 1.0
) -> None:
    """Write mesh.ply and surface.json; for a scan also vertex_sigma.csv.

    Parameters
    ----------
    folder : Path                   exists
    surface : PreparedSurface or ScannedSurface
    metres_per_unit : float         unit of mesh.ply; all else is in metres

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_mesh(folder / "mesh.ply", surface.mesh, metres_per_unit=metres_per_unit)
    if isinstance(surface, ScannedSurface):
        details = _of_views(surface)
        rows = np.column_stack([surface.mesh.vertices, surface.sigma])
        lines = ["x_m,y_m,z_m,sigma_m"]
        lines += [",".join("" if np.isnan(x) else f"{x:.9g}" for x in row) for row in rows]
        write_text(folder / "vertex_sigma.csv", "\n".join(lines) + "\n")
    else:
        details = _of_mending(surface)
    content = {
        "format": MESH_FORMAT,
        **details,
        "guessed_triangles": np.flatnonzero(surface.guessed),
        "quality": asdict(surface.quality),
    }
    write_text(folder / "surface.json", json_text(content))


def _of_mending(surface: PreparedSurface) -> dict[str, Any]:
    """Repairs, and the deviation of the mesh from the mended surface."""
    return {
        "actions": [
            {"defect": a.defect, "count": a.count, "place": a.place, "done": a.done}
            for a in surface.actions
        ],
        "deviation": asdict(surface.deviation),
    }


def _of_views(surface: ScannedSurface) -> dict[str, Any]:
    """Agreement of the views with each other and with the mesh."""
    return {
        "views": [asdict(agreement) for agreement in surface.agreements],
        "distance": {"median": surface.distance[0], "percentile_95": surface.distance[1]},
        "volume_std": surface.volume_std,
    }
