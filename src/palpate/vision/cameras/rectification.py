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

from palpate.errors import CalibrationError, InputError
from palpate.records import Camera, camera_centre
from palpate.shapes import Matrix3, Points, PointScalars, Vector3
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


def rectify_pair(reference: Camera, other: Camera, shape: tuple[int, int]) -> Rectified:
    """Turn two cameras so that every point lies in the same row of both.

    Parameters
    ----------
    reference, other : Camera
    shape : (rows, columns) [px]    of their pictures

    Returns
    -------
    Rectified                       its pictures hold the whole reference picture

    Raises
    ------
    CalibrationError                one centre, or a camera that looks along the baseline
    InputError                      a shape that contradicts a camera's
    """
    arm = _arm(reference, other)
    x = arm / np.linalg.norm(arm)
    x = x * np.copysign(1.0, x @ reference.T_camera_object[0, :3])
    view = _mean_view((reference, other))
    z = view - (view @ x) * x
    if np.linalg.norm(z) < _MIN_COSINE:
        raise CalibrationError(
            f"cameras '{reference.name}' and '{other.name}' look along the line between them"
            " (within 30 degrees); such a pair cannot be rectified. Match without rectification"
        )
    z = z / np.linalg.norm(z)
    rotation = np.stack([x, np.cross(z, x), z])
    return _rectified((reference, other), rotation, 0.0, (0,), shape)


def rectify_triple(
    reference: Camera, left: Camera, top: Camera, shape: tuple[int, int]
) -> Rectified:
    """Turn three cameras so that a point shares its row with the left, its column with the top one.

    Parameters
    ----------
    reference, left, top : Camera   an L, not necessarily a right angle
    shape : (rows, columns) [px]    of their pictures

    Returns
    -------
    Rectified                       its pictures hold the whole reference picture

    Raises
    ------
    CalibrationError                centres (nearly) on a line, or a camera that looks along the
                                    plane of the centres
    InputError                      a shape that contradicts a camera's
    """
    cameras = (reference, left, top)
    arms = [_arm(reference, other) for other in cameras[1:]]
    first, second = (arm / np.linalg.norm(arm) for arm in arms)
    z = np.cross(first, second)
    if np.linalg.norm(z) < _MIN_SINE:
        angle = np.rad2deg(np.arccos(np.clip(first @ second, -1.0, 1.0)))
        raise CalibrationError(
            f"seen from camera '{reference.name}' the cameras '{left.name}' and '{top.name}' are"
            f" {angle:.1f} degrees apart; an L needs 30 to 150. Take another camera as the"
            " reference, or rectify pairs"
        )
    view = _mean_view(cameras)
    z = z / np.linalg.norm(z) * np.copysign(1.0, z @ view)
    if z @ view < _MIN_COSINE:
        raise CalibrationError(
            f"cameras '{reference.name}', '{left.name}' and '{top.name}' look along the plane of"
            " their centres (within 30 degrees); such a triple cannot be rectified. Match without"
            " rectification"
        )
    x = first * np.copysign(1.0, first @ reference.T_camera_object[0, :3])
    y = np.cross(z, x)
    skew = -float(second @ x) / float(second @ y)
    return _rectified(cameras, np.stack([x, y, z]), skew, (0, 1), shape)


def from_disparity(
    rectified: Rectified,
    pixels: Float[np.ndarray, "n 2"],
    disparity: PointScalars,
    *,
    partner: int = 0,
) -> Points:
    """Points of the object from pixels of the rectified reference and their disparity.

    Parameters
    ----------
    rectified : Rectified
    pixels : (n, 2) float [px]      column and row in the rectified reference picture
    disparity : (n,) float [px]     coordinate in the partner minus that in the reference: columns
                                    where `rectified.axis` is 0, rows where it is 1
    partner : int                   0 for the first camera after the reference, 1 for the next

    Returns
    -------
    (n, 3) float [m]                object frame; NaN where the disparity is that of a point at
                                    infinity or beyond

    Raises
    ------
    InputError                      no such partner
    """
    if not 0 <= partner < len(rectified.axis):
        raise InputError(
            f"partner is {partner}; must be from 0 to {len(rectified.axis) - 1}, the cameras after"
            " the reference"
        )
    reference, other = rectified.cameras[0], rectified.cameras[partner + 1]
    axis = rectified.axis[partner]
    pose = reference.T_camera_object
    shift = other.T_camera_object[:3, 3] - pose[:3, 3]
    # A point at depth z moves by (K shift) / z, and by the difference of the principal points.
    at_unit_depth = float((reference.matrix @ shift)[axis])
    parallax = disparity - (other.matrix - reference.matrix)[axis, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = at_unit_depth / parallax
    depth = np.where((depth > 0.0) & np.isfinite(depth), depth, np.nan)
    flat = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(reference.matrix).T
    return (depth[:, None] * flat - pose[:3, 3]) @ pose[:3, :3]


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
    """From the centre of the reference to that of another camera, object frame [m]."""
    arm = camera_centre(other) - camera_centre(reference)
    distance = np.linalg.norm(camera_centre(reference))
    # Centres closer than the rounding of their coordinates give no direction.
    if np.linalg.norm(arm) <= 1e-9 * max(float(distance), 1e-9):
        raise CalibrationError(
            f"cameras '{reference.name}' and '{other.name}' have the same centre; depth needs a"
            " baseline. Are R and t of each camera's own, x_camera = R x_object + t?"
        )
    return arm


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
