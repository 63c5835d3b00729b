"""Camera rigs of the facility, and calibrations of them with errors."""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.config import Calibration, Head
from palpate.records import DISTORTION_TERMS, Camera, Rig
from palpate.shapes import Vector3

# Share of the picture that the object fills where no focal length is given.
_FILL = 0.75
# Object z is up in the pictures, unless the head looks along it.
_UP = np.array([0.0, 0.0, 1.0])
_MAX_COSINE = 0.999


def make_head(head: Head, mesh: TriangleMesh) -> Rig:
    """Cameras around an object.

    The trinocular layout is the paper's: the reference, one beside it to its left and one above,
    all three looking at the middle of the object. On a ring the cameras stand evenly around the
    direction of view.

    Parameters
    ----------
    head : Head                     with no file
    mesh : TriangleMesh             the object: the middle of its bounds is looked at

    Returns
    -------
    Rig                             the first camera is the reference

    Raises
    ------
    InputError                      a head so near that a camera stands within the object
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
    eyes = [eye + x * right + y * down for x, y in _places(head)]
    poses = [_pose(place, middle) for place in eyes]
    focal = head.focal or min(_filling(head, pose, mesh) for pose in poses)
    cameras = [_camera(f"c{k}", pose, head, focal) for k, pose in enumerate(poses)]
    return Rig(tuple(cameras), 0, "facility")


def miscalibrated(
    rig: Rig, error: Calibration, mesh: TriangleMesh, *, rng: np.random.Generator
) -> Rig:
    """The rig that a calibration with errors would give.

    Parameters
    ----------
    rig : Rig                       the truth
    error : Calibration             standard deviations
    mesh : TriangleMesh             the object turns about its middle
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
        off = _small_pose(error.rotation, error.translation, rng)
        moved = off @ camera.T_camera_object @ pose
        cameras.append(replace(camera, matrix=matrix, T_camera_object=moved))
    return replace(rig, cameras=tuple(cameras))


def _small_pose(
    rotation: float, translation: float, rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """A random pose, standard deviations in degrees and metres about and along each axis."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.deg2rad(rotation) * rng.standard_normal(3))[0]
    pose[:3, 3] = translation * rng.standard_normal(3)
    return pose


def _places(head: Head) -> Float[np.ndarray, "c 2"]:
    """Places of the cameras beside the middle of the head, to the right and down [m]."""
    if head.layout == "trinocular":
        return head.baseline * np.array([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]])
    angle = 2.0 * np.pi * np.arange(head.cameras) / head.cameras
    return 0.5 * head.baseline * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _picture_axes(view: Vector3) -> tuple[Vector3, Vector3]:
    """Directions to the right and down in a picture along `view`."""
    up = _UP if abs(view @ _UP) < _MAX_COSINE else np.array([0.0, 1.0, 0.0])
    right = np.cross(view, up)
    right /= np.linalg.norm(right)
    return right, np.cross(view, right)


def _pose(eye: Vector3, target: Vector3) -> Float[np.ndarray, "4 4"]:
    """Pose of the object before a camera at a place that looks at another."""
    view = (target - eye) / np.linalg.norm(target - eye)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([*_picture_axes(view), view])
    pose[:3, 3] = -pose[:3, :3] @ eye
    return pose


def _filling(head: Head, pose: Float[np.ndarray, "4 4"], mesh: TriangleMesh) -> float:
    """Focal length with which the object fills its share of the picture [px]."""
    x, y, z = (mesh.vertices @ pose[:3, :3].T + pose[:3, 3]).T
    wide, high = 2.0 * np.abs(x / z).max(), 2.0 * np.abs(y / z).max()
    return _FILL * float(min(head.columns / wide, head.rows / high))


def _camera(name: str, pose: Float[np.ndarray, "4 4"], head: Head, focal: float) -> Camera:
    centre = [(head.columns - 1) / 2, (head.rows - 1) / 2]
    matrix = np.array([[focal, 0.0, centre[0]], [0.0, focal, centre[1]], [0.0, 0.0, 1.0]])
    terms = np.zeros(len(DISTORTION_TERMS))
    terms[0] = head.k1
    return Camera(name, (head.columns, head.rows), matrix, terms, pose)
