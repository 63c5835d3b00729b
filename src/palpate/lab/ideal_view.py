"""The pinhole picture that is rendered, its resampling to a real camera, and its true motion.

The renderer knows only square pixels and no lens. The picture of such a camera is rendered
directly, cropped to the bodies. For any other camera a finer pinhole picture is rendered, and each
pixel of the camera is its mean over the pixel's area. Distortion is removed by `vision.pixel_grid`,
which the facility shares with the code that it tests; hence tests compare rendered positions with
OpenCV's projection.

Truth maps are the ground truth of the pictures, pixel by pixel, to compare estimates with.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32
from numba import njit, prange

from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh
from palpate.records import Camera, Rig, picture_size
from palpate.shapes import PointIndices, Points
from palpate.vision import SurfaceMap, pixel_grid, surface_map, visible

# Subdivision of a pixel's side where distortion has to be removed: with two, rendered features are
# within 0.002 px of their true positions.
FINE = 2
# Pixels kept around the bodies: the reach of the cubic interpolation.
_MARGIN = 3
# A point counts as hidden by its own body if it lies this far behind it, in pixel widths there: the
# tolerance covers the interpolation of depth between pixel centres near the silhouette.
_BEHIND = 0.1
# One bit of a byte for each camera.
_MAX_CAMERAS = 8


@dataclass(frozen=True, slots=True)
class IdealView:
    """Pinhole view in the camera's own frame: square pixels, no distortion.

    Attributes
    ----------
    shape : (rows, columns) [px]
    focal : float [px]
    centre : (column, row) [px]     principal point; the first pixel's centre is (0, 0); may lie
                                    outside the picture
    fine : int                      its pixels along a side of a camera pixel; 1: the same pixels
    """

    shape: tuple[int, int]
    focal: float
    centre: tuple[float, float]
    fine: int


def ideal_view(camera: Camera, points: Points) -> IdealView:
    """Pinhole view that covers the points which a camera sees.

    Parameters
    ----------
    camera : Camera                 with a picture size
    points : (n, 3) float [m]       object frame, all in front of the camera

    Returns
    -------
    IdealView

    Raises
    ------
    CalibrationError                points that are not in front of the camera
    InputError                      a camera without a picture size, or that sees none of the points
    """
    low, high = _bounds(camera, points)
    k = camera.matrix
    ideal = _is_ideal(camera)
    fine = 1 if ideal else FINE
    focal = fine * float(max(k[0, 0], k[1, 1]))
    # Where lens and unequal pixels do little, the view's pixels are parts of the camera's.
    axis = fine * k[:2, 2] + 0.5 * (fine - 1)
    origin = np.floor(low * focal + axis).astype(np.int64) - _MARGIN
    last = np.ceil(high * focal + axis).astype(np.int64) + _MARGIN
    if ideal:
        origin, last = np.maximum(origin, 0), np.minimum(last, np.array(camera.size) - 1)
    centre = axis - origin
    columns, rows = (int(count) for count in last - origin + 1)
    return IdealView((rows, columns), focal, (float(centre[0]), float(centre[1])), fine)


def camera_picture(
    camera: Camera, view: IdealView, picture: Float32[np.ndarray, "fine_rows fine_columns"]
) -> Float32[np.ndarray, "rows columns"]:
    """A camera's picture, resampled from its rendered pinhole view; zero beyond that view.

    Parameters
    ----------
    camera : Camera                 with a picture size
    view : IdealView                of this camera
    picture : (fine_rows, fine_columns) float32     rendered picture, of the view's shape

    Returns
    -------
    (rows, columns) float32         of the camera's size; every pixel is the mean over its area
    """
    columns, rows = picture_size(camera)
    if view.fine == 1:
        whole = np.zeros((rows, columns), dtype=np.float32)
        left = round(float(camera.matrix[0, 2]) - view.centre[0])
        top = round(float(camera.matrix[1, 2]) - view.centre[1])
        whole[top : top + view.shape[0], left : left + view.shape[1]] = picture
        return whole
    grid = _fine_grid(camera, view.fine) * view.focal
    grid[0] += view.centre[0]
    grid[1] += view.centre[1]
    return _area_means(np.ascontiguousarray(picture), grid, view.fine)


def _is_ideal(camera: Camera) -> bool:
    """Whether a camera is a pinhole with square pixels, without skew or distortion."""
    k = camera.matrix
    return bool(k[0, 0] == k[1, 1] and k[0, 1] == 0.0 and not camera.distortion.any())


def _bounds(
    camera: Camera, points: Points
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Corners of the visible points' bounding box, in the plane z = 1 of the camera."""
    pose = camera.T_camera_object
    x, y, depth = (points @ pose[:3, :3].T + pose[:3, 3]).T
    behind = ~(depth > 0.0)
    if behind.any():
        raise CalibrationError(
            f"camera '{camera.name}': {int(behind.sum())} of {len(points)} points of the bodies lie"
            f" beside or behind it (depth {depth.min():.3g} to {depth.max():.3g} m); all must be in"
            " front: check R, t, and how far the tool reaches"
        )
    flat = np.stack([x / depth, y / depth])
    field = _fine_grid(camera, 1)
    low = np.maximum(flat.min(axis=1), np.nanmin(field, axis=(1, 2)))
    high = np.minimum(flat.max(axis=1), np.nanmax(field, axis=(1, 2)))
    if not (low < high).all():
        middle = np.median(flat, axis=1)
        raise InputError(
            f"camera '{camera.name}' sees nothing of the bodies: their middle lies"
            f" {np.degrees(np.arctan(np.hypot(*middle))):.0f} degrees off its axis, outside its"
            f" {camera.size} pixels; turn the camera towards the object"
        )
    return low, high


def _fine_grid(camera: Camera, fine: int) -> Float[np.ndarray, "2 rows columns"]:
    """Rays, as points of the plane z = 1, through the centres of all subpixels of a camera."""
    columns, rows = picture_size(camera)
    matrix = fine * camera.matrix
    # The first pixel's corner, (-0.5, -0.5), stays where it is.
    matrix[:2, 2] += 0.5 * (fine - 1)
    matrix[2, 2] = 1.0
    finer = replace(camera, size=(fine * columns, fine * rows), matrix=matrix)
    return pixel_grid(finer, (fine * rows, fine * columns))


@njit(cache=True, parallel=True, error_model="numpy")
def _area_means(picture: np.ndarray, grid: np.ndarray, fine: int) -> np.ndarray:
    """Mean of the picture over the fine x fine subpixels of each pixel."""
    rows, columns = grid.shape[1] // fine, grid.shape[2] // fine
    means = np.empty((rows, columns), dtype=np.float32)
    share = 1.0 / (fine * fine)
    for i in prange(rows):
        for j in range(columns):
            total = 0.0
            for a in range(fine * i, fine * (i + 1)):
                for b in range(fine * j, fine * (j + 1)):
                    total += _cubic_kernel(picture, grid[0, a, b], grid[1, a, b])
            means[i, j] = total * share
    return means


@njit(cache=True, error_model="numpy")
def _cubic_kernel(picture: np.ndarray, x: float, y: float) -> float:
    """Keys' cubic interpolation; zero outside, and where x or y is NaN."""
    rows, columns = picture.shape
    if not (x > -2.0 and y > -2.0 and x < columns + 1.0 and y < rows + 1.0):
        return 0.0
    j, i = int(np.floor(x)), int(np.floor(y))
    u, v = x - j, y - i
    total = 0.0
    for a in range(-1, 3):
        if 0 <= i + a < rows:
            line = 0.0
            for b in range(-1, 3):
                if 0 <= j + b < columns:
                    line += _keys_kernel(abs(u - b)) * picture[i + a, j + b]
            total += _keys_kernel(abs(v - a)) * line
    return total


@njit(cache=True, error_model="numpy", inline="always")
def _keys_kernel(s: float) -> float:
    """Weight of a sample at distance s.

    Source
    ------
    R. Keys, Cubic convolution interpolation for digital image processing, IEEE Trans. Acoustics,
    Speech and Signal Processing 29 (1981), with a = -1/2.
    """
    if s < 1.0:
        return 1.0 + s * s * (1.5 * s - 2.5)
    return 2.0 + s * (-4.0 + s * (2.5 - 0.5 * s))


@dataclass(frozen=True, slots=True, eq=False)
class TruthMap:
    """True motion of what the reference camera sees at rest.

    Attributes
    ----------
    shape : (rows, columns)         of the reference camera
    pixel : (n,) int                row * columns + column of the pixels that show the body at rest
    point : (n, 3) float [m]        surface points at their centres, at rest, object frame
    displacement : (n, 3) float [m] of these points
    hidden_rest, hidden_loaded : (n,) int   bit i is set if camera i does not see the point, because
                                    it is outside the picture or occluded
    """

    shape: tuple[int, int]
    pixel: PointIndices
    point: Points
    displacement: Points
    hidden_rest: PointIndices
    hidden_loaded: PointIndices


def truth_map(
    rig: Rig,
    mesh: TriangleMesh,
    loaded: Float[np.ndarray, "w 3"],
    *,
    tool: TriangleMesh | None = None,
) -> TruthMap:
    """Truth map of one pair of rest and loaded pictures.

    Parameters
    ----------
    rig : Rig                       cameras with picture sizes, at most eight
    mesh : TriangleMesh             rendered mesh, at rest
    loaded : (v, 3) float [m]       its vertices in the loaded pictures
    tool : TriangleMesh or None     visible in the loaded pictures only

    Returns
    -------
    TruthMap

    Raises
    ------
    InputError                      too many cameras, one without a size, a reference camera that
                                    sees nothing of the body
    CalibrationError                a body that is not in front of a camera
    """
    if len(rig.cameras) > _MAX_CAMERAS:
        raise InputError(
            f"truth maps hold {_MAX_CAMERAS} cameras, a bit each; the rig has {len(rig.cameras)}"
        )
    seen = _surface_maps(rig, mesh)
    shown = seen[rig.reference]
    pixel = np.flatnonzero(shown.triangle.ravel() >= 0)
    if len(pixel) == 0:
        raise InputError(
            f"camera '{rig.cameras[rig.reference].name}' sees nothing of the body; turn it towards"
            " the object"
        )
    point = shown.point.reshape(-1, 3)[pixel]
    corner = mesh.triangles[shown.triangle.ravel()[pixel]]
    weight = _barycentric(mesh.vertices[corner], point)
    displacement = np.einsum("nc,nca->na", weight, (loaded - mesh.vertices)[corner])
    moved = point + displacement
    hidden_loaded = _hidden(
        rig, _surface_maps(rig, replace(mesh, vertices=loaded)), moved, behind=_BEHIND
    )
    if tool is not None:
        # Without tolerance: where the tool touches the body both surfaces coincide, but the tool's
        # near side is well in front.
        hidden_loaded |= _hidden(rig, _surface_maps(rig, tool), moved, behind=0.0)
    return TruthMap(
        shown.triangle.shape,
        pixel,
        point,
        displacement,
        _hidden(rig, seen, point, behind=_BEHIND),
        hidden_loaded,
    )


def write_truth_map(path: Path | io.BytesIO, truth: TruthMap) -> None:
    """Write a truth map as a compressed NPZ file; the same map gives the same bytes.

    Entries: `shape`, `pixel` (int32), `X` (point) and `U` (displacement; both float32, metres),
    `hidden_rest` and `hidden_loaded` (uint8).

    Parameters
    ----------
    path : Path or BytesIO
    truth : TruthMap
    """
    np.savez_compressed(
        path,
        shape=np.array(truth.shape),
        pixel=truth.pixel.astype(np.int32),
        X=truth.point.astype(np.float32),
        U=truth.displacement.astype(np.float32),
        hidden_rest=truth.hidden_rest.astype(np.uint8),
        hidden_loaded=truth.hidden_loaded.astype(np.uint8),
    )


def _surface_maps(rig: Rig, mesh: TriangleMesh) -> tuple[SurfaceMap, ...]:
    """What every camera of a rig sees of a surface."""
    return tuple(
        surface_map(camera, picture_size(camera)[::-1], mesh.vertices, mesh.triangles)
        for camera in rig.cameras
    )


def _hidden(rig: Rig, maps: Sequence[SurfaceMap], points: Points, *, behind: float) -> PointIndices:
    """Bits of the cameras that do not see points; `behind` is the tolerance in pixel widths."""
    bits = np.zeros(len(points), dtype=np.int64)
    for k, (camera, surface) in enumerate(zip(rig.cameras, maps, strict=True)):
        pose = camera.T_camera_object
        width = float((points @ pose[2, :3] + pose[2, 3]).min() / camera.matrix[0, 0])
        seen = visible(surface, camera, points, tolerance=behind * width)
        bits |= np.where(seen, 0, 1 << k)
    return bits


def _barycentric(corner: Float[np.ndarray, "n 3 3"], point: Points) -> Float[np.ndarray, "n 3"]:
    """Barycentric coordinates of points in their triangles' planes."""
    a, b = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    normal = np.cross(a, b)
    away = point - corner[:, 0]
    area2 = np.einsum("na,na->n", normal, normal)
    beside_b = np.einsum("na,na->n", np.cross(away, b), normal) / area2
    beside_c = np.einsum("na,na->n", np.cross(a, away), normal) / area2
    return np.stack([1.0 - beside_b - beside_c, beside_b, beside_c], axis=1)
