"""Fitting of a mesh's vertices to the surrounding points, with their standard deviations."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import cKDTree

from palpate.arrays import STD_OVER_MEDIAN
from palpate.geometry import TriangleMesh, half_edges, vertex_normals
from palpate.shapes import PointIndices, Points, PointScalars

# Largest and smallest number of points for the fit of a quadratic surface.
_MAX_NEIGHBOURS, _MIN_NEIGHBOURS = 60, 15
# Constant of Tukey's biweight: 95 % efficiency for normal noise.
_TUKEY = 4.685
_ROUNDS = 3
# Vertices processed at once, which limits the memory for their pairs of points.
_AT_ONCE = 256


@dataclass(frozen=True, slots=True, eq=False)
class FittedSurface:
    """A surface fitted to points.

    Attributes
    ----------
    mesh : TriangleMesh
    sigma : (v,) float [m]          standard deviation of each vertex along its normal, from the
                                    scatter of the points; NaN where the vertex was not fitted
    """

    mesh: TriangleMesh
    sigma: Float[np.ndarray, " v"]


def fitted(
    mesh: TriangleMesh,
    points: Points,
    normals: Points,
    sigma: PointScalars,
    *,
    view: PointIndices,
    correlation_length: Float[np.ndarray, " n"],
    fixed: Bool[np.ndarray, " v"] | None = None,
) -> FittedSurface:
    """Move vertices along their normals onto a smooth surface fitted to the surrounding points.

    A robust quadratic fit to the nearest points is not biased by curvature, as the mean of tangent
    planes would be.

    Parameters
    ----------
    mesh : TriangleMesh             of v vertices, near the points
    points, normals : (n, 3) float  positions [m], unit normals
    sigma : (n,) float [m]          standard deviation of the points along their normals
    view : (n,) int                 index of each point's view
    correlation_length : (n,) float [m]     distance within which errors of points of a view are
                                    correlated, fully at distance 0; if residuals show more
                                    correlation, all standard deviations are inflated
    fixed : (v,) bool or None       vertices not to be moved

    Returns
    -------
    FittedSurface
    """
    normal = vertex_normals(mesh.vertices, mesh.triangles)
    ends = half_edges(mesh.triangles).ends
    edge = float(np.linalg.norm(np.diff(mesh.vertices[ends], axis=1)[:, 0], axis=1).mean())
    k = min(_MAX_NEIGHBOURS, len(points))
    gap, index = cKDTree(points).query(mesh.vertices, k=k, distance_upper_bound=edge)
    near = np.isfinite(gap)
    index = np.where(near, index, 0)
    near &= np.einsum("vka,va->vk", normals[index], normal) > 0.5
    offset = points[index] - mesh.vertices[:, None]
    height = np.einsum("vka,va->vk", offset, normal)
    base = _fit_rows(offset, normal, edge)
    # Weights decrease with distance, and with the variance of each point.
    radius = np.maximum(np.where(near, gap, 0.0).max(axis=1), 1e-12)[:, None]
    weight = np.where(near, (1.0 - (np.where(near, gap, 0.0) / (1.0001 * radius)) ** 2) ** 2, 0.0)
    weight /= sigma[index] ** 2
    move, error, contribution = _solved(base, height, weight, sigma[index])
    std = _deviation(error, points[index], view[index], correlation_length[index])
    # Inflate by the correlation seen in residuals; a lower bound, for the fit absorbs part of it.
    independent = float((error**2).sum())
    if independent > 0.0:
        std *= max(
            1.0, _correlation(contribution, view[index]) / np.sqrt((std**2).sum() / independent)
        )
    known = (near.sum(axis=1) >= _MIN_NEIGHBOURS) & (abs(move) < 0.5 * edge)
    # With points on one side only, the fit would extrapolate.
    middle = np.linalg.norm((weight[..., None] * offset).sum(axis=1), axis=1)
    known &= middle < 0.6 * radius[:, 0] * np.maximum(weight.sum(axis=1), 1e-300)
    if fixed is not None:
        known &= ~fixed
    vertices = mesh.vertices + np.where(known, move, 0.0)[:, None] * normal
    return FittedSurface(
        TriangleMesh(vertices=vertices, triangles=mesh.triangles), np.where(known, std, np.nan)
    )


def _fit_rows(
    offset: Float[np.ndarray, "v k 3"], normal: Float[np.ndarray, "v 3"], scale: float
) -> Float[np.ndarray, "v k 6"]:
    """Terms 1, s, t, s^2, s t, t^2 in tangent coordinates, in units of `scale`."""
    axis = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, axis)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(normal, first)
    s = np.einsum("vka,va->vk", offset, first) / scale
    t = np.einsum("vka,va->vk", offset, second) / scale
    return np.stack([np.ones_like(s), s, t, s * s, s * t, t * t], axis=2)


def _solved(
    base: Float[np.ndarray, "v k 6"],
    height: Float[np.ndarray, "v k"],
    weight: Float[np.ndarray, "v k"],
    sigma: Float[np.ndarray, "v k"],
) -> tuple[Float[np.ndarray, " v"], Float[np.ndarray, "v k"], Float[np.ndarray, "v k"]]:
    """Height of the fitted surface at each vertex, and the contributions to it of each point's
    standard deviation and residual [m]."""
    robust = weight.copy()
    damping = 1e-9 * np.eye(6)
    for _ in range(_ROUNDS):
        rows = robust[..., None] * base
        total = np.maximum(robust.sum(axis=1), 1e-300)[:, None, None]
        matrix = np.einsum("vki,vkj->vij", rows, base) / total + damping
        right = np.einsum("vki,vk->vi", rows, height) / total[:, :, 0]
        inverse = np.linalg.inv(matrix)
        coefficients = np.einsum("vij,vj->vi", inverse, right)
        residual = height - np.einsum("vki,vi->vk", base, coefficients)
        unit = residual / sigma
        level = STD_OVER_MEDIAN * np.ma.median(np.ma.array(abs(unit), mask=weight <= 0.0), axis=1)
        level = np.maximum(level.filled(1.0), 1e-6)[:, None]
        u = unit / (_TUKEY * level)
        robust = weight * np.where(abs(u) < 1.0, (1.0 - u**2) ** 2, 0.0)
    # Weight of each point's height in the result; its noise is the larger of claimed and observed.
    gain = np.einsum("vi,vki,vk->vk", inverse[:, 0], base, robust) / total[:, :, 0]
    noise = sigma * np.maximum(level, 1.0)
    return coefficients[:, 0], gain * noise, gain * residual


def _deviation(
    error: Float[np.ndarray, "v k"],
    place: Float[np.ndarray, "v k 3"],
    view: Int[np.ndarray, "v k"],
    correlation_length: Float[np.ndarray, "v k"],
) -> Float[np.ndarray, " v"]:
    """Standard deviation of sums of errors, correlated between nearby points of the same view.

    The correlation decreases linearly to zero at distance `correlation_length`, as the overlap of
    windows does.
    """
    variance = np.empty(len(error))
    for rows in np.array_split(np.arange(len(error)), len(error) // _AT_ONCE + 1):
        distance = np.linalg.norm(place[rows, :, None] - place[rows, None], axis=3)
        width = np.maximum(correlation_length[rows][:, :, None], 1e-12)
        same = view[rows][:, :, None] == view[rows][:, None]
        common = np.where(same, np.maximum(1.0 - distance / width, 0.0), 0.0)
        common[:, np.arange(error.shape[1]), np.arange(error.shape[1])] = 1.0
        variance[rows] = np.einsum("vi,vij,vj->v", error[rows], common, error[rows])
    return np.sqrt(np.maximum(variance, 0.0))


def _correlation(contribution: Float[np.ndarray, "v k"], view: Int[np.ndarray, "v k"]) -> float:
    """Rms of the residuals' sums over each view relative to that of independent ones, >= 1."""
    independent = float((contribution**2).sum())
    together = 0.0
    for one in range(int(view.max()) + 1):
        together += float((np.where(view == one, contribution, 0.0).sum(axis=1) ** 2).sum())
    return max(float(np.sqrt(together / independent)), 1.0) if independent > 0.0 else 1.0
