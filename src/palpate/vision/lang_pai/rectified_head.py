"""The cameras of a rig as a rectified stereo head: a pair, or three in an L."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from jaxtyping import Float, Int

from palpate.records import Rig, camera_centre
from palpate.shapes import Points, PointScalars
from palpate.vision.cameras.rectification import Rectified, rectify, remapped
from palpate.vision.lang_pai.disparity import Instant, Views, disparity_map


@dataclass(frozen=True, slots=True, eq=False)
class StereoHead:
    """Rectified cameras of a rig.

    Disparity is measured in pixels for the longest baseline; it is zero at infinity.

    Attributes
    ----------
    rectified : Rectified
    order : tuple of c int          index in the rig of each rectified camera, the reference first
    views : Views                   of the c cameras
    parallax : float [px m]         disparity times depth
    shape : (rows, columns) [px]    of the original pictures
    canvas : (rows, columns) [px]   of the rectified pictures
    """

    rectified: Rectified
    order: tuple[int, ...]
    views: Views
    parallax: float
    shape: tuple[int, int]
    canvas: tuple[int, int]


def make_head(rig: Rig, shape: tuple[int, int]) -> StereoHead:
    """Rectify the reference camera of a rig with its partner, or with two that form an L with it.

    Parameters
    ----------
    rig : Rig                       of more than three cameras, the method uses the two whose
                                    directions from the reference are nearest to a right angle
    shape : (rows, columns) [px]    of the pictures

    Returns
    -------
    StereoHead

    Raises
    ------
    CalibrationError                cameras that cannot be rectified
    InputError                      `shape` contradicts a camera's size
    """
    order = (rig.reference, *_partners(rig))
    rectified = rectify([rig.cameras[i] for i in order], shape)
    reference = rectified.cameras[0]
    slope, offset = np.zeros(len(order)), np.zeros(len(order))
    for i, axis in enumerate(rectified.axis, start=1):
        other = rectified.cameras[i]
        arm = other.T_camera_object[:3, 3] - reference.T_camera_object[:3, 3]
        slope[i] = (reference.matrix @ arm)[axis]
        offset[i] = (other.matrix - reference.matrix)[axis, 2]
    parallax = float(np.abs(slope).max())
    views = Views(np.array([0, *rectified.axis]), slope / parallax, offset)
    canvas = rectified.maps[0].shape[1:]
    return StereoHead(rectified, order, views, parallax, shape, canvas)


def make_instant(
    head: StereoHead,
    pictures: Sequence[Float[np.ndarray, "_ _"]],
    limits: tuple[float, float],
) -> Instant:
    """Rectify the pictures of one instant and match them with each other.

    Parameters
    ----------
    head : StereoHead
    pictures : sequence of (rows, columns) float [grey levels]  of all cameras of the rig
    limits : (float, float) [px]    minimum and maximum disparity to try

    Returns
    -------
    Instant

    Raises
    ------
    InputError                      as in `disparity_map`
    """
    flat = [remapped(head.rectified, k, pictures[i]) for k, i in enumerate(head.order)]
    disparity = disparity_map(flat, head.views, limits)
    # Zero is at infinity; trials extend a pixel or two beyond the limits.
    return Instant(np.stack(flat), np.where(disparity > 0.0, disparity, np.nan))


def head_points(head: StereoHead, pixel: Int[np.ndarray, "n 2"], disparity: PointScalars) -> Points:
    """Points of the object from pixels of the rectified reference and their disparities.

    Parameters
    ----------
    head : StereoHead
    pixel : (n, 2) int [px]         column and row
    disparity : (n,) float [px]     above zero

    Returns
    -------
    (n, 3) float [m]                object frame
    """
    camera = head.rectified.cameras[0]
    pose = camera.T_camera_object
    flat = np.column_stack([pixel, np.ones(len(pixel))]) @ np.linalg.inv(camera.matrix).T
    return ((head.parallax / disparity)[:, None] * flat - pose[:3, 3]) @ pose[:3, :3]


def head_disparity(
    head: StereoHead, points: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "..."]:
    """Disparity of points of the object.

    Parameters
    ----------
    head : StereoHead
    points : (..., 3) float [m]     object frame, in front of the reference camera

    Returns
    -------
    (...,) float [px]               parallax over depth
    """
    pose = head.rectified.cameras[0].T_camera_object
    return head.parallax / (points @ pose[2, :3] + pose[2, 3])


def _partners(rig: Rig) -> tuple[int, ...]:
    """Index of the other camera, or indices of the left and the top one."""
    others = [i for i in range(len(rig.cameras)) if i != rig.reference]
    if len(others) == 1:
        return tuple(others)
    reference = rig.cameras[rig.reference]
    right = reference.T_camera_object[0, :3]
    arm = {i: camera_centre(rig.cameras[i]) - camera_centre(reference) for i in others}
    unit = {i: arm[i] / max(float(np.linalg.norm(arm[i])), 1e-300) for i in others}
    pairs = list(permutations(others, 2))
    # The pair nearest to a right angle, in the order whose first arm lies along the rows.
    bent = [float(np.linalg.norm(np.cross(unit[i], unit[j]))) for i, j in pairs]
    along = [abs(float(unit[i] @ right)) - abs(float(unit[j] @ right)) for i, j in pairs]
    best = max(range(len(pairs)), key=lambda k: (round(bent[k], 9), along[k]))
    return pairs[best]
