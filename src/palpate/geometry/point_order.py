"""Order of points along a Morton curve."""

import numpy as np
from jaxtyping import Float, Int

_BITS = 10


def morton_order(point: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Order of points along a Morton curve, in which neighbours in space stay close.

    Parameters
    ----------
    point : (n, 3) float [m]  NaN where a point has no place; one at least has

    Returns
    -------
    (n,) int                  indices; the box around the points is cut into 1024 cells along its
                              longest side, points of one cell keep their order, those without a
                              place come last
    """
    low = np.nanmin(point, axis=0)
    size = max(float((np.nanmax(point, axis=0) - low).max()), np.finfo(float).tiny)
    cell = np.nan_to_num((point - low) / size * (2**_BITS - 1)).astype(np.int64)
    bits = (cell[:, None, :] >> np.arange(_BITS)[:, None]) & 1
    code = bits.reshape(len(point), -1) @ 2 ** np.arange(3 * _BITS)
    code[np.isnan(point).any(axis=1)] = 2 ** (3 * _BITS)
    return np.argsort(code, kind="stable")
