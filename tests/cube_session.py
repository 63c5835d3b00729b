"""A session on disk that the tests of several rooms read: the fixture `cube_session`."""

from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import write_mesh

SESSION = """\
format = "palpate-session/1"
name = "a [bold] cube"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }
[[probe]]
name = "n01"
contact = { point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }
force = [0, 0, -1.2]
displacement = "n01.csv"
"""


@pytest.fixture
def cube_session(tmp_path: Path) -> Path:
    """A cube of 40 mm held at z = 0, pressed from above; sigma 0.1 mm, one row not measured."""
    return write_cube_session(tmp_path / "cube")


def write_cube_session(folder: Path) -> Path:
    """The files of `cube_session` in a folder that is not there yet."""
    folder.mkdir()
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    write_mesh(folder / "mesh.ply", mesh)
    (folder / "session.toml").write_text(SESSION)
    top = mesh.vertices[mesh.vertices[:, 2] > 0.0]
    moved = np.array([3e-4, 0.0, -4e-4]) * np.ones((len(top), 1))
    moved[0] = np.nan
    rows = np.hstack([top, moved, np.full((len(top), 1), 1e-4)])
    head = "x,y,z,ux,uy,uz,sigma"
    np.savetxt(folder / "n01.csv", rows, delimiter=",", header=head, comments="")
    return folder
