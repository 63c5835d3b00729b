"""Whether `palpate flow` takes constant memory and time on a video, however long it is."""

import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import psutil

from benchmarks.clock import shortest
from benchmarks.figure import FLOW, Figure
from benchmarks.machine import ROOT, SHARED
from benchmarks.options import Options
from palpate.records import Camera, read_rig, write_rig

SOURCE = SHARED / "halfball_images"
INSTANTS, QUICK = 300, 12
# Pushed in and let go again, over and over: pictures of SOURCE, after "rest".
LOADED = tuple(f"n05_{k}" for k in (1, 2, 3, 4, 5, 4, 3, 2))
ROWS, COLUMNS = 1024, 1280
NOISE = 1.5  # grey levels
SAMPLING = 0.02  # s, between two readings of the memory
SESSION = """\
format = "palpate-session/1"
name = "half ball, a video"

[object]
mesh = "mesh.ply"
length_unit = "m"

[rig]
cameras = "rig.toml"
"""
STEP = """
[[step]]
name = "{name}"
images = "images/{name}_{{camera}}.png"
"""


def measure(options: Options) -> list[Figure]:
    """Memory and time of the last instants beside those of the first ones."""
    instants = QUICK if options.quick else INSTANTS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names = write_video_session(folder / "video", instants)
        memory, seconds = _followed(folder, names[1:])
        reading = _reading_time(folder / "video" / "images", names[1:11])
    tenth, last = memory[9] / 1e9, memory[-1] / 1e9
    first = float(np.median(seconds[1:11]))
    final = float(np.median(seconds[-(len(seconds) // 10) :]))
    what = f"a video of 3 x {instants} frames of {COLUMNS} x {ROWS}"
    return [
        Figure(
            FLOW, f"{what}: memory at the last instant over that at the tenth", last / tenth, "x",
            note=f"`palpate flow --no-pictures` in a process of its own: {tenth:.2f} GB resident at"
            f" most while the tenth motion was measured, {last:.2f} GB while the last one was",
        ),
        Figure(
            FLOW, f"{what}: time per instant, last tenth over the first", final / first, "x",
            note=f"{final:.2f} s, median of the last tenth of the instants; {first:.2f} s, of"
            " motions 2 to 11; reading, measuring and writing; floor: to decode the three pictures"
            f" of an instant, one after the other, takes {reading:.2f} s",
        ),
    ]  # fmt: skip


def write_video_session(folder: Path, instants: int) -> list[str]:
    """Write a session of steps: a half ball that is pushed again and again.

    Parameters
    ----------
    folder : Path               made
    instants : int              of three cameras; the first is at rest

    Returns
    -------
    list of str                 names of the steps
    """
    (folder / "images").mkdir(parents=True)
    shutil.copy(SOURCE / "mesh.ply", folder / "mesh.ply")
    rig = read_rig(SOURCE / "rig.toml")
    write_rig(folder / "rig.toml", replace(rig, cameras=tuple(map(_enlarged_camera, rig.cameras))))
    names = [f"s{k:04d}" for k in range(instants)]
    steps = "".join(STEP.format(name=name) for name in names)
    (folder / "session.toml").write_text(SESSION + steps)
    rng = np.random.default_rng(1)
    for camera in rig.cameras:
        shown = {name: _enlarged(name, camera.name) for name in ("rest", *LOADED)}
        for k, name in enumerate(names):
            grey = shown[LOADED[(k - 1) % len(LOADED)] if k else "rest"]
            noisy = grey + rng.normal(0.0, NOISE, grey.shape)
            path = folder / "images" / f"{name}_{camera.name}.png"
            levels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
            cv2.imwrite(str(path), levels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    return names


def _reading_time(folder: Path, names: list[str]) -> float:
    """Shortest time [s] in which the pictures of one instant are decoded."""

    def read(name: str) -> None:
        for path in folder.glob(f"{name}_*.png"):
            cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)

    return min(shortest(lambda name=name: read(name), repeats=1) for name in names)


def _enlarged(name: str, camera: str) -> np.ndarray:
    """A picture of SOURCE at twice the size, its last row repeated below."""
    grey = cv2.imread(str(SOURCE / "images" / f"{name}_{camera}.png"), cv2.IMREAD_GRAYSCALE)
    twice = cv2.resize(grey.astype(np.float32), None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    return np.pad(twice, ((0, ROWS - len(twice)), (0, 0)), mode="edge")


def _enlarged_camera(camera: Camera) -> Camera:
    """The camera of enlarged pictures; a pixel's centre, u, comes to lie at 2 u + 0.5."""
    matrix = 2.0 * camera.matrix
    matrix[:2, 2] += 0.5
    matrix[2, 2] = 1.0
    return replace(camera, size=(COLUMNS, ROWS), matrix=matrix)


def _followed(folder: Path, names: list[str]) -> tuple[list[int], np.ndarray]:
    """Largest resident memory [bytes] and time [s] of every motion of the session `video`."""
    command = [sys.executable, "-m", "palpate", "flow", str(folder / "video"), "--no-pictures"]
    begun, samples = time.time(), []
    process = subprocess.Popen(
        [*command, "--out", str(folder / "result")], cwd=ROOT, stdout=subprocess.DEVNULL
    )
    watched = psutil.Process(process.pid)
    while process.poll() is None:
        with suppress(psutil.NoSuchProcess):
            samples.append((time.time(), watched.memory_info().rss))
        time.sleep(SAMPLING)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    # A motion ends when its table, the last of its files, has been written.
    ends = np.array([(folder / "result" / f"{name}.csv").stat().st_mtime for name in names])
    when, memory = np.array(samples).T
    motion = np.searchsorted(ends, when)
    largest = [int(memory[motion == k].max()) for k in range(len(names))]
    return largest, np.diff(ends, prepend=begun)
