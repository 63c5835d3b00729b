"""Camera rigs of the facility, rigs with simulated calibration errors, and pictures of boards.

The picture of a flat printed board is made by tracing rays from the camera's pixels to the print.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.config import Calibration, Head
from palpate.records import DISTORTION_TERMS, Camera, Rig, picture_size
from palpate.shapes import Vector3
from palpate.vision import normalised

# Fraction of the picture that the object fills if no focal length is given.
_FILL = 0.75
# The object's z axis is up in the pictures, unless the head looks along it.
_UP = np.array([0.0, 0.0, 1.0])
_MAX_COSINE = 0.999
# Grey levels of ink, of paper, and of the background beyond the board.
_INK, _PAPER, _BEYOND = 25.0, 235.0, 235.0


def make_head(head: Head, mesh: TriangleMesh) -> Rig:
    """Cameras around an object.

    The trinocular layout is the paper's: the reference camera, one to its left and one above it,
    all pointing at the middle of the object. On a ring the cameras are evenly spaced around the
    viewing direction.

    Parameters
    ----------
    head : Head                     without a file
    mesh : TriangleMesh             the object; the cameras point at the middle of its bounding box

    Returns
    -------
    Rig                             the first camera is the reference

    Raises
    ------
    InputError                      a head closer than the size of the object
    """
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if head.distance < size:
        raise InputError(
            f"distance is {head.distance:g} m, less than the object's size of {size:.3g} m; move"
            " the head away"
        )
    view = -head.toward / np.linalg.norm(head.toward)
    right, down = _picture_axes(view)
    eye = middle - head.distance * view
    eyes = [eye + x * right + y * down for x, y in _camera_offsets(head)]
    poses = [_pose(camera_eye, middle) for camera_eye in eyes]
    focal = head.focal or min(_filling_focal_length(head, pose, mesh) for pose in poses)
    cameras = [_camera(f"c{k}", pose, head, focal) for k, pose in enumerate(poses)]
    return Rig(tuple(cameras), 0, "facility")


def miscalibrated(
    rig: Rig, error: Calibration, mesh: TriangleMesh, *, rng: np.random.Generator
) -> Rig:
    """A rig with random calibration errors.

    Parameters
    ----------
    rig : Rig                       the true rig
    error : Calibration             standard deviations of the errors
    mesh : TriangleMesh             the object; its pose error is a rotation about its middle
    rng : Generator

    Returns
    -------
    Rig                             the same bytes for the same state of `rng`
    """
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    pose = _small_pose(error.object_rotation, error.object_translation, rng)
    about = np.eye(4)
    about[:3, 3] = middle
    pose = about @ pose @ np.linalg.inv(about)
    cameras = []
    for camera in rig.cameras:
        matrix = camera.matrix.copy()
        matrix[[0, 1], [0, 1]] *= 1.0 + error.focal * rng.standard_normal()
        matrix[:2, 2] += error.centre * rng.standard_normal(2)
        pose_error = _small_pose(error.rotation, error.translation, rng)
        misjudged = pose_error @ camera.T_camera_object @ pose
        cameras.append(replace(camera, matrix=matrix, T_camera_object=misjudged))
    return replace(rig, cameras=tuple(cameras))


def _small_pose(
    rotation: float, translation: float, rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """Random small pose; standard deviations about [degrees] and along [m] each axis."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.deg2rad(rotation) * rng.standard_normal(3))[0]
    pose[:3, 3] = translation * rng.standard_normal(3)
    return pose


def _camera_offsets(head: Head) -> Float[np.ndarray, "c 2"]:
    """Positions of the cameras relative to the head's reference point, right and down [m]."""
    if head.layout == "trinocular":
        return head.baseline * np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    angle = 2.0 * np.pi * np.arange(head.cameras) / head.cameras
    return 0.5 * head.baseline * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _picture_axes(view: Vector3) -> tuple[Vector3, Vector3]:
    """Unit vectors to the right and down in a picture with viewing direction `view`."""
    up = _UP if abs(view @ _UP) < _MAX_COSINE else np.array([0.0, 1.0, 0.0])
    right = np.cross(view, up)
    right /= np.linalg.norm(right)
    return right, np.cross(view, right)


def _pose(eye: Vector3, target: Vector3) -> Float[np.ndarray, "4 4"]:
    """Pose of the object in the frame of a camera at `eye` that points at `target`."""
    view = (target - eye) / np.linalg.norm(target - eye)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([*_picture_axes(view), view])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def _filling_focal_length(head: Head, pose: Float[np.ndarray, "4 4"], mesh: TriangleMesh) -> float:
    """Focal length [px] at which the object fills the fraction `_FILL` of the picture."""
    x, y, z = (mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).T
    wide, high = 2.0 * np.abs(x / z).max(), 2.0 * np.abs(y / z).max()
    return _FILL * float(min(head.columns / wide, head.rows / high))


def _camera(name: str, pose: Float[np.ndarray, "4 4"], head: Head, focal: float) -> Camera:
    centre = [(head.columns - 1) / 2, (head.rows - 1) / 2]
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    terms = np.zeros(len(DISTORTION_TERMS))
    terms[0] = head.k1
    return Camera(name, (head.columns, head.rows), matrix, terms, pose)


def board_picture(
    camera: Camera,
    T_object_board: Float[np.ndarray, "4 4"],
    print_: UInt8[np.ndarray, "_ _"],
    extent: tuple[float, float],
    *,
    rng: np.random.Generator,
    noise: float,
    rays: int = 2,
    blur: float = 0.0,
) -> UInt8[np.ndarray, "_ _"]:
    """A picture of a board under uniform light.

    Parameters
    ----------
    camera : Camera                 with its picture size
    T_object_board : (4, 4) float   pose of the board, translation in metres; its upper left corner
                                    is the origin, x along its rows, y down; it is seen from z < 0
    print_ : (rows, columns) uint8  the printed pattern: 0 ink, 255 paper
    extent : (float, float) [m]     width and height of the board
    rng : Generator                 of the noise
    noise : float [grey levels]     standard deviation of a pixel
    rays : int                      rays per pixel along each axis, which are averaged; 2 are as
                                    sharp as an ideal image sensor
    blur : float [px]               standard deviation of the blur of lens and sensor

    Returns
    -------
    (rows, columns) uint8
    """
    columns, rows = picture_size(camera)
    pose = camera.T_camera_object @ T_object_board
    turn, shift = pose[:3, :3], pose[:3, 3]
    row, column = np.indices((rows, columns)).reshape(2, -1)
    total = np.zeros(rows * columns)
    for dy, dx in np.ndindex(rays, rays):
        away = (np.array([dx, dy]) + 0.5) / rays - 0.5
        flat = normalised(camera, np.column_stack([column, row]) + away)
        ray = np.column_stack([flat, np.ones(len(flat))])
        # (t ray - shift) lies in the plane z = 0 of the board.
        depth = (turn[:, 2] @ shift) / (ray @ turn[:, 2])
        position = (depth[:, None] * ray - shift) @ turn
        u = np.floor(position[:, 0] / extent[0] * print_.shape[1]).astype(np.int64)
        v = np.floor(position[:, 1] / extent[1] * print_.shape[0]).astype(np.int64)
        on = (depth > 0.0) & (u >= 0) & (v >= 0) & (u < print_.shape[1]) & (v < print_.shape[0])
        grey = np.full(len(flat), _BEYOND)
        grey[on] = _INK + (_PAPER - _INK) / 255.0 * print_[v[on], u[on]]
        total += grey / rays**2
    levels = total.reshape(rows, columns)
    if blur > 0.0:
        levels = cv2.GaussianBlur(levels, (0, 0), blur)
    levels += noise * rng.normal(size=levels.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
