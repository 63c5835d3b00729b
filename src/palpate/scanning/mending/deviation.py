"""Distances between two surfaces."""

from dataclasses import dataclass

import numpy as np

from palpate.geometry import TriangleMesh, enclosed_volume, triangle_areas
from palpate.optional_imports import late_import
from palpate.shapes import Points, PointScalars

_SAMPLES = 20_000
_SEED = 1


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
    return nearest(points, mesh)[0]


def nearest(points: Points, mesh: TriangleMesh) -> tuple[PointScalars, Points]:
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
    square, _, place = igl.point_mesh_squared_distance(
        np.ascontiguousarray(points), mesh.vertices, mesh.triangles
    )
    gap = np.sqrt(np.maximum(np.asarray(square).ravel(), 0.0))
    return gap, np.array(place).reshape(-1, 3)


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
    gap = np.concatenate(
        [
            distances(surface_samples(other, _SAMPLES), true),
            distances(other.vertices, true),
            distances(surface_samples(true, _SAMPLES), other),
        ]
    )
    return Deviation(
        median=float(np.median(gap)),
        percentile_95=float(np.quantile(gap, 0.95)),
        largest=float(gap.max()),
        volume=enclosed_volume(other) / enclosed_volume(true) - 1.0,
    )


def surface_samples(mesh: TriangleMesh, count: int) -> Points:
    """Random points uniform over the area of a surface, the same at every call.

    Parameters
    ----------
    mesh : TriangleMesh
    count : int

    Returns
    -------
    (count, 3) float [m]
    """
    rng = np.random.default_rng(_SEED)
    area = triangle_areas(mesh)
    triangle = rng.choice(len(area), count, p=area / area.sum())
    u, v = np.sqrt(rng.random(count)), rng.random(count)
    weight = np.stack([1.0 - u, u * (1.0 - v), u * v], axis=1)
    return np.einsum("nv,nva->na", weight, mesh.vertices[mesh.triangles[triangle]])
