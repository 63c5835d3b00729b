"""Calibrations of a real pair of cameras: chessboards beside OpenCV, a cylinder moved rigidly."""

from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np

from benchmarks.figure import DOOR, Figure
from palpate.calibration import Calibration, Chessboard, calibrate, find_boards, find_pictures
from palpate.records import Camera, Rig, read_rig
from palpate.records.programs.multidic import read_control_points
from palpate.vision import triangulate

_BOARD = Chessboard(14, 19, 0.01)
_POSES = 5


def real_figures(folder: Path) -> list[Figure]:
    """Those of the shared pair: 25 chessboards a camera and a cylinder in five poses."""
    made, figures = {}, []
    for camera in sorted(path for path in (folder / "BAcheckerboardImages").iterdir()):
        if camera.is_dir():
            made[camera.name], figure = _chessboards(camera)
            figures.append(figure)
    return [*figures, _cylinder(folder, made)]


def _chessboards(camera: Path) -> tuple[Calibration, Figure]:
    """What is left of the corners, over what OpenCV's own calibration of them leaves."""
    sightings = find_boards(find_pictures(camera), [_BOARD])
    result = calibrate(sightings, [_BOARD])
    corners = result.corners
    views = range(len(result.sightings.views))
    points = [corners.point[corners.view == v].astype(np.float32) for v in views]
    pixels = [corners.pixel[corners.view == v].astype(np.float32) for v in views]
    rms, *_ = cv2.calibrateCamera(points, pixels, sightings.sizes[0], None, None)
    rms_here = np.sqrt((result.adjusted.residual**2).sum(axis=1).mean())
    good = result.adjusted.good
    rms_good = np.sqrt((result.adjusted.residual[good] ** 2).sum(axis=1).mean())
    note = (
        f"{len(views)} views, rms {rms_here:.3f} px ({rms_good:.3f} without {int((~good).sum())}"
        f" gross errors) against {rms:.3f} px"
    )
    return result, Figure(
        DOOR, f"real chessboards, camera {camera.name}: rms over OpenCV's own", rms_here / rms, "x",
        note=note,
    )  # fmt: skip


def _cylinder(folder: Path, made: dict[str, Calibration]) -> Figure:
    """What a rigid motion leaves of the same matches, triangulated with two rigs.

    The chessboards of the two cameras were not taken at the same instants, so that they give the
    lenses alone; both poses are from the one picture of the calibration object, as the published
    calibration's are.
    """
    published = read_rig(folder / "calibrationObjectImages")
    control = read_control_points(folder / "calibrationObjectImages")
    lenses = [
        _posed(made[camera.name].cameras[0], points, pixels)
        for camera, (points, pixels) in zip(published.cameras, control, strict=True)
    ]
    matches = _matches(folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat")
    rows = {"own": Rig(tuple(lenses), 0, "own"), "published": published}
    left = {name: _left(rig, matches) for name, rig in rows.items()}
    said = [
        f"{name} {1e6 * _rms(rest):.2f} um ("
        + " / ".join(f"{1e6 * axis:.2f}" for axis in np.max(rest, axis=0))
        + " in x / y / z)"
        for name, rest in left.items()
    ]
    return Figure(
        DOOR, "real cylinder: what a rigid motion leaves, over the published calibration's",
        _rms(left["own"]) / _rms(left["published"]), "x",
        note=f"{'; '.join(said)}, worst of four poses",
    )  # fmt: skip


def _rms(rest: np.ndarray) -> float:
    return float(np.sqrt((rest**2).sum(axis=1).mean()))


def _posed(camera: Camera, points: np.ndarray, pixels: np.ndarray) -> Camera:
    """The camera with its lens as it is, in the frame of points that it sees."""
    _, turn, shift = cv2.solvePnP(
        points, pixels, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_SQPNP
    )
    turn, shift = cv2.solvePnPRefineLM(
        points, pixels, camera.matrix, camera.distortion, turn, shift
    )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(turn)[0], shift.ravel()
    return replace(camera, T_camera_object=pose)


def _matches(file: Path) -> np.ndarray:
    """The published matches, (poses, cameras, n, 2) [px], of points found in all pictures."""
    with h5py.File(file) as content:
        points = [np.array(content[key]).T - 1.0 for key in content["DIC2DpairResults/Points"][0]]
    every = np.stack(points).reshape(2, _POSES, -1, 2).swapaxes(0, 1)
    return every[:, :, np.isfinite(every).all(axis=(0, 1, 3))]


def _left(rig: Rig, matches: np.ndarray) -> np.ndarray:
    """Standard deviations of what the best rigid motion leaves, (4, 3) [m], for each pose."""
    places = [triangulate(rig, pixels, 1.0).point for pixels in matches]
    known = np.isfinite(np.stack(places)).all(axis=(0, 2))
    before = places[0][known] - places[0][known].mean(axis=0)
    left = []
    for pose in places[1:]:
        after = pose[known] - pose[known].mean(axis=0)
        u, _, v = np.linalg.svd(before.T @ after)
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
        left.append((after - before @ turn).std(axis=0))
    return np.stack(left)
