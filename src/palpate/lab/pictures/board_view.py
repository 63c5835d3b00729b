"""Picture of a flat printed board, by tracing rays from the camera's pixels to the print."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.records import Camera, picture_size
from palpate.vision import normalised

# Grey levels of ink, of paper, and of the background beyond the board.
_INK, _PAPER, _BEYOND = 25.0, 235.0, 235.0


def board_picture(
    camera: Camera,
    T_object_board: Float[np.ndarray, "4 4"],
    print_: UInt8[np.ndarray, "_ _"],
    extent: tuple[float, float],
    *,
    rng: np.random.Generator,
    noise: float,
    rays: int = 2,
    blur: float = 0.0,
) -> UInt8[np.ndarray, "_ _"]:
    """A picture of a board under uniform light.

    Parameters
    ----------
    camera : Camera                 with its picture size
    T_object_board : (4, 4) float   pose of the board, translation in metres; its upper left corner
                                    is the origin, x along its rows, y down; it is seen from z < 0
    print_ : (rows, columns) uint8  the printed pattern: 0 ink, 255 paper
    extent : (float, float) [m]     width and height of the board
    rng : Generator                 of the noise
    noise : float [grey levels]     standard deviation of a pixel
    rays : int                      rays per pixel along each axis, which are averaged; 2 are as
                                    sharp as an ideal image sensor
    blur : float [px]               standard deviation of the blur of lens and sensor

    Returns
    -------
    (rows, columns) uint8
    """
    columns, rows = picture_size(camera)
    pose = camera.T_camera_object @ T_object_board
    turn, shift = pose[:3, :3], pose[:3, 3]
    row, column = np.indices((rows, columns)).reshape(2, -1)
    total = np.zeros(rows * columns)
    for dy, dx in np.ndindex(rays, rays):
        away = (np.array([dx, dy]) + 0.5) / rays - 0.5
        flat = normalised(camera, np.column_stack([column, row]) + away)
        ray = np.column_stack([flat, np.ones(len(flat))])
        # (t ray - shift) lies in the plane z = 0 of the board.
        depth = (turn[:, 2] @ shift) / (ray @ turn[:, 2])
        place = (depth[:, None] * ray - shift) @ turn
        u = np.floor(place[:, 0] / extent[0] * print_.shape[1]).astype(np.int64)
        v = np.floor(place[:, 1] / extent[1] * print_.shape[0]).astype(np.int64)
        on = (depth > 0.0) & (u >= 0) & (v >= 0) & (u < print_.shape[1]) & (v < print_.shape[0])
        grey = np.full(len(flat), _BEYOND)
        grey[on] = _INK + (_PAPER - _INK) / 255.0 * print_[v[on], u[on]]
        total += grey / rays**2
    levels = total.reshape(rows, columns)
    if blur > 0.0:
        levels = cv2.GaussianBlur(levels, (0, 0), blur)
    levels += noise * rng.normal(size=levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
