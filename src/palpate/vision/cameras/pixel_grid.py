"""The rays of all pixels of a camera at once, the lens undone."""

import numpy as np
from jaxtyping import Float
from numba import njit

from palpate.errors import InputError
from palpate.records import Camera
from palpate.threads import in_threads
from palpate.vision.cameras.lens import distort_kernel, lens_reach
from palpate.vision.cameras.projection import normalised, packed_camera

# A neighbour's ray and its change are good to about 1e-6; Newton squares that with each step.
_STEPS = 4
# What is left before the last step, which leaves its square: 1e-16.
_NEARLY = 1e-8
# Where the area of a pixel shrinks to this share the lens is about to fold over, and a square of
# 1e-8 divided by it would no longer be nothing: there every pixel is sought on its own.
_SMALLEST_AREA = 1e-2


def pixel_grid(camera: Camera, shape: tuple[int, int]) -> Float[np.ndarray, "2 rows columns"]:
    """Where the ray of every pixel centre meets the plane z = 1 of the camera.

    Several times faster than `normalised` on as many pixels, with the same result.

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]    of its pictures

    Returns
    -------
    (2, rows, columns) float [-]    x / z and y / z; NaN where the lens model has no such ray

    Raises
    ------
    InputError                      a shape that contradicts the camera's
    """
    rows, columns = shape
    if camera.size is not None and camera.size != (columns, rows):
        raise InputError(
            f"camera '{camera.name}' has {camera.size[0]} x {camera.size[1]} pixels; asked for"
            f" {columns} x {rows} (columns x rows)"
        )
    row = np.arange(rows, dtype=np.float64)
    k = camera.matrix
    if not camera.distortion.any():
        y = (row - k[1, 2]) / k[1, 1]
        x = (np.arange(columns) - k[0, 2] - k[0, 1] * y[:, None]) / k[0, 0]
        return np.stack([x, np.broadcast_to(y[:, None], x.shape)])
    middle = int(np.clip(k[0, 2], 0, columns - 1))
    grid = np.full((2, rows, columns), np.nan)
    grid[:, :, middle] = normalised(camera, np.stack([np.full(rows, float(middle)), row], 1)).T
    reach = lens_reach(camera.distortion)
    in_threads(_spread_kernel, rows, packed_camera(camera), reach, middle, grid)
    # Where the lens is about to fold over neighbours do not help.
    left = np.argwhere(np.isnan(grid[0]))
    if len(left):
        grid[:, left[:, 0], left[:, 1]] = normalised(camera, left[:, ::-1].astype(np.float64)).T
    return grid


@njit(cache=True, nogil=True, error_model="numpy")
def _spread_kernel(begin, end, c, reach, middle, grid):
    """Fill each row to both sides of its middle pixel; NaN from where that does not succeed."""
    columns = grid.shape[2]
    for i in range(begin, end):
        y = (i - c[3]) / c[1]
        for side in (-1, 1):
            a, b = grid[0, i, middle], grid[1, i, middle]
            step_a, step_b = side / c[0], 0.0
            j = middle + side
            while 0 <= j < columns:
                x = (j - c[2] - c[4] * y) / c[0]
                next_a, next_b = _refined_kernel(c, reach, x, y, a + step_a, b + step_b)
                if np.isnan(next_a):
                    break
                step_a, step_b = next_a - a, next_b - b
                a, b = next_a, next_b
                grid[0, i, j], grid[1, i, j] = a, b
                j += side


@njit(cache=True, error_model="numpy", inline="always")
def _refined_kernel(c, reach, x, y, a, b):
    """Place near (a, b) whose distorted place is (x, y); NaN where there is none."""
    for _ in range(_STEPS):
        u, v, xa, xb, yb = distort_kernel(c, a, b)
        area = xa * yb - xb * xb
        scale = 1.0 / area
        gap_x, gap_y = x - u, y - v
        a += (yb * gap_x - xb * gap_y) * scale
        b += (xa * gap_y - xb * gap_x) * scale
        if abs(gap_x) + abs(gap_y) <= _NEARLY:
            if a * a + b * b < reach * reach and area > _SMALLEST_AREA:
                return a, b
            break
    return np.nan, np.nan
