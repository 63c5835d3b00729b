"""Small videos of presses in closed form: a speckled plane that gives way around the tool.

The plane z = 0 of a block is looked at straight from above by two cameras side by side, so that a
small displacement along the plane is one in the picture, the same for both.
"""

from pathlib import Path

import cv2
import numpy as np
from recording.bench_signals import duration, push, readings, write_log
from scipy.ndimage import gaussian_filter
from surfaces import box

from palpate.geometry import write_mesh
from palpate.records import Camera, Rig, write_rig

SIZE = (160, 120)
RATE = 20.0
HEIGHT, EDGE, FOCAL = 0.4, 0.06, 700.0
PEAKS = np.array([0.8, 1.2, 0.6])
# Where the gauge's clock is when the camera's is at nought [s].
OFFSETS = (0.4, -0.23)
# Of the picture's centre, under the largest force [px].
MOTION = 4.0

RECORDING = """\
format = "palpate-recording/1"
name = "block"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = { point = [0, 0, -0.03], normal = [0, 0, 1], tolerance = 1e-6 }
[rig]
cameras = "rig.toml"
[force]
file = "force.csv"
axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
[[camera]]
name = "c0"
video = "c0.avi"
[[camera]]
name = "c1"
video = "c1.avi"
[contact]
radius = 0.004
profile = "hertz"
points = [[0.0, 0.0, 0.0], [0.001, 0.0, 0.0], [0.0, 0.001, 0.0]]
"""


def rig() -> Rig:
    """Two cameras above the block."""
    matrix = np.array([[FOCAL, 0.0, 79.5], [0.0, FOCAL, 59.5], [0.0, 0.0, 1.0]])
    cameras = []
    for name, x in (("c0", 0.0), ("c1", 0.01)):
        pose = np.diag([1.0, -1.0, -1.0, 1.0])
        pose[:3, 3] = [-x, 0.0, HEIGHT]
        cameras.append(Camera(name, SIZE, matrix, np.zeros(5), pose))
    return Rig(tuple(cameras), 0, "rig")


def texture(seed: int) -> np.ndarray:
    """Speckles of three pixels."""
    rng = np.random.default_rng(seed)
    smooth = gaussian_filter(rng.standard_normal(SIZE[::-1]), 1.5, mode="wrap")
    return np.clip(128.0 + 45.0 * smooth / smooth.std(), 0.0, 255.0).astype(np.float32)


def picture(plain: np.ndarray, share: float, tool: float, rng: np.random.Generator) -> np.ndarray:
    """What is seen with `share` of the motion, the tool's end at column `tool`; noise of 1.5."""
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    bump = np.exp(-((x - 79.5) ** 2 + (y - 59.5) ** 2) / (2.0 * 25.0**2)).astype(np.float32)
    seen = cv2.remap(
        plain,
        x - np.float32(MOTION * share) * bump,
        y,
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REFLECT,
    )
    seen[50:70, : max(int(tool), 0)] = 20.0
    noisy = seen + 1.5 * rng.standard_normal(seen.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def tool_column(time: float, times: np.ndarray, size: np.ndarray) -> float:
    """Where the tool's end is: it comes in half a second before it touches, and goes after."""
    near = np.abs(times - time) < 0.5
    return 60.0 if size[near].max(initial=0.0) > 1e-3 else -1.0


def frame_times(offset: float, *, count: int = 3) -> np.ndarray:
    """Times of a camera's frames on its own clock [s], so that it covers the recording."""
    return np.arange(0.0, duration(count) - max(offset, 0.0), 1.0 / RATE)


def write_video(path: Path, seed: int, offset: float, *, peaks: np.ndarray = PEAKS) -> None:
    """A camera's video without losses: frames of the closed form at its own times."""
    rng, plain = np.random.default_rng(100 + seed), texture(seed)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), RATE, SIZE)
    fine = np.arange(-1.0, duration(len(peaks)) + 1.0, 0.02)
    size = push(fine, peaks)
    for frame_time in frame_times(offset, count=len(peaks)):
        share = float(push(np.array([frame_time + offset]), peaks)[0]) / PEAKS.max()
        grey = picture(plain, share, tool_column(frame_time + offset, fine, size), rng)
        writer.write(cv2.merge([grey] * 3))
    writer.release()


def write_recording(folder: Path, *, peaks: np.ndarray = PEAKS, rate: float = 200.0) -> Path:
    """A whole recording: mesh, rig, two videos, a force log, recording.toml."""
    folder.mkdir(parents=True, exist_ok=True)
    mesh = box(size=(EDGE, EDGE, 0.03), cells=6)
    shifted = type(mesh)(mesh.vertices - [EDGE / 2, EDGE / 2, 0.03], mesh.triangles)
    write_mesh(folder / "mesh.ply", shifted)
    write_rig(folder / "rig.toml", rig())
    time, force = readings(peaks=peaks, drift=0.01, rate=rate)
    write_log(folder / "force.csv", time, force, "time [s],Fx [N],Fy [N],Fz [N]")
    for k, offset in enumerate(OFFSETS):
        write_video(folder / f"c{k}.avi", k, offset, peaks=peaks)
    (folder / "recording.toml").write_text(RECORDING)
    return folder
