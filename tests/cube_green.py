"""Green's functions of the top of a cube of 40 mm, for the tests of the room: `green`."""

import pytest
from cube_session import cube_session

from palpate.records import read_session
from palpate.simulation import exact_material, make_green_functions, nearest_nodes

SHEAR, NU = 2e4, 0.3
TOP = [0.02, 0.02, 0.04]


@pytest.fixture(scope="session")
def session(tmp_path_factory):
    return read_session(cube_session.__wrapped__(tmp_path_factory.mktemp("green")))


def top_functions(session, material, cache=None):
    """Of the 37 vertices nearest to the middle of the top."""
    nodes = nearest_nodes(session, session.probings[0].contact.point[None], 37)
    return make_green_functions(session, material, nodes=nodes, cache=cache)


@pytest.fixture(scope="session")
def green(session):
    return top_functions(session, exact_material(SHEAR, NU))
