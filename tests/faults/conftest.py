"""Good examples that the kinds of broken input start from: folders made once, copied for each."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from cube_session import SESSION
from estimate_samples import sample_result
from faults.bench import write_bench
from faults.samples import (
    STEPS,
    write_cube,
    write_meshes,
    write_pictures,
    write_results,
    write_rigs,
    write_texts,
)
from flow_samples import rig
from recording.bench_footage import write_recording
from surfaces import box

from palpate.geometry import write_mesh
from palpate.pipeline import write_fitted_surface
from palpate.records import (
    read_session,
    record_inputs,
    result_folder,
    session_files,
    write_estimate,
    write_rig,
)


@pytest.fixture(scope="session")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of displacements: a cube of 40 mm held at z = 0, pressed from above."""
    folder = tmp_path_factory.mktemp("cube")
    write_cube(folder)
    return folder


@pytest.fixture(scope="session")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the commands around a fit read: `faults.bench`."""
    folder = tmp_path_factory.mktemp("bench")
    write_bench(folder)
    return folder


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of three presses by two cameras and a force gauge."""
    return write_recording(tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="session")
def meshes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with its surface in every format."""
    folder = tmp_path_factory.mktemp("meshes")
    write_meshes(folder)
    write_cube(folder)
    return folder


@pytest.fixture(scope="session")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rigid motion: the cube, pictures of two steps in every format, a rig of every program."""
    folder = tmp_path_factory.mktemp("motion")
    write_cube(folder)
    write_rigs(folder)
    write_pictures(folder)
    (folder / "session.toml").write_text(STEPS)
    return folder


@pytest.fixture(scope="session")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cube, and results of other programs, a pose, a compression test, the facility's plans."""
    folder = tmp_path_factory.mktemp("others")
    write_cube(folder)
    write_results(folder)
    write_texts(folder)
    return folder


@pytest.fixture(scope="session")
def results(cube: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The session `cube`, a result of fitting it, a compression test and its result."""
    folder = tmp_path_factory.mktemp("results")
    shutil.copytree(cube, folder / "cube")
    with result_folder(folder / "result", kind="fit") as made:
        record_inputs(made, session_files(folder / "cube"))
        session = read_session(folder / "cube")
        fitted = sample_result(session)
        write_estimate(made / "estimate.json", fitted.estimate)
        write_fitted_surface(made, session, fitted)
        (made / "table.csv").write_text("1\n")
    strain = np.linspace(0.0, 0.1, 40)
    rows = np.stack([30.0 * strain, 1e5 * strain * np.pi * 0.025**2], axis=1)
    np.savetxt(folder / "record.csv", rows, delimiter=",", header="displacement,force", comments="")
    return folder


@pytest.fixture(scope="session")
def tension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bar of 40 mm between a grip whose motion is given and one that a load cell pulls."""
    folder = tmp_path_factory.mktemp("tension")
    mesh = box(size=(0.04, 0.01, 0.01), cells=(4, 2, 2))
    write_mesh(folder / "mesh.ply", mesh)
    (folder / "session.toml").write_text(TENSION)
    (folder / "side.txt").write_text("# a free triangle\n40\n")
    grip = np.array([[0.0, y, z] for y in (0.001, 0.009) for z in (0.001, 0.009)])
    side = np.array([[x, 0.0, 0.005] for x in (0.01, 0.02, 0.03)])
    head = "x,y,z,ux,uy,uz"
    for name, points in (("foot.csv", grip), ("n01.csv", side)):
        rows = np.hstack([points, points * [5e-4, -1e-4, -1e-4] + [1e-4, 0.0, 0.0]])
        np.savetxt(folder / name, rows, delimiter=",", header=head, comments="")
    return folder


TENSION = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[[support]]
plane = { point = [0, 0, 0], normal = [1, 0, 0], tolerance = 1e-6 }
motion = "given"
[[support]]
plane = { point = [0.04, 0, 0], normal = [1, 0, 0], tolerance = 1e-6 }
motion = "free"
[[probe]]
name = "n01"
contact = { support = 2 }
force = [2, 0, 0]
force_std = [0.002, 0.5, 0.5]
displacement = "n01.csv"
support_displacement = "foot.csv"
"""


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
