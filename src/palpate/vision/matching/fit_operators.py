"""Local polynomial fits as linear operators on the surrounding displacements.

Weighted least squares are linear, so each coefficient is a sum of the displacements with weights
that depend on the geometry alone. As in `local_field` and in a matched window, the normal rotates
with the surface: points above or below the tangent plane are displaced by their height times the
rotation of the normal, so every weight is a matrix. Infinitesimal rigid motions are exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import bsr_array

from palpate.shapes import Points, PointScalars
from palpate.vision.matching.local_regression import nearest_within
from palpate.vision.matching.scatter import Scatter

# Smallest tolerance (1 / variance inflation factor) of a coefficient; below it the polynomial is
# undetermined.
_MIN_TOLERANCE = 1e-3
# Far below that: lets a singular matrix be inverted, and then recognised.
_RIDGE = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class LocalFits:
    """Weighted polynomial fits about n places to the displacements of surrounding points.

    Attributes
    ----------
    place : (n, 3) float [m]
    tangent : (n, 2, 3) float       orthonormal, the coordinates of the polynomials
    reach : (n,) float [m]          their unit of length
    around : (k, 3) float [m]       the points
    first, second : (m,) int        index of a place (ascending) and of one of its points
    weight : (m,) float             weight of that point in the fit about that place
    """

    place: Points
    tangent: Float[np.ndarray, "n 2 3"]
    reach: PointScalars
    around: Float[np.ndarray, "_ 3"]
    first: Int[np.ndarray, " m"]
    second: Int[np.ndarray, " m"]
    weight: Float[np.ndarray, " m"]


def local_fits(
    scatter: Scatter,
    place: Float[np.ndarray, "n 3"],
    tangent: Float[np.ndarray, "n 2 3"],
    *,
    reach: float,
    max_points: int = 48,
    min_points: int | None = None,
) -> LocalFits:
    """Set up the polynomial fits of `local_field` as they are without outliers.

    Parameters
    ----------
    scatter : Scatter
    place, tangent, reach, max_points, min_points   as `local_field`

    Returns
    -------
    LocalFits
    """
    nearest, radius = nearest_within(scatter.point, place, reach, max_points, min_points)
    first, column = np.nonzero(nearest >= 0)
    second = nearest[first, column]
    away = np.linalg.norm(scatter.point[second] - place[first], axis=1) / radius[first]
    trace = np.trace(scatter.covariance - scatter.bias, axis1=1, axis2=2)
    # Without a variance nothing is known, e.g. of windows without contrast.
    certainty = np.divide(1.0, trace, out=np.zeros_like(trace), where=trace > 0.0)
    weight = np.maximum(1.0 - away**2, 0.0) ** 2 * certainty[second]
    return LocalFits(place, tangent, radius, scatter.point, first, second, weight)


def coefficient_operators(
    fits: LocalFits, order: int, terms: Sequence[int]
) -> tuple[list[bsr_array], Bool[np.ndarray, " n"]]:
    """Linear operators from the displacements of the points to the polynomial coefficients.

    Parameters
    ----------
    fits : LocalFits                of n places
    order : 1 or 2                  degree of the polynomials
    terms : sequence of int         indices into 1, x, y, x^2, x y, y^2, with lengths in units of
                                    the reach

    Returns
    -------
    operators : list of (3 n, 3 k) sparse   one per term; zero where undetermined
    determined : (n,) bool
    """
    monomials, height = local_terms(fits)
    design = monomials[:, : 3 * order]
    weighted = fits.weight[:, None] * design
    inverse, determined = _inverse(_normal(fits, design, weighted))
    weight = np.einsum("mi,mik->mk", weighted, inverse[fits.first])
    # Displacement of points off the tangent plane: height times slope, along each tangent.
    lever = sum_over_points(fits, weight * height[:, None])
    normals = np.cross(fits.tangent[:, 0], fits.tangent[:, 1])
    turned = np.einsum("nki,nj->nkij", fits.tangent, normals)
    slope = np.einsum("mk,mkij->mij", weight[:, 1:3], turned[fits.first])
    operators = []
    for term in terms:
        block = weight[:, term, None, None] * np.eye(3)
        block += lever[fits.first, term, None, None] * slope
        operators.append(_of_blocks(fits, block))
    return operators, determined


def local_terms(fits: LocalFits) -> tuple[Float[np.ndarray, "m 6"], Float[np.ndarray, " m"]]:
    """Monomials 1, x, y, x^2, x y, y^2 of each point about its place, (m, 6), and its height above
    the tangent plane, (m,), with lengths in units of the reach.

    Parameters
    ----------
    fits : LocalFits                of m pairs
    """
    away = (fits.around[fits.second] - fits.place[fits.first]) / fits.reach[fits.first, None]
    x, y = np.einsum("mki,mi->km", fits.tangent[fits.first], away)
    normals = np.cross(fits.tangent[:, 0], fits.tangent[:, 1])
    height = np.einsum("mi,mi->m", normals[fits.first], away)
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y]), height


def sum_over_points(
    fits: LocalFits, values: Float[np.ndarray, "m ..."]
) -> Float[np.ndarray, "n ..."]:
    """Sum of `values` over the points about each place, (n, ...)."""
    result = np.zeros((len(fits.place), *values.shape[1:]))
    starts = np.flatnonzero(np.diff(fits.first, prepend=-1))
    result[fits.first[starts]] = np.add.reduceat(values, starts)
    return result


def _normal(
    fits: LocalFits, design: Float[np.ndarray, "m k"], weighted: Float[np.ndarray, "m k"]
) -> Float[np.ndarray, "n k k"]:
    """Normal matrix about each place, entry by entry: there may be millions of pairs."""
    count = design.shape[1]
    normal = np.empty((len(fits.place), count, count))
    for i in range(count):
        for j in range(i + 1):
            normal[:, i, j] = normal[:, j, i] = sum_over_points(fits, weighted[:, i] * design[:, j])
    return normal


def _inverse(
    normal: Float[np.ndarray, "n k k"],
) -> tuple[Float[np.ndarray, "n k k"], Bool[np.ndarray, " n"]]:
    """Inverse of each matrix, zero where undetermined; and a flag where determined."""
    size = np.sqrt(np.einsum("nkk->nk", normal))
    size[size == 0.0] = 1.0
    scale = size[:, :, None] * size[:, None, :]
    inverse = np.linalg.inv(normal / scale + _RIDGE * np.eye(normal.shape[1]))
    determined = np.einsum("nkk->nk", inverse).max(axis=1) < 1.0 / _MIN_TOLERANCE
    return np.where(determined[:, None, None], inverse / scale, 0.0), determined


def _of_blocks(fits: LocalFits, block: Float[np.ndarray, "m 3 3"]) -> bsr_array:
    """Sparse matrix of 3 x 3 blocks, one per pair of place and point."""
    count = np.bincount(fits.first, minlength=len(fits.place))
    starts = np.concatenate([[0], np.cumsum(count)])
    shape = (3 * len(fits.place), 3 * len(fits.around))
    return bsr_array((block, fits.second, starts), shape=shape)
