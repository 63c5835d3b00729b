"""Errors of a calibration as strains of space, against closed forms of a parallel pair."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.errors import CalibrationError
from palpate.records import Camera, Rig, RigCovariance
from palpate.vision import calibration_numbers, project, space_strains, triangulate

FOCAL, BASE, DEPTH = 1000.0, 0.1, 0.4
MATRIX = np.array([[FOCAL, 0.0, 320.0], [0.0, FOCAL, 240.0], [0.0, 0.0, 1.0]])
# Nearly a point: the gradient of what is measured there, not its mean over a volume.
HERE = np.array([0.0, 0.0, DEPTH]) + 1e-4 * np.random.default_rng(1).uniform(-1, 1, (50, 3))


def _pair(turned: np.ndarray | None = None) -> Rig:
    T_object = np.eye(4) if turned is None else turned
    right = np.eye(4)
    right[0, 3] = -BASE
    cameras = [
        Camera(name, (640, 480), MATRIX, np.zeros(5), pose @ T_object)
        for name, pose in (("left", np.eye(4)), ("right", right))
    ]
    return Rig(tuple(cameras), 0, "pair")


def _known(rig: Rig, **variances: float) -> RigCovariance:
    names = [f"{camera}.{t}" for camera in ("left", "right") for t in ["fx", "fy", "cx", "cy"]]
    names += [f"right.{term}" for term in ("rx", "ry", "rz", "tx", "ty", "tz")]
    std = np.array([variances.get(name.replace(".", "_"), 0.0) for name in names])
    return RigCovariance(
        tuple(names), calibration_numbers(rig.cameras, names), np.diag(std**2), "known"
    )


def test_a_longer_base_makes_everything_longer() -> None:
    """All lengths are in proportion to the base."""
    rig = _pair()
    (strain,) = space_strains(rig, _known(rig, right_tx=1e-3 * BASE), HERE)
    # Second differences over a step of half a thousandth.
    np.testing.assert_allclose(strain * np.sign(strain[0, 0]), 1e-3 * np.eye(3), atol=1e-8)


def test_focal_lengths_that_are_wrong_alike_stretch_depth() -> None:
    """z = f b / d and x = z (u - c) / f: only depth goes with the focal length."""
    rig = _pair()
    known = _known(rig)
    same = np.zeros((len(known.names), 1))
    same[[known.names.index(f"{c}.{t}") for c in ("left", "right") for t in ("fx", "fy")]] = 1.0
    known = replace(known, covariance=(1e-3 * FOCAL) ** 2 * same @ same.T)
    (strain,) = space_strains(rig, known, HERE)
    expected = np.diag([0.0, 0.0, 1e-3])
    np.testing.assert_allclose(strain * np.sign(strain[2, 2]), expected, atol=3e-6)


def test_independent_errors_add_up_in_the_object_frame() -> None:
    """Against points that are triangulated with drawn errors, in a frame that is turned."""
    turned = np.eye(4)
    turned[:3, :3] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    turned[:3, 3] = [0.0, 0.0, DEPTH]
    rig = _pair(turned)
    std = {"right_tx": 2e-5, "right_ry": 1e-4, "left_fx": 0.3, "right_cx": 0.2, "right_rx": 1e-4}
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.03, 0.03, (100, 3))
    strains = space_strains(rig, _known(rig, **std), points)
    pixels = np.stack([project(camera, points) for camera in rig.cameras])
    draws = []
    for _ in range(300):
        d = {name: size * rng.normal() for name, size in std.items()}
        left, right = rig.cameras
        left = replace(left, matrix=left.matrix + d["left_fx"] * np.diag([1.0, 0.0, 0.0]))
        matrix = right.matrix.copy()
        matrix[0, 2] += d["right_cx"]
        pose = np.eye(4)
        pose[0, 3] = -BASE + d["right_tx"]
        # Small turns about x and y, to first order.
        pose[:3, :3] += np.cross(np.eye(3), [-d["right_rx"], -d["right_ry"], 0.0])
        pose[:3, :3] = np.linalg.qr(pose[:3, :3])[0] * [[-1, -1, -1]]
        pose[:3, :3] *= np.sign(np.diag(pose[:3, :3]))
        right = replace(right, matrix=matrix, T_camera_object=pose @ turned)
        moved = triangulate(Rig((left, right), 0, "drawn"), pixels, 1.0).point - points
        gradient = np.linalg.lstsq(points - points.mean(axis=0), moved - moved.mean(axis=0))[0].T
        draws.append(0.5 * (gradient + gradient.T))
    found = np.sqrt(np.square(strains).sum(axis=0))
    drawn = np.sqrt(np.square(draws).mean(axis=0))
    # 300 draws know a standard deviation to 4 %; the depth is along the object's y.
    assert drawn[2, 2] < drawn.max() == drawn[1, 1] or drawn.max() > 1e-4
    np.testing.assert_allclose(np.diag(found), np.diag(drawn), rtol=0.15)
    np.testing.assert_allclose(found, drawn, atol=0.15 * drawn.max())


def test_beyond_the_pictures_nothing_is_asked() -> None:
    """A lens term that is unknown bends only what the cameras do not see."""
    rig = _pair()
    points = HERE + np.linspace(-0.5, 0.5, len(HERE))[:, None] * [1.0, 0.0, 0.0]
    with pytest.raises(CalibrationError, match=r"two cameras together see \d+ of 300 points"):
        space_strains(rig, _known(rig, right_tx=1e-5), points + np.array([2.0, 0.0, 0.0]))
    (strain,) = space_strains(rig, _known(rig, right_tx=1e-3 * BASE), points)
    assert abs(strain[0, 0]) == pytest.approx(1e-3, rel=1e-3)


def test_the_covariance_of_another_rig_is_refused() -> None:
    rig = _pair()
    known = _known(rig, right_tx=1e-5)
    other = replace(rig.cameras[1], matrix=MATRIX + np.diag([40.0, 40.0, 0.0]))
    with pytest.raises(CalibrationError, match=r"right\.fx is 1000 there and 1040 in pair"):
        space_strains(Rig((rig.cameras[0], other), 0, "pair"), known, HERE)
    named = replace(rig.cameras[1], name="c1")
    with pytest.raises(CalibrationError, match="cameras left, right, the rig has c1, left"):
        space_strains(Rig((rig.cameras[0], named), 0, "pair"), known, HERE)
    odd = replace(known, names=(*known.names[:-1], "right.zoom"))
    with pytest.raises(CalibrationError, match=r"'?right\.zoom'? is no number of a camera"):
        space_strains(rig, odd, HERE)
