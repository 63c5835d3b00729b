"""Range flow at every pixel, between the points it was measured at."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import map_coordinates

from palpate.vision.range_flow import RangeFlow, is_valid

# Of a sum of four weights.
_ROUNDING = 1e-9


def dense_maps(
    flow: RangeFlow,
) -> tuple[Float[np.ndarray, "rows columns 3"], Float[np.ndarray, "rows columns"]]:
    """Displacement and its standard deviation at the pixels of the reference camera.

    Bilinear between the four points around a pixel: they are a quarter of a window apart, so their
    errors are nearly the same and the error of a pixel is no smaller than theirs.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    displacement : (rows, columns, 3) float32 [m]   NaN where one of the four points was rejected
    sigma : (rows, columns) float32 [m]             root of the covariance's trace
    """
    rows, columns = flow.shape
    displacement = np.full((rows, columns, 3), np.nan, dtype=np.float32)
    sigma = np.full((rows, columns), np.nan, dtype=np.float32)
    valid = is_valid(flow)
    if not valid.any():
        return displacement, sigma
    offset = flow.pixel[valid][0] % flow.step
    cell = np.rint((flow.pixel[valid] - offset) / flow.step).astype(int)
    low, high = cell.min(axis=0), cell.max(axis=0)
    # The last plane tells where all four are there: a missing one of no weight does no harm.
    grid = np.zeros((5, *(high - low + 1)[::-1]))
    at = (cell[:, 1] - low[1], cell[:, 0] - low[0])
    for k in range(3):
        grid[k][at] = flow.displacement[valid, k]
    grid[3][at] = np.sqrt(np.trace(flow.covariance[valid], axis1=1, axis2=2))
    grid[4][at] = 1.0
    start = np.rint(offset + flow.step * low).astype(int)
    stop = np.minimum(start + flow.step * (high - low) + 1, [columns, rows])
    row, column = np.mgrid[start[1] : stop[1], start[0] : stop[0]]
    place = [(row - start[1]) / flow.step, (column - start[0]) / flow.step]
    inside = (slice(start[1], stop[1]), slice(start[0], stop[0]))
    maps = np.stack([map_coordinates(plane, place, order=1, mode="nearest") for plane in grid])
    maps[:, maps[4] < 1.0 - _ROUNDING] = np.nan
    displacement[inside] = np.moveaxis(maps[:3], 0, -1)
    sigma[inside] = maps[3]
    return displacement, sigma
