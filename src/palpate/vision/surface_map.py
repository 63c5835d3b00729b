"""Ray casting: the point of a triangle surface seen by each pixel of a camera.

The ray of each pixel is found once by inverting the lens distortion. In the plane z = 1 of the
camera every triangle is then a straight-edged triangle over which inverse depth is linear. So the
intersections are exact for any distortion, and a fold of the lens model outside the picture is
harmless.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from palpate.errors import CalibrationError
from palpate.records import Camera
from palpate.shapes import Flags, Points, Triangles, Vertices
from palpate.threads import in_threads
from palpate.vision.projection import pixel_grid, project

# Side of the tiles of pixels that are tested together [px]: a triangle of a usual mesh covers one
# to four of them.
_TILE = 8
# Tolerance of the inside test, as a fraction of a triangle's size: well above rounding (1e-13 for a
# triangle of one pixel) and well below a pixel, so that no ray slips through a shared edge.
_RIM = 1e-9
# Tolerance for rounding of a projection at the edge of the picture [px].
_EDGE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMap:
    """Surface point behind every pixel centre of one camera.

    Attributes
    ----------
    point : (rows, columns, 3) float [m]        object frame; NaN where no surface is seen
    triangle : (rows, columns) int              -1 where no surface is seen
    """

    point: Float[np.ndarray, "rows columns 3"]
    triangle: Int[np.ndarray, "rows columns"]


@dataclass(frozen=True, slots=True, eq=False)
class PixelRays:
    """Rays of all pixel centres of one camera.

    Attributes
    ----------
    camera : Camera
    grid : (2, rows, columns) float [-]         where they meet its plane z = 1 (`pixel_grid`)
    bounds : (2, 2, bands, tiles) float [-]     minimum and maximum x and y of every tile of pixels
    """

    camera: Camera
    grid: Float[np.ndarray, "2 rows columns"]
    bounds: Float[np.ndarray, "2 2 bands tiles"]

    def meet(self, vertices: Vertices, triangles: Triangles) -> SurfaceMap:
        """The nearest hit of every ray with a triangle surface.

        The surface may be open or closed; both sides are visible. The result does not depend on the
        number of threads.

        Parameters
        ----------
        vertices : (v, 3) float [m]     object frame
        triangles : (m, 3) int

        Returns
        -------
        SurfaceMap

        Raises
        ------
        CalibrationError                part of the surface is not in front of the camera
        """
        pose, shape = self.camera.T_camera_object, self.grid.shape[1:]
        in_camera = vertices @ pose[:3, :3].T + pose[:3, 3]
        _check_in_front(self.camera, in_camera[:, 2], triangles)
        with np.errstate(divide="ignore", invalid="ignore"):  # vertices of no triangle: anywhere
            flat = in_camera / in_camera[:, 2:]
            flat[:, 2] = 1.0 / in_camera[:, 2]
        corner = flat[triangles]
        low, high = corner[..., :2].min(axis=1).T, corner[..., :2].max(axis=1).T
        rim = _RIM * (high - low)
        boxes = np.stack([low - rim, high + rim])
        point, triangle = np.empty((*shape, 3)), np.full(shape, -1)
        in_threads(
            _hit_bands, self.bounds.shape[2], self.grid, self.bounds, corner, boxes,
            np.ascontiguousarray(pose), point, triangle,
        )  # fmt: skip
        return SurfaceMap(point, triangle)


def pixel_rays(camera: Camera, shape: tuple[int, int]) -> PixelRays:
    """The rays of every pixel centre, which serve all surfaces before a camera.

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]    of its pictures

    Returns
    -------
    PixelRays

    Raises
    ------
    InputError                      a shape that contradicts the camera's size
    """
    grid = pixel_grid(camera, shape)
    return PixelRays(camera, grid, np.stack([_tiled(np.fmin, grid), _tiled(np.fmax, grid)]))


def surface_map(
    camera: Camera,
    shape: tuple[int, int],
    vertices: Vertices,
    triangles: Triangles,
) -> SurfaceMap:
    """Intersect the ray of every pixel centre with a triangle surface (`PixelRays.meet`).

    Parameters
    ----------
    camera : Camera
    shape : (rows, columns) [px]    of its pictures
    vertices : (v, 3) float [m]     object frame
    triangles : (m, 3) int

    Returns
    -------
    SurfaceMap

    Raises
    ------
    InputError, CalibrationError    as in `pixel_rays`, `PixelRays.meet`
    """
    return pixel_rays(camera, shape).meet(vertices, triangles)


def _tiled(
    extreme: np.ufunc, grid: Float[np.ndarray, "2 rows columns"]
) -> Float[np.ndarray, "2 bands tiles"]:
    """`np.fmin` or `np.fmax` over the pixels of every tile, ignoring NaN."""
    rows, columns = (np.arange(0, size, _TILE) for size in grid.shape[1:])
    return extreme.reduceat(extreme.reduceat(grid, rows, axis=1), columns, axis=2)


def visible(surface: SurfaceMap, camera: Camera, points: Points, *, tolerance: float) -> Flags:
    """True for points that a camera sees: in the picture, and not behind the surface.

    The depth of the surface is interpolated between the four pixel centres around the projection; a
    pixel without surface counts as infinitely far. Within a pixel of an outline the result is
    uncertain: a point beside the outline of a nearer part counts as hidden, one just beyond an
    outline against the background counts as seen.

    Parameters
    ----------
    surface : SurfaceMap            of this camera
    camera : Camera
    points : (n, 3) float [m]       object frame
    tolerance : float [m]           how far behind the surface, along the ray, a point may lie and
                                    still be seen; should exceed the error of the mesh

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
    """Raise if any part of the surface is not in front of the camera."""
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

    Inverse depth is interpolated, because it is linear over a plane.
    """
    toward, total = camera.T_camera_object[2], np.zeros(len(pixel))
    first = pixel.astype(np.int64)
    second = np.minimum(first + 1, np.array(surface.triangle.shape[::-1]) - 1)
    share = pixel - first
    for column, along in ((first[:, 0], 1.0 - share[:, 0]), (second[:, 0], share[:, 0])):
        for row, down in ((first[:, 1], 1.0 - share[:, 1]), (second[:, 1], share[:, 1])):
            depth = surface.point[row, column] @ toward[:3] + toward[3]
            hit = surface.triangle[row, column] >= 0
            total += along * down * np.where(hit, 1.0 / depth, 0.0)
    with np.errstate(divide="ignore"):
        return 1.0 / total


# No fastmath: NaN marks pixels without a ray.
@njit(cache=True, nogil=True, error_model="numpy")
def _hit_bands(begin, end, grid, bounds, corner, boxes, pose, point, triangle):
    """Point and triangle of the nearest hit of every pixel, in bands of one tile's height.

    `bounds` (2, 2, bands, tiles): minimum and maximum x and y of each tile; `corner` (m, 3, 3):
    x / z, y / z and 1 / z of each vertex; `boxes` (2, 2, m): minimum and maximum x and y; `pose`
    (4, 4): `T_camera_object`.
    """
    tiles = bounds.shape[3]
    for band in range(begin, end):
        part = grid[:, band * _TILE : (band + 1) * _TILE]
        depth_part = np.zeros(part.shape[1:])
        triangle_part = triangle[band * _TILE : (band + 1) * _TILE]
        whole = np.empty((2, 2))
        for a in range(2):
            whole[0, a] = np.nanmin(bounds[0, a, band])
            whole[1, a] = np.nanmax(bounds[1, a, band])
        for e in range(len(corner)):
            if _is_disjoint(boxes[:, :, e], whole):
                continue
            for tile in range(tiles):
                if _is_disjoint(boxes[:, :, e], bounds[:, :, band, tile]):
                    continue
                left = tile * _TILE
                right = min(grid.shape[2], left + _TILE)
                _hit_kernel(part, left, right, corner[e], e, depth_part, triangle_part)
        point_part = point[band * _TILE : (band + 1) * _TILE]
        _place_hits(part, depth_part, triangle_part, pose, point_part)


@njit(cache=True, error_model="numpy")
def _place_hits(grid, inverse_depth, triangle, pose, point):
    """Points of the object frame at known inverse depths; NaN where nothing is hit."""
    for i in range(triangle.shape[0]):
        for j in range(triangle.shape[1]):
            if triangle[i, j] < 0:
                point[i, j] = np.nan
                continue
            depth = 1.0 / inverse_depth[i, j]
            x = grid[0, i, j] * depth - pose[0, 3]
            y = grid[1, i, j] * depth - pose[1, 3]
            z = depth - pose[2, 3]
            for a in range(3):
                point[i, j, a] = x * pose[0, a] + y * pose[1, a] + z * pose[2, a]


@njit(cache=True, error_model="numpy", inline="always")
def _is_disjoint(box, other):
    """True for disjoint boxes (2, 2), given by minimum and maximum x and y."""
    return (
        box[0, 0] > other[1, 0]
        or box[1, 0] < other[0, 0]
        or box[0, 1] > other[1, 1]
        or box[1, 1] < other[0, 1]
    )


@njit(cache=True, error_model="numpy", inline="always")
def _hit_kernel(grid, left, right, corner, number, inverse_depth, triangle):
    """Depth-test one triangle against some pixels, recording it where it is the nearest so far."""
    x0, y0, near0 = corner[0, 0], corner[0, 1], corner[0, 2]
    x1, y1, near1 = corner[1, 0], corner[1, 1], corner[1, 2]
    x2, y2, near2 = corner[2, 0], corner[2, 1], corner[2, 2]
    # A triangle seen edge-on has no area: its weights are infinite or NaN, so it is never hit.
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
