"""One instant as the cameras see it, with the points to be tracked; a match of their windows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit

from palpate.records import Camera, Rig
from palpate.shapes import Points, PointScalars, Triangles, Vertices
from palpate.threads import in_threads
from palpate.vision.normalisation import point_spread_variance
from palpate.vision.projection import packed_rig, pixel_sizes
from palpate.vision.range_flow import grid_points, grid_triangles
from palpate.vision.spline import SplinePicture, spline_pictures
from palpate.vision.surface_map import PixelRays, SurfaceMap, pixel_rays, visible

# Pixels this close to an outline mix object and background, by the support of the pixel response
# and of the spline.
_RIM_PX = 2
# Neighbouring pixels whose depths differ by more than this many pixel sides lie on two parts of the
# object, one in front of the other, or on a surface seen at less than 12 degrees.
_MAX_DEPTH_JUMP_PX = 5.0
# Blocks along a side of a window whose residuals are treated as mutually independent.
BLOCKS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Pictures, surface and points of one instant.

    Attributes
    ----------
    rig : Rig
    rays : tuple of c PixelRays         of its cameras
    packed : (c, 25) float              the cameras for the kernels, see `packed_camera`
    grey : tuple of c (rows, columns) float [grey levels]   the original pictures
    pictures : tuple of c SplinePicture     the same, smoothed, prepared for matching
    surface : tuple of c (rows, columns, 3) float32 [m]     point behind each pixel, NaN where none
    interior : tuple of c (rows, columns) float32   1 where a pixel shows only one unbroken part of
                                        the surface, else 0
    pixel : (n, 2) float [px]           of the points, in the reference camera
    point : (n, 3) float [m]            on the surface
    tangent : (n, 2, 3) float           two orthonormal tangents there
    half_window : (n,) float [m]        half side of a window on the surface
    seen : (n, c) bool                  which cameras see the point
    subset : int [px]                   side of a window
    step : int [px]                     spacing of the points in the reference camera
    smoothing : float [px]              standard deviation of the Gaussian low-pass of `pictures`
    blur_variance : (c,) float [px^2]   blur variance of `pictures`: lens, sensor and low-pass
    """

    rig: Rig
    rays: tuple[PixelRays, ...]
    packed: Float[np.ndarray, "c 25"]
    grey: tuple[Float[np.ndarray, "_ _"], ...]
    pictures: tuple[SplinePicture, ...]
    surface: tuple[Float[np.ndarray, "_ _ 3"], ...]
    interior: tuple[Float[np.ndarray, "_ _"], ...]
    pixel: Float[np.ndarray, "n 2"]
    point: Points
    tangent: Float[np.ndarray, "n 2 3"]
    half_window: PointScalars
    seen: Bool[np.ndarray, "n c"]
    subset: int
    step: int
    smoothing: float
    blur_variance: Float[np.ndarray, " c"]


def make_scene(
    rig: Rig,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    vertices: Vertices,
    triangles: Triangles,
    *,
    subset: int,
    step: int,
    smoothing: float,
) -> Scene:
    """Set up an instant, with points of the surface on a grid of the reference camera.

    Parameters
    ----------
    rig : Rig
    pictures : sequence of c (rows, columns) float [grey levels]
    vertices, triangles : (v, 3) float [m], (m, 3) int      the surface, open or closed
    subset, step : int [px]         side of a window, spacing of the points
    smoothing : float [px]          low-pass of the pictures that are matched

    Returns
    -------
    Scene                           with no points if the reference camera sees none

    Raises
    ------
    InputError, CalibrationError    as in `surface_map`
    """
    rays = tuple(map(pixel_rays, rig.cameras, (picture.shape for picture in pictures)))
    maps, views = _views(rays, pictures, vertices, triangles, smoothing)
    shown = views["interior"][rig.reference] > 0.0
    pixel, point, tangent = grid_points(maps[rig.reference], shown, vertices, triangles, step)
    half_window = (subset // 2) * pixel_sizes(rig.cameras[rig.reference], point)
    # More than half a window behind the surface means hidden by another part of it.
    tolerance = float(np.median(half_window)) if len(half_window) else 0.0
    return Scene(
        rig=rig,
        rays=rays,
        packed=packed_rig(rig),
        pixel=pixel.astype(np.float64),
        point=point,
        tangent=tangent,
        half_window=half_window,
        seen=_seen(rig, maps, point, tolerance),
        subset=subset,
        step=step,
        smoothing=smoothing,
        blur_variance=np.array([point_spread_variance(picture) for picture in pictures])
        + smoothing**2,
        **views,
    )


def advanced_scene(
    scene: Scene,
    grey: tuple[Float[np.ndarray, "_ _"], ...],
    motion: Float[np.ndarray, "n 6 3"],
    valid: Bool[np.ndarray, " n"],
) -> Scene:
    """The scene at a later instant, with its surface moved.

    Parameters
    ----------
    scene : Scene                   the first instant
    grey : tuple of c (rows, columns) float     pictures of the later instant
    motion : (n, 6, 3) float [m]    from the first instant, used where valid
    valid : (n,) bool

    Returns
    -------
    Scene                           of the same n points; those not valid are marked as unseen

    Raises
    ------
    InputError, CalibrationError    as in `surface_map`
    """
    moved = scene.point + np.where(valid[:, None], motion[:, 0], 0.0)
    rows = np.flatnonzero(valid)
    triangles = grid_triangles(scene.pixel[rows], scene.step)
    maps, views = _views(scene.rays, grey, moved[rows], triangles, scene.smoothing)
    seen = _seen(scene.rig, maps, moved, float(np.median(scene.half_window)))
    return replace(
        scene,
        point=moved,
        tangent=_moved_tangents(scene, motion, valid),
        seen=seen & scene.seen & valid[:, None],
        **views,
    )


def scene_rows(scene: Scene, rows: Int[np.ndarray, " k"]) -> Scene:
    """The scene restricted to some of its points.

    Parameters
    ----------
    scene : Scene                   of n points
    rows : (k,) int                 0 to n - 1

    Returns
    -------
    Scene                           of k points; pictures and surfaces are shared
    """
    names = ("pixel", "point", "tangent", "half_window", "seen")
    return replace(scene, **{name: getattr(scene, name)[rows] for name in names})


def interior_pixels(surface: SurfaceMap, camera: Camera) -> Float[np.ndarray, "rows columns"]:
    """1 where a pixel and its neighbours within 2 px show one unbroken part of the surface, else 0.

    Parameters
    ----------
    surface : SurfaceMap            (rows, columns), of that camera
    camera : Camera

    Returns
    -------
    (rows, columns) float32         weight of each pixel in a window
    """
    toward = np.ascontiguousarray(camera.T_camera_object[2])
    jump = _MAX_DEPTH_JUMP_PX / camera.matrix[0, 0]
    shown = np.empty(surface.triangle.shape, dtype=np.uint8)
    in_threads(_unbroken, len(shown), surface.point, surface.triangle, toward, jump, shown)
    around = np.ones((2 * _RIM_PX + 1, 2 * _RIM_PX + 1), dtype=np.uint8)
    eroded = cv2.erode(shown, around, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return eroded.astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy")
def _unbroken(begin, end, point, triangle, toward, jump, shown):
    """1 where a pixel of some rows shows the surface, and at no other depth than the pixels beside
    it, else 0.

    `toward` (4,): depth of a point of the object frame; `jump`: largest difference of two depths
    over the one to the right or below.
    """
    rows, columns = triangle.shape
    for i in range(begin, end):
        for j in range(columns):
            shown[i, j] = triangle[i, j] >= 0
            if triangle[i, j] < 0:
                continue
            here = _depth(point[i, j], toward)
            for down, right in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                k, m = i + down, j + right
                if 0 <= k < rows and 0 <= m < columns and triangle[k, m] >= 0:
                    there = _depth(point[k, m], toward)
                    later = there if down + right > 0 else here
                    if abs(there - here) > jump * later:
                        shown[i, j] = 0


@njit(cache=True, error_model="numpy", inline="always")
def _depth(point, toward):
    return point[0] * toward[0] + point[1] * toward[1] + point[2] * toward[2] + toward[3]


def _views(
    rays: Sequence[PixelRays],
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    vertices: Vertices,
    triangles: Triangles,
    smoothing: float,
) -> tuple[list[SurfaceMap], dict[str, Any]]:
    """Surface maps of all cameras, and the fields of a `Scene` made from them and the pictures."""
    maps = [own.meet(vertices, triangles) for own in rays]
    return maps, {
        "grey": tuple(pictures),
        "pictures": spline_pictures(pictures, smoothing),
        "surface": tuple(np.ascontiguousarray(seen.point, dtype=np.float32) for seen in maps),
        "interior": tuple(map(interior_pixels, maps, (own.camera for own in rays))),
    }


def _seen(
    rig: Rig, maps: Sequence[SurfaceMap], point: Points, tolerance: float
) -> Bool[np.ndarray, "n c"]:
    """Which cameras see which points."""
    seen = [
        visible(surface, camera, point, tolerance=tolerance)
        for surface, camera in zip(maps, rig.cameras, strict=True)
    ]
    return np.stack(seen, axis=1)


def _moved_tangents(
    scene: Scene, motion: Float[np.ndarray, "n 6 3"], valid: Bool[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2 3"]:
    """Orthonormal tangents of the moved surface."""
    gradient = (
        np.where(valid[:, None, None], motion[:, 1:3], 0.0) / scene.half_window[:, None, None]
    )
    image = scene.tangent + gradient
    first = image[:, 0] / np.linalg.norm(image[:, 0], axis=1)[:, None]
    along = np.einsum("ni,ni->n", image[:, 1], first)
    second = image[:, 1] - along[:, None] * first
    second /= np.linalg.norm(second, axis=1)[:, None]
    return np.stack([first, second], axis=1)


class Limits(NamedTuple):
    """Settings of the match of a window.

    Attributes
    ----------
    half : int [px]                 half the side of a window, rounded down
    bases : 1, 3 or 6               terms of the shape function that are free: shift, affine,
                                    quadratic
    iterations : int                largest number of iterations
    shading : bool                  whether the gain may vary linearly over a window: a moving
                                    object rotates in the light, tools cast soft shadows
    tolerance : float [px]          the iteration ends when a step is shorter; far below the noise
    reach : float [px]              a window that moves farther than this from its start is lost
    min_fraction : float            fraction of the window that must show the surface at rest
    """

    half: int
    bases: int = 3
    iterations: int = 25
    shading: bool = True
    tolerance: float = 1e-3
    reach: float = 6.0
    min_fraction: float = 0.6


class Match(NamedTuple):
    """Motion of n points from the pictures of c cameras; NaN where not found.

    Attributes
    ----------
    motion : (n, 6, 3) float [m]        u, its derivatives along the tangents times the half window,
                                        its second-order terms times the square of that
    covariance : (n, 3, 3) float [m^2]  of u for white noise of the given standard deviations
    score : (n, c) float                normalised cross-correlation
    residual_variance : (n, c) float [grey levels^2] residual variance
    own_step : (n, c, 2) float [px]     further step that each camera alone would take
    own_variance : (n, c) float [px^2]  variance of `own_step` per component
    variance_ratio : (n,) float [-]     ratio of the variance of u from the residuals in blocks
                                        (sandwich estimate) to that from white residuals
    cameras : (n, c) bool               cameras to use, as given
    outcome : (n,) int                  VALID, HIDDEN, TEXTURE, OUTSIDE or LOST
    """

    motion: Float[np.ndarray, "n 6 3"]
    covariance: Float[np.ndarray, "n 3 3"]
    score: Float[np.ndarray, "n c"]
    residual_variance: Float[np.ndarray, "n c"]
    own_step: Float[np.ndarray, "n c 2"]
    own_variance: Float[np.ndarray, "n c"]
    variance_ratio: Float[np.ndarray, " n"]
    cameras: Bool[np.ndarray, "n c"]
    outcome: Int[np.ndarray, " n"]
