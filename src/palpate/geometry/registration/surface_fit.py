"""Robust registration of points to a triangle surface by Gauss-Newton steps of their pose.

A motion of the points is six numbers, a small rotation about their centroid (rad) and a translation
(m). Within the iteration they are scaled so that a unit of any of them moves the points by 1 m rms.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm

from palpate.arrays import STD_OVER_MEDIAN
from palpate.geometry.closest_point import SurfaceSearch
from palpate.geometry.triangle_mesh import TriangleMesh, unit_normals
from palpate.shapes import Indices, PointIndices, Points, PointScalars, Vector3

# Tukey's constant for 95 % efficiency with normal errors; larger residuals have zero weight.
_TUKEY = 4.685
# A step shorter than this fraction of its standard deviation ends the iteration.
_SMALL_STEP = 0.1

Pose = Float[np.ndarray, "4 4"]
Matrix6 = Float[np.ndarray, "6 6"]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPoints:
    """Points of a surface in their own frame, with their covariances.

    Attributes
    ----------
    point : (n, 3) float [m]
    covariance : (n, 3, 3) float [m^2]      zero where it is unknown
    """

    point: Points
    covariance: Float[np.ndarray, "n 3 3"]

    def chosen(self, rows: Indices) -> "MeasuredPoints":
        """Some of the points, by their indices, (k,)."""
        return MeasuredPoints(self.point[rows], self.covariance[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """Distances of n points from the surface, and their Jacobian with respect to a motion.

    Attributes
    ----------
    centre : (3,) float [m]             centre of rotation of motions
    scale : (6, 6) float                maps the scaled unknowns to a motion
    offset : (n, 3) float [m]           of the points from the centre
    normal : (n, 3) float               direction in which the distance grows
    row : (n, 6) float [-]              derivative of the distance with respect to the scaled
                                        unknowns
    residual : (n,) float [m]           signed distance
    sigma : (n,) float [m]              its expected standard deviation
    triangle : (n,) int                 triangle of the nearest point
    barycentric : (n, 3) float          position of the nearest point in it
    """

    centre: Vector3
    scale: Matrix6
    offset: Points
    normal: Points
    row: Float[np.ndarray, "n 6"]
    residual: PointScalars
    sigma: PointScalars
    triangle: PointIndices
    barycentric: Points

    def chosen(self, rows: Indices) -> "Linearised":
        """Some of the points, by indices, (k,); the centre of rotation remains that of all."""
        names = ("offset", "normal", "row", "residual", "sigma", "triangle", "barycentric")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Result of the iteration."""

    pose: Pose
    iterations: int
    converged: bool


def placed(pose: Pose, points: Points) -> Points:
    """Points, (n, 3) [m], moved by a pose, (4, 4)."""
    return points @ pose[:3, :3].T + pose[:3, 3]


def motion_pose(motion: Float[np.ndarray, "6"], centre: Vector3) -> Pose:
    """Finite motion (a screw) of a rotation about a centre and a translation: the exponential map.

    Points move on arcs, not along tangents: a ball that is rotated about a point other than its
    centre, and shifted back, stays in place.

    Parameters
    ----------
    motion : (6,) float             rotation (rad) and translation (m)
    centre : (3,) float [m]         centre of the rotation

    Returns
    -------
    (4, 4) float                    translation in metres
    """
    rate = np.zeros((4, 4))
    rate[:3, :3] = np.cross(motion[:3], np.eye(3)).T
    rate[:3, 3] = motion[3:] - np.cross(motion[:3], centre)
    return expm(rate)


def motion_scale(offset: Points) -> Matrix6:
    """Motions, in columns, that are mutually orthogonal and move points by 1 m rms each.

    Parameters
    ----------
    offset : (n, 3) float [m]       from their centroid, not all collinear

    Returns
    -------
    (6, 6) float                    rotation (rad) and translation (m) of each
    """
    scatter = offset.T @ offset / len(offset)
    values, vectors = np.linalg.eigh(np.trace(scatter) * np.eye(3) - scatter)
    scale = np.eye(6)
    scale[:3, :3] = (vectors / np.sqrt(values)) @ vectors.T
    return scale


def linearised(search: SurfaceSearch, points: MeasuredPoints, pose: Pose) -> Linearised:
    """Distances from the surface at a pose, and their derivatives.

    Where the nearest point is inside a triangle, the distance is that from its plane; where it is
    on an edge or a corner, it is the Euclidean distance, so that points beyond an edge are drawn
    back.

    Parameters
    ----------
    search : SurfaceSearch          of the surface
    points : MeasuredPoints         n points, not collinear
    pose : (4, 4) float [m]

    Returns
    -------
    Linearised
    """
    position = placed(pose, points.point)
    mesh = search.mesh
    found = search.closest(position)
    offset_from_surface = position - found.position
    normal = unit_normals(TriangleMesh(mesh.vertices, mesh.triangles[found.triangle]))
    beyond = (found.barycentric <= 0.0).any(axis=1)
    beyond &= found.distance > 1e-9 * search.diagonal
    normal[beyond] = offset_from_surface[beyond] / found.distance[beyond, None]
    residual = np.einsum("na,na->n", normal, offset_from_surface)
    centre = position.mean(axis=0)
    offset = position - centre
    scale = motion_scale(offset)
    row = np.hstack([np.cross(offset, normal), normal]) @ scale
    own = normal @ pose[:3, :3]
    variance = np.einsum("na,nab,nb->n", own, points.covariance, own)
    return Linearised(
        centre=centre,
        scale=scale,
        offset=offset,
        normal=normal,
        row=row,
        residual=residual,
        sigma=_sigma(residual, variance, 1e-7 * search.diagonal),
        triangle=found.triangle,
        barycentric=found.barycentric,
    )


def _sigma(residual: PointScalars, variance: PointScalars, least: float) -> PointScalars:
    """Expected standard deviation of every residual.

    Scatter that the noise of the points does not explain is attributed to errors of the surface,
    equal for all points.
    """
    robust_std = STD_OVER_MEDIAN * float(np.median(np.abs(residual)))
    surface = max(robust_std**2 - float(np.median(variance)), 0.0)
    return np.sqrt(np.maximum(variance + surface, least**2))


@dataclass(frozen=True, slots=True, eq=False)
class RobustResiduals:
    """Residuals in units of the width beyond which Tukey's function ignores them.

    Attributes
    ----------
    unit : (n,) float [-]       residuals in that unit; all zero if the width is
    width : float [-]           in units of `sigma`; zero if most residuals are
    """

    unit: PointScalars
    width: float

    def weight(self) -> PointScalars:
        """Tukey's weight of every residual, (n,) [-], 0 to 1."""
        return np.maximum(1.0 - self.unit**2, 0.0) ** 2


def robust_residuals(linearisation: Linearised) -> RobustResiduals:
    """Residuals scaled by a robust estimate of their spread.

    Parameters
    ----------
    linearisation : Linearised

    Returns
    -------
    RobustResiduals

    Source
    ------
    Huber, Robust Statistics (1981): the scale from the median, Tukey's constant for 95 % efficiency
    """
    scaled = linearisation.residual / linearisation.sigma
    width = _TUKEY * STD_OVER_MEDIAN * float(np.median(np.abs(scaled)))
    return RobustResiduals(scaled / width if width > 0.0 else np.zeros(len(scaled)), width)


def fit_pose(
    search: SurfaceSearch,
    points: MeasuredPoints,
    pose: Pose,
    *,
    constraints: Float[np.ndarray, "k 6"],
    iterations: int,
) -> Fit:
    """Fit the pose of points on a surface.

    The iteration ends when a step is small in comparison with its standard deviation.

    Parameters
    ----------
    search : SurfaceSearch          of the surface
    points : MeasuredPoints
    pose : (4, 4) float             initial pose
    constraints : (k, 6) float      combinations of a step's rotation and translation that must be
                                    zero
    iterations : int                largest number of steps

    Returns
    -------
    Fit
    """
    for done in range(1, iterations + 1):
        linearisation = linearised(search, points, pose)
        weight = robust_residuals(linearisation).weight() / linearisation.sigma**2
        free = null_space_basis(constraints @ linearisation.scale)
        row = linearisation.row @ free
        matrix = row.T @ (weight[:, None] * row)
        step = -_solved(matrix, row.T @ (weight * linearisation.residual), search.diagonal)
        pose = motion_pose(linearisation.scale @ free @ step, linearisation.centre) @ pose
        if step @ matrix @ step < _SMALL_STEP**2:
            return Fit(pose, done, True)
    return Fit(pose, iterations, False)


def null_space_basis(constraints: Float[np.ndarray, "k 6"]) -> Float[np.ndarray, "6 f"]:
    """Orthonormal basis, (6, f), of the motions for which all k held combinations, (k, 6), are
    zero (null space)."""
    _, values, vectors = np.linalg.svd(constraints)
    rank = int((values > 1e-9 * values.max()).sum()) if values.size else 0
    return vectors[rank:].T


def _solved(
    matrix: Float[np.ndarray, "f f"], right: Float[np.ndarray, " f"], diagonal: float
) -> np.ndarray:
    """Least-squares step of limited length, without directions that are known no better than the
    object's size."""
    values, vectors = np.linalg.eigh(matrix)
    known = values > diagonal**-2
    step = vectors[:, known] @ ((vectors[:, known].T @ right) / values[known])
    # At most a tenth of the object's size: farther away, the nearest points are different ones.
    return step * min(1.0, 0.1 * diagonal / max(float(np.linalg.norm(step)), 1e-300))
