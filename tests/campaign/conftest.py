"""Small sessions that fit in a second, and a scheduler with workers in this process."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import dask
import distributed
import numpy as np
import pytest
from cube_session import cube_session as cube_session, write_cube_session
from surfaces import box

from palpate.bem import make_elastic_map
from palpate.campaign.work import PackedSession, pack_session
from palpate.geometry import write_mesh
from palpate.pipeline import make_object_model
from palpate.records import read_session

SHEAR, NU = 2e4, 0.3


@pytest.fixture(scope="session")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The cube of `cube_session`, coarser, displaced as the model itself says."""
    folder = write_cube_session(tmp_path_factory.mktemp("campaign") / "cube")
    write_mesh(folder / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=4))
    session = read_session(folder, observations=False)
    model = make_object_model(session)
    elastic = make_elastic_map(model.system, shear_modulus=SHEAR, poisson_ratio=NU)
    unit = elastic.solve(model.right.at(NU)) / SHEAR
    moved = elastic.state(unit[:, :3] @ session.probings[0].force).displacement
    write_displacements(folder, session.mesh.vertices, moved)
    return folder


def write_displacements(folder: Path, points: np.ndarray, moved: np.ndarray) -> None:
    """Displacements of the vertices above the support, with noise of 10 um."""
    rng = np.random.default_rng(0)
    rows = np.hstack([points, moved + 1e-5 * rng.normal(size=moved.shape)])[points[:, 2] > 0]
    rows = np.hstack([rows, np.full((len(rows), 1), 1e-5)])
    head = "x,y,z,ux,uy,uz,sigma"
    np.savetxt(folder / "n01.csv", rows, delimiter=",", header=head, comments="")


@pytest.fixture
def cubes(cube: Path, tmp_path: Path) -> Path:
    """A folder of two sessions, each with a force of its own, and one that is none."""
    folder = tmp_path / "cubes"
    for name, force in {"c0": "-1.2", "c1": "-1.3"}.items():
        shutil.copytree(cube, folder / name)
        file = folder / name / "session.toml"
        file.write_text(file.read_text().replace("-1.2", force))
    (folder / "bad").mkdir()
    (folder / "bad" / "session.toml").write_text('format = "palpate-session/0"\n')
    return folder


@pytest.fixture
def packed_cube(cube: Path) -> PackedSession:
    """The files of one session."""
    return pack_session(cube)


@pytest.fixture(scope="package", autouse=True)
def _own_environment() -> Iterator[None]:
    """Clusters that tests start themselves leave their workers' settings in our environment."""
    before = dict(os.environ)
    yield
    os.environ.clear()
    os.environ.update(before)


@pytest.fixture(scope="package", autouse=True)
def _certificate() -> Iterator[None]:
    """One for schedulers, workers and clients, in Dask's configuration as on many machines."""
    made = distributed.Security.temporary()
    files = {"ca-file": made.tls_ca_file}
    for role in ("client", "scheduler", "worker"):
        files |= {f"{role}.cert": made.tls_client_cert, f"{role}.key": made.tls_client_key}
    with dask.config.set({f"distributed.comm.tls.{name}": text for name, text in files.items()}):
        yield


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a scheduler with two workers, in this process."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tls", dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address
