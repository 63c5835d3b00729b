"""Correlation of the errors of a local field between neighbouring places: windows share pixels."""

import numpy as np
from scipy.sparse import coo_array, csr_array, dia_array
from scipy.spatial import cKDTree

from palpate.records import PointCorrelation
from palpate.vision.matching.local_regression import LocalField
from palpate.vision.matching.scatter import Scatter

# Smaller correlations are dropped: three quarters of the pairs whose windows touch, which together
# would add about 1 % to a variance.
_MIN_CORRELATION = 0.05


def noise_correlation(scatter: Scatter, field: LocalField) -> PointCorrelation:
    """Correlation between the errors of a local field's displacements at different places.

    Each displacement is a weighted sum of scattered ones whose noise is correlated by the overlap
    of their windows, as in the field's covariance. Shared bias is taken to be correlated alike.

    Parameters
    ----------
    scatter : Scatter
    field : LocalField              of that scatter

    Returns
    -------
    PointCorrelation                of the t places; magnitudes above 0.05 only; undetermined places
                                    have none
    """
    known = np.isfinite(field.weight)
    place, column = np.nonzero(known)
    shape = (len(field.weight), len(scatter.point))
    weights = csr_array((field.weight[known], (place, field.nearest[place, column])), shape=shape)
    covariance = (weights @ _noise(scatter) @ weights.T).tocoo()
    variance = np.zeros(shape[0])
    first, second = covariance.coords
    same = first == second
    variance[first[same]] = covariance.data[same]
    chosen = first < second
    first, second = first[chosen], second[chosen]
    value = covariance.data[chosen] / np.sqrt(variance[first] * variance[second])
    kept = np.abs(value) > _MIN_CORRELATION
    return PointCorrelation(np.column_stack([first[kept], second[kept]]), value[kept])


def _noise(scatter: Scatter) -> csr_array:
    """Noise covariance of the scattered displacements, from the overlap of their windows."""
    pair = cKDTree(scatter.pixel).query_pairs(scatter.subset, p=np.inf, output_type="ndarray")
    first, second = pair.T
    offset = np.abs(scatter.pixel[first] - scatter.pixel[second]) / scatter.subset
    size = np.sqrt(np.trace(scatter.covariance - scatter.bias, axis1=1, axis2=2))
    count = len(size)
    covariance = np.maximum(1.0 - offset, 0.0).prod(axis=1) * size[first] * size[second]
    upper = coo_array((covariance, (first, second)), shape=(count, count)).tocsr()
    diagonal = dia_array((size[None] ** 2, [0]), shape=(count, count)).tocsr()
    return csr_array(diagonal + upper + upper.T)
