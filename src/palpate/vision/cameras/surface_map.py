"""What each pixel of a camera sees of a triangle surface.

The ray of a pixel is found once by undoing the lens distortion; in the plane z = 1 of the camera
every triangle is a straight triangle then, and the inverse of the depth is linear over it. So the
hits are exact whatever the distortion, and a fold of the lens model beyond the picture is harmless.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from palpate.errors import CalibrationError, InputError
from palpate.records import Camera
from palpate.shapes import Flags, Points, Triangles, Vertices
from palpate.threads import in_threads
from palpate.vision.cameras.pixel_grid import pixel_grid
from palpate.vision.cameras.projection import project

# Side of the squares of pixels that are skipped together [px]: a triangle of a usual mesh covers
# one to four of them.
_TILE = 8
# Pixels this share of a triangle's size outside it still hit it: far above rounding (1e-13 for a
# triangle of one pixel), far below a pixel, so that no ray slips through a shared edge.
_RIM = 1e-9
# Rounding of a projection onto a pixel centre at the edge of the picture [px].
_EDGE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMap:
    """Point of the surface behind every pixel centre of one camera.

    Attributes
    ----------
    point : (rows, columns, 3) float [m]        object frame; NaN where no surface is seen
    triangle : (rows, columns) int              -1 where no surface is seen
    """

    point: Float[np.ndarray, "rows columns 3"]
    triangle: Int[np.ndarray, "rows columns"]


def surface_map(
    camera: Camera,
    shape: tuple[int, int],
    vertices: Vertices,
    triangles: Triangles,
    *,
    grid: Float[np.ndarray, "2 rows columns"] | None = None,
) -> SurfaceMap:
    """Intersect the ray of every pixel centre with a triangle surface; the nearest hit is kept.

    The surface may be open or closed, and is seen from both sides. The result does not depend on
    the number of threads.

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]    of its pictures
    vertices : (v, 3) float [m]     object frame
    triangles : (m, 3) int
    grid : (2, rows, columns) or None   of `pixel_grid`, for a camera that is used again and again

    Returns
    -------
    SurfaceMap

    Raises
    ------
    InputError                      a shape that contradicts the camera's or the grid's
    CalibrationError                a part of the surface is beside or behind the camera
    """
    if grid is None:
        grid = pixel_grid(camera, shape)
    elif grid.shape[1:] != shape:
        raise InputError(f"grid is of {grid.shape[1:]} pixels; must be of {shape}")
    pose = camera.T_camera_object
    in_camera = vertices @ pose[:3, :3].T + pose[:3, 3]
    _check_in_front(camera, in_camera[:, 2], triangles)
    with np.errstate(divide="ignore", invalid="ignore"):  # vertices of no triangle may be anywhere
        flat = in_camera / in_camera[:, 2:]
        flat[:, 2] = 1.0 / in_camera[:, 2]
    corner = flat[triangles]
    low, high = corner[..., :2].min(axis=1), corner[..., :2].max(axis=1)
    rim = _RIM * (high - low)
    boxes = np.hstack([low - rim, high + rim])
    inverse_depth, triangle = np.zeros(shape), np.full(shape, -1)
    bands = (shape[0] + _TILE - 1) // _TILE
    in_threads(_hit_bands, bands, grid, corner, boxes, inverse_depth, triangle)
    point = np.empty((*shape, 3))
    in_threads(_hit_points, shape[0], grid, inverse_depth, np.ascontiguousarray(pose), point)
    return SurfaceMap(point, triangle)


def visible(surface: SurfaceMap, camera: Camera, points: Points, *, tolerance: float) -> Flags:
    """True for the points that a camera sees: in the picture, and not behind the surface.

    The depth of the surface is interpolated between the four pixel centres around the projection;
    one without surface counts as infinitely far. Less than a pixel off an outline the answer is a
    guess: a point beside the outline of something nearer counts as hidden, one just past the
    outline against the background as seen.

    Parameters
    ----------
    surface : SurfaceMap            of this camera
    camera : Camera
    points : (n, 3) float [m]       object frame
    tolerance : float [m]           how far behind the surface, along the ray, a point may lie; more
                                    than the error of the mesh

    Returns
    -------
    (n,) bool                       False where NaN
    """
    pose = camera.T_camera_object
    rows, columns = surface.triangle.shape
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    pixel = project(camera, points)  # NaN behind the camera and beyond the fold of the lens
    nearest = np.clip(pixel, 0.0, [columns - 1, rows - 1])
    inside = np.flatnonzero((np.abs(pixel - nearest) < _EDGE).all(axis=1))
    depth = in_camera[inside, 2]
    gap = depth - _depth_at(surface, camera, nearest[inside])
    slant = np.linalg.norm(in_camera[inside], axis=1) / depth
    seen = np.zeros(len(points), dtype=bool)
    seen[inside[~(gap * slant > tolerance)]] = True
    return seen


def _check_in_front(camera: Camera, depth: Float[np.ndarray, " v"], triangles: Triangles) -> None:
    """Refuse a surface that reaches beside or behind the camera."""
    used = depth[triangles]
    behind = ~(used > 0.0)
    if behind.any():
        raise CalibrationError(
            f"camera '{camera.name}': {int(behind.any(axis=1).sum())} of {len(triangles)} triangles"
            f" of the surface reach beside or behind the camera (depth {used.min():.3g} to"
            f" {used.max():.3g} m along its axis); the whole object must be in front: check R, t"
            " and the length unit of the cameras"
        )


def _depth_at(
    surface: SurfaceMap, camera: Camera, pixel: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, " k"]:
    """Depth of the surface between pixel centres [m], infinite where there is none.

    Its inverse is interpolated: linear over a plane.
    """
    rows, columns = surface.triangle.shape
    first = np.minimum(pixel.astype(np.int64), [max(columns - 2, 0), max(rows - 2, 0)])
    share = pixel - first
    total = np.zeros(len(pixel))
    toward = camera.T_camera_object[2]
    for down in (0, 1):
        for right in (0, 1):
            column = np.minimum(first[:, 0] + right, columns - 1)
            row = np.minimum(first[:, 1] + down, rows - 1)
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
            depth = surface.point[row, column] @ toward[:3] + toward[3]
            total += np.where(surface.triangle[row, column] >= 0, weight / depth, 0.0)
    with np.errstate(divide="ignore"):
        return 1.0 / total


# No fastmath here: NaN marks pixels without a ray.
@njit(cache=True, nogil=True, error_model="numpy")
def _hit_bands(begin, end, grid, corner, boxes, inverse_depth, triangle):
    """Inverse depth and triangle of the nearest hit of every pixel, in bands of one tile's height.

    `corner` (m, 3, 3): x / z, y / z and 1 / z of each vertex; `boxes` (m, 4): x, y from and to.
    """
    rows, columns = grid.shape[1], grid.shape[2]
    tiles = (columns + _TILE - 1) // _TILE
    around = np.empty((tiles, 4))
    for band in range(begin, end):
        top = band * _TILE
        bottom = min(rows, top + _TILE)
        part = grid[:, top:bottom]
        depth_part, triangle_part = inverse_depth[top:bottom], triangle[top:bottom]
        low_x = low_y = np.inf
        high_x = high_y = -np.inf
        for tile in range(tiles):
            left = tile * _TILE
            _bounds_kernel(part[:, :, left : left + _TILE], around[tile])
            low_x, low_y = min(low_x, around[tile, 0]), min(low_y, around[tile, 1])
            high_x, high_y = max(high_x, around[tile, 2]), max(high_y, around[tile, 3])
        for e in range(len(boxes)):
            box = boxes[e]
            if box[0] > high_x or box[2] < low_x or box[1] > high_y or box[3] < low_y:
                continue
            for tile in range(tiles):
                other = around[tile]
                if box[0] > other[2] or box[2] < other[0]:
                    continue
                if box[1] > other[3] or box[3] < other[1]:
                    continue
                left = tile * _TILE
                right = min(columns, left + _TILE)
                _hit_kernel(part, left, right, corner[e], e, depth_part, triangle_part)


@njit(cache=True, error_model="numpy", inline="always")
def _bounds_kernel(grid, bounds):
    """Smallest and largest x and y of some pixels, NaN left out."""
    bounds[:2] = np.inf
    bounds[2:] = -np.inf
    for i in range(grid.shape[1]):
        for j in range(grid.shape[2]):
            for a in range(2):
                if grid[a, i, j] < bounds[a]:
                    bounds[a] = grid[a, i, j]
                if grid[a, i, j] > bounds[2 + a]:
                    bounds[2 + a] = grid[a, i, j]


@njit(cache=True, error_model="numpy", inline="always")
def _hit_kernel(grid, left, right, corner, number, inverse_depth, triangle):
    """Note one triangle at those of some pixels that it hits in front of what is noted there."""
    x0, y0, near0 = corner[0, 0], corner[0, 1], corner[0, 2]
    x1, y1, near1 = corner[1, 0], corner[1, 1], corner[1, 2]
    x2, y2, near2 = corner[2, 0], corner[2, 1], corner[2, 2]
    # A triangle seen edge on has no area: its weights are infinite or NaN, and hit nothing.
    inverse = 1.0 / ((x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0))
    for i in range(grid.shape[1]):
        for j in range(left, right):
            x, y = grid[0, i, j], grid[1, i, j]
            w0 = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) * inverse
            w1 = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) * inverse
            w2 = 1.0 - w0 - w1
            if w0 >= -_RIM and w1 >= -_RIM and w2 >= -_RIM:
                near = w0 * near0 + w1 * near1 + w2 * near2
                if near > inverse_depth[i, j]:
                    inverse_depth[i, j] = near
                    triangle[i, j] = number


@njit(cache=True, nogil=True, error_model="numpy")
def _hit_points(begin, end, grid, inverse_depth, pose, point):
    """The hits of some rows of pixels in the object frame, NaN where there is none."""
    for i in range(begin, end):
        for j in range(inverse_depth.shape[1]):
            if inverse_depth[i, j] > 0.0:
                z = 1.0 / inverse_depth[i, j]
                x = z * grid[0, i, j] - pose[0, 3]
                y = z * grid[1, i, j] - pose[1, 3]
                z -= pose[2, 3]
                for a in range(3):
                    point[i, j, a] = pose[0, a] * x + pose[1, a] * y + pose[2, a] * z
            else:
                point[i, j, :] = np.nan
