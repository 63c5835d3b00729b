"""How long one instant of three cameras takes, from pictures in memory to vertices."""

import time

import numpy as np

from benchmarks.figure import FLOW, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from palpate.records import read_rig, read_session
from palpate.vision import JointFlow, read_pictures

FOLDER = SHARED / "halfball_images"
NAMES = ("n01", "n02", "n03", "n04")


def measure(options: Options) -> list[Figure]:
    """Frames per second of 640 x 480 x 3, some two thousand points, both cores, warm."""
    session, rig = read_session(FOLDER), read_rig(FOLDER / "rig.toml")
    patterns = ["images/rest_{camera}.png", *(f"images/{name}_{{camera}}.png" for name in NAMES)]
    grey = [read_pictures(rig, pattern, folder=FOLDER, what=pattern).grey for pattern in patterns]
    method = JointFlow()
    state = method.start(rig, grey[0], session.mesh)
    seconds = []
    for pictures in grey[1:]:
        begun = time.perf_counter()
        _, flow = method.follow(state, pictures)
        found = method.vertices(flow, rig, session.mesh)
        seconds.append(time.perf_counter() - begun)
    count = int(np.isfinite(found.displacement[:, 0]).sum())
    return [
        Figure(
            FLOW, "640 x 480 x 3 cameras, one instant, warm", 1.0 / float(np.min(seconds[1:])),
            "1/s", must=1.0, reach=5.0, higher=True,
            note=f"{len(flow.point)} points in the reference camera, {count} vertices measured;"
            " dense start, refinement with retries, judgement and vertices; best of three, the"
            " first left aside",
        )
    ]  # fmt: skip
