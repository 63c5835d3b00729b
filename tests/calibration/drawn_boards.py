"""Pictures of flat boards, drawn by casting a ray through every part of a pixel."""

import numpy as np

from palpate.calibration.lens_model import camera_matrix
from palpate.records import Camera
from palpate.vision import normalised


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
    camera = Camera("c", None, camera_matrix(inner), inner[4:], np.eye(4))
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
