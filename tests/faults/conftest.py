"""Good examples that the kinds of broken input start from: folders made once, copied for each."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from cube_session import SESSION
from estimate_samples import sample_result
from flow_samples import rig
from surfaces import box

from palpate.geometry import write_mesh
from palpate.records import (
    read_session,
    record_inputs,
    result_file,
    result_folder,
    sealed,
    session_files,
    write_estimate,
    write_rig,
    write_text,
)


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


@pytest.fixture(scope="session")
def results(cube: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session `cube`, a result of fitting it, a compression test and its result."""
    folder = tmp_path_factory.mktemp("results")
    shutil.copytree(cube, folder / "cube")
    with result_folder(folder / "result", kind="fit") as made:
        record_inputs(made, session_files(folder / "cube"))
        session = read_session(folder / "cube")
        write_estimate(made / "estimate.json", sample_result(session).estimate)
        (made / "table.csv").write_text("1\n")
    strain = np.linspace(0.0, 0.1, 40)
    rows = np.stack([30.0 * strain, 1e5 * strain * np.pi * 0.025**2], axis=1)
    np.savetxt(folder / "record.csv", rows, delimiter=",", header="displacement,force", comments="")
    with result_file(folder / "young.json") as file:
        content = {"format": "palpate-compression/1", "young_modulus": {"value": 1.0}}
        write_text(file, sealed(content, [folder / "record.csv"], folder=folder))
    return folder


def _add_pictures(folder: Path, tail: str) -> None:
    """A rig of two cameras over the cube, noise for pictures, and a session that names them."""
    rng = np.random.default_rng(1)
    for instant in ("a", "b"):
        for name in ("c0", "c1"):
            grey = rng.integers(20, 230, (120, 160), dtype=np.uint8)
            cv2.imwrite(str(folder / f"{instant}_{name}.png"), grey)
    write_rig(folder / "rig.toml", rig())
    head = SESSION[: SESSION.index("[[probe]]")]
    (folder / "session.toml").write_text(f'{head}[rig]\ncameras = "rig.toml"\n{tail}')


@pytest.fixture(scope="session")
def pictured(cube: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of one probing with pictures, called last."""
    folder = tmp_path_factory.mktemp("pictured") / "cube"
    shutil.copytree(cube, folder)
    probing = SESSION[SESSION.index("[[probe]]") :].replace('"n01"', '"last"')
    images = 'images = { rest = "a_{camera}.png", loaded = ["b_{camera}.png"] }'
    _add_pictures(folder, probing.replace('displacement = "n01.csv"', images))
    return folder


@pytest.fixture(scope="session")
def rigid_motion(cube: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rigid motion of two steps, the second called last."""
    folder = tmp_path_factory.mktemp("rigid") / "cube"
    shutil.copytree(cube, folder)
    steps = (("first", "a"), ("last", "b"))
    tables = [f'[[step]]\nname = "{n}"\nimages = "{k}_{{camera}}.png"\n' for n, k in steps]
    _add_pictures(folder, "".join(tables))
    return folder
