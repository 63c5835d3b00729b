"""Rectified pictures: epipolar lines along the rows, and for an L of three cameras the columns too.

All rectified cameras share one rotation and one K but for the principal point, and have no lens.
For a pair the x axis is the baseline. For an L the image plane is parallel to the plane of the
three centres and x is the baseline of the left camera; where the L is not a right angle, K gets the
skew that lays the baseline of the top camera along the columns. So the reference picture serves
both baselines, and a rectified camera is an ordinary `Camera`: `project` and `rays` work on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import CalibrationError
from palpate.records import Camera, camera_centre
from palpate.shapes import Matrix3, Vector3
from palpate.vision.cameras.projection import check_picture_size, normalised, project
from palpate.vision.images import interpolate, make_spline_picture

# Tilting a picture by 60 degrees stretches its centre by two and its far edge without bound.
_MIN_COSINE = np.cos(np.deg2rad(60.0))
# An L this far from a right angle (30 degrees between the arms) is sheared by two.
_MIN_SINE = np.sin(np.deg2rad(30.0))
# Where `cv2.remap` is sent for a pixel that the camera does not see: outside, whatever the method.
_OUTSIDE = -1e4


@dataclass(frozen=True, slots=True, eq=False)
class Rectified:
    """Two or three cameras made parallel; the first is the reference.

    Attributes
    ----------
    cameras : tuple of Camera       k of them, rectified: no lens, one rotation, own T_camera_object
    maps : tuple of (2, rows, columns) float32 [px]     column and row in each camera's own picture,
                                    for `cv2.remap`; far outside where it sees nothing
    axis : tuple of int             for each camera but the first: 0 where its disparity is in
                                    columns (epipolar lines along rows), 1 where in rows
    """

    cameras: tuple[Camera, ...]
    maps: tuple[Float[np.ndarray, "2 rows columns"], ...]
    axis: tuple[int, ...]


def rectify(cameras: Sequence[Camera], shape: tuple[int, int]) -> Rectified:
    """Turn cameras so that a point shares its row with the second, its column with the third.

    Parameters
    ----------
    cameras : 2 or 3 of Camera      the reference first; three make an L, not necessarily a right
                                    angle: the left one before the top one
    shape : (rows, columns) [px]    of their pictures

    Returns
    -------
    Rectified                       its pictures hold the whole reference picture

    Raises
    ------
    CalibrationError                one centre, centres (nearly) on a line, or cameras that look
                                    along the line of the two centres or the plane of the three
    InputError                      a shape that contradicts a camera's
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
    """The picture of one camera as its rectified camera would take it.

    Interpolated by the cubic spline that the refinement uses too: `cv2.remap`, which takes the maps
    as well, rounds places to a 32nd of a pixel, and its bicubic kernel bends a plain slope.

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
    place = np.stack([column[inside], row[inside]], axis=1).astype(np.float64)
    result = np.full(column.shape, np.nan, dtype=np.float32)
    result[inside] = interpolate(make_spline_picture(picture), place)
    return result


def _arm(reference: Camera, other: Camera) -> Vector3:
    """Unit vector from the centre of the reference to that of another camera, object frame."""
    arm = camera_centre(other) - camera_centre(reference)
    distance = np.linalg.norm(camera_centre(reference))
    # Centres closer than the rounding of their coordinates give no direction.
    if np.linalg.norm(arm) <= 1e-9 * max(float(distance), 1e-9):
        raise CalibrationError(
            f"cameras '{reference.name}' and '{other.name}' have the same centre; depth needs a"
            " baseline. Are R and t of each camera's own, x_camera = R x_object + t?"
        )
    return arm / np.linalg.norm(arm)


def _plane_normal(cameras: Sequence[Camera], arms: Sequence[Vector3]) -> Vector3:
    """Normal of the plane of three centres, as long as the sine of the angle between the arms."""
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
    """Unit vector along which the cameras look, on average, object frame."""
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
        own = matrix.copy()
        own[:2, 2] = -origin
        turned.append(
            replace(camera, size=size, matrix=own, distortion=np.zeros(8), T_camera_object=pose)
        )
        maps.append(_map(camera, turned[-1], size))
    return Rectified(tuple(turned), tuple(maps), axis)


def _extent(
    camera: Camera, rotation: Matrix3, matrix: Matrix3, shape: tuple[int, int]
) -> Float[np.ndarray, "2 2"]:
    """Least and greatest (column, row) of a camera's picture after the turn, principal point 0."""
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
    place = turned[:, :2] / turned[:, 2:]
    return np.stack([place.min(axis=0), place.max(axis=0)])


def _canvas(
    extents: Sequence[Float[np.ndarray, "2 2"]], axis: tuple[int, ...]
) -> tuple[tuple[int, int], list[Float[np.ndarray, "2"]]]:
    """Common size (columns, rows), and the place of each camera's first pixel.

    Along its disparity a camera's picture is centred in the canvas; across, all share one origin.
    """
    span = np.max([extent[1] - extent[0] for extent in extents], axis=0)
    # Across the disparity only what the reference sees can be matched.
    across = [k for k in (0, 1) if k not in axis]
    span[across] = (extents[0][1] - extents[0][0])[across]
    centres = [0.5 * (extent[0] + extent[1]) for extent in extents]
    origins = [centres[0] - 0.5 * span]
    for which, centre in zip(axis, centres[1:], strict=True):
        origin = origins[0].copy()
        origin[which] = centre[which] - 0.5 * span[which]
        origins.append(origin)
    columns, rows = (int(np.ceil(length)) + 1 for length in span)
    return (columns, rows), origins


def _map(
    camera: Camera, turned: Camera, size: tuple[int, int]
) -> Float[np.ndarray, "2 rows columns"]:
    """Where the pixels of a rectified camera lie in the picture as it was taken."""
    row, column = np.indices(size[::-1], dtype=np.float64).reshape(2, -1)
    pixels = np.column_stack([column, row, np.ones(len(row))])
    back = np.linalg.inv(turned.matrix @ turned.T_camera_object[:3, :3])
    pose = camera.T_camera_object.copy()
    pose[:3, 3] = 0.0
    place = project(replace(camera, T_camera_object=pose), pixels @ back.T)
    place = np.where(np.isnan(place), _OUTSIDE, np.clip(place, _OUTSIDE, -_OUTSIDE))
    return np.ascontiguousarray(place.T.reshape(2, *size[::-1]), dtype=np.float32)
