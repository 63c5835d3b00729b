"""Initial lenses and poses: each camera by itself, then the cameras relative to each other."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

from palpate.calibration.adjustment import Bundle, Corners
from palpate.calibration.sightings import Sightings
from palpate.calibration.targets import Target
from palpate.errors import CalibrationError
from palpate.records import camera_matrix, make_pose

# Largest difference between poses of one board, rotation [rad] plus shift over distance: from one
# camera alone they are accurate to a few degrees or per cent; at different instants they differ by
# more.
_MAX_DIFFERENCE = 0.1
# With fewer views, a camera's lens cannot be separated from the boards' poses.
_MIN_VIEWS = 3
Pose = Float[np.ndarray, "4 4"]


def start_bundle(
    found: Sightings, targets: Sequence[Target]
) -> tuple[Bundle, Corners, Bool[np.ndarray, " v"]]:
    """Initial cameras and board poses for the bundle adjustment.

    Parameters
    ----------
    found : Sightings
    targets : sequence of Target    the boards in `found`

    Returns
    -------
    bundle : Bundle
    corners : Corners               those found; marks of boards that look the same after half a
                                    turn are numbered consistently in all cameras
    inconsistent : (v,) bool        views whose board poses differ between cameras

    Raises
    ------
    CalibrationError                too few views of a camera; cameras that share no view; board
                                    poses of a camera that mostly contradict the others
    """
    intrinsics, poses = [], []
    for c, name in enumerate(found.cameras):
        lens, seen = _single_camera(found, c)
        if len(seen) < _MIN_VIEWS:
            raise CalibrationError(
                f"camera '{name}': the board was found in {len(seen)} views; at least {_MIN_VIEWS}"
                " are needed, and 15 to 25 tilted to all sides are good"
            )
        intrinsics.append(lens)
        poses.append(seen)
    camera, view, turned, inconsistent = _placed(found, targets, poses)
    mark = found.mark.copy()
    for c, v in turned:
        rows = (found.corners.camera == c) & (found.corners.view == v)
        mark[rows] = np.asarray(targets[found.targets[v]].turned)[mark[rows]]
    point = found.corners.point.copy()
    for k, target in enumerate(targets):
        rows = np.array(found.targets)[found.corners.view] == k
        point[rows] = target.points[mark[rows]]
    corners = Corners(found.corners.camera, found.corners.view, point, found.corners.pixel)
    flags = np.isin(np.arange(len(view)), inconsistent)
    return Bundle(np.stack(intrinsics), np.stack(camera), np.stack(view)), corners, flags


def _single_camera(found: Sightings, c: int) -> tuple[Float[np.ndarray, "9"], dict[int, Pose]]:
    """Lens of one camera, and the poses of the boards it sees in its own frame."""
    mine = found.corners.chosen(found.corners.camera == c)
    views = np.unique(mine.view)
    points = [mine.point[mine.view == v].astype(np.float32) for v in views]
    pixels = [mine.pixel[mine.view == v].astype(np.float32) for v in views]
    if len(views) < _MIN_VIEWS:
        return np.zeros(9), {int(v): np.eye(4) for v in views}
    size = found.sizes[c]
    # Few views may not determine k3; without it the start is closer.
    _, matrix, lens, turn, shift = cv2.calibrateCamera(
        points, pixels, size, camera_matrix(np.zeros(4)), np.zeros(5), flags=cv2.CALIB_FIX_K3
    )
    intrinsics = np.array(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *lens.ravel()[:5]]
    )
    poses = {
        int(v): make_pose(Rotation.from_rotvec(r.ravel()).as_matrix(), t.ravel())
        for v, r, t in zip(views, turn, shift, strict=True)
    }
    return intrinsics, poses


def _placed(
    found: Sightings, targets: Sequence[Target], poses: Sequence[Mapping[int, Pose]]
) -> tuple[list[Pose], list[Pose], list[tuple[int, int]], list[int]]:
    """Poses of cameras and views in the first camera's frame; pairs (camera, view) whose marks are
    numbered the other way round; views whose poses differ between cameras."""
    camera: dict[int, Pose] = {0: np.eye(4)}
    view: dict[int, Pose] = dict(poses[0])
    turned: list[tuple[int, int]] = []
    inconsistent: list[int] = []
    while len(camera) < len(poses):
        remaining = [c for c in range(len(poses)) if c not in camera]
        best = max(remaining, key=lambda c: len(view.keys() & poses[c].keys()))
        common = sorted(view.keys() & poses[best].keys())
        if not common:
            names = ", ".join(f"'{found.cameras[c]}'" for c in remaining)
            raise CalibrationError(
                f"cameras {names} share no view of a board with the others: take pictures of the"
                " board where two cameras see it at the same instant; files of one instant must"
                " have the same name in every camera's folder"
            )
        turns = {v: half_turn(targets[found.targets[v]]) for v in poses[best]}
        pose, flipped, gaps = _agreed(view, poses[best], common, turns)
        difference = float(np.median(gaps))
        inconsistent += [v for v, gap in zip(common, gaps, strict=True) if gap > _MAX_DIFFERENCE]
        if difference > _MAX_DIFFERENCE:
            raise CalibrationError(
                f"camera '{found.cameras[best]}' and the others do not see the board at the same"
                f" place: its poses differ by {100 * difference:.0f} % of the distance in"
                f" the median of {len(common)} common views; were pictures of the same name taken"
                " at the same instant? To calibrate the lens of one camera alone, give its own"
                " folder"
            )
        camera[best] = pose
        turned += [(best, v) for v in flipped]
        for v, seen in poses[best].items():
            view.setdefault(v, np.linalg.inv(pose) @ seen)
    posed = [camera[c] for c in range(len(poses))], [view[v] for v in range(len(view))]
    return *posed, turned, inconsistent


def half_turn(target: Target) -> Pose | None:
    """Half-turn symmetry of a target: the motion that maps it onto itself; None if it has none.

    Parameters
    ----------
    target : Target

    Returns
    -------
    (4, 4) float [m] or None        in the target's frame
    """
    if target.turned is None:
        return None
    pose = np.diag([-1.0, -1.0, 1.0, 1.0])
    pose[:3, 3] = target.points[0] + target.points[-1]
    return pose


def _agreed(
    view: Mapping[int, Pose],
    seen: Mapping[int, Pose],
    common: Sequence[int],
    turns: Mapping[int, Pose | None],
) -> tuple[Pose, list[int], list[float]]:
    """Pose of a camera with the smallest median distance to those from the shared views; the views
    seen after half a turn; and the distance of every shared view from it."""
    tries: list[list[Pose]] = []
    for v in common:
        back = np.linalg.inv(view[v])
        candidates = [np.eye(4)] if turns[v] is None else [np.eye(4), turns[v]]
        tries.append([seen[v] @ way @ back for way in candidates])
    size = np.median([np.linalg.norm(view[v][:3, 3]) for v in common])

    def difference(a: Pose, b: Pose) -> float:
        angle = Rotation.from_matrix(a[:3, :3] @ b[:3, :3].T).magnitude()
        return float(angle + np.linalg.norm(a[:3, 3] - b[:3, 3]) / size)

    def gaps(pose: Pose) -> list[float]:
        return [min(difference(pose, other) for other in candidates) for candidates in tries]

    def cost(pose: Pose) -> float:
        return float(np.median(gaps(pose)))

    best = min((pose for candidates in tries for pose in candidates), key=cost)
    flipped = [
        v
        for v, candidates in zip(common, tries, strict=True)
        if len(candidates) > 1 and difference(best, candidates[1]) < difference(best, candidates[0])
    ]
    return best, flipped, gaps(best)
