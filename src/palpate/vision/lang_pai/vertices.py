"""Vertex displacements as in the source: least median of squares, rejection, weighted mean.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4;
Rousseeuw and Leroy, Robust Regression and Outlier Detection (1987), for the least median of squares
and its robust scale.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from palpate.arrays import STD_OVER_MEDIAN
from palpate.shapes import Flags, Points, PointScalars, Triangles, Vertices
from palpate.threads import map_in_threads
from palpate.vision.range_flow.flow import RangeFlow, VertexDisplacement, is_valid

# Radius of the flow used for a vertex [m]; the source's 1 cm.
_REACH = 0.01
# Unit of d in the weight 1 / (1 + d) [m]: lengths are in cm in the source's tables.
_DISTANCE_UNIT = 0.01
# Standard deviations beyond which a motion is rejected; the source's 3.
_MAX_DEVIATION = 3.0
# Motions around a vertex tried as centres, evenly spread: if half of the motions are outliers, the
# probability that all 100 are is 1e-30.
_TRIALS = 100
# Fewer motions do not determine a covariance in three dimensions.
_MIN_MOTIONS = 4


def lang_pai_vertices(
    flow: RangeFlow, vertices: Vertices, triangles: Triangles
) -> VertexDisplacement:
    """Mean of the flow around each vertex, weighted by 1 / (1 + d), after rejection of outliers.

    Of the motions around a vertex, the one with the smallest median distance to the others is
    found. Motions farther from it than three robust standard deviations, derived from that median,
    are rejected.

    Parameters
    ----------
    flow : RangeFlow                of any method
    vertices, triangles : (v, 3) float [m], (m, 3) int

    Returns
    -------
    VertexDisplacement              NaN at vertices of no triangle, or with fewer than 4 motions
                                    left. The covariance is that of the mean, from the scatter of
                                    the remaining motions; motions with overlapping windows count as
                                    one, and their shared rounding error is not averaged down

    Source
    ------
    Lang and Pai (2001), section 4; the unit of d is not given there.
    """
    valid = is_valid(flow)
    displacement = np.full(vertices.shape, np.nan)
    covariance = np.full((*vertices.shape, 3), np.nan)
    count = np.zeros(len(vertices), dtype=np.int64)
    if valid.any():
        point, motion, bias = flow.point[valid], flow.displacement[valid], flow.bias[valid]
        tree = cKDTree(point)
        overlap = max(1.0, (flow.subset / flow.step) ** 2)

        def estimate(v: int) -> None:
            near = np.array(tree.query_ball_point(vertices[v], _REACH, return_sorted=True), int)
            if len(near) < _MIN_MOTIONS:
                return
            near = near[_agreeing(motion[near])]
            count[v] = len(near)
            if len(near) >= _MIN_MOTIONS:
                distance = np.linalg.norm(point[near] - vertices[v], axis=1)
                weight = 1.0 / (1.0 + distance / _DISTANCE_UNIT)
                displacement[v], covariance[v] = _weighted_mean(
                    motion[near], bias[near], weight / weight.sum(), overlap
                )

        for _ in map_in_threads(estimate, np.unique(triangles).tolist()):
            pass
    return VertexDisplacement(displacement, covariance, count)


def _agreeing(motion: Points) -> Flags:
    """True for motions within three standard deviations of the one with the least median distance.

    For an even number of motions the upper median is used, as in Rousseeuw and Leroy (h = n / 2 +
    1).
    """
    n = len(motion)
    tried = min(n, _TRIALS)
    trial = np.arange(tried) * n // tried
    square = cdist(motion[trial], motion, "sqeuclidean")
    median = np.partition(square, n // 2, axis=1)[:, n // 2]
    best = int(median.argmin())
    # With a small-sample correction.
    deviation = STD_OVER_MEDIAN * (1.0 + 5.0 / (n - 1)) * np.sqrt(median[best])
    return square[best] <= (_MAX_DEVIATION * deviation) ** 2


def _weighted_mean(
    motion: Points, bias: Float[np.ndarray, "n 3 3"], weight: PointScalars, overlap: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Weighted mean of motions, the weights adding up to 1, and its covariance."""
    mean = weight @ motion
    deviations = motion - mean
    sum_of_squares = float((weight**2).sum())
    # Fraction of the scatter that remains in the mean; all of it where all windows overlap.
    fraction = min(1.0, overlap * sum_of_squares) / (1.0 - sum_of_squares)
    scatter = fraction * (weight[:, None] * deviations).T @ deviations
    return mean, scatter + np.einsum("n,nij->ij", weight, bias)
