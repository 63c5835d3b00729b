"""A session on disk, and a result of it as `palpate fit` leaves it."""

import shutil

import pytest
from cube_session import cube_session as cube_session, write_cube_session
from estimate_samples import sample_result

from palpate.api import Result
from palpate.records import read_session


@pytest.fixture
def session(cube_session):
    return read_session(cube_session)


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """Folder of a result with its report, which stays as it is; its session lies beside it."""
    folder = tmp_path_factory.mktemp("report")
    session = read_session(write_cube_session(folder / "cube"))
    return Result(session, sample_result(session)).save(folder / "saved")


@pytest.fixture
def saved(tmp_path, whole):
    """The same, to be spoilt, without its session."""
    shutil.copytree(whole, tmp_path / "saved")
    return tmp_path / "saved"
