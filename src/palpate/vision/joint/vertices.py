"""Displacement of the mesh's vertices from range flow: robust local quadratics on the surface."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.geometry import TriangleMesh, vertex_normals
from palpate.records import INDEPENDENT, Camera, PointCorrelation, Rig, camera_centre
from palpate.shapes import Flags, Triangles, Vertices
from palpate.vision.cameras.projection import pixel_sizes
from palpate.vision.joint.averaging import surface_average
from palpate.vision.joint.match import BEND_REACH
from palpate.vision.matching.fit_operators import local_fits
from palpate.vision.matching.local_regression import LocalField, local_field
from palpate.vision.matching.noise_correlation import noise_correlation
from palpate.vision.matching.scatter import Scatter
from palpate.vision.range_flow.flow import (
    RangeFlow,
    VertexDisplacement,
    is_valid,
    measured_vertices,
)

# Radius around a vertex, in half windows, of the points used: those whose windows contain it.
_REACH = 1.2
# Minimum cosine between normal and viewing direction: below it, the points lie on one side only.
_MIN_COSINE = 0.1
# Twice the number of coefficients of a quadratic.
_MIN_POINTS = 12
# A vertex whose standard deviation exceeds this many times that of a typical point is extrapolated.
_MAX_SIGMA_RATIO = 3.0


def vertex_displacement(
    flow: RangeFlow, camera: Camera, vertices: Vertices, triangles: Triangles
) -> VertexDisplacement:
    """Displacement and covariance of the vertices around which range flow was measured.

    Parameters
    ----------
    flow : RangeFlow
    camera : Camera                 the reference camera
    vertices, triangles : (v, 3) float [m], (m, 3) int

    Returns
    -------
    VertexDisplacement              NaN at vertices that face away from the camera, have fewer than
                                    12 points around them, or lie outside the measured area
    """
    displacement = np.full(vertices.shape, np.nan)
    covariance = np.full((*vertices.shape, 3), np.nan)
    count = np.zeros(len(vertices), dtype=np.int64)
    valid = is_valid(flow)
    normal = vertex_normals(vertices, triangles)
    rows = np.flatnonzero(_facing(camera, vertices, normal))
    correlation = INDEPENDENT
    if valid.any() and len(rows) > 0:
        scatter = _scatter(flow, valid)
        field = _field_at(scatter, vertices[rows], normal[rows], camera)
        good = np.isfinite(field.displacement).all(axis=1) & (field.count >= _MIN_POINTS)
        # Outside the points the polynomial extrapolates, with a large variance.
        trace = np.trace(field.covariance, axis1=1, axis2=2)
        usual = np.median(np.trace(flow.covariance[valid], axis1=1, axis2=2))
        with np.errstate(invalid="ignore"):
            good &= trace < _MAX_SIGMA_RATIO**2 * usual
        displacement[rows[good]] = field.displacement[good]
        covariance[rows[good]] = field.covariance[good]
        count[rows] = field.count
        correlated = noise_correlation(scatter, field)
        kept = good[correlated.pair].all(axis=1)
        correlation = PointCorrelation(rows[correlated.pair[kept]], correlated.value[kept])
    return VertexDisplacement(displacement, covariance, count, correlation)


def with_average(
    found: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh, order: int
) -> VertexDisplacement:
    """Add the weighted average of the surface's displacement that each vertex value represents.

    Parameters
    ----------
    found : VertexDisplacement      of v vertices, from `flow`
    flow : RangeFlow
    rig : Rig
    surface : TriangleMesh          of v vertices
    order : 1 or 2                  shape function of the windows: affine or quadratic

    Returns
    -------
    VertexDisplacement
    """
    valid, rows = is_valid(flow), np.flatnonzero(measured_vertices(found))
    if len(rows) == 0:
        return found
    scatter, camera = _scatter(flow, valid), rig.cameras[rig.reference]
    half = _half_window(scatter, camera)
    normal = vertex_normals(surface.vertices, surface.triangles)
    vertices = local_fits(
        scatter, surface.vertices[rows], _tangents(normal[rows]), reach=_REACH * half,
        min_points=_MIN_POINTS,
    )  # fmt: skip
    bends = local_fits(scatter, scatter.point, flow.tangent[valid], reach=BEND_REACH * half)
    average = surface_average(flow.subset, rig, surface, vertices, bends, order)
    return replace(found, average=average.embedded(rows, len(surface.vertices)))


def _scatter(flow: RangeFlow, valid: Flags) -> Scatter:
    """Collect the valid points of range flow."""
    return Scatter(
        flow.point[valid],
        flow.pixel[valid],
        flow.displacement[valid],
        flow.covariance[valid],
        flow.bias[valid],
        flow.subset,
    )


def _field_at(
    scatter: Scatter,
    place: Float[np.ndarray, "k 3"],
    normal: Float[np.ndarray, "k 3"],
    camera: Camera,
) -> LocalField:
    """Local field of the scatter at vertices."""
    reach = _REACH * _half_window(scatter, camera)
    return local_field(scatter, place, _tangents(normal), reach=reach, min_points=_MIN_POINTS)


def _half_window(scatter: Scatter, camera: Camera) -> float:
    """Half the side of a window on the surface [m]."""
    return (scatter.subset // 2) * float(np.median(pixel_sizes(camera, scatter.point)))


def _facing(camera: Camera, vertices: Vertices, normal: Vertices) -> Flags:
    """True for vertices whose normals point towards the camera."""
    toward = camera_centre(camera) - vertices
    toward = toward / np.linalg.norm(toward, axis=1)[:, None]
    return (toward * normal).sum(axis=1) > _MIN_COSINE


def _tangents(normal: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Two orthonormal tangents for each normal."""
    other = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)
