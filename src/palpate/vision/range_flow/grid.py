"""The pixel grid of a range flow: surface points, triangles, and maps between its points."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.ndimage import map_coordinates

from palpate.shapes import Points, Triangles, Vertices
from palpate.vision.cameras.surface_map import SurfaceMap
from palpate.vision.range_flow.flow import RangeFlow, is_valid

# Tolerance for rounding in a sum of four interpolation weights.
_ROUNDING = 1e-9


def grid_points(
    surface: SurfaceMap,
    shown: Bool[np.ndarray, "rows columns"],
    vertices: Vertices,
    triangles: Triangles,
    step: int,
) -> tuple[Int[np.ndarray, "n 2"], Points, Float[np.ndarray, "n 2 3"]]:
    """Surface points seen at the pixels of a regular grid.

    Parameters
    ----------
    surface : SurfaceMap                the surface point behind each pixel of the camera
    shown : (rows, columns) bool        pixels that may be used
    vertices, triangles : (v, 3) float [m], (m, 3) int
    step : int [px]                     spacing of the grid; its first row and column are step // 2

    Returns
    -------
    pixel : (n, 2) int [px]             column and row
    point : (n, 3) float [m]
    tangent : (n, 2, 3) float           two orthonormal tangents
    """
    begin = step // 2
    row, column = np.nonzero(shown[begin::step, begin::step])
    row, column = begin + step * row, begin + step * column
    corner = vertices[triangles[surface.triangle[row, column]]]
    along = corner[:, 1] - corner[:, 0]
    along = along / np.linalg.norm(along, axis=1)[:, None]
    normal = np.cross(along, corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    point = np.ascontiguousarray(surface.point[row, column], dtype=np.float64)
    tangent = np.stack([along, np.cross(normal, along)], axis=1)
    return np.stack([column, row], axis=1), point, tangent


def grid_triangles(pixel: Float[np.ndarray, "n 2"], step: int) -> Triangles:
    """Triangulate points on a pixel grid: two triangles for every cell with all four corners.

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
    corner = np.stack([number[:-1, :-1], number[1:, :-1], number[:-1, 1:], number[1:, 1:]])
    whole = corner[:, (corner >= 0).all(axis=0)]
    return np.concatenate([whole[[0, 2, 1]].T, whole[[1, 2, 3]].T])


def dense_maps(
    flow: RangeFlow,
) -> tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns"]]:
    """Displacement and its standard deviation at the pixels of the reference camera.

    Both are interpolated bilinearly between the four surrounding points. These are about a quarter
    of a window apart, so their errors are strongly correlated and interpolation does not reduce the
    standard deviation.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    displacement : (rows, columns, 3) float32 [m]   NaN where one of the four points was rejected
    sigma : (rows, columns) float32 [m]             square root of the covariance's trace
    """
    rows, columns = flow.shape
    maps = np.full((5, rows, columns), np.nan)
    valid = is_valid(flow)
    if valid.any():
        offset = flow.pixel[valid][0] % flow.step
        cell = np.rint((flow.pixel[valid] - offset) / flow.step).astype(int)
        low, high = cell.min(axis=0), cell.max(axis=0)
        # The last plane is the weight of valid points: 1 where every point of non-zero weight is.
        grid = np.zeros((5, *(high - low + 1)[::-1]))
        sigma = np.sqrt(np.trace(flow.covariance[valid], axis1=1, axis2=2))
        values = np.vstack([flow.displacement[valid].T, sigma, np.ones(len(sigma))])
        grid[:, cell[:, 1] - low[1], cell[:, 0] - low[0]] = values
        start = np.rint(offset + flow.step * low).astype(int)
        stop = np.minimum(start + flow.step * (high - low) + 1, [columns, rows])
        row, column = np.mgrid[start[1] : stop[1], start[0] : stop[0]]
        place = [(row - start[1]) / flow.step, (column - start[0]) / flow.step]
        maps[:, row, column] = [
            map_coordinates(plane, place, order=1, mode="nearest") for plane in grid
        ]
        maps[:, maps[4] < 1.0 - _ROUNDING] = np.nan
    return np.moveaxis(maps[:3], 0, -1).astype(np.float32), maps[3].astype(np.float32)
