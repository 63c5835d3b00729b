"""Boards before cameras of a known rig: their corners, and pictures drawn by casting rays."""

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.calibration import Target
from palpate.calibration.adjustment import Bundle, Corners, seen_points
from palpate.calibration.sightings import Sightings
from palpate.lab.head import board_picture
from palpate.records import Camera, camera_matrix

SIZE = (1280, 1024)


def board_points(columns: int = 9, rows: int = 7, square: float = 0.012) -> np.ndarray:
    """Inner corners of a chessboard, centred, (n, 3) float [m]."""
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return np.column_stack([square * (grid - grid.mean(axis=0)), np.zeros(len(grid))])


def true_bundle(rng: np.random.Generator, *, cameras: int = 3, views: int = 25) -> Bundle:
    """Cameras 60 mm apart that look at boards 0.36 m away, tilted by up to 40 degrees."""
    intrinsics = np.array([1800.0, 1805.0, 642.0, 508.0, -0.11, 0.09, 3e-4, -5e-4, 0.02])
    lens = intrinsics * (1.0 + 0.01 * rng.normal(size=(cameras, 9)))
    pose = np.tile(np.eye(4), (cameras, 1, 1))
    for c in range(cameras):
        turn = np.deg2rad([0.0, 9.0 * c, 1.0 * c])
        pose[c, :3, :3] = Rotation.from_rotvec(turn).as_matrix()
        pose[c, :3, 3] = [-0.06 * c, 0.002 * c, 0.004 * c]
    view = np.tile(np.eye(4), (views, 1, 1))
    for v in range(views):
        tilt = np.deg2rad(rng.uniform(-40.0, 40.0, 3) * [1.0, 1.0, 2.0])
        view[v, :3, :3] = Rotation.from_rotvec(tilt).as_matrix()
        view[v, :3, 3] = rng.uniform(-1.0, 1.0, 3) * [0.04, 0.03, 0.06] + [0.0, 0.0, 0.36]
    return Bundle(lens, pose, view)


def seen_corners(
    bundle: Bundle, points: np.ndarray, rng: np.random.Generator, *, noise: float
) -> Corners:
    """Every corner within the picture of each camera, a dozen at least, with normal errors."""
    parts = []
    for c, (intrinsics, pose) in enumerate(zip(bundle.intrinsics, bundle.camera, strict=True)):
        for v, view in enumerate(bundle.view):
            whole = pose @ view
            position = points @ whole[:3, :3].T + whole[:3, 3]
            pixel, _, _ = seen_points(intrinsics, position)
            inside = ((pixel > 5.0) & (pixel < np.array(SIZE) - 6.0)).all(axis=1)
            if inside.sum() < 12:
                continue
            which = np.full(int(inside.sum()), c), np.full(int(inside.sum()), v)
            parts.append((*which, points[inside], pixel[inside]))
    camera, view, point, pixel = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Corners(camera, view, point, pixel + noise * rng.normal(size=pixel.shape))


def sightings(
    corners: Corners, board: Target, cameras: int, size: tuple[int, int] = SIZE
) -> Sightings:
    """Corners as if they had been found in the pictures of c0, c1, ..., views 00, 01, ..."""
    mark = np.linalg.norm(corners.point[:, None] - board.points, axis=2).argmin(axis=1)
    views = int(corners.view.max()) + 1
    return Sightings(
        tuple(f"c{c}" for c in range(cameras)), (size,) * cameras,
        tuple(f"{v:02d}" for v in range(views)), (0,) * views, corners, mark, (),
    )  # fmt: skip


def bundle_errors(estimated: Bundle, truth: Bundle) -> np.ndarray:
    """Errors of all unknowns, as the covariance of an adjustment counts them."""

    def motion(pose: np.ndarray, true: np.ndarray) -> np.ndarray:
        turn = Rotation.from_matrix(pose[:, :3, :3] @ true[:, :3, :3].swapaxes(1, 2)).as_rotvec()
        return np.hstack([turn, pose[:, :3, 3] - true[:, :3, 3]]).ravel()

    return np.concatenate(
        [
            (estimated.intrinsics - truth.intrinsics).ravel(),
            motion(estimated.camera[1:], truth.camera[1:]),
            motion(estimated.view, truth.view),
        ]
    )


def draw_board(
    texture: np.ndarray,
    extent: tuple[float, float],
    intrinsics: np.ndarray,
    pose: np.ndarray,
    size: tuple[int, int],
    *,
    rng: np.random.Generator,
    noise: float = 2.0,
    blur: float = 0.0,
    parts: int = 2,
) -> np.ndarray:
    """A grey picture of a board with its upper left corner at the origin of its frame.

    `texture` covers `extent` [m] of it and is white beyond; every pixel is the mean of parts^2
    rays, so that edges are as sharp as a perfect sensor's.
    """
    camera = Camera("c", size, camera_matrix(intrinsics[:4]), intrinsics[4:], np.eye(4))
    return board_picture(camera, pose, texture, extent, rng=rng, noise=noise, rays=parts, blur=blur)
