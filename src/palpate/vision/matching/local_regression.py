"""A smooth field from scattered displacements of the surface: robust local polynomials.

Around every place a polynomial in two tangent coordinates is fitted to nearby displacements,
weighted by inverse variance and a smooth kernel, and made robust by Student-t weights. The result
is a weighted sum of the displacements, so its covariance follows from theirs and from the overlap
of their windows in the picture: windows that share pixels share noise, also that of the field at
neighbouring places. Points above or below the tangent plane rotate with the normal, so a rigid
motion is reproduced exactly on curved and creased surfaces too.

Source: Cleveland and Devlin, Locally weighted regression, Journal of the American Statistical
Association 83 (1988).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from scipy.sparse import coo_array, csr_array, dia_array
from scipy.spatial import cKDTree

from palpate.records import PointCorrelation
from palpate.shapes import Points
from palpate.threads import in_threads
from palpate.vision.cholesky import cholesky_kernel, cholesky_solve_kernel

_TERMS = {1: 3, 2: 6}
# Largest number of displacements that a fit uses, the nearest ones.
_MAX_POINTS = 48
# Degrees of freedom of the Student-t weights: a residual of ten sigma in one component has 1/15 of
# the usual weight.
_DEGREES_OF_FREEDOM = 4.0
_ROUNDS = 6
# Minimum number of places per thread: each takes about 0.02 ms.
_MIN_PLACES_PER_THREAD = 32
# Smallest relative pivot (tolerance) of a term: displacements on a line, or on one side only, do
# not determine the polynomial.
_MIN_PIVOT = 1e-3
# What the compiler may assume of floating-point numbers: NaN keep their meaning.
_ANY_ORDER = {"reassoc", "nsz", "contract"}
# Minimum number of sums per thread: each takes about 0.003 ms.
_MIN_SUMS_PER_THREAD = 128
# Smaller correlations are dropped: three quarters of the pairs whose windows touch, which together
# would add about 1 % to a variance.
_MIN_CORRELATION = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class LocalField:
    """The fitted field and its derivatives along two tangents; NaN where undetermined.

    Attributes
    ----------
    displacement : (t, 3) float [m]
    gradient : (t, 2, 3) float [-]      along the first and the second tangent
    curvature : (t, 3, 3) float [1/m]   coefficients of xi^2, xi eta, eta^2; zero for order 1
    covariance : (t, 3, 3) float [m^2]  of the displacement; inflated where the residuals exceed the
                                        noise
    count : (t,) int                    number of displacements within reach
    nearest : (t, m) int                their indices in the scatter; -1 where there are fewer
    weight : (t, m) float [-]           weight of each in the fitted displacement; NaN where unused
                                        or undetermined
    bend : (t, m) float [1/m^2]         the same in the sum of the coefficients of xi^2 and eta^2;
                                        NaN for order 1
    """

    displacement: Float[np.ndarray, "t 3"]
    gradient: Float[np.ndarray, "t 2 3"]
    curvature: Float[np.ndarray, "t 3 3"]
    covariance: Float[np.ndarray, "t 3 3"]
    count: Int[np.ndarray, " t"]
    nearest: Int[np.ndarray, "t m"]
    weight: Float[np.ndarray, "t m"]
    bend: Float[np.ndarray, "t m"]


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


def local_field(
    scatter: Scatter,
    position: Float[np.ndarray, "t 3"],
    tangent: Float[np.ndarray, "t 2 3"],
    *,
    reach: float,
    order: int = 2,
    min_points: int | None = None,
) -> LocalField:
    """Fit the displacement field of the surface at given places.

    Parameters
    ----------
    scatter : Scatter
    position : (t, 3) float [m]     on the surface
    tangent : (t, 2, 3) float       orthonormal tangents there
    reach : float [m]               displacements farther away have zero weight
    order : 1 or 2                  degree of the polynomial
    min_points : int or None        where fewer are within reach, the reach grows until it holds
                                    this many, but at most doubles: a surface seen obliquely has
                                    fewer

    Returns
    -------
    LocalField                      NaN where too few displacements are near
    """
    nearest, radius = nearest_within(scatter.point, position, reach, min_points)
    noise = scatter.covariance - scatter.bias
    count = len(position)
    value, gradient, curvature, covariance = (
        np.full((count, *shape), np.nan) for shape in ((3,), (2, 3), (3, 3), (3, 3))
    )
    weight, bend = np.full(nearest.shape, np.nan), np.full(nearest.shape, np.nan)
    in_threads(
        _fit_range, count, np.ascontiguousarray(position, dtype=np.float64),
        np.ascontiguousarray(tangent, dtype=np.float64), nearest, scatter.point, scatter.pixel,
        scatter.displacement, noise, scatter.bias, np.trace(noise, axis1=1, axis2=2),
        float(scatter.subset), radius, _TERMS[order], value, gradient, curvature, covariance,
        weight, bend, min_items=_MIN_PLACES_PER_THREAD,
    )  # fmt: skip
    neighbours = (nearest >= 0).sum(axis=1)
    return LocalField(value, gradient, curvature, covariance, neighbours, nearest, weight, bend)


def nearest_within(
    point: Points,
    position: Float[np.ndarray, "t 3"],
    reach: float,
    min_points: int | None,
) -> tuple[Int[np.ndarray, "t k"], Float[np.ndarray, " t"]]:
    """Nearest points of each place, as `local_field` uses them.

    Parameters
    ----------
    point : (n, 3) float [m]
    position : (t, 3) float [m]
    reach, min_points               as `local_field`

    Returns
    -------
    nearest : (t, k) int            at most k, nearest first, -1 where there are fewer
    reach : (t,) float [m]          radius within which they lie
    """
    nearest = np.full((len(position), _MAX_POINTS), -1)
    radius = np.full(len(position), reach)
    if len(point) > 0:
        count = min(_MAX_POINTS, len(point))
        farthest = reach if min_points is None else 2.0 * reach
        away, index = cKDTree(point).query(position, k=count, distance_upper_bound=farthest)
        away, index = away.reshape(len(position), count), index.reshape(len(position), count)
        if min_points is not None:
            last = np.minimum(away[:, min(min_points, count) - 1], farthest)
            # Slightly larger, so that the last point has some weight.
            radius = np.maximum(reach, 1.1 * last)
        inside = (index < len(point)) & (away < radius[:, None])
        nearest[:, :count] = np.where(inside, index, -1)
    return nearest, radius


@njit(cache=True, nogil=True, error_model="numpy")
def _fit_range(
    begin, end, position, tangent, nearest, point, pixel, displacement, noise, bias, trace,
    subset, reach, terms, value, gradient, curvature, covariance, weight, bend,
):  # fmt: skip
    max_points = nearest.shape[1]
    # Terms along the first axis: sums over the displacements are then vectorised.
    design, given = np.empty((terms, max_points)), np.empty((3, max_points))
    base_weight, robust, height = np.empty(max_points), np.empty(max_points), np.empty(max_points)
    variance, ratio = np.empty(max_points), np.empty(max_points)
    order = np.empty(max_points, dtype=np.int64)
    normal, solution, row = np.empty((terms, terms)), np.empty((3, terms)), np.empty(terms)
    turn = np.empty(3)
    for i in range(begin, end):
        size = reach[i]
        robust[:] = 1.0
        turn[:] = 0.0
        m = 0
        while m < max_points and nearest[i, m] >= 0:
            n = nearest[i, m]
            height[m] = _design_kernel(position[i], tangent[i], point[n], size, design[:, m])
            distance = 0.0
            for a in range(3):
                distance += (point[n, a] - position[i, a]) ** 2
                given[a, m] = displacement[n, a]
            near = 1.0 - distance / (size * size)
            base_weight[m] = max(near, 0.0) ** 2 / trace[n]
            variance[m] = trace[n]
            order[m] = m
            m += 1
        # Without a degree of freedom left, no outlier can be recognised.
        if m <= terms:
            continue
        good = False
        residual_rms = 0.0
        for _ in range(_ROUNDS):
            good = _solve_kernel(
                design, base_weight, robust, given, height, turn, m, normal, solution
            )
            if not good:
                break
            residual_rms = _reweigh_kernel(
                design, base_weight, robust, given, height, turn, m, variance, solution, ratio,
                order,
            )  # fmt: skip
            _turn_kernel(tangent[i], solution, size, turn)
        if not good:
            continue
        for a in range(3):
            value[i, a] = solution[a, 0]
            gradient[i, 0, a] = solution[a, 1] / size
            gradient[i, 1, a] = solution[a, 2] / size
            for k in range(3):
                curvature[i, k, a] = solution[a, 3 + k] / size**2 if terms == 6 else 0.0
        row[:] = 0.0
        row[0] = 1.0
        _weights_kernel(normal, row, design, base_weight, robust, m, weight[i])
        if terms == 6:
            row[:] = 0.0
            row[3] = row[5] = 1.0 / size**2
            _weights_kernel(normal, row, design, base_weight, robust, m, bend[i])
        _covariance_kernel(weight[i], noise, trace, pixel, subset, nearest[i], m, covariance[i])
        for a in range(3):
            for b in range(3):
                covariance[i, a, b] *= max(1.0, residual_rms * residual_rms)
                covariance[i, a, b] += bias[nearest[i, 0], a, b]


@njit(cache=True, error_model="numpy")
def _turn_kernel(tangent, solution, reach, turn):
    """Change of the surface's unit normal, from the derivatives along the tangents."""
    t, s, u = tangent[0], tangent[1], solution
    a0, a1, a2 = t[0] + u[0, 1] / reach, t[1] + u[1, 1] / reach, t[2] + u[2, 1] / reach
    b0, b1, b2 = s[0] + u[0, 2] / reach, s[1] + u[1, 2] / reach, s[2] + u[2, 2] / reach
    n0 = a1 * b2 - a2 * b1
    n1 = a2 * b0 - a0 * b2
    n2 = a0 * b1 - a1 * b0
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
    turn[0] = n0 / length - (t[1] * s[2] - t[2] * s[1])
    turn[1] = n1 / length - (t[2] * s[0] - t[0] * s[2])
    turn[2] = n2 / length - (t[0] * s[1] - t[1] * s[0])


@njit(cache=True, error_model="numpy")
def _design_kernel(position, tangent, point, reach, out):
    """Polynomial terms of one displacement, in units of the reach; returns its height [m]."""
    t, s = tangent[0], tangent[1]
    d0, d1, d2 = point[0] - position[0], point[1] - position[1], point[2] - position[2]
    xi = (d0 * t[0] + d1 * t[1] + d2 * t[2]) / reach
    eta = (d0 * s[0] + d1 * s[1] + d2 * s[2]) / reach
    out[0] = 1.0
    out[1] = xi
    out[2] = eta
    if len(out) == 6:
        out[3] = xi * xi
        out[4] = xi * eta
        out[5] = eta * eta
    return (
        d0 * (t[1] * s[2] - t[2] * s[1])
        + d1 * (t[2] * s[0] - t[0] * s[2])
        + d2 * (t[0] * s[1] - t[1] * s[0])
    )


@njit(cache=True, error_model="numpy", fastmath=_ANY_ORDER)
def _solve_kernel(design, base_weight, robust, given, height, turn, m, normal, solution):
    """Weighted least squares; leaves the Cholesky factor in `normal`; False where singular."""
    terms = len(design)
    for k in range(terms):
        for n in range(k + 1):
            total = 0.0
            for j in range(m):
                total += base_weight[j] * robust[j] * design[k, j] * design[n, j]
            normal[k, n] = total
        for a in range(3):
            total = 0.0
            for j in range(m):
                value = given[a, j] - height[j] * turn[a]
                total += base_weight[j] * robust[j] * design[k, j] * value
            solution[a, k] = total
    if not cholesky_kernel(normal, _MIN_PIVOT):
        return False
    for a in range(3):
        cholesky_solve_kernel(normal, solution[a])
    return True


@njit(cache=True, error_model="numpy", fastmath=_ANY_ORDER)
def _reweigh_kernel(
    design, base_weight, robust, given, height, turn, m, variance, solution, ratio, order
):
    """Student-t weights from the residuals; returns their weighted rms in units of sigma.

    `order` sorts `ratio` (m,), and is nearly that of the round before.
    """
    terms = len(design)
    for j in range(m):
        square = 0.0
        for a in range(3):
            residual = given[a, j] - height[j] * turn[a]
            for k in range(terms):
                residual -= design[k, j] * solution[a, k]
            square += residual * residual
        ratio[j] = square / variance[j]
    for j in range(m):
        this, k = order[j], j
        while k > 0 and ratio[order[k - 1]] > ratio[this]:
            order[k] = order[k - 1]
            k -= 1
        order[k] = this
    # Where the field is rougher than its noise everywhere, not every point is an outlier.
    scale = max(1.0, 0.5 * (ratio[order[(m - 1) // 2]] + ratio[order[m // 2]]))
    total = 0.0
    squares = 0.0
    for j in range(m):
        robust[j] = (_DEGREES_OF_FREEDOM + 3.0) / (_DEGREES_OF_FREEDOM + 3.0 * ratio[j] / scale)
        total += base_weight[j] * robust[j]
        squares += base_weight[j] * robust[j] * ratio[j]
    return np.sqrt(squares / total * m / (m - terms))


@njit(cache=True, error_model="numpy", fastmath=_ANY_ORDER)
def _weights_kernel(normal, row, design, base_weight, robust, m, out):
    """Weight of each displacement in a combination of the coefficients, given as `row`, which is
    overwritten; `normal` holds the Cholesky factor."""
    cholesky_solve_kernel(normal, row)
    for j in range(m):
        out[j] = 0.0
        for k in range(len(row)):
            out[j] += row[k] * design[k, j]
        out[j] *= base_weight[j] * robust[j]


@njit(cache=True, error_model="numpy", fastmath=_ANY_ORDER)
def _covariance_kernel(weight, noise, trace, pixel, subset, nearest, m, covariance):
    """Covariance of the fitted value, including the noise shared by overlapping windows."""
    mean = np.zeros((3, 3))
    total = 0.0
    for j in range(m):
        n = nearest[j]
        for a in range(3):
            for b in range(3):
                mean[a, b] += abs(weight[j]) * noise[n, a, b] / trace[n]
        total += abs(weight[j])
    factor = _variance_kernel(weight, trace, pixel, subset, nearest, m)
    for a in range(3):
        for b in range(3):
            covariance[a, b] = factor * mean[a, b] / total


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


@njit(cache=True, error_model="numpy", fastmath=_ANY_ORDER)
def _variance_kernel(weight, trace, pixel, subset, nearest, m):
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
        variance[i] = _variance_kernel(weight[i], trace, pixel, subset, nearest[i], m)


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
    row, column = np.nonzero(known)
    shape = (len(field.weight), len(scatter.point))
    weights = csr_array((field.weight[known], (row, field.nearest[row, column])), shape=shape)
    covariance = (weights @ _noise(scatter) @ weights.T).tocoo()
    variance = np.zeros(shape[0])
    first, second = covariance.coords
    same = first == second
    variance[first[same]] = covariance.data[same]
    chosen = first < second
    first, second = first[chosen], second[chosen]
    value = covariance.data[chosen] / np.sqrt(variance[first] * variance[second])
    significant = np.abs(value) > _MIN_CORRELATION
    return PointCorrelation(
        np.column_stack([first[significant], second[significant]]), value[significant]
    )


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
