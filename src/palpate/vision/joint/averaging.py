"""Spatial averaging of the displacement by the windows of the method `joint`.

A window with an affine shape function measures the affine fit of the motion over its pixels. The
final match takes second derivatives from the surrounding points, which corrects for as much of the
bending as these resolve, and a vertex gets the value of a local quadratic fit to the points around
it. All three steps are linear with known weights, so each vertex value is a weighted sum of the
surface's displacements. Applying the same sum to a model's displacements removes the effect of the
window size from a comparison.

Source: Schreier and Sutton, Systematic errors in digital image correlation due to undermatched
subset shape functions, Experimental Mechanics 42 (2002).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
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
)
from palpate.records import Camera, Rig, SurfaceAverage, camera_centre
from palpate.shapes import Points, PointScalars
from palpate.vision.cameras.projection import pixel_sizes, project
from palpate.vision.matching.fit_operators import (
    LocalFits,
    coefficient_operators,
    local_terms,
    sum_over_points,
)

# Side of the surface pieces that represent pixels, in sides of a window.
_PIECE = 0.25
# Largest number of pieces, a few hundred bytes each: if windows are far smaller than triangles,
# pieces are larger than `_PIECE`.
_MAX_PIECES = 1e6
# Area of an equilateral triangle of side one.
_EQUILATERAL = 0.433
# Minimum cosine between normal and viewing direction for a camera's windows to count.
_MIN_COSINE = 0.2
# Radius, in half windows, within which a window's pixels lie on one part of the surface.
_MAX_DISTANCE = 4.0
# Indices of the second-order terms of a quadratic: x^2, x y, y^2.
_SECOND_ORDER = (3, 4, 5)
# Largest sum of absolute weights: usually 1.6, up to 3.5 at creases and beside tools. Above it all
# points lie on one side, and the weights depend on which of them gave the second derivatives.
_MAX_WEIGHT = 4.0
# Tolerance for rounding in a sum of about a hundred weights.
_ROUNDING = 1e-6


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


def surface_average(
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
        bend = sum(moment @ one for moment, one in zip(moments, curvature, strict=True))
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
    found = element_points(nodes[fitted.element[near]], middles).reshape(-1, 6)
    owner, place = np.repeat(near, cuts**2), np.tile(middles, (len(near), 1))
    from_nodes = interpolation_matrix(free_nodes(fitted), owner, place)
    # Area normals of parallelograms, twice those of the pieces.
    return _Pieces(found[:, :3], 0.5 * found[:, 3:] / cuts**2, nodes, from_nodes)


def _windows(
    subset: int, rig: Rig, pieces: _Pieces, points: LocalFits, half_window: PointScalars
) -> LocalFits:
    """Pieces of the surface within each point's windows, weighted by the pixels they cover."""
    place, tangent = points.place, points.tangent
    normal = np.cross(tangent[:, 0], tangent[:, 1])
    weight = csr_array((len(place), len(pieces.middle)))
    for camera in rig.cameras:
        weight += _in_windows(camera, subset, place, normal, pieces)
    pair = weight.tocoo()
    first, second = pair.coords
    distance = np.linalg.norm(pieces.middle[second] - place[first], axis=1)
    near = np.flatnonzero(distance < _MAX_DISTANCE * half_window[first])
    near = near[np.lexsort((second[near], first[near]))]
    return LocalFits(
        place, tangent, half_window, pieces.middle, first[near], second[near], pair.data[near]
    )


def _cosine(camera: Camera, place: Points, normal: Points) -> Float[np.ndarray, " n"]:
    """Cosine of the angle between the surface's normal and the direction to a camera."""
    toward = camera_centre(camera) - place
    size = np.linalg.norm(toward, axis=1) * np.linalg.norm(normal, axis=1)
    return np.einsum("ni,ni->n", toward, normal) / size


def _in_windows(
    camera: Camera, subset: int, place: Points, normal: Points, pieces: _Pieces
) -> csr_array:
    """Number of pixels that pieces cover in one camera's windows around the points it sees."""
    cosine = _cosine(camera, pieces.middle, pieces.area)
    pixel, centre = project(camera, pieces.middle), project(camera, place)
    # NaN behind the camera and outside the valid range of its lens model.
    shown = np.flatnonzero((cosine > _MIN_COSINE) & np.isfinite(pixel).all(axis=1))
    faces = _cosine(camera, place, normal) > _MIN_COSINE
    seen = np.flatnonzero(faces & np.isfinite(centre).all(axis=1))
    middle, pixel, centre = pieces.middle[shown], pixel[shown], centre[seen]
    cover = cosine[shown] * np.linalg.norm(pieces.area[shown], axis=1)
    cover /= pixel_sizes(camera, middle) ** 2
    side = np.sqrt(cover)
    # A piece counts by the fraction inside, in a window shrunk so that its second moment is right.
    half = 0.5 * np.sqrt(np.maximum(subset**2 - cover, 0.0))
    widest = 0.5 * (subset + side.max(initial=0.0))
    found = cKDTree(pixel).query_ball_point(centre, widest, p=np.inf)
    first = np.repeat(np.arange(len(seen)), list(map(len, found)))
    second = np.concatenate([*found, []]).astype(np.int64)
    offset = np.abs(pixel[second] - centre[first])
    beyond = (offset - half[second, None]) / side[second, None]
    fraction = np.clip(0.5 - beyond, 0.0, 1.0).prod(axis=1)
    counts = np.flatnonzero(fraction > 0.0)
    first, second = first[counts], second[counts]
    return csr_array(
        (fraction[counts] * cover[second], (seen[first], shown[second])),
        shape=(len(place), len(pieces.middle)),
    )


def _moments(windows: LocalFits, mean: bsr_array, curvature_fits: LocalFits) -> list[bsr_array]:
    """Response of each window to each second-order term of a motion about its point."""
    monomials, _ = local_terms(windows)
    every = np.arange(len(windows.place) + 1)
    scale = ((windows.reach / curvature_fits.reach) ** 2)[:, None, None]
    moments = [
        scale * sum_over_points(windows, monomials[:, term, None, None] * mean.data)
        for term in _SECOND_ORDER
    ]
    return [bsr_array((moment, every[:-1], every)) for moment in moments]


def _used(weights: csr_array, points: Points) -> SurfaceAverage:
    """The average without unused points and without unreliable rows: those whose weights do not add
    up to the identity, or whose absolute sum is too large."""
    blocks = (weights @ np.tile(np.eye(3), (len(points), 1))).reshape(-1, 3, 3)
    whole = np.abs(blocks - np.eye(3)).max(axis=(1, 2)) < _ROUNDING
    whole &= abs(weights).sum(axis=1).reshape(-1, 3).max(axis=1) < _MAX_WEIGHT
    kept = csr_array(diags_array(np.repeat(whole.astype(np.float64), 3)) @ weights)
    kept.eliminate_zeros()
    used = np.zeros(3 * len(points), dtype=bool)
    used[kept.indices] = True
    counts = used.reshape(-1, 3).any(axis=1)
    columns = np.flatnonzero(np.repeat(counts, 3))
    return SurfaceAverage(points[counts], csr_array(kept[:, columns]))
