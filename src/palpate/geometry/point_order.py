"""Order of points along a Morton curve."""

import numpy as np
from jaxtyping import Float, Int

_BITS = 10


def morton_order(point: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, " n"]:
    """Order of points along a Morton curve, in which neighbours in space stay close.

    Parameters
    ----------
    point : (n, 3) float [m]  NaN where a position is missing; at least one is not

    Returns
    -------
    (n,) int                  indices; the bounding box is cut into 1024 cells along its longest
                              side, points of one cell keep their order, those without a position
                              come last
    """
    low = np.nanmin(point, axis=0)
    size = max(float((np.nanmax(point, axis=0) - low).max()), np.finfo(float).tiny)
    cell = np.nan_to_num((point - low) / size * (2**_BITS - 1)).astype(np.int64)
    bits = (cell[:, None, :] >> np.arange(_BITS)[:, None]) & 1
    code = bits.reshape(len(point), -1) @ 2 ** np.arange(3 * _BITS)
    code[np.isnan(point).any(axis=1)] = 2 ** (3 * _BITS)
    return np.argsort(code, kind="stable")
