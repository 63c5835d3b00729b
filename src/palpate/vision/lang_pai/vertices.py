"""Displacement of the mesh's vertices as in the source: least median, rejection, weighted mean.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4;
Rousseeuw and Leroy, Robust Regression and Outlier Detection (1987), for the least median of squares
and the scale that goes with it.
"""

import numpy as np
from jaxtyping import Float
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from palpate.shapes import Flags, Points, PointScalars, Triangles, Vertices
from palpate.vision.range_flow import RangeFlow, VertexDisplacement, is_valid

# Flow no farther from a vertex speaks for it [m]; the source's 1 cm.
_REACH = 0.01
# Unit of d in the weight 1 / (1 + d) [m]: lengths are in cm in the source's tables.
_DISTANCE_UNIT = 0.01
# Standard deviations beyond which a motion is rejected; the source's 3.
_MAX_DEVIATION = 3.0
# Motions around a vertex that are tried as the least median, evenly spread: that all of 100 are
# outliers where half of the motions are has a chance of 1e-30.
_TRIALS = 100
# Fewer motions have no scatter in three dimensions.
_MIN_MOTIONS = 4


def lang_pai_vertices(
    flow: RangeFlow, vertices: Vertices, triangles: Triangles
) -> VertexDisplacement:
    """Mean of the flow around each vertex, weighted by 1 / (1 + d), after outliers are rejected.

    Around a vertex, the motion from which the others have the least median distance is found; what
    is farther from it than three of the standard deviations that go with that median is rejected.

    Parameters
    ----------
    flow : RangeFlow                of any method
    vertices, triangles : (v, 3) float [m], (m, 3) int

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
    if valid.any():
        point, motion, bias = flow.point[valid], flow.displacement[valid], flow.bias[valid]
        tree = cKDTree(point)
        overlap = max(1.0, (flow.subset / flow.step) ** 2)
        for v in np.unique(triangles):
            near = np.array(tree.query_ball_point(vertices[v], _REACH, return_sorted=True), int)
            if len(near) < _MIN_MOTIONS:
                continue
            near = near[_agreeing(motion[near])]
            count[v] = len(near)
            if len(near) >= _MIN_MOTIONS:
                distance = np.linalg.norm(point[near] - vertices[v], axis=1)
                weight = 1.0 / (1.0 + distance / _DISTANCE_UNIT)
                displacement[v], covariance[v] = _weighted_mean(
                    motion[near], bias[near], weight / weight.sum(), overlap
                )
    return VertexDisplacement(displacement, covariance, count)


def _agreeing(motion: Points) -> Flags:
    """True for motions within three standard deviations of the one with the least median distance.

    For an even number of motions the median is the upper one, as the source on least medians has it
    (h = n / 2 + 1).
    """
    n = len(motion)
    tried = min(n, _TRIALS)
    trial = np.arange(tried) * n // tried
    square = cdist(motion[trial], motion, "sqeuclidean")
    median = np.partition(square, n // 2, axis=1)[:, n // 2]
    best = int(median.argmin())
    # 1.4826 makes the median of normal errors their deviation, the rest corrects few of them.
    deviation = 1.4826 * (1.0 + 5.0 / (n - 1)) * np.sqrt(median[best])
    return square[best] <= (_MAX_DEVIATION * deviation) ** 2


def _weighted_mean(
    motion: Points, bias: Float[np.ndarray, "n 3 3"], weight: PointScalars, overlap: float
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
    """Mean of motions by weights that add up to 1, and its covariance."""
    mean = weight @ motion
    off = motion - mean
    share = float((weight**2).sum())
    # The part of the scatter that is left in the mean; all of it where all windows overlap.
    left = min(1.0, overlap * share) / (1.0 - share)
    scatter = left * (weight[:, None] * off).T @ off
    return mean, scatter + np.einsum("n,nij->ij", weight, bias)
