"""Cameras for tests: any pose, any lens, looking at the origin of the object frame."""

import cv2
import numpy as np

from palpate.records import Camera

# A webcam-like barrel, all eight terms at once, and a real lens of 50 mm (of a stereo challenge).
BARREL = (-0.3, 0.1, 1e-3, -2e-3, -0.02)
RATIONAL = (-0.3, 0.1, 2e-3, -1e-3, 0.02, 0.05, 0.01, -0.02)
REAL = (0.0614, 2.03, 0.0, 0.0, -120.6)


def make_camera(
    name="c0",
    *,
    lens=(),
    turn=(0.1, -0.2, 0.3),
    shift=(0.01, -0.02, 0.6),
    focal=900.0,
    skew=0.7,
    size=(640, 480),
):
    """A camera at `shift` from the origin, turned by a rotation vector [rad]."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.array(turn, dtype=np.float64))[0]
    pose[:3, 3] = shift
    matrix = np.array([[focal, skew, 322.3], [0.0, 1.01 * focal, 236.9], [0.0, 0.0, 1.0]])
    return Camera(name, size, matrix, terms(lens), pose)


def terms(lens):
    """The eight distortion terms, those not given zero."""
    return np.pad(np.array(lens, dtype=np.float64), (0, 8 - len(lens)))


def moved(camera, motion):
    """The same camera after the object frame was moved: x_new = motion x_old."""
    pose = camera.T_camera_object @ np.linalg.inv(motion)
    return Camera(camera.name, camera.size, camera.matrix, camera.distortion, pose)
