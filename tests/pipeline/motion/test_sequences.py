"""The object's pose: believed where the pictures agree, registered where they do not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from surfaces import sphere

from palpate.errors import CalibrationError
from palpate.geometry import TriangleMesh
from palpate.pipeline.motion.sequences import _encloses, posed_rig
from palpate.records import Rig, read_rig, read_session
from palpate.vision import read_pictures

Scene = tuple[Rig, tuple[np.ndarray, ...], TriangleMesh]


def _scene(folder: Path, pattern: str) -> Scene:
    session = read_session(folder)
    rig = read_rig(folder / "rig.toml")
    pictures = read_pictures(rig, pattern, folder=folder, what="the test")
    return rig, pictures.grey, session.mesh


@pytest.fixture(scope="module")
def solid(shared_data: Path) -> Scene:
    return _scene(shared_data / "rigid_translation_x", "images/s0_{camera}.png")


@pytest.fixture(scope="module")
def ball(shared_data: Path) -> Scene:
    return _scene(shared_data / "halfball_images", "images/rest_{camera}.png")


def _moved(rig: Rig, degrees: float, shift: float) -> Rig:
    """The rig with an object that is turned about (1, 1, 1) and shifted along x [m]."""
    pose = np.eye(4)
    axis = np.ones(3) / np.sqrt(3.0)
    pose[:3, :3] = Rotation.from_rotvec(np.radians(degrees) * axis).as_matrix()
    pose[0, 3] = shift
    cameras = tuple(
        replace(camera, T_camera_object=camera.T_camera_object @ pose) for camera in rig.cameras
    )
    return replace(rig, cameras=cameras)


def _difference(first: Rig, second: Rig) -> tuple[float, float]:
    """Turn [degrees] and shift at the object's origin [m] between two poses."""
    pose = np.linalg.inv(first.cameras[0].T_camera_object) @ second.cameras[0].T_camera_object
    turn = Rotation.from_matrix(pose[:3, :3]).magnitude()
    return float(np.degrees(turn)), float(np.linalg.norm(pose[:3, 3]))


def test_a_right_pose_is_kept_to_the_bit(solid: Scene) -> None:
    rig, pictures, mesh = solid
    posed, notes = posed_rig(rig, pictures, mesh, "auto")
    assert posed is rig
    assert notes == ()


def test_a_pose_that_is_off_is_registered(solid: Scene) -> None:
    rig, pictures, mesh = solid
    posed, notes = posed_rig(_moved(rig, 4.0, 0.01), pictures, mesh, "auto")
    turn, shift = _difference(rig, posed)
    # Stereo points lie within a tenth of a millimetre of the mesh of 90 mm.
    assert turn < 0.1
    assert shift < 2e-4
    assert any("was registered" in note for note in notes)


def test_given_means_given(solid: Scene) -> None:
    rig, pictures, mesh = solid
    moved = _moved(rig, 4.0, 0.01)
    posed, _ = posed_rig(moved, pictures, mesh, "given")
    assert posed is moved


@pytest.mark.slow
def test_what_a_ball_does_not_tell_is_left_as_given_and_said(ball: Scene) -> None:
    """Its centre is found where it was 10 mm off; its direction, 4 degrees off, stays."""
    rig, pictures, mesh = ball
    said = "the shape is symmetric about any axis through"
    same_rig, notes = posed_rig(rig, pictures, mesh, "auto")
    assert same_rig is rig
    assert [said in note for note in notes] == [True]
    given = _moved(rig, 4.0, 0.01)
    posed, notes = posed_rig(given, pictures, mesh, "auto")
    assert said in notes[-1]
    assert "was registered" in notes[-2]
    turn, shift = _difference(rig, posed)
    # A few hundredths of a millimetre, of stereo and facets; the origin is the ball's centre.
    assert shift < 2e-4
    assert turn == pytest.approx(4.0, abs=0.05)


def test_a_pose_far_off_is_refused(solid: Scene) -> None:
    rig, pictures, mesh = solid
    with pytest.raises(CalibrationError):
        posed_rig(_moved(rig, 0.0, 0.2), pictures, mesh, "register")


@pytest.mark.parametrize(
    ("eye", "inside"),
    [((0.0, 0.0, 0.0), True), ((0.9, 0.0, 0.0), True), ((0.9, 0.9, 0.0), False)],
)
def test_a_camera_beside_a_ball_is_not_inside_it(eye, inside) -> None:
    # The last one is within the box about the ball.
    assert _encloses(sphere(2), np.array(eye)) is inside
