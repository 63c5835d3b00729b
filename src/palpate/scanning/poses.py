"""Poses of views: as given, or estimated from the surface that overlapping views share.

Each view is registered to its predecessor by point-to-plane distances: first from many starts with
few points, then with up to some thousand points. A joint adjustment of all poses, which includes
all pairs of views found to overlap, closes the loop.

Source: Chen and Medioni, Object modelling by registration of multiple range images (1992); Pulli,
Multiview registration for large data sets (1999).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.progress import Progress, part_of, silent
from palpate.scanning.scan_file import Pose, View
from palpate.shapes import Points

# Points of a view for the many starts, and for the adjustment.
_FEW, _MANY = 250, 3000
# Angles of the starts about axes through the centroid of the points [degrees].
_TURNS = (0.0, 12.0, -12.0, 25.0, -25.0, 40.0, -40.0, 60.0, -60.0)
_AXES = 9
_COARSE_STEPS, _FINE_STEPS, _ROUNDS = 25, 40, 30
# Final width of the robust weights for distances from tangent planes, in standard deviations.
_WIDTH = 4.0
# Views overlap if this fraction of one's points lie on the other.
_MIN_OVERLAP = 0.4
# Test of determinacy: rms motion as a fraction of the size; if this fraction of the overlapping
# points still lie on the other view afterwards, the shape does not determine the pose.
_TRIAL, _STILL = 0.03, 0.8


@dataclass(frozen=True, slots=True, eq=False)
class _Cloud:
    """Subsampled points of a view with a search tree, median sigma and point spacing [m]."""

    points: Points
    normals: Points
    tree: cKDTree
    sigma: float
    spacing: float


def posed(views: Sequence[View], *, progress: Progress = silent) -> tuple[View, ...]:
    """Transform the views to the object's frame, estimating their poses if not given.

    Parameters
    ----------
    views : sequence of View        all with a pose; or all without, in the order they were taken,
                                    and the object's frame is then that of the first
    progress : callable

    Returns
    -------
    tuple of View

    Raises
    ------
    InputError                      consecutive views do not overlap, or their shape does not
                                    determine the relative pose
    """
    if views[0].T_object_view is not None:
        return tuple(
            view.placed(np.eye(4) if view.T_object_view is None else view.T_object_view)
            for view in views
        )
    clouds = [_cloud(view, _MANY) for view in views]
    poses = [np.eye(4)]
    step = np.eye(4)
    for k in range(1, len(views)):
        progress(f"pose {k + 1} of {len(views)}", 0.7 * k / len(views))
        # On a turntable every step repeats the previous one.
        step = _pair_pose(views[k - 1], views[k], clouds[k - 1], clouds[k], guess=step)
        poses.append(poses[-1] @ step)
    if len(views) > 1:
        poses = _adjusted(clouds, poses, progress=part_of(progress, 0.7, 1.0))
        _check_fixed(views, clouds, poses)
    return tuple(view.placed(pose) for view, pose in zip(views, poses, strict=True))


def _cloud(view: View, count: int) -> _Cloud:
    step = max(1, len(view.points) // count)
    points, normals = view.points[::step], view.normals[::step]
    tree = cKDTree(points)
    spacing = float(np.median(tree.query(points, k=2)[0][:, 1]))
    return _Cloud(points, normals, tree, float(np.median(view.sigma)), spacing)


def _pair_pose(first: View, second: View, a: _Cloud, b: _Cloud, *, guess: Pose) -> Pose:
    """Pose T_first_second from the shape that both views show."""
    few = _cloud(second, _FEW)
    size = float(np.linalg.norm(np.ptp(few.points, axis=0)))
    centre = few.points.mean(axis=0)
    turns = (np.radians(angle) * axis for axis in _axes() for angle in _TURNS)
    starts = [guess, *(_motion(turn, np.zeros(3), centre) for turn in turns)]
    costs, poses = [], []
    for start in starts:
        pose = start
        for width in size * np.geomspace(0.1, 0.01, _COARSE_STEPS):
            pose = _stepped(a, few, pose, width)
        costs.append(_cost(a, few, pose, 0.01 * size))
        poses.append(pose)
        if start is guess and not np.array_equal(guess, np.eye(4)) and costs[0] < 0.35:
            break
    pose = poses[int(np.argmin(costs))]
    for width in np.geomspace(0.01 * size, _WIDTH * max(a.sigma, b.sigma), _FINE_STEPS):
        pose = _stepped(a, b, pose, width)
    overlap = _overlap(a, b, pose)
    if overlap < _MIN_OVERLAP:
        raise InputError(
            f"views '{first.name}' and '{second.name}' do not overlap: {100.0 * overlap:.0f} % of"
            f" the points of one lie on the other, {100.0 * _MIN_OVERLAP:.0f} % are needed; take"
            " views between, not more than 40 degrees apart, or give their poses"
        )
    return pose


def _axes() -> Float[np.ndarray, "a 3"]:
    """Directions distributed over a hemisphere."""
    k = np.arange(_AXES) + 0.5
    z, turn = k / _AXES, np.pi * (1.0 + 5.0**0.5) * k
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)


def _compared(
    a: _Cloud, b: _Cloud, pose: Pose
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points of b in a's frame, normals of the nearest points of a, distances from these and from
    their tangent planes, cosines between the normals."""
    points = b.points @ pose[:3, :3].T + pose[:3, 3]
    gap, index = a.tree.query(points)
    normal = a.normals[index]
    height = np.einsum("na,na->n", points - a.points[index], normal)
    return points, normal, gap, height, np.einsum("na,na->n", b.normals @ pose[:3, :3].T, normal)


def _matched(
    a: _Cloud, b: _Cloud, pose: Pose, width: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points of b in a's frame, normals of a there, distances from a's tangent planes, weights."""
    points, normal, gap, height, facing = _compared(a, b, pose)
    weight = 1.0 / (1.0 + (height / width) ** 2) ** 2
    # Points without a counterpart, or on another side of the object, get no weight.
    weight *= 1.0 / (1.0 + (gap / (3.0 * width + a.spacing)) ** 2) ** 2
    weight *= facing > 0.5
    return points, normal, height, weight


def _stepped(a: _Cloud, b: _Cloud, pose: Pose, width: float) -> Pose:
    """One weighted point-to-plane step of b towards a's tangent planes."""
    points, normal, height, weight = _matched(a, b, pose, width)
    if weight.sum() < 10.0 * np.finfo(float).eps:
        return pose
    centre = points.mean(axis=0)
    scale = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
    row = np.hstack([np.cross((points - centre) / scale, normal), normal])
    matrix = row.T @ (weight[:, None] * row)
    matrix += 1e-4 * np.trace(matrix) / 6.0 * np.eye(6)
    move = -np.linalg.solve(matrix, row.T @ (weight * height))
    return _motion(move[:3] / scale, move[3:], centre) @ pose


def _motion(turn: np.ndarray, shift: np.ndarray, centre: np.ndarray) -> Pose:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    pose[:3, 3] = centre + shift - pose[:3, :3] @ centre
    return pose


def _cost(a: _Cloud, b: _Cloud, pose: Pose, width: float) -> float:
    """Fraction of the points of b that do not lie on a, with soft weights: 0 to 1."""
    *_, weight = _matched(a, b, pose, width)
    return 1.0 - float(weight.mean())


def _overlap(a: _Cloud, b: _Cloud, pose: Pose) -> float:
    """Fraction of the points of b that lie on a."""
    _, _, gap, height, facing = _compared(a, b, pose)
    near = (gap < 3.0 * a.spacing) & (abs(height) < _WIDTH * max(a.sigma, b.sigma))
    return float((near & (facing > 0.7)).mean())


def _adjusted(clouds: Sequence[_Cloud], poses: list[Pose], *, progress: Progress) -> list[Pose]:
    """Adjust all poses jointly, so that errors along the chain are distributed over the loop."""
    count = len(clouds)
    for round_ in range(_ROUNDS):
        progress("closing the loop", round_ / _ROUNDS)
        if round_ % 10 == 0:
            pairs = _overlapping(clouds, poses)
        centre = np.mean([p[:3, :3] @ c.points.mean(axis=0) + p[:3, 3]
                          for p, c in zip(poses, clouds, strict=True)], axis=0)  # fmt: skip
        matrix, right = np.zeros((count, 6, count, 6)), np.zeros((count, 6))
        scale = float(np.linalg.norm(np.ptp(clouds[0].points, axis=0)))
        for i, j in pairs:
            block, side = _pair_equations(clouds[i], clouds[j], poses[i], poses[j], centre, scale)
            for k, m, sign in ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)):
                matrix[k, :, m] += sign * block
            right[j] += side
            right[i] -= side
        free = matrix[1:, :, 1:].reshape(6 * (count - 1), -1)
        free = free + 1e-9 * np.trace(free) / len(free) * np.eye(len(free))
        move = -np.linalg.solve(free, right[1:].ravel()).reshape(-1, 6)
        for k, (turn, shift) in enumerate(zip(move[:, :3] / scale, move[:, 3:], strict=True)):
            poses[k + 1] = _motion(turn, shift, centre) @ poses[k + 1]
        if abs(move).max() < 1e-7 * scale:
            break
    return poses


def _overlapping(clouds: Sequence[_Cloud], poses: list[Pose]) -> list[tuple[int, int]]:
    """Ordered pairs of views that overlap; consecutive views in any case."""
    pairs = []
    for i in range(len(clouds)):
        for j in range(len(clouds)):
            if i == j:
                continue
            between = np.linalg.inv(poses[i]) @ poses[j]
            wide = _cost(clouds[i], clouds[j], between, 0.01 * _size(clouds[i]))
            if abs(i - j) == 1 or wide < 1.0 - _MIN_OVERLAP:
                pairs.append((i, j))
    return pairs


def _size(cloud: _Cloud) -> float:
    return float(np.linalg.norm(np.ptp(cloud.points, axis=0)))


def _pair_equations(
    a: _Cloud, b: _Cloud, first: Pose, second: Pose, centre: np.ndarray, scale: float
) -> tuple[Float[np.ndarray, "6 6"], Float[np.ndarray, "6"]]:
    """Normal equations of the motion of b's view relative to a's, in the common frame."""
    width = _WIDTH * max(a.sigma, b.sigma)
    points, normal, height, weight = _matched(a, b, np.linalg.inv(first) @ second, width)
    points, normal = points @ first[:3, :3].T + first[:3, 3], normal @ first[:3, :3].T
    row = np.hstack([np.cross((points - centre) / scale, normal), normal])
    weighted = row.T * (weight / (a.sigma**2 + b.sigma**2))
    return weighted @ row, weighted @ height


def _check_fixed(views: Sequence[View], clouds: Sequence[_Cloud], poses: list[Pose]) -> None:
    """Raise if the shape, such as a sphere, does not determine the pose of a view."""
    for k in range(1, len(clouds)):
        a, b = clouds[k - 1], clouds[k]
        pose = np.linalg.inv(poses[k - 1]) @ poses[k]
        points, normal, _, weight = _matched(a, b, pose, _WIDTH * max(a.sigma, b.sigma))
        centre = points.mean(axis=0)
        scale = float(np.sqrt(((points - centre) ** 2).sum(axis=1).mean()))
        row = np.hstack([np.cross((points - centre) / scale, normal), normal])
        _, vectors = np.linalg.eigh(row.T @ (weight[:, None] * row))
        weakest = vectors[:, 0]
        moved = np.cross(weakest[:3], (points - centre) / scale) + weakest[3:]
        length = _TRIAL * _size(b) / float(np.sqrt((moved**2).sum(axis=1).mean()))
        still = [
            _overlap(a, b, _motion(s * weakest[:3] / scale, s * weakest[3:], centre) @ pose)
            for s in (length, -length)
        ]
        if min(still) > _STILL * _overlap(a, b, pose):
            raise InputError(
                f"the shape does not fix how view '{views[k].name}' lies against"
                f" '{views[k - 1].name}': moved by {1e3 * _TRIAL * _size(b):.2g} mm its points lie"
                " on the surface as well, as on a ball or a cylinder; give the poses, or the"
                " turntable with the angle of every view"
            )
