"""Where lost vertices lie: under the tool, turned away, or in full view of the cameras."""

from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from pipeline.picture_session import given_and_measured

from palpate.geometry import closest_points
from palpate.pipeline.motion.figures import rejection_note, rejections


@pytest.fixture
def lost(cube_session):
    """Function: rejections of the cube with some of its places lost.

    Two cameras look straight down. The contact is the middle of the upper face; its radius of
    2 mm makes six radii 12 mm.
    """
    _, session = given_and_measured(cube_session)
    (probing,) = session.probings
    contact = replace(probing.contact, radius=0.002)
    places = {
        "tool": [[0.02, 0.02, 0.04], [0.03, 0.02, 0.04]],
        "view": [[0.002, 0.002, 0.04], [0.038, 0.002, 0.04], [0.038, 0.038, 0.04]],
        # On the sides of the cube the sight runs along the surface.
        "side": [[0.0, 0.02, 0.02], [0.04, 0.02, 0.02], [0.02, 0.0, 0.01]],
    }

    def found(*names):
        points = np.array([point for lost_here in places.values() for point in lost_here])
        flags = np.array([name in names for name, lost_here in places.items() for _ in lost_here])
        moved = np.where(flags[:, None], np.nan, 1e-4 * np.arange(3 * len(points)).reshape(-1, 3))
        field = replace(
            probing.displacement, points=points, displacement=moved, std=np.full((8, 3), 1e-6),
            covariance=None, average=None, vertex=None,
            surface=closest_points(session.mesh, points),
        )  # fmt: skip
        disturbed = replace(probing, contact=contact, displacement=field)
        return rejections(replace(session, probings=(disturbed,)))

    return found


@pytest.mark.parametrize(
    ("names", "counts"),
    [
        (("tool",), (2, 0, 0)), (("side",), (0, 3, 0)), (("view",), (0, 0, 3)),
        (("tool", "side"), (2, 3, 0)), ((), (0, 0, 0)),
    ],
)  # fmt: skip
def test_lost_vertices_are_told_apart(lost, names, counts):
    (rejection,) = lost(*names)
    assert (rejection.near_tool, rejection.oblique, rejection.in_view) == counts
    assert (rejection.name, rejection.seen, rejection.lost) == ("n01", 8, sum(counts))


def test_what_the_tool_covers_is_as_usual(lost):
    text = rejection_note(lost("tool", "side"))
    assert "5 of 8 vertices that a camera saw were not measured (62 %): 2 within 6" in text
    assert "That is as usual" in text


def test_what_is_lost_in_full_view_is_not(lost):
    text = rejection_note(lost("tool", "view"))
    assert "3 in full view" in text
    assert "unusual" in text
    assert "palpate flow" in text


def test_a_session_without_cameras_says_nothing(cube_session):
    _, session = given_and_measured(cube_session)
    assert rejections(replace(session, rig=None)) == ()
