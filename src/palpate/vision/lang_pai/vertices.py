"""Displacement of the mesh's vertices as in the source: least median, rejection, weighted mean.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4;
Rousseeuw and Leroy, Robust Regression and Outlier Detection (1987), for the least median of squares
and the scale that goes with it.
"""

import numpy as np
from jaxtyping import Float, Int
from numba import njit, prange
from scipy.spatial import cKDTree

from palpate.shapes import Triangles, Vertices
from palpate.vision.lang_pai.settings import LangPaiSettings
from palpate.vision.range_flow import RangeFlow, VertexDisplacement, is_valid

# Fewer motions have no scatter in three dimensions.
_FEWEST = 4
# Vertices whose points are gathered at a time, so that memory stays small.
_BLOCK = 512


def lang_pai_vertices(
    flow: RangeFlow,
    vertices: Vertices,
    triangles: Triangles,
    *,
    settings: LangPaiSettings = LangPaiSettings(),
) -> VertexDisplacement:
    """Mean of the flow around each vertex, weighted by 1 / (1 + d), after outliers are rejected.

    Around a vertex, the motion from which the others have the least median distance is found; what
    is farther from it than three of the standard deviations that go with that median is rejected.

    Parameters
    ----------
    flow : RangeFlow                of `lang_pai_flow`, or of any method
    vertices, triangles : (v, 3) float [m], (m, 3) int
    settings : LangPaiSettings      `reach`, `distance_unit`, `outlier` and `trials` are used

    Returns
    -------
    VertexDisplacement              NaN at vertices of no triangle, or with fewer than 4 motions
                                    left. The covariance is that of the mean, from the scatter of
                                    what remains; motions count as one where their windows overlap,
                                    and the rounding that they share is not averaged away

    Source
    ------
    Lang and Pai (2001), section 4; the unit of d is not given there.
    """
    valid = is_valid(flow)
    displacement = np.full(vertices.shape, np.nan)
    covariance = np.full((*vertices.shape, 3), np.nan)
    count = np.zeros(len(vertices), dtype=np.int64)
    used = np.unique(triangles)
    if not valid.any():
        return VertexDisplacement(displacement, covariance, count)
    point, motion, bias = flow.point[valid], flow.displacement[valid], flow.bias[valid]
    tree = cKDTree(point)
    overlap = max(1.0, (flow.subset / flow.step) ** 2)
    for begin in range(0, len(used), _BLOCK):
        rows = used[begin : begin + _BLOCK]
        first, near = _around(tree, vertices[rows], settings.reach)
        mean, spread, many = _vertex_means(
            point,
            motion,
            bias,
            vertices[rows],
            first,
            near,
            settings.distance_unit,
            settings.outlier,
            settings.trials,
            overlap,
        )
        displacement[rows], covariance[rows], count[rows] = mean, spread, many
    return VertexDisplacement(displacement, covariance, count)


def _around(
    tree: cKDTree, place: Float[np.ndarray, "k 3"], reach: float
) -> tuple[Int[np.ndarray, " bounds"], Int[np.ndarray, " s"]]:
    """Points around each place, one place after the other, and where each place's begin."""
    found = tree.query_ball_point(place, reach, return_sorted=True)
    first = np.concatenate([[0], np.cumsum([len(rows) for rows in found])])
    near = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in found])
    return first, near


@njit(cache=True, parallel=True, error_model="numpy")
def _vertex_means(point, motion, bias, place, first, near, unit, outlier, trials, overlap):
    """Mean motion, its covariance and the count of motions left, for every place."""
    n = len(place)
    mean = np.full((n, 3), np.nan)
    covariance = np.full((n, 3, 3), np.nan)
    count = np.zeros(n, dtype=np.int64)
    for v in prange(n):
        rows = near[first[v] : first[v + 1]]
        if len(rows) < _FEWEST:
            continue
        middle, median = least_median_kernel(motion, rows, trials)
        # 1.4826 makes the median of normal errors their deviation, the rest corrects few of them.
        limit = outlier * 1.4826 * (1.0 + 5.0 / (len(rows) - 1)) * np.sqrt(median)
        weight = np.zeros(len(rows))
        for i in range(len(rows)):
            away = 0.0
            distance = 0.0
            for a in range(3):
                away += (motion[rows[i], a] - motion[rows[middle], a]) ** 2
                distance += (point[rows[i], a] - place[v, a]) ** 2
            if away <= limit * limit:
                weight[i] = 1.0 / (1.0 + np.sqrt(distance) / unit)
                count[v] += 1
        if count[v] >= _FEWEST:
            _weighted_mean(motion, bias, rows, weight, overlap, mean[v], covariance[v])
    return mean, covariance, count


@njit(cache=True, error_model="numpy")
def least_median_kernel(motion, rows, trials):
    """Index into `rows` of the motion with the least median square distance, and that median.

    At most `trials` of them, evenly spread, are tried: with 100 all are outliers where half of the
    motions are with a chance of 1e-30. For an even number of motions the median is the upper one,
    as the source on least medians has it (h = n / 2 + 1).
    """
    n = len(rows)
    tried = min(n, trials)
    best = np.inf
    middle = 0
    square = np.empty(n)
    for t in range(tried):
        i = (t * n) // tried
        for j in range(n):
            total = 0.0
            for a in range(3):
                total += (motion[rows[j], a] - motion[rows[i], a]) ** 2
            square[j] = total
        median = _order_kernel(square, n // 2)
        if median < best:
            best = median
            middle = i
    return middle, best


@njit(cache=True, error_model="numpy")
def _order_kernel(values, k):
    """The value that has k smaller ones; the values are rearranged (Hoare's selection)."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return values[k]


@njit(cache=True, error_model="numpy")
def _weighted_mean(motion, bias, rows, weight, overlap, mean, covariance):
    """Write the weighted mean of motions and its covariance."""
    total = weight.sum()
    mean[:] = 0.0
    covariance[:] = 0.0
    for i in range(len(rows)):
        for a in range(3):
            mean[a] += weight[i] / total * motion[rows[i], a]
    share = 0.0
    for i in range(len(rows)):
        share += (weight[i] / total) ** 2
    # The part of the scatter that is left in the mean; all of it where all windows overlap.
    left = min(1.0, overlap * share) / (1.0 - share)
    for i in range(len(rows)):
        w = weight[i] / total
        for a in range(3):
            for b in range(3):
                off = (motion[rows[i], a] - mean[a]) * (motion[rows[i], b] - mean[b])
                covariance[a, b] += w * (left * off + bias[rows[i], a, b])
