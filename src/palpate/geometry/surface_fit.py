"""Robust fits of the pose of points on a triangle surface: coarse search, then Gauss-Newton steps.

A motion of the points is six numbers, a small rotation about their centroid (rad) and a translation
(m). Within the iteration they are scaled so that a unit of any of them moves the points by 1 m rms.
The coarse search reduces the distance of a few hundred points from a cloud of surface samples, in a
robust norm of decreasing width, from many initial poses in parallel, spread over the uncertainty of
the guess; it returns the pose whose points end nearest to the surface.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import expm
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palpate.arrays import STD_OVER_MEDIAN
from palpate.geometry.closest_point import SurfaceSearch, small_pieces, surface_search
from palpate.geometry.triangle_mesh import (
    TriangleMesh,
    area_vectors,
    bounding_diagonal,
    unit_normals,
)
from palpate.shapes import Flags, Indices, PointIndices, Points, PointScalars, Vector3

# Tukey's constant for 95 % efficiency with normal errors; larger residuals have zero weight.
_TUKEY = 4.685
# A step shorter than this fraction of its standard deviation ends the iteration.
_SMALL_STEP = 0.1
Pose = Float[np.ndarray, "4 4"]
_Matrix6 = Float[np.ndarray, "6 6"]
# Spacing of the surface samples over the mesh's diagonal: finer than the basin of convergence of
# the fit that follows.
_SAMPLE_SPACING = 1.0 / 50.0
_COARSE_ITERATIONS = 30
# Factor by which the norm's width shrinks per step, from the uncertainty of the guess to the
# spacing of the samples.
_SHRINK = 0.75
# Poses whose cost is within this factor of the lowest are equally good: of these, the one nearest
# to the start is taken.
_COST_TOLERANCE = 1.05


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
    scale: _Matrix6
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


def motion_scale(offset: Points) -> _Matrix6:
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
    closest = search.closest(position)
    offset_from_surface = position - closest.position
    normal = unit_normals(TriangleMesh(mesh.vertices, mesh.triangles[closest.triangle]))
    beyond = (closest.barycentric <= 0.0).any(axis=1)
    beyond &= closest.distance > 1e-9 * search.diagonal
    normal[beyond] = offset_from_surface[beyond] / closest.distance[beyond, None]
    residual = np.einsum("na,na->n", normal, offset_from_surface)
    centre = position.mean(axis=0)
    offset = position - centre
    scale = motion_scale(offset)
    row = np.hstack([np.cross(offset, normal), normal]) @ scale
    turned = normal @ pose[:3, :3]
    variance = np.einsum("na,nab,nb->n", turned, points.covariance, turned)
    return Linearised(
        centre=centre,
        scale=scale,
        offset=offset,
        normal=normal,
        row=row,
        residual=residual,
        sigma=_sigma(residual, variance, 1e-7 * search.diagonal),
        triangle=closest.triangle,
        barycentric=closest.barycentric,
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
) -> tuple[Pose, int, bool]:
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
    pose : (4, 4) float
    iterations : int                steps made
    converged : bool
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
            return pose, done, True
    return pose, iterations, False


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


def compact_groups(points: Points, count: int) -> PointIndices:
    """Divide points into groups of equal size and small extent.

    They are bisected recursively across the longest side, in the frame of their principal axes, so
    that the groups do not depend on the frame of the points.

    Parameters
    ----------
    points : (n, 3) float [m]
    count : int                     largest number of groups; the power of two below is used

    Returns
    -------
    (n,) int                        group of every point
    """
    centred = points - points.mean(axis=0)
    along_axes = centred @ np.linalg.eigh(centred.T @ centred)[1]
    parts = [np.arange(len(points))]
    while 2 * len(parts) <= min(count, len(points)):
        halves = []
        for part in parts:
            axis = int(np.ptp(along_axes[part], axis=0).argmax())
            order = part[np.argsort(along_axes[part, axis], kind="stable")]
            halves += [order[: len(order) // 2], order[len(order) // 2 :]]
        parts = halves
    label = np.empty(len(points), dtype=np.int64)
    for i, part in enumerate(parts):
        label[part] = i
    return label


def even_sample(points: Points, count: int) -> Indices:
    """Evenly spread sample of points: of each compact group, the one nearest to its mean.

    Parameters
    ----------
    points : (n, 3) float [m]
    count : int                     number of points requested

    Returns
    -------
    (k,) int                        indices, of the largest power of two up to `count`; all where
                                    there are no more than `count` points
    """
    if len(points) <= count:
        return np.arange(len(points))
    label = compact_groups(points, count)
    groups = int(label.max()) + 1
    size = np.bincount(label, minlength=groups)
    mean = np.stack([np.bincount(label, points[:, a], groups) for a in range(3)], axis=1)
    distance = np.linalg.norm(points - (mean / size[:, None])[label], axis=1)
    order = np.lexsort((distance, label))
    return order[np.searchsorted(label[order], np.arange(groups))]


def facing_surface(mesh: TriangleMesh, viewpoint: Vector3, *, angle: float) -> TriangleMesh:
    """The triangles that face a viewpoint, or would after a rotation by an angle.

    Parameters
    ----------
    mesh : TriangleMesh
    viewpoint : (3,) float [m]      from which the surface is seen
    angle : float [rad]

    Returns
    -------
    TriangleMesh                    the whole mesh if no triangle faces the viewpoint
    """
    area = area_vectors(mesh)
    sight = viewpoint - mesh.vertices[mesh.triangles].mean(axis=1)
    cosine = np.einsum("ma,ma->m", area, sight)
    limit = -np.sin(angle) * np.linalg.norm(area, axis=1) * np.linalg.norm(sight, axis=1)
    facing = cosine > limit
    return TriangleMesh(mesh.vertices, mesh.triangles[facing]) if facing.any() else mesh


def coarse_pose(
    search: SurfaceSearch, points: Points, start: Pose, *, angle: float, distance: float
) -> Pose:
    """Pose of points on a surface from an inaccurate initial pose.

    Parameters
    ----------
    search : SurfaceSearch          of the part of the surface that may be visible
    points : (n, 3) float [m]       a few hundred, not collinear
    start : (4, 4) float            initial pose
    angle : float [rad]             largest error of its rotation
    distance : float [m]            largest error of its translation

    Returns
    -------
    (4, 4) float                    accurate to less than a hundredth of the mesh's diagonal; the
                                    start itself where its errors move points by less than a
                                    fiftieth

    Source
    ------
    Chen and Medioni, Object modelling by registration of multiple range images (1992), for the
    distance from tangent planes; the robust weight is Geman and McClure's.
    """
    diagonal = bounding_diagonal(search.mesh)
    spacing = _SAMPLE_SPACING * diagonal
    if distance + 0.5 * angle * diagonal < spacing:
        return start
    sample, normal = _surface_samples(search.mesh, spacing)
    tree = cKDTree(sample)
    first = placed(start, points)
    centre = first.mean(axis=0)
    starts = _spread_starts(first - centre, 0.6 * angle, 0.6 * distance)
    positions = np.stack([placed(motion_pose(motion, centre), first) for motion in starts])
    width = distance
    # All tries move the same cloud of points, so their motions have the same scale.
    scale = motion_scale(first - centre)
    for _ in range(_COARSE_ITERATIONS):
        positions = _stepped(positions, tree, sample, normal, scale, width)
        width = max(_SHRINK * width, spacing)
    best = _nearest_of_the_best(search, positions, first)
    return _rigid(points, positions[best])


def initial_pose(
    points: Points,
    mesh: TriangleMesh,
    *,
    start: Pose,
    viewpoint: Vector3,
    angle: float,
    distance: float,
    count: int,
) -> Pose:
    """Initial pose for a registration, the best of many tries (`coarse_pose`).

    Parameters
    ----------
    points : (n, 3) float [m]       of the surface, in any frame
    mesh : TriangleMesh
    start : (4, 4) float            guess of the pose
    viewpoint : (3,) float [m]      from which the points were seen, in their frame
    angle : float [rad]             largest error of the guess's rotation
    distance : float [m]            largest error of its translation
    count : int                     number of points that are used

    Returns
    -------
    (4, 4) float [m]                as of `coarse_pose`
    """
    seen = facing_surface(mesh, placed(start, viewpoint[None])[0], angle=angle)
    sample = points[even_sample(points, count)]
    return coarse_pose(surface_search(seen), sample, start, angle=angle, distance=distance)


def _surface_samples(mesh: TriangleMesh, spacing: float) -> tuple[Points, Points]:
    """Points of the surface about `spacing` apart, and the normals there."""

    def is_large(corner: Float[np.ndarray, "k 3 3"]) -> Flags:
        length = np.linalg.norm(corner[:, [1, 2, 0]] - corner, axis=2)
        return length.max(axis=1) > 1.5 * spacing

    pieces, owner = small_pieces(mesh.vertices[mesh.triangles], is_large)
    area = area_vectors(mesh)
    normal = area / np.maximum(np.linalg.norm(area, axis=1), np.finfo(float).tiny)[:, None]
    return pieces.mean(axis=1), normal[owner]


def _spread_starts(offset: Points, angle: float, distance: float) -> Float[np.ndarray, "s 6"]:
    """Motions over the uncertainty of the guess: a grid of translations along the principal axes,
    and rotations about these."""
    axes = np.linalg.eigh(offset.T @ offset)[1].T
    grid = np.stack(np.meshgrid(*[[0.0, -1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    translations = np.hstack([np.zeros_like(grid), distance * grid @ axes])
    rotations = np.hstack([angle * np.concatenate([axes, -axes]), np.zeros((6, 3))])
    return np.concatenate([translations, rotations])


def _stepped(
    positions: Float[np.ndarray, "s n 3"],
    tree: cKDTree,
    sample: Float[np.ndarray, "p 3"],
    normal: Float[np.ndarray, "p 3"],
    scale: Float[np.ndarray, "6 6"],
    width: float,
) -> Float[np.ndarray, "s n 3"]:
    """One robust step of every try towards the tangent planes of the nearest samples."""
    distance, index = tree.query(positions)
    n = normal[index]
    residual = np.einsum("sna,sna->sn", n, positions - sample[index])
    weight = 1.0 / (1.0 + (distance / width) ** 2) ** 2
    centre = positions.mean(axis=1)
    offset = positions - centre[:, None]
    row = np.concatenate([np.cross(offset, n), n], axis=2) @ scale
    weighted = (weight[..., None] * row).swapaxes(1, 2)
    matrix = weighted @ row
    # A little damping, so that motions which the shape does not determine keep their value.
    damping = 1e-3 * np.einsum("sii->s", matrix) / 6.0
    matrix = matrix + damping[:, None, None] * np.eye(6)
    step = -np.linalg.solve(matrix, weighted @ residual[..., None])[..., 0] @ scale.T
    rotation = Rotation.from_rotvec(step[:, :3]).as_matrix()
    return offset @ rotation.swapaxes(1, 2) + (centre + step[:, 3:])[:, None]


def _nearest_of_the_best(
    search: SurfaceSearch, positions: Float[np.ndarray, "s n 3"], first: Points
) -> int:
    """Index of the try whose points lie nearest to the surface, by the mean truncated square.

    Tries within a few per cent of the lowest cost are equally good: of these, the one that moved
    the points least is taken.
    """
    distance = search.closest(positions.reshape(-1, 3)).distance.reshape(positions.shape[:2])
    typical = float(np.median(distance, axis=1).min())
    width = max(4.0 * typical, 1e-4 * bounding_diagonal(search.mesh))
    cost = np.minimum((distance / width) ** 2, 1.0).mean(axis=1)
    displacement = np.sqrt(((positions - first) ** 2).sum(axis=2).mean(axis=1))
    good = cost <= _COST_TOLERANCE * cost.min()
    return int(np.where(good, displacement, np.inf).argmin())


def _rigid(points: Points, positions: Points) -> Pose:
    """The pose that maps points to places."""
    a, b = points - points.mean(axis=0), positions - positions.mean(axis=0)
    rotation, _ = Rotation.align_vectors(b, a)
    pose = np.eye(4)
    pose[:3, :3] = rotation.as_matrix()
    pose[:3, 3] = positions.mean(axis=0) - pose[:3, :3] @ points.mean(axis=0)
    return pose
