"""Displacement of the mesh's vertices from range flow: robust local quadratics on the surface; and
the spatial averaging by windows and fits that each of them has.

A window with an affine shape function measures the affine fit of the motion over its pixels. The
final match takes second derivatives from the surrounding points, which corrects for as much of the
bending as these resolve, and a vertex gets the value of a local quadratic fit to the points around
it. All three steps are weighted least squares, linear with weights that depend on the geometry
alone, so each vertex value is a weighted sum of the surface's displacements. Applying the same sum
to a model's displacements removes the effect of the window size from a comparison. As in
`local_field` and in a matched window, the normal rotates with the surface: points above or below
the tangent plane are displaced by their height times the rotation of the normal, so every weight is
a matrix. Infinitesimal rigid motions are exact.

Source: Schreier and Sutton, Systematic errors in digital image correlation due to undermatched
subset shape functions, Experimental Mechanics 42 (2002).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import bsr_array, csr_array, diags_array, kron
from scipy.spatial import cKDTree

from palpate.geometry import (
    TriangleMesh,
    displacement_nodes,
    element_points,
    free_nodes,
    interpolation_matrix,
    piece_middles,
    split_sides,
    triangle_areas,
    vertex_normals,
)
from palpate.records import (
    INDEPENDENT,
    Camera,
    PointCorrelation,
    Rig,
    SurfaceAverage,
    camera_centre,
)
from palpate.shapes import Flags, Points, PointScalars, Triangles, Vertices
from palpate.vision.joint.match import BEND_REACH
from palpate.vision.matching.local_regression import (
    LocalField,
    Scatter,
    local_field,
    nearest_within,
    noise_correlation,
)
from palpate.vision.projection import pixel_sizes, project
from palpate.vision.range_flow import (
    RangeFlow,
    VertexDisplacement,
    is_valid,
    measured_vertices,
)

# Radius around a vertex, in half windows, of the points used: those whose windows contain it.
_REACH = 1.2
# Minimum cosine between normal and viewing direction: below it, the points lie on one side only.
_MIN_COSINE = 0.1
# Twice the number of coefficients of a quadratic.
_MIN_POINTS = 12
# A vertex whose standard deviation exceeds this many times that of a typical point is extrapolated.
_MAX_SIGMA_RATIO = 3.0
# Side of the surface pieces that represent pixels, in sides of a window.
_PIECE = 0.25
# Largest number of pieces, a few hundred bytes each: if windows are far smaller than triangles,
# pieces are larger than `_PIECE`.
_MAX_PIECES = 1e6
# Area of an equilateral triangle of side one.
_EQUILATERAL = 0.433
# Minimum cosine between normal and viewing direction for a camera's windows to count.
_MIN_SIDE_COSINE = 0.2
# Radius, in half windows, within which a window's pixels lie on one part of the surface.
_MAX_DISTANCE = 4.0
# Indices of the second-order terms of a quadratic: x^2, x y, y^2.
_SECOND_ORDER = (3, 4, 5)
# Largest sum of absolute weights: usually 1.6, up to 3.5 at creases and beside tools. Above it all
# points lie on one side, and the weights depend on which of them gave the second derivatives.
_MAX_WEIGHT = 4.0
# Tolerance for rounding in a sum of about a hundred weights.
_ROUNDING = 1e-6
# Smallest tolerance (1 / variance inflation factor) of a coefficient; below it the polynomial is
# undetermined.
_MIN_TOLERANCE = 1e-3
# Far below that: lets a singular matrix be inverted, and then recognised.
_RIDGE = 1e-9


def vertex_displacement(
    flow: RangeFlow, camera: Camera, vertices: Vertices, triangles: Triangles
) -> VertexDisplacement:
    """Displacement and covariance of the vertices around which range flow was measured.

    Parameters
    ----------
    flow : RangeFlow
    camera : Camera                 the reference camera
    vertices, triangles : (v, 3) float [m], (m, 3) int

    Returns
    -------
    VertexDisplacement              NaN at vertices that face away from the camera, have fewer than
                                    12 points around them, or lie outside the measured area
    """
    displacement = np.full(vertices.shape, np.nan)
    covariance = np.full((*vertices.shape, 3), np.nan)
    count = np.zeros(len(vertices), dtype=np.int64)
    valid = is_valid(flow)
    normal = vertex_normals(vertices, triangles)
    rows = np.flatnonzero(_facing(camera, vertices, normal))
    correlation = INDEPENDENT
    if valid.any() and len(rows) > 0:
        scatter = _scatter(flow, valid)
        field = _field_at(scatter, vertices[rows], normal[rows], camera)
        good = np.isfinite(field.displacement).all(axis=1) & (field.count >= _MIN_POINTS)
        # Outside the points the polynomial extrapolates, with a large variance.
        trace = np.trace(field.covariance, axis1=1, axis2=2)
        usual = np.median(np.trace(flow.covariance[valid], axis1=1, axis2=2))
        with np.errstate(invalid="ignore"):
            good &= trace < _MAX_SIGMA_RATIO**2 * usual
        displacement[rows[good]] = field.displacement[good]
        covariance[rows[good]] = field.covariance[good]
        count[rows] = field.count
        correlated = noise_correlation(scatter, field)
        both_good = good[correlated.pair].all(axis=1)
        correlation = PointCorrelation(
            rows[correlated.pair[both_good]], correlated.value[both_good]
        )
    return VertexDisplacement(displacement, covariance, count, correlation)


def with_average(
    displacement: VertexDisplacement, flow: RangeFlow, rig: Rig, surface: TriangleMesh, order: int
) -> VertexDisplacement:
    """Add the weighted average of the surface's displacement that each vertex value represents.

    Parameters
    ----------
    displacement : VertexDisplacement      of v vertices, from `flow`
    flow : RangeFlow
    rig : Rig
    surface : TriangleMesh          of v vertices
    order : 1 or 2                  shape function of the windows: affine or quadratic

    Returns
    -------
    VertexDisplacement
    """
    valid, rows = is_valid(flow), np.flatnonzero(measured_vertices(displacement))
    if len(rows) == 0:
        return displacement
    scatter, camera = _scatter(flow, valid), rig.cameras[rig.reference]
    half = _half_window(scatter, camera)
    normal = vertex_normals(surface.vertices, surface.triangles)
    vertices = local_fits(
        scatter, surface.vertices[rows], _tangents(normal[rows]), reach=_REACH * half,
        min_points=_MIN_POINTS,
    )  # fmt: skip
    bends = local_fits(scatter, scatter.point, flow.tangent[valid], reach=BEND_REACH * half)
    average = _surface_average(flow.subset, rig, surface, vertices, bends, order)
    return replace(displacement, average=average.embedded(rows, len(surface.vertices)))


def _scatter(flow: RangeFlow, valid: Flags) -> Scatter:
    """Collect the valid points of range flow."""
    return Scatter(
        flow.point[valid],
        flow.pixel[valid],
        flow.displacement[valid],
        flow.covariance[valid],
        flow.bias[valid],
        flow.subset,
    )


def _field_at(
    scatter: Scatter,
    position: Float[np.ndarray, "k 3"],
    normal: Float[np.ndarray, "k 3"],
    camera: Camera,
) -> LocalField:
    """Local field of the scatter at vertices."""
    reach = _REACH * _half_window(scatter, camera)
    return local_field(scatter, position, _tangents(normal), reach=reach, min_points=_MIN_POINTS)


def _half_window(scatter: Scatter, camera: Camera) -> float:
    """Half the side of a window on the surface [m]."""
    return (scatter.subset // 2) * float(np.median(pixel_sizes(camera, scatter.point)))


def _facing(camera: Camera, vertices: Vertices, normal: Vertices) -> Flags:
    """True for vertices whose normals point towards the camera."""
    toward = camera_centre(camera) - vertices
    toward = toward / np.linalg.norm(toward, axis=1)[:, None]
    return (toward * normal).sum(axis=1) > _MIN_COSINE


def _tangents(normal: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "k 2 3"]:
    """Two orthonormal tangents for each normal."""
    other = np.eye(3)[np.abs(normal).argmin(axis=1)]
    first = np.cross(normal, other)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(normal, first)], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Small triangles that represent the pixels on them.

    Attributes
    ----------
    middle : (k, 3) float [m]
    area : (k, 3) float [m^2]       area vector along the outward normal
    nodes : (s, 3) float [m]        vertices and midside nodes of the quadratic elements
    from_nodes : (k, s) sparse      interpolates a displacement from the nodes to the middles
    """

    middle: Points
    area: Points
    nodes: Float[np.ndarray, "s 3"]
    from_nodes: csr_array


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


def _surface_average(
    subset: int,
    rig: Rig,
    surface: TriangleMesh,
    vertices: LocalFits,
    curvature_fits: LocalFits,
    order: int,
) -> SurfaceAverage:
    """Weights with which measured vertex displacements average the surface's displacement.

    Parameters
    ----------
    subset : int [px]               side of a window
    rig : Rig
    surface : TriangleMesh
    vertices : LocalFits            quadratic fits about v vertices to the p matched points
    curvature_fits : LocalFits      quadratic fits to the same points about each of them, which give
                                    affine windows their second derivatives
    order : 1 or 2                  shape function of the windows: affine or quadratic

    Returns
    -------
    SurfaceAverage                  of v points; rows without weights where they are not reliable

    Source
    ------
    Schreier and Sutton (2002), for the bias of undermatched shape functions.
    """
    half_window = (subset // 2) * pixel_sizes(rig.cameras[rig.reference], curvature_fits.place)
    pieces = _cut(surface, _PIECE * 2.0 * float(np.median(half_window)), curvature_fits.place)
    windows = _windows(subset, rig, pieces, curvature_fits, half_window)
    (mean,), _ = coefficient_operators(windows, order, (0,))
    (weights,), _ = coefficient_operators(vertices, 2, (0,))
    if order == 1:
        curvature, _ = coefficient_operators(curvature_fits, 2, _SECOND_ORDER)
        moments = _moments(windows, mean, curvature_fits)
        bend = sum(moment @ operator for moment, operator in zip(moments, curvature, strict=True))
        weights = weights - weights @ bend
    weights = weights @ (mean @ kron(pieces.from_nodes, np.eye(3), format="bsr"))
    return _used(csr_array(weights), pieces.nodes)


def _cut(surface: TriangleMesh, side: float, points: Points) -> _Pieces:
    """Subdivide the triangles near some points into pieces of about equal size."""
    corner = surface.vertices[surface.triangles]
    centre = corner.mean(axis=1)
    reach = np.linalg.norm(corner - centre[:, None], axis=2).max(axis=1)
    near = np.flatnonzero(cKDTree(points).query(centre)[0] < reach + side / _PIECE)
    # Mean area of a triangle, weighted by area.
    area = triangle_areas(surface)[near]
    usual = float((area**2).sum() / area.sum())
    cuts = round(np.sqrt(usual / (_EQUILATERAL * side**2)))
    cuts = int(np.clip(cuts, 1, np.sqrt(_MAX_PIECES / len(near))))
    whole = np.zeros(len(surface.triangles), dtype=np.int64)
    fitted = displacement_nodes(surface, split_sides(surface, whole))
    nodes = np.concatenate([surface.vertices, fitted.weights @ surface.vertices])
    middles = piece_middles(cuts)
    corners = element_points(nodes[fitted.element[near]], middles).reshape(-1, 6)
    owner, barycentric = np.repeat(near, cuts**2), np.tile(middles, (len(near), 1))
    from_nodes = interpolation_matrix(free_nodes(fitted), owner, barycentric)
    # Area normals of parallelograms, twice those of the pieces.
    return _Pieces(corners[:, :3], 0.5 * corners[:, 3:] / cuts**2, nodes, from_nodes)


def _windows(
    subset: int, rig: Rig, pieces: _Pieces, points: LocalFits, half_window: PointScalars
) -> LocalFits:
    """Pieces of the surface within each point's windows, weighted by the pixels they cover."""
    position, tangent = points.place, points.tangent
    normal = np.cross(tangent[:, 0], tangent[:, 1])
    weight = csr_array((len(position), len(pieces.middle)))
    for camera in rig.cameras:
        weight += _in_windows(camera, subset, position, normal, pieces)
    pair = weight.tocoo()
    first, second = pair.coords
    distance = np.linalg.norm(pieces.middle[second] - position[first], axis=1)
    near = np.flatnonzero(distance < _MAX_DISTANCE * half_window[first])
    near = near[np.lexsort((second[near], first[near]))]
    return LocalFits(
        position, tangent, half_window, pieces.middle, first[near], second[near], pair.data[near]
    )


def _cosine(camera: Camera, position: Points, normal: Points) -> Float[np.ndarray, " n"]:
    """Cosine of the angle between the surface's normal and the direction to a camera."""
    toward = camera_centre(camera) - position
    size = np.linalg.norm(toward, axis=1) * np.linalg.norm(normal, axis=1)
    return np.einsum("ni,ni->n", toward, normal) / size


def _in_windows(
    camera: Camera, subset: int, position: Points, normal: Points, pieces: _Pieces
) -> csr_array:
    """Number of pixels that pieces cover in one camera's windows around the points it sees."""
    cosine = _cosine(camera, pieces.middle, pieces.area)
    pixel, centre = project(camera, pieces.middle), project(camera, position)
    # NaN behind the camera and outside the valid range of its lens model.
    shown = np.flatnonzero((cosine > _MIN_SIDE_COSINE) & np.isfinite(pixel).all(axis=1))
    faces = _cosine(camera, position, normal) > _MIN_SIDE_COSINE
    seen = np.flatnonzero(faces & np.isfinite(centre).all(axis=1))
    middle, pixel, centre = pieces.middle[shown], pixel[shown], centre[seen]
    cover = cosine[shown] * np.linalg.norm(pieces.area[shown], axis=1)
    cover /= pixel_sizes(camera, middle) ** 2
    side = np.sqrt(cover)
    # A piece counts by the fraction inside, in a window shrunk so that its second moment is right.
    half = 0.5 * np.sqrt(np.maximum(subset**2 - cover, 0.0))
    widest = 0.5 * (subset + side.max(initial=0.0))
    inside = cKDTree(pixel).query_ball_point(centre, widest, p=np.inf)
    first = np.repeat(np.arange(len(seen)), list(map(len, inside)))
    second = np.concatenate([*inside, []]).astype(np.int64)
    offset = np.abs(pixel[second] - centre[first])
    beyond = (offset - half[second, None]) / side[second, None]
    fraction = np.clip(0.5 - beyond, 0.0, 1.0).prod(axis=1)
    counts = np.flatnonzero(fraction > 0.0)
    first, second = first[counts], second[counts]
    return csr_array(
        (fraction[counts] * cover[second], (seen[first], shown[second])),
        shape=(len(position), len(pieces.middle)),
    )


def _moments(windows: LocalFits, mean: bsr_array, curvature_fits: LocalFits) -> list[bsr_array]:
    """Response of each window to each second-order term of a motion about its point."""
    monomials, _ = _local_terms(windows)
    every = np.arange(len(windows.place) + 1)
    scale = ((windows.reach / curvature_fits.reach) ** 2)[:, None, None]
    moments = [
        scale * _sum_over_points(windows, monomials[:, term, None, None] * mean.data)
        for term in _SECOND_ORDER
    ]
    return [bsr_array((moment, every[:-1], every)) for moment in moments]


def _used(weights: csr_array, points: Points) -> SurfaceAverage:
    """The average without unused points and without unreliable rows: those whose weights do not add
    up to the identity, or whose absolute sum is too large."""
    blocks = (weights @ np.tile(np.eye(3), (len(points), 1))).reshape(-1, 3, 3)
    whole = np.abs(blocks - np.eye(3)).max(axis=(1, 2)) < _ROUNDING
    whole &= abs(weights).sum(axis=1).reshape(-1, 3).max(axis=1) < _MAX_WEIGHT
    reliable = csr_array(diags_array(np.repeat(whole.astype(np.float64), 3)) @ weights)
    reliable.eliminate_zeros()
    used = np.zeros(3 * len(points), dtype=bool)
    used[reliable.indices] = True
    counts = used.reshape(-1, 3).any(axis=1)
    columns = np.flatnonzero(np.repeat(counts, 3))
    return SurfaceAverage(points[counts], bsr_array(reliable[:, columns], blocksize=(3, 3)))


def local_fits(
    scatter: Scatter,
    position: Float[np.ndarray, "n 3"],
    tangent: Float[np.ndarray, "n 2 3"],
    *,
    reach: float,
    min_points: int | None = None,
) -> LocalFits:
    """Set up the polynomial fits of `local_field` as they are without outliers.

    Parameters
    ----------
    scatter : Scatter
    position, tangent, reach, min_points   as `local_field`

    Returns
    -------
    LocalFits
    """
    nearest, radius = nearest_within(scatter.point, position, reach, min_points)
    first, column = np.nonzero(nearest >= 0)
    second = nearest[first, column]
    away = np.linalg.norm(scatter.point[second] - position[first], axis=1) / radius[first]
    trace = np.trace(scatter.covariance - scatter.bias, axis1=1, axis2=2)
    # Without a variance nothing is known, e.g. of windows without contrast.
    certainty = np.divide(1.0, trace, out=np.zeros_like(trace), where=trace > 0.0)
    weight = np.maximum(1.0 - away**2, 0.0) ** 2 * certainty[second]
    return LocalFits(position, tangent, radius, scatter.point, first, second, weight)


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
    monomials, height = _local_terms(fits)
    design = monomials[:, : 3 * order]
    weighted = fits.weight[:, None] * design
    inverse, determined = _inverse(_normal(fits, design, weighted))
    weight = np.einsum("mi,mik->mk", weighted, inverse[fits.first])
    # Displacement of points off the tangent plane: height times slope, along each tangent.
    lever = _sum_over_points(fits, weight * height[:, None])
    normals = np.cross(fits.tangent[:, 0], fits.tangent[:, 1])
    turned = np.einsum("nki,nj->nkij", fits.tangent, normals)
    slope = np.einsum("mk,mkij->mij", weight[:, 1:3], turned[fits.first])
    operators = []
    for term in terms:
        block = weight[:, term, None, None] * np.eye(3)
        block += lever[fits.first, term, None, None] * slope
        operators.append(_of_blocks(fits, block))
    return operators, determined


def _local_terms(fits: LocalFits) -> tuple[Float[np.ndarray, "m 6"], Float[np.ndarray, " m"]]:
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


def _sum_over_points(
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
            normal[:, i, j] = normal[:, j, i] = _sum_over_points(
                fits, weighted[:, i] * design[:, j]
            )
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
