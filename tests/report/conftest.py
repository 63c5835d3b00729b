"""A session on disk, and a result of it as `palpate fit` leaves it."""

import pytest
from cube_session import cube_session as cube_session
from estimate_samples import sample_result

from palpate.api import Result
from palpate.records import read_session


@pytest.fixture
def session(cube_session):
    return read_session(cube_session)


@pytest.fixture
def saved(tmp_path, session):
    """Folder of a result with its report."""
    return Result(session, sample_result(session)).save(tmp_path / "saved")
