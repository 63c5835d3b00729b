"""Good examples that the kinds of broken input start from: folders made once, copied for each."""

from pathlib import Path

import numpy as np
import pytest
from cube_session import SESSION
from surfaces import box

from palpate.geometry import write_mesh


@pytest.fixture(scope="session")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of displacements: a cube of 40 mm held at z = 0, pressed from above."""
    folder = tmp_path_factory.mktemp("cube")
    mesh = box(size=(0.04, 0.04, 0.04), cells=3)
    write_mesh(folder / "mesh.ply", mesh)
    (folder / "session.toml").write_text(SESSION)
    top = mesh.vertices[mesh.vertices[:, 2] > 0.0]
    height = top[:, 2:] / 0.04
    moved = np.array([3e-4, 0.0, -4e-4]) * height
    rows = np.hstack([top, moved, np.full((len(top), 1), 1e-4)])
    head = "x,y,z,ux,uy,uz,sigma"
    np.savetxt(folder / "n01.csv", rows, delimiter=",", header=head, comments="")
    return folder
