"""A measurement that is made up: it runs every kernel that the flow and the fit of a real one run.

numba compiles a kernel when it is called for the first time, and keeps it on the disk. After this
no measurement waits for that.
"""

import tempfile
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from palpate.geometry import TriangleMesh, refined_surface, welded, write_mesh
from palpate.pipeline.fit_session import fit_session
from palpate.pipeline.motion.displacement import measure_pictures, with_motions
from palpate.progress import Progress, silent
from palpate.records import Camera, Rig, Session, read_session, write_rig

# A block held at its foot, pushed in the middle of its top [m], and the parts of its edges.
_SIZE, _PIECES = (0.04, 0.03, 0.012), 5
_SESSION = f"""\
format = "palpate-session/1"
name = "warming up"

[object]
mesh = "mesh.ply"
length_unit = "m"

[support]
plane = {{ point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }}

[rig]
cameras = "rig.toml"

[[probe]]
name = "push"
contact = {{ point = [0, 0, {_SIZE[2]}], radius = 0.004, profile = "smooth" }}
force = [0, 0, -1]
images = {{ rest = "rest_{{camera}}.png", loaded = ["loaded_{{camera}}.png"] }}
"""
# Depth and width of the dip that the push makes [m].
_DIP, _WIDTH = 3e-4, 6e-3
# Pictures: rows and columns, focal length [px], distance [m], and angles beside the normal [rad].
_SHAPE, _FOCAL, _DISTANCE, _ANGLES = (300, 400), 1400.0, 0.25, (-0.2, 0.2)
# Waves of random direction and phase that make the texture, and their wave numbers [1/m].
_WAVES, _WAVE_NUMBER = 60, 3e3


def warm_up(progress: Progress = silent) -> None:
    """Measure the made-up motion in its pictures, and fit constants to it.

    Parameters
    ----------
    progress : callable             called with the current step (text) and the fraction done
    """
    with tempfile.TemporaryDirectory(prefix="palpate-warm-up-") as name:
        session = _made_up_session(Path(name))
        progress("the flow", 0.0)
        session = with_motions(session, measure_pictures(session))
        progress("the fit", 0.7)
        fit_session(session)


def _made_up_session(folder: Path) -> Session:
    """A session with pictures of a push, written into a folder."""
    rig = Rig(tuple(_camera(f"c{k}", angle) for k, angle in enumerate(_ANGLES)), 0, "warm up")
    write_rig(folder / "rig.toml", rig)
    write_mesh(folder / "mesh.ply", _block())
    (folder / "session.toml").write_text(_SESSION, encoding="utf-8")
    for camera in rig.cameras:
        for state, depth in (("rest", 0.0), ("loaded", 1.0)):
            cv2.imwrite(str(folder / f"{state}_{camera.name}.png"), _picture(camera, depth))
    return read_session(folder)


def _block() -> TriangleMesh:
    """The block, its foot at z = 0."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0, 1)])
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    halves = [half for a, b, c, d in faces for half in ((a, b, c), (a, c, d))]
    coarse = TriangleMesh(corners * _SIZE, np.array(halves))
    return welded(TriangleMesh(*refined_surface(coarse, pieces=_PIECES)))


def _camera(name: str, angle: float) -> Camera:
    """A camera that looks at the middle of the top from an angle [rad] beside its normal."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, 0, -s], [0, -1, 0], [-s, 0, -c]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [0, 0, _DISTANCE] - turn @ [0, 0, _SIZE[2]]
    rows, columns = _SHAPE
    matrix = np.array([[_FOCAL, 0, (columns - 1) / 2], [0, _FOCAL, (rows - 1) / 2], [0, 0, 1]])
    return Camera(name, (columns, rows), matrix, np.zeros(5), pose)


def _picture(camera: Camera, depth: float) -> NDArray[np.uint8]:
    """Grey levels of the top with a part of the dip: every pixel's ray is cut with it."""
    pixels = np.stack([*np.mgrid[: _SHAPE[0], : _SHAPE[1]][::-1], np.ones(_SHAPE)], axis=-1)
    turn, shift = camera.T_camera_object[:3, :3], camera.T_camera_object[:3, 3]
    centre, rays = -turn.T @ shift, pixels @ np.linalg.inv(camera.matrix).T @ turn
    height = np.full(_SHAPE, _SIZE[2])
    # Where a ray arrives depends on the height there, but hardly: the dip is flat.
    for _ in range(4):
        position = centre + rays * ((height - centre[2]) / rays[..., 2])[..., None]
        height = _SIZE[2] - depth * _dip(position)
    rng = np.random.default_rng(0)
    waves, phases = rng.normal(0.0, _WAVE_NUMBER, (2, _WAVES)), rng.uniform(0, 2 * np.pi, _WAVES)
    texture = 120 + 5 * np.cos(position[..., :2] @ waves + phases).sum(axis=-1)
    return texture.clip(0, 255).astype(np.uint8)


def _dip(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n"]:
    """How far the top gives way at points [m]."""
    return _DIP * np.exp(-(points[..., :2] ** 2).sum(axis=-1) / (2 * _WIDTH**2))
