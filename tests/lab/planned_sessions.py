"""A session before its pictures: a half ball, three cameras, two probings."""

from pathlib import Path

from palpate.geometry import write_mesh
from palpate.lab import Head
from palpate.lab.head import make_head
from palpate.lab.specimens import half_ball
from palpate.records import write_rig

SESSION = """\
format = "palpate-session/1"
name = "to be measured"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-9 }
[rig]
cameras = "rig.toml"
[[probe]]
name = "n01"
contact = { point = [0, 0, 0.04], radius = 0.004, profile = "hertz" }
force = [0, 0, -0.5]
force_std = 0.005
images = { rest = "rest_{camera}.png", loaded = ["n01_{camera}.png"] }
[[probe]]
name = "n02"
contact = { point = [0.02, 0, 0.0346], radius = 0.004, profile = "hertz" }
force = [-0.2, 0, -0.4]
images = { rest = "rest_{camera}.png", loaded = ["n02_{camera}.png"] }
"""


def planned_session(folder: Path, text: str = SESSION) -> Path:
    """Write it; there are no pictures."""
    mesh = half_ball(radius=0.04, edge=0.008)
    write_mesh(folder / "mesh.ply", mesh)
    write_rig(folder / "rig.toml", make_head(Head(distance=0.5, columns=200, rows=160), mesh))
    (folder / "session.toml").write_text(text)
    return folder
