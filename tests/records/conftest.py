"""A small session on disk that every test may spoil in its own way."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import write_mesh

SESSION = """\
format = "palpate-session/1"
name = "test cube"

[object]
mesh = "mesh.ply"
length_unit = "m"
density = 1000.0

[support]
plane = { point = [0, 0, 0], normal = [0, 0, 2], tolerance = 1e-6 }

[[probe]]
name = "n01"
contact = { point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }
force = [0, 0, -1.2]
force_std = 0.012
tip_displacement = [0, 0, -0.0021]
tip_displacement_std = 5e-5
displacement = "n01.csv"

[[probe]]
name = "n02"
contact = { point = [0.04, 0.02, 0.03], profile = "vertex" }
force = [-1, 0, 0]
displacement = "n02.csv"
"""


@pytest.fixture
def session_folder(tmp_path: Path) -> Path:
    """A cube of 40 mm held at z = 0, with two probings; the rows of n02 include a NaN."""
    mesh = box(size=(0.04, 0.04, 0.04), cells=4)
    write_mesh(tmp_path / "mesh.ply", mesh)
    (tmp_path / "session.toml").write_text(SESSION)
    free = mesh.vertices[mesh.vertices[:, 2] > 0.0]
    moved = np.stack([0.0 * free[:, 0], 0.0 * free[:, 0], -0.05 * free[:, 2]], axis=1)
    rows = [",".join(f"{x:.9g}" for x in row) for row in np.hstack([free, moved])]
    (tmp_path / "n01.csv").write_text("\n".join(["x,y,z,ux,uy,uz", *rows]) + "\n")
    rows = [",".join(f"{x:.9g}" for x in row) for row in np.hstack([free, 0.98 * moved])]
    rows[3] = ",".join([*rows[3].split(",")[:3], "nan", "0", "0"])
    (tmp_path / "n02.csv").write_text("\n".join(["x,y,z,ux,uy,uz", *rows]) + "\n")
    return tmp_path


@pytest.fixture
def edited(session_folder: Path) -> Callable[..., Path]:
    """Function that replaces a piece of a session's file and gives the folder."""

    def edit(old: str, new: str, *, file: str = "session.toml") -> Path:
        path = session_folder / file
        text = path.read_text()
        assert old in text, f"{old!r} is not in {file}"
        path.write_text(text.replace(old, new, 1))
        return session_folder

    return edit
