"""Coarse registration: many starts, few points, a robust norm of decreasing width.

The distance of a few hundred points from a cloud of surface samples is reduced from many initial
poses, spread over the uncertainty of the guess, in parallel. The pose whose points end nearest to
the surface is returned.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palpate.geometry.closest_point import SurfaceSearch, small_pieces, surface_search
from palpate.geometry.registration.surface_fit import Pose, motion_pose, motion_scale, placed
from palpate.geometry.triangle_mesh import TriangleMesh, area_vectors, bounding_diagonal
from palpate.shapes import Flags, Indices, PointIndices, Points, Vector3

# Spacing of the surface samples over the mesh's diagonal: finer than the basin of convergence of
# the fit that follows.
_SPACING = 1.0 / 50.0
_ITERATIONS = 30
# Factor by which the norm's width shrinks per step, from the uncertainty of the guess to the
# spacing of the samples.
_SHRINK = 0.75
# Poses whose cost is within this factor of the lowest are equally good: of these, the one nearest
# to the start is taken.
_COST_TOLERANCE = 1.05


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
    own = centred @ np.linalg.eigh(centred.T @ centred)[1]
    parts = [np.arange(len(points))]
    while 2 * len(parts) <= min(count, len(points)):
        halves = []
        for part in parts:
            axis = int(np.ptp(own[part], axis=0).argmax())
            order = part[np.argsort(own[part, axis], kind="stable")]
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
    spacing = _SPACING * diagonal
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
    for _ in range(_ITERATIONS):
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
