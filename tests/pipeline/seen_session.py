"""A session of three probings whose pictures are rendered: a cube's upper face, moved rigidly."""

from pathlib import Path

import cv2
import numpy as np
from surfaces import box
from vision.scenes import STILL, Stage, make_rig, noisy_views, rigid, tilted

from palpate.geometry import write_mesh
from palpate.records import write_rig

SIDE = 0.04  # m
# Pictures at rest, and the loaded ones in temporal order.
PROBINGS = {
    "n01": ("rest", ("n01_1", "n01_2")),
    "n02": ("rest", ("n02",)),
    "n03": ("other", ("n03",)),
}
_MOTIONS = {
    "rest": STILL,
    "other": STILL,
    "n01_1": rigid((0.0, 0.0, 0.01), (3e-4, -2e-4, 1e-4)),
    "n01_2": rigid((0.0, 0.0, 0.02), (6e-4, -3e-4, 2e-4)),
    "n02": rigid((0.0, 0.01, 0.0), (-5e-4, 3e-4, -3e-4)),
    "n03": rigid((0.01, 0.0, -0.01), (2e-4, 7e-4, -2e-4)),
}
_HEAD = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = { point = [0, 0, -0.04], normal = [0, 0, 1], tolerance = 1e-6 }
[rig]
cameras = "rig.toml"
"""


def write_seen_session(folder: Path) -> Path:
    """n01 in two steps and n02 share their pictures at rest, which are in colour."""
    folder.mkdir()
    write_mesh(folder / "mesh.ply", box((SIDE,) * 3, 8, (-SIDE / 2, -SIDE / 2, -SIDE)))
    stage = Stage(make_rig(2), tilted((0.0, 0.0)))
    write_rig(folder / "rig.toml", stage.rig)
    for seed, (name, motion) in enumerate(_MOTIONS.items()):
        for camera, view in zip(
            stage.rig.cameras, noisy_views(stage.views(motion), 1.0, seed), strict=True
        ):
            grey = np.clip(np.round(view), 0, 255).astype(np.uint8)
            picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) if name == "rest" else grey
            cv2.imwrite(str(folder / f"{name}_{camera.name}.png"), picture)
    write_probings(folder, PROBINGS)
    return folder


def write_probings(folder: Path, probings: dict[str, tuple[str, tuple[str, ...]]]) -> None:
    """The session file, with these probings: name -> pictures at rest, loaded ones."""
    tables = [
        f"""
[[probe]]
name = "{name}"
contact = {{ point = [0, 0, 0], radius = 0.006, profile = "smooth" }}
force = [0, 0, -1.2]
[probe.images]
rest = "{rest}_{{camera}}.png"
loaded = [{", ".join(f'"{stem}_{{camera}}.png"' for stem in loaded)}]
"""
        for name, (rest, loaded) in probings.items()
    ]
    (folder / "session.toml").write_text("".join([_HEAD, *tables]), encoding="utf-8")
