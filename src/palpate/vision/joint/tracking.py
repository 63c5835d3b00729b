"""From one later instant to the next, where the first one is too different to be matched with.

A surface that has moved far or lost its light may no longer resemble its first picture, but always
resembles the last one. What is followed from instant to instant adds up errors; so it is taken only
where the match with the first instant fails or is less certain, and the drift is measured on points
that were found both ways.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float

from palpate.shapes import Triangles
from palpate.vision.cameras import surface_map, visible
from palpate.vision.images import spline_pictures
from palpate.vision.joint.scene import Scene, inner_pixels
from palpate.vision.joint.settings import JointSettings


def grid_triangles(pixel: Float[np.ndarray, "n 2"], step: int) -> Triangles:
    """Triangles between points on a pixel grid: two for every cell that has all four corners.

    Parameters
    ----------
    pixel : (n, 2) float [px]       column, row
    step : int [px]                 spacing of the grid

    Returns
    -------
    (m, 3) int
    """
    if len(pixel) == 0:
        return np.zeros((0, 3), dtype=np.int64)
    cell = np.rint((pixel - pixel.min(axis=0)) / step).astype(np.int64)
    number = np.full(cell.max(axis=0) + 2, -1)
    number[cell[:, 0], cell[:, 1]] = np.arange(len(pixel))
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[:-1, 1:].ravel(), number[1:, 1:].ravel()
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    return np.concatenate(
        [
            np.stack([a[whole], c[whole], b[whole]], axis=1),
            np.stack([b[whole], c[whole], d[whole]], axis=1),
        ]
    )


def advanced_scene(
    scene: Scene,
    grey: tuple[Float[np.ndarray, "_ _"], ...],
    motion: Float[np.ndarray, "n 6 3"],
    valid: Bool[np.ndarray, " n"],
    *,
    settings: JointSettings,
) -> Scene:
    """The scene at a later instant, its surface where it has moved to.

    Parameters
    ----------
    scene : Scene                   the first instant
    grey : tuple of c (rows, columns) float     pictures of the later instant
    motion : (n, 6, 3) float [m]    from the first instant, used where valid
    valid : (n,) bool
    settings : JointSettings        spacing of the points, smoothing

    Returns
    -------
    Scene                           of the same n points; those not valid are seen by no camera
    """
    moved = scene.point + np.where(valid[:, None], motion[:, 0], 0.0)
    rows = np.flatnonzero(valid)
    triangles = grid_triangles(scene.pixel[rows], settings.step)
    maps = [
        surface_map(camera, picture.shape, moved[rows], triangles)
        for camera, picture in zip(scene.rig.cameras, grey, strict=True)
    ]
    seen = np.stack(
        [
            visible(one, camera, moved, tolerance=float(np.median(scene.extent)))
            for one, camera in zip(maps, scene.rig.cameras, strict=True)
        ],
        axis=1,
    )
    return replace(
        scene,
        grey=grey,
        pictures=spline_pictures(grey, settings.smoothing),
        surface=tuple(np.ascontiguousarray(one.point, dtype=np.float32) for one in maps),
        inner=tuple(
            inner_pixels(one, camera) for one, camera in zip(maps, scene.rig.cameras, strict=True)
        ),
        point=moved,
        tangent=_turned(scene.tangent, motion, scene.extent, valid),
        seen=seen & scene.seen & valid[:, None],
    )


def composed_motion(
    before: Float[np.ndarray, "k 6 3"],
    after: Float[np.ndarray, "k 6 3"],
    first: Float[np.ndarray, "k 2 3"],
    second: Float[np.ndarray, "k 2 3"],
    extent: Float[np.ndarray, " k"],
) -> Float[np.ndarray, "k 6 3"]:
    """One motion after another, with its first derivatives.

    Parameters
    ----------
    before, after : (k, 6, 3) float [m]     see `refine_joint`
    first, second : (k, 2, 3) float         tangents that their derivatives are taken along
    extent : (k,) float [m]

    Returns
    -------
    (k, 6, 3) float [m]                     second-order terms are zero
    """
    size = extent[:, None, None]
    images = first + before[:, 1:3] / size
    # Each image is a sum of the second tangents and a small normal part, which turns along.
    share = np.einsum("kai,kbi->kab", images, second)
    result = np.zeros_like(before)
    result[:, 0] = before[:, 0] + after[:, 0]
    result[:, 1:3] = before[:, 1:3] + np.einsum("kab,kbi->kai", share, after[:, 1:3])
    return result


def _turned(
    tangent: Float[np.ndarray, "n 2 3"],
    motion: Float[np.ndarray, "n 6 3"],
    extent: Float[np.ndarray, " n"],
    valid: Bool[np.ndarray, " n"],
) -> Float[np.ndarray, "n 2 3"]:
    """Orthonormal tangents of the moved surface."""
    gradient = np.where(valid[:, None, None], motion[:, 1:3], 0.0) / extent[:, None, None]
    image = tangent + gradient
    first = image[:, 0] / np.linalg.norm(image[:, 0], axis=1)[:, None]
    along = np.einsum("ni,ni->n", image[:, 1], first)
    second = image[:, 1] - along[:, None] * first
    second /= np.linalg.norm(second, axis=1)[:, None]
    return np.stack([first, second], axis=1)
