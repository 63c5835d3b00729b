"""Rectification: epipolar lines along rows and, for an L of three cameras, also along columns.

All rectified cameras share one rotation and, apart from the principal point, one camera matrix K;
they have no lens distortion. For a pair the x axis is the baseline. For an L the image plane is
parallel to the plane of the three centres and x is the baseline of the left camera; if the arms are
not at a right angle, K has the skew that maps the baseline of the top camera onto the columns. So
one rectified reference picture serves both baselines. A rectified camera is an ordinary `Camera`:
`project` and `rays` work on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError
from palpate.records import Camera, camera_centre
from palpate.shapes import Matrix3, Vector3
from palpate.vision.projection import check_picture_size, normalised, project
from palpate.vision.spline import interpolate, make_spline_picture

# Rotating the image plane by 60 degrees stretches the picture's centre by a factor of two, and its
# far edge without bound.
_MIN_COSINE = np.cos(np.deg2rad(60.0))
# With arms at 30 (or 150) degrees, rectification shears the picture by about two.
_MIN_SINE = np.sin(np.deg2rad(30.0))
# Coordinate passed to `cv2.remap` for pixels that the camera does not see: far outside.
_OUTSIDE = -1e4


@dataclass(frozen=True, slots=True, eq=False)
class Rectified:
    """Two or three rectified cameras; the first is the reference.

    Attributes
    ----------
    cameras : tuple of Camera       k of them, without distortion, with one common rotation
    maps : tuple of (2, rows, columns) float32 [px]     column and row in each camera's original
                                    picture, for `cv2.remap`; far outside where it sees nothing
    axis : tuple of int             for each camera but the first: 0 where its disparity is in
                                    columns (epipolar lines along rows), 1 where in rows
    """

    cameras: tuple[Camera, ...]
    maps: tuple[Float[np.ndarray, "2 rows columns"], ...]
    axis: tuple[int, ...]


def rectify(cameras: Sequence[Camera], shape: tuple[int, int]) -> Rectified:
    """Rectify cameras: a point keeps its row in the second camera and its column in the third.

    Parameters
    ----------
    cameras : 2 or 3 of Camera      the reference first; three form an L, not necessarily with a
                                    right angle: the left one before the top one
    shape : (rows, columns) [px]    of their pictures

    Returns
    -------
    Rectified                       its pictures contain the whole reference picture

    Raises
    ------
    CalibrationError                coincident or (nearly) collinear centres, or cameras that look
                                    along the baseline or the plane of the three centres
    InputError                      a shape that contradicts a camera's size
    """
    reference, *others = cameras
    arms = [_arm(reference, other) for other in others]
    x = arms[0] * np.copysign(1.0, arms[0] @ reference.T_camera_object[0, :3])
    view = _mean_view(cameras)
    skew, where, kind = 0.0, "line between them", "pair"
    z = view - (view @ x) * x
    if len(others) == 2:
        where, kind = "plane of their centres", "triple"
        z = _plane_normal(cameras, arms)
        z = z * np.copysign(1.0, z @ view)
    z = z / max(float(np.linalg.norm(z)), 1e-12)
    if z @ view < _MIN_COSINE:
        names = [f"'{camera.name}'" for camera in cameras]
        raise CalibrationError(
            f"cameras {', '.join(names[:-1])} and {names[-1]} look along the {where} (within 30"
            f" degrees); such a {kind} cannot be rectified. Match without rectification"
        )
    y = np.cross(z, x)
    if len(others) == 2:
        skew = -float(arms[1] @ x) / float(arms[1] @ y)
    return _rectified(cameras, np.stack([x, y, z]), skew, tuple(range(len(others))), shape)


def remapped(
    rectified: Rectified, index: int, picture: Float[np.ndarray, "_ _"]
) -> Float[np.ndarray, "rows columns"]:
    """Resample the picture of one camera into its rectified camera.

    Interpolates with the spline that the refinement uses too: `cv2.remap`, which accepts the
    same maps, rounds coordinates to 1/32 px, and its bicubic kernel does not reproduce a linear
    ramp.

    Parameters
    ----------
    rectified : Rectified
    index : int                     0 for the reference
    picture : (rows, columns) float [grey levels]

    Returns
    -------
    (rows, columns) float32 [grey levels]   NaN where the camera sees nothing
    """
    column, row = rectified.maps[index]
    rows, columns = picture.shape
    inside = (column >= 0) & (column <= columns - 1) & (row >= 0) & (row <= rows - 1)
    position = np.stack([column[inside], row[inside]], axis=1).astype(np.float64)
    result = np.full(column.shape, np.nan, dtype=np.float32)
    result[inside] = interpolate(make_spline_picture(picture), position)
    return result


def _arm(reference: Camera, other: Camera) -> Vector3:
    """Unit vector from the centre of the reference to that of another camera, object frame."""
    arm = camera_centre(other) - camera_centre(reference)
    distance = np.linalg.norm(camera_centre(reference))
    # Centres that coincide within rounding give no direction.
    if np.linalg.norm(arm) <= 1e-9 * max(float(distance), 1e-9):
        raise CalibrationError(
            f"cameras '{reference.name}' and '{other.name}' have the same centre; depth needs a"
            " baseline. Are R and t of each camera's own, x_camera = R x_object + t?"
        )
    return arm / np.linalg.norm(arm)


def _plane_normal(cameras: Sequence[Camera], arms: Sequence[Vector3]) -> Vector3:
    """Normal of the plane of three centres; its length is the sine of the angle of the arms."""
    normal = np.cross(arms[0], arms[1])
    if np.linalg.norm(normal) < _MIN_SINE:
        reference, left, top = (camera.name for camera in cameras)
        angle = np.rad2deg(np.arccos(np.clip(arms[0] @ arms[1], -1.0, 1.0)))
        raise CalibrationError(
            f"seen from camera '{reference}' the cameras '{left}' and '{top}' are {angle:.1f}"
            " degrees apart; an L needs 30 to 150. Take another camera as the reference, or"
            " rectify pairs"
        )
    return normal


def _mean_view(cameras: Sequence[Camera]) -> Vector3:
    """Mean viewing direction of the cameras, unit vector in the object frame."""
    view = np.sum([camera.T_camera_object[2, :3] for camera in cameras], axis=0)
    return view / max(float(np.linalg.norm(view)), 1e-12)


def _rectified(
    cameras: Sequence[Camera],
    rotation: Matrix3,
    skew: float,
    axis: tuple[int, ...],
    shape: tuple[int, int],
) -> Rectified:
    """Cameras and maps for a common rotation (rows x, y, z in the object frame)."""
    first = cameras[0].matrix
    focal = 0.5 * (first[0, 0] + first[1, 1])
    matrix = np.array([[focal, focal * skew, 0.0], [0.0, focal, 0.0], [0.0, 0.0, 1.0]])
    extents = [_extent(camera, rotation, matrix, shape) for camera in cameras]
    size, origins = _canvas(extents, axis)
    turned, maps = [], []
    for camera, origin in zip(cameras, origins, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = rotation
        pose[:3, 3] = -rotation @ camera_centre(camera)
        shifted = matrix.copy()
        shifted[:2, 2] = -origin
        turned.append(
            replace(camera, size=size, matrix=shifted, distortion=np.zeros(8), T_camera_object=pose)
        )
        maps.append(_map(camera, turned[-1], size))
    return Rectified(tuple(turned), tuple(maps), axis)


def _extent(
    camera: Camera, rotation: Matrix3, matrix: Matrix3, shape: tuple[int, int]
) -> Float[np.ndarray, "2 2"]:
    """Minimum and maximum (column, row) of a camera's rectified picture, principal point at 0."""
    check_picture_size(camera, shape)
    rows, columns = shape
    column, row = np.arange(columns, dtype=np.float64), np.arange(rows, dtype=np.float64)
    edge = [np.stack([column, np.full(columns, end)], axis=1) for end in (0.0, rows - 1.0)]
    edge += [np.stack([np.full(rows, end), row], axis=1) for end in (0.0, columns - 1.0)]
    flat = normalised(camera, np.concatenate(edge))
    inside = np.column_stack([flat, np.ones(len(flat))]) @ camera.T_camera_object[:3, :3]
    turned = inside @ (matrix @ rotation).T
    turned = turned[turned[:, 2] > _MIN_COSINE * np.linalg.norm(inside, axis=1)]
    if not len(turned):
        raise CalibrationError(
            f"camera '{camera.name}' looks elsewhere than the others: nothing of its picture is"
            " left after rectification. Check its R and t, or match without rectification"
        )
    position = turned[:, :2] / turned[:, 2:]
    return np.stack([position.min(axis=0), position.max(axis=0)])


def _canvas(
    extents: Sequence[Float[np.ndarray, "2 2"]], axis: tuple[int, ...]
) -> tuple[tuple[int, int], list[Float[np.ndarray, "2"]]]:
    """Common size (columns, rows) of the rectified pictures, and coordinates of their first pixels.

    Along its disparity a camera's picture is centred in the canvas; across, all share one origin.
    """
    span = np.max([extent[1] - extent[0] for extent in extents], axis=0)
    # Across the disparity only what the reference sees can be matched.
    across = [k for k in (0, 1) if k not in axis]
    span[across] = (extents[0][1] - extents[0][0])[across]
    centres = [0.5 * (extent[0] + extent[1]) for extent in extents]
    origins = [centres[0] - 0.5 * span]
    for along, centre in zip(axis, centres[1:], strict=True):
        origin = origins[0].copy()
        origin[along] = centre[along] - 0.5 * span[along]
        origins.append(origin)
    columns, rows = (int(np.ceil(length)) + 1 for length in span)
    return (columns, rows), origins


def _map(
    camera: Camera, turned: Camera, size: tuple[int, int]
) -> Float[np.ndarray, "2 rows columns"]:
    """Positions of a rectified camera's pixels in the original picture."""
    row, column = np.indices(size[::-1], dtype=np.float64).reshape(2, -1)
    pixels = np.column_stack([column, row, np.ones(len(row))])
    back = np.linalg.inv(turned.matrix @ turned.T_camera_object[:3, :3])
    pose = camera.T_camera_object.copy()
    pose[:3, 3] = 0.0
    position = project(replace(camera, T_camera_object=pose), pixels @ back.T)
    position = np.where(np.isnan(position), _OUTSIDE, np.clip(position, _OUTSIDE, -_OUTSIDE))
    return np.ascontiguousarray(position.T.reshape(2, *size[::-1]), dtype=np.float32)
