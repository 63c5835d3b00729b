"""A good folder for the commands around a fit: scan, calibrate, campaign, view, export, report."""

import shutil
from pathlib import Path

import cv2
import numpy as np
from cube_session import SESSION
from estimate_samples import sample_result
from faults.samples import two_cameras, write_cube
from flow_samples import rig
from scan_views import camera_at, seen_points, toy

from benchmarks.boards import draw_board, true_bundle
from palpate.api import Result
from palpate.calibration import Chessboard
from palpate.campaign.store import Store, read_items
from palpate.records import RigCovariance, read_session, write_rig
from palpate.records.rig import write_rig_covariance

SCAN = """\
format = "palpate-scan/1"
length_unit = "mm"
sigma = 0.05
[[view]]
file = "top.xyz"
eye = [20, 20, 500]
"""


def write_bench(folder: Path) -> None:
    """A cube with its result, a rig with its covariance, boards, a scan, a list, a campaign."""
    (folder / "cube").mkdir()
    write_cube(folder / "cube")
    session = read_session(folder / "cube")
    Result(session, sample_result(session)).save(folder / "result")
    shutil.copy(folder / "cube" / "mesh.ply", folder / "mesh.ply")
    rng = np.random.default_rng(3)
    write_rig(folder / "rig.toml", two_cameras())
    names = ("c0.fx", "c1.tx")
    known = RigCovariance(names, np.array([400.0, -0.06]), np.diag([1.0, 1e-8]), "rig")
    write_rig_covariance(folder, known)
    for camera in ("c0", "c1"):
        (folder / "boards" / camera).mkdir(parents=True)
        for file in (folder / f"rest_{camera}.png", folder / "boards" / camera / "01.png"):
            cv2.imwrite(str(file), rng.integers(20, 230, (48, 64), dtype=np.uint8))
    (folder / "scan").mkdir()
    (folder / "scan" / "scan.toml").write_text(SCAN)
    side = np.linspace(0.0, 40.0, 20)
    top = np.stack(np.meshgrid(side, side, [40.0]), axis=-1).reshape(-1, 3)
    np.savetxt(folder / "scan" / "top.xyz", top, fmt="%.4f")
    np.savetxt(folder / "near.csv", [[20.0, 20.0, 40.0]], fmt="%.3f")
    (folder / "list.txt").write_text("cube\n")
    Store(folder / "many").begin(read_items(folder / "list.txt"))
    _write_pictured(folder / "pictured")


def _write_pictured(folder: Path) -> None:
    """The cube before two cameras, its pictures still to be taken."""
    folder.mkdir()
    write_cube(folder)
    write_rig(folder / "rig.toml", rig())
    session = folder / "session.toml"
    images = 'images = { rest = "a_{camera}.png", loaded = ["b_{camera}.png"] }'
    text = SESSION.replace("[[probe]]", '[rig]\ncameras = "rig.toml"\n[[probe]]')
    session.write_text(text.replace('displacement = "n01.csv"', images))


def write_shots(folder: Path) -> None:
    """Pictures of a chessboard by two cameras, that a calibration can be made of."""
    board, rng = Chessboard(7, 5, 0.016), np.random.default_rng(5)
    squares = np.pad(np.indices((6, 8)).sum(axis=0) % 2, 1, constant_values=1)
    texture = (255 * np.kron(squares, np.ones((40, 40)))).astype(np.uint8)
    extent = (squares.shape[1] * board.square, squares.shape[0] * board.square)
    truth = true_bundle(rng, cameras=2, views=5)
    for c, intrinsics in enumerate(truth.intrinsics):
        (folder / f"c{c}").mkdir(parents=True)
        lens = np.array([*(0.25 * intrinsics[:4]), *intrinsics[4:]])
        for v, view in enumerate(truth.view):
            pose = view.copy()
            pose[:3, 3] = [0.03, 0.0, 0.36] - pose[:3, :3] @ [*(0.5 * np.array(extent)), 0.0]
            grey = draw_board(texture, extent, lens, truth.camera[c] @ pose, (320, 256), rng=rng)
            cv2.imwrite(str(folder / f"c{c}" / f"{v:02d}.png"), grey)


def write_scan(folder: Path) -> None:
    """Points of a toy that six viewpoints show."""
    folder.mkdir()
    lines = ['format = "palpate-scan/1"', 'length_unit = "m"', "sigma = 1e-4"]
    lines.append('support = "z=0"')
    mesh, rng = toy(edge=5e-3), np.random.default_rng(7)
    for k in range(6):
        camera = camera_at(2.0 * np.pi * k / 6)
        inverse = np.linalg.inv(camera.T_camera_object)
        points = seen_points(mesh, camera, rng) @ inverse[:3, :3].T + inverse[:3, 3]
        np.savetxt(folder / f"v{k}.xyz", points[::4], fmt="%.6f")
        lines += ["[[view]]", f'file = "v{k}.xyz"', f"eye = {inverse[:3, 3].tolist()}"]
    (folder / "scan.toml").write_text("\n".join(lines) + "\n")
