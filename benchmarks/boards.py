"""Boards before cameras of a known rig: their corners, and pictures drawn by casting rays."""

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.calibration.adjustment import Bundle, Corners
from palpate.calibration.lens_model import seen_points
from palpate.records import Camera, camera_matrix
from palpate.vision import normalised

SIZE = (1280, 1024)


def board_points(columns: int = 9, rows: int = 7, square: float = 0.012) -> np.ndarray:
    """Inner corners of a chessboard, centred, (n, 3) float [m]."""
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2)
    return np.column_stack([square * (grid - grid.mean(axis=0)), np.zeros(len(grid))])


def true_bundle(rng: np.random.Generator, *, cameras: int = 3, views: int = 25) -> Bundle:
    """Cameras 60 mm apart that look at boards 0.36 m away, tilted by up to 40 degrees."""
    inner = np.array([1800.0, 1805.0, 642.0, 508.0, -0.11, 0.09, 3e-4, -5e-4, 0.02])
    lens = inner * (1.0 + 0.01 * rng.normal(size=(cameras, 9)))
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
    for c, (inner, pose) in enumerate(zip(bundle.inner, bundle.camera, strict=True)):
        for v, view in enumerate(bundle.view):
            whole = pose @ view
            place = points @ whole[:3, :3].T + whole[:3, 3]
            pixel, _, _ = seen_points(np.tile(inner, (len(place), 1)), place)
            inside = ((pixel > 5.0) & (pixel < np.array(SIZE) - 6.0)).all(axis=1)
            if inside.sum() < 12:
                continue
            which = np.full(int(inside.sum()), c), np.full(int(inside.sum()), v)
            parts.append((*which, points[inside], pixel[inside]))
    camera, view, point, pixel = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Corners(camera, view, point, pixel + noise * rng.normal(size=pixel.shape))


def draw_board(
    texture: np.ndarray,
    extent: tuple[float, float],
    inner: np.ndarray,
    pose: np.ndarray,
    size: tuple[int, int],
    *,
    rng: np.random.Generator,
    noise: float = 2.0,
    parts: int = 2,
) -> np.ndarray:
    """A grey picture of a board with its upper left corner at the origin of its frame.

    `texture` covers `extent` [m] of it and is white beyond; every pixel is the mean of parts^2
    rays, so that edges are as sharp as a perfect sensor's.
    """
    camera = Camera("c", None, camera_matrix(inner[:4]), inner[4:], np.eye(4))
    columns, rows = size
    away = (np.arange(parts) + 0.5) / parts - 0.5
    total = np.zeros(rows * columns)
    row, column = np.indices((rows, columns)).reshape(2, -1)
    turn, shift = pose[:3, :3], pose[:3, 3]
    for dy in away:
        for dx in away:
            flat = normalised(camera, np.column_stack([column + dx, row + dy]))
            ray = np.column_stack([flat, np.ones(len(flat))])
            # (t ray - shift) lies in the plane z = 0 of the board.
            depth = (turn[:, 2] @ shift) / (ray @ turn[:, 2])
            place = (depth[:, None] * ray - shift) @ turn
            u = np.floor(place[:, 0] / extent[0] * texture.shape[1]).astype(np.int64)
            v = np.floor(place[:, 1] / extent[1] * texture.shape[0]).astype(np.int64)
            inside = (u >= 0) & (v >= 0) & (u < texture.shape[1]) & (v < texture.shape[0])
            grey = np.full(len(flat), 235.0)
            grey[inside] = 25.0 + 0.82 * texture[v[inside], u[inside]]
            total += grey / parts**2
    levels = total + noise * rng.normal(size=total.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8).reshape(rows, columns)
