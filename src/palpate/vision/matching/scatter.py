"""Displacements at scattered points of the surface, and the noise that they share: windows that
share pixels share noise.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit

from palpate.shapes import Points
from palpate.threads import in_threads

# What the compiler may assume of floating-point numbers: NaN keep their meaning.
ANY_ORDER = {"reassoc", "nsz", "contract"}
# Minimum number of sums per thread: each takes about 0.003 ms.
_MIN_SUMS_PER_THREAD = 128


@dataclass(frozen=True, slots=True, eq=False)
class Scatter:
    """Displacements measured at scattered points of the surface.

    Attributes
    ----------
    point : (n, 3) float [m]
    pixel : (n, 2) float [px]           position of the point in the reference camera
    displacement : (n, 3) float [m]     all finite
    covariance : (n, 3, 3) float [m^2]  noise plus bias
    bias : (n, 3, 3) float [m^2]        the part of the covariance shared by neighbouring points
    subset : int [px]                   side of the windows they were measured with
    """

    point: Points
    pixel: Float[np.ndarray, "n 2"]
    displacement: Points
    covariance: Float[np.ndarray, "n 3 3"]
    bias: Float[np.ndarray, "n 3 3"]
    subset: int


def sum_variance(
    scatter: Scatter, nearest: Int[np.ndarray, "t m"], weight: Float[np.ndarray, "t m"]
) -> Float[np.ndarray, " t"]:
    """Variance of weighted sums of displacements whose windows may overlap.

    Parameters
    ----------
    scatter : Scatter
    nearest : (t, m) int            indices of the displacements in the scatter; -1: none, and none
                                    behind it
    weight : (t, m) float

    Returns
    -------
    (t,) float                      sum over the three components [m^2, times the weight's unit^2]
    """
    variance = np.empty(len(weight))
    trace = np.trace(scatter.covariance - scatter.bias, axis1=1, axis2=2)
    in_threads(
        _sum_variance_range, len(weight), weight, nearest, trace, scatter.pixel,
        float(scatter.subset), variance, min_items=_MIN_SUMS_PER_THREAD,
    )  # fmt: skip
    return variance


@njit(cache=True, error_model="numpy", fastmath=ANY_ORDER)
def variance_kernel(weight, trace, pixel, subset, nearest, m):
    """Variance of a weighted sum: windows correlate by the share of pixels that they share."""
    # Copied together, so that the double loop is vectorised.
    sigma, column, row = np.empty(m), np.empty(m), np.empty(m)
    for j in range(m):
        n = nearest[j]
        sigma[j] = weight[j] * np.sqrt(trace[n])
        column[j], row[j] = pixel[n, 0] / subset, pixel[n, 1] / subset
    variance = 0.0
    for j in range(m):
        shared = 0.0
        for k in range(m):
            common = max(0.0, 1.0 - abs(column[j] - column[k]))
            shared += sigma[k] * common * max(0.0, 1.0 - abs(row[j] - row[k]))
        variance += sigma[j] * shared
    return variance


@njit(cache=True, nogil=True, error_model="numpy")
def _sum_variance_range(begin, end, weight, nearest, trace, pixel, subset, variance):
    for i in range(begin, end):
        m = 0
        while m < nearest.shape[1] and nearest[i, m] >= 0:
            m += 1
        variance[i] = variance_kernel(weight[i], trace, pixel, subset, nearest[i], m)
