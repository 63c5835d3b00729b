"""The files that the guides of docs/howto speak of, small: a generator for every page.

Each yields once before every shell block of its page, when the folder holds what that block needs.
"""

import os
import shlex
import shutil
import tomllib
from contextlib import chdir
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pytest
import trimesh
from cube_session import write_cube_session
from docs.page_blocks import blocks
from estimate_samples import sample_result
from lab.lab_configs import HALF_BALL, STAGE
from lab.planned_sessions import SESSION as PLANNED, planned_session
from program_files import write_mat, write_table
from recording.bench_footage import write_recording
from scan_views import camera_at, seen_points, toy
from scipy.spatial.transform import Rotation

from benchmarks.boards import draw_board, true_bundle
from benchmarks.creep import TWO, write_creeping_session
from palpate.api import Result
from palpate.app.cli import main
from palpate.calibration import Charuco
from palpate.geometry import write_mesh
from palpate.lab import Head
from palpate.lab.head import make_head
from palpate.lab.specimens import half_ball
from palpate.records import read_session, write_rig
from palpate.viewer import stills
from palpate.vision import surface_map

# One probing of the first session, seen in the mirrors of its square block: six distinct ones.
_MIRRORS = {
    "n01": [[1, 0], [0, 1]],
    "p1": [[1, 0], [0, 1]], "p2": [[-1, 0], [0, 1]], "p3": [[0, 1], [1, 0]],
    "p4": [[0, -1], [1, 0]], "p5": [[1, 0], [0, -1]], "p6": [[-1, 0], [0, -1]],
}  # fmt: skip
_PROBE = """\
[[probe]]
name = "{name}"
contact = {{ point = [{x}, {y}, 30.0], radius = 8.0, profile = "smooth" }}
force = [0, 0, -1.2]
force_std = 0.012
displacement = "{name}.csv"
"""


def write_block(folder, names=("p1",)):
    """A coarse foam block in the half ball's place: its top 30 mm high, too, its middle at 0."""
    page = "docs/howto/first_session.md"
    folder.mkdir(parents=True)
    block = trimesh.creation.box(bounds=[[-30, -30, -10], [30, 30, 30]])
    block.subdivide_to_size(20).export(folder / "mesh.ply")
    head = blocks(page, "toml")[0].partition("[[probe]]")[0].replace("[0, 0, 0]", "[0, 0, -10]")
    table = blocks(page, "csv")[0].splitlines()
    rows = np.array([line.split(",") for line in table[1:]], dtype=float)
    rows[:, :3] -= [30.0, 30.0, 10.0]
    parts = [head]
    for name in names:
        mirror, seen = np.array(_MIRRORS[name]), rows.copy()
        for columns in (slice(0, 2), slice(3, 5)):
            seen[:, columns] = rows[:, columns] @ mirror.T
        x, y = mirror @ [-6.0, 0.0]
        parts.append(_PROBE.format(name=name, x=x, y=y))
        np.savetxt(
            folder / f"{name}.csv", seen, delimiter=",", header=table[0], comments="", fmt="%.3f"
        )
    (folder / "session.toml").write_text("".join(parts), encoding="utf-8")
    return folder


def _calibrate(here):
    board = Charuco(12, 9, 0.02, 0.015)
    rng = np.random.default_rng(3)
    truth, texture = true_bundle(rng, cameras=2, views=5), board.drawing(40)
    for c, intrinsics in enumerate(truth.intrinsics):
        folder = here / "boards" / f"c{c}"
        folder.mkdir(parents=True)
        lens = np.concatenate([0.375 * intrinsics[:4], intrinsics[4:]])
        for v, view in enumerate(truth.view):
            view = view.copy()
            view[:3, 3] = [0.03, 0.0, 0.55] - view[:3, :3] @ [0.12, 0.09, 0.0]
            pose = truth.camera[c] @ view
            picture = draw_board(texture, (0.24, 0.18), lens, pose, (480, 384), rng=rng, parts=1)
            cv2.imwrite(str(folder / f"{v:02d}.png"), picture)
    yield


def _moved_camera(here):
    mesh = toy(4e-3)
    rig = make_head(Head(distance=0.5, columns=320, rows=256), mesh)
    (here / "rig").mkdir()
    write_rig(here / "rig" / "rig.toml", rig)
    write_mesh(here / "mesh.ply", mesh)
    (here / "rest").mkdir()
    for k, angle in enumerate((0.0, 0.2, 0.4)):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
        for camera in rig.cameras:
            turned = replace(camera, T_camera_object=camera.T_camera_object @ turn)
            cv2.imwrite(str(here / "rest" / f"v{k}_{camera.name}.png"), _picture(turned, mesh))
    yield


def _picture(camera, mesh):
    """What a camera sees of an object that is marbled through and through, with the noise."""
    columns, rows = camera.size
    seen = surface_map(camera, (rows, columns), mesh.vertices, mesh.triangles)
    rng = np.random.default_rng(2)
    waves = rng.normal(0.0, 700.0, (60, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, 60)
    inside = seen.triangle >= 0
    grey = np.full((rows, columns), 8.0)
    grey[inside] = 128.0 + 8.0 * np.cos(seen.point[inside] @ waves.T + phases).sum(axis=1)
    return np.clip(grey + rng.normal(0.0, 1.0, grey.shape), 0, 255).astype(np.uint8)


def _campaign(here):
    write_block(here / "parts" / "monday" / "part 1")
    yield
    yield
    yield


def _compression(here):
    rng = np.random.default_rng(1)
    shortening = np.linspace(0.0, 3.0, 60)
    for name, modulus in (("test1.csv", 6e4), ("test2.csv", 6.2e4)):
        force = modulus * np.pi * 0.025**2 * shortening / 30.0 + rng.normal(0.0, 0.05, 60)
        rows = np.column_stack([shortening, force])
        head = "Compression (mm),Load (N)"
        np.savetxt(here / name, rows, delimiter=",", header=head, comments="", fmt="%.4f")
    yield


def _export(here):
    write_block(here / "examples" / "half_ball", ("p1", "p2", "p3", "p4", "p5", "p6"))
    yield
    yield


_PLAN = "palpate lab plan my_session --young-modulus 50e3 --poisson-ratio 0.3"


@cache
def _planned():
    """Files of a session that was planned as the guide says: its pictures are those of the plan."""
    with TemporaryDirectory() as folder, chdir(folder):
        session = Path("my_session")
        session.mkdir()
        planned_session(session, PLANNED.replace("n02", "n05").replace("0.004,", "0.008,"))
        # Coarser than for a plan's own tests.
        mesh = half_ball(radius=0.04, edge=0.014)
        write_mesh(session / "mesh.ply", mesh)
        write_rig(session / "rig.toml", make_head(Head(distance=0.5, columns=240, rows=192), mesh))
        assert main(shlex.split(_PLAN)[1:]) == 0
        pictures = Path("my_session-plan").glob("*_c?.png")
        return {path.name: path.read_bytes() for path in (*session.iterdir(), *pictures)}


def _write_planned(here):
    (here / "my_session").mkdir()
    for name, content in _planned().items():
        (here / "my_session" / name).write_bytes(content)


def _flow(here):
    _write_planned(here)
    yield


_MEASURED_BY_VIC3D = "x,y,sigma,X,Y,Z,U,V,W"


def _import(here):
    """A cube of 40 mm whose upper face a program measured, in its own frame or the mesh's."""
    pose = tomllib.loads(blocks("docs/howto/import.md", "toml")[0])
    turn, shift = np.array(pose["R"], dtype=float), np.array(pose["t"], dtype=float)
    (here / "pose.toml").write_text(blocks("docs/howto/import.md", "toml")[0])
    names = ("n01", "n02", "n03")
    _bare_cube(here / "my_session", names)
    for name in names:
        points, moved = _upper_face(name)
        _vic3d(here / f"{name}.csv", (points - shift) @ turn, moved @ turn)
    yield
    shutil.rmtree(here / "my_session")
    _bare_cube(here / "my_session", (*names, "n04", "n05"))
    for name, file in (("n01", "B00012.csv"), ("n02", "B00031.csv")):
        _vic3d(here / file, *_upper_face(name))
    points, moved = _upper_face("n03")
    states = [points + share * moved for share in (0.0, 0.4, 0.7, 1.0)]
    write_mat(here / "DIC3Dstereo.mat", "DIC3D", states, version="7.3")
    yield


def _bare_cube(folder, names):
    """The cube's session without displacements."""
    write_cube_session(folder)
    file = folder / "session.toml"
    text = file.read_text().replace('displacement = "n01.csv"\n', "")
    probing = text[text.index("[[probe]]") :]
    file.write_text(text + "".join(probing.replace("n01", name) for name in names[1:]))
    (folder / "n01.csv").unlink()


def _upper_face(name):
    """Points of the cube's upper face and how far they moved [mm]."""
    rng = np.random.default_rng(int(name[1:]))
    points = np.column_stack([rng.uniform(0.0, 40.0, (30, 2)), np.full(30, 40.0)])
    return points, 0.1 * rng.normal(size=(30, 3))


def _vic3d(file, points, moved):
    sigma = np.full(len(points), 0.01)
    write_table(file, _MEASURED_BY_VIC3D, np.column_stack([points[:, :2], sigma, points, moved]))


def _init(here):
    write_block(here / "my_object")
    (here / "my_object" / "session.toml").unlink()
    yield
    (here / "my_object" / "session.toml").unlink()
    yield


# A wide contact, whose elements are large.
_COARSE = {
    "edge = 0.008\nelement = 0.01": "edge = 0.012\nelement = 0.03",
    "[arm]\nradius = 6e-3": "[arm]\nradius = 40e-3",
    "depth = 4e-3\nsteps = 2": "depth = 6e-3\nsteps = 1",
}


def _lab(here):
    _planned()
    yield {_PLAN}
    small = HALF_BALL
    for key, value in _COARSE.items():
        assert key in small
        small = small.replace(key, value)
    # A file hides the built-in configuration of its name, which takes minutes.
    (here / "half-ball").write_text(small)
    (here / "my_bench.toml").write_text(STAGE)
    yield


def _mesh(here):
    """What a scanner gives: millimetres, and nothing below z = 0."""
    mesh = toy(4e-3)
    above = mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) > 1e-6
    part = trimesh.Trimesh(1e3 * mesh.vertices, mesh.triangles[above], process=False)
    part.export(here / "toy.stl")
    (here / "touch.xyz").write_text("0 0 70\n")
    yield


def _heterogeneous(here):
    write_block(here / "examples" / "half_ball", ("p1", "p2", "p3", "p4"))
    yield
    yield


def _next(here):
    write_block(here / "half_ball")
    yield


def _creep(here):
    write_creeping_session(here / "my_object", TWO, noise=0.01, instants=range(20, 320, 8))
    yield


def _pokes(here):
    """A half space of 30 kPa, poked in nine places."""
    rows = ["poke,x,y,z,force"]
    for k in range(9):
        for depth in np.linspace(0.2, 2.0, 10):
            force = 4.0 / 3.0 * 40e3 * np.sqrt(4e-3) * (1e-3 * depth) ** 1.5
            rows.append(f"{k},{10 * (k % 3)},{10 * (k // 3)},{20 - depth:.6f},{force:.9f}")
    (here / "pokes.csv").write_text("\n".join(rows) + "\n")
    yield


def _poke(here):
    write_block(here / "SESSION")
    write_block(here / "examples" / "half_ball")
    yield
    yield


def _record(here):
    folder = write_recording(here / "bench")
    yield
    (folder / "recording.toml").unlink()
    yield


def _report(here):
    write_block(here / "examples" / "half_ball")
    yield


def _results(here):
    _written(here, "my_session", "n01").save(here / "my_session-result")
    os.chdir(here / "my_session-result")
    yield
    os.chdir(here)
    yield


def _written(here, session, name):
    """A session of one probing with a result as a fit would have written it."""
    write_block(here / session, (name,))
    read = read_session(here / session)
    # Of a probing 'n01'.
    made = sample_result(replace(read, probings=(replace(read.probings[0], name="n01"),)))
    (fitted,), (probe,) = made.probes, made.estimate.probes
    return Result(
        read,
        replace(
            made,
            probes=(replace(fitted, name=name),),
            estimate=replace(made.estimate, probes=(replace(probe, name=name),)),
        ),
    )


def _scan(here):
    """The toy before a scanner that stands still, turned on its table between two views."""
    folder, mesh = here / "toy", toy()
    folder.mkdir()
    (folder / "scan.toml").write_text(blocks("docs/howto/scan.md", "toml")[0])
    rng = np.random.default_rng(2)
    for name, angle in (("front.ply", 0.0), ("side.ply", np.deg2rad(30.0))):
        camera = camera_at(-angle)
        T_object_camera = np.linalg.inv(camera.T_camera_object)
        points = seen_points(mesh, camera, rng) @ T_object_camera[:3, :3].T + T_object_camera[:3, 3]
        turned = points @ Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix().T
        trimesh.PointCloud(1e3 * turned).export(folder / name)
    yield


def _view(here):
    _written(here, "session", "p4").save(here / "half_ball")
    yield
    # A turntable has 72 pictures.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stills, "_VIEWS", 4)
        yield


def _measure(_here):
    # The virtual bench; then one with devices.
    yield
    yield


GUIDES = {
    "calibrate": _calibrate,
    "campaign": _campaign,
    "compression": _compression,
    "export": _export,
    "flow": _flow,
    "heterogeneous": _heterogeneous,
    "import": _import,
    "init": _init,
    "measure": _measure,
    "moved_camera": _moved_camera,
    "lab": _lab,
    "mesh": _mesh,
    "next": _next,
    "poke": _poke,
    "creep": _creep,
    "pokes": _pokes,
    "record": _record,
    "report": _report,
    "results": _results,
    "scan": _scan,
    "view": _view,
}
