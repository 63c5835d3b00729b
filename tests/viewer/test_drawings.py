from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from PIL import Image

from palpate.estimation import LikelihoodMap
from palpate.records import Camera, Rig, read_session
from palpate.viewer.drawings import LikelihoodPlot, camera_picture
from palpate.viewer.panels import rms_text
from palpate.viewer.scenes import camera_view_pose
from palpate.viewer.stage import merged_labels
from palpate.viewer.subject import read_subject, shown_probings

FOCAL, SIZE, HEIGHT = 800.0, (400, 300), 0.2


def camera(name):
    """Above the cube's middle, looking down; columns along x, rows against y."""
    turn = np.diag([1.0, -1.0, -1.0])
    pose = np.eye(4)
    pose[:3, :3] = turn
    pose[:3, 3] = -turn @ np.array([0.02, 0.02, HEIGHT])
    matrix = np.array([[FOCAL, 0.0, 199.5], [0.0, FOCAL, 149.5], [0.0, 0.0, 1.0]])
    return Camera(name, SIZE, matrix, np.zeros(5), pose)


@pytest.fixture
def seen(cube_session):
    """The session with a picture of camera a, and the rig."""
    grey = np.full(SIZE[::-1], 90, dtype=np.uint8)
    grey[0, 0] = 200
    Image.fromarray(grey).save(cube_session / "rest_a.png")
    return read_session(cube_session), Rig((camera("a"), camera("b")), 0, "here")


def orange(picture):
    """Pixels of arrows: rows and columns."""
    return np.argwhere((picture[..., 0] > 180) & (picture[..., 2] < 60))


def test_arrows_go_where_the_points_went(seen, cube_session):
    session, rig = seen
    (shown,) = shown_probings(read_subject(cube_session))
    picture = camera_picture(session, rig, 0, "rest_{camera}.png", flow=shown, magnification=10.0)
    assert picture.shape == (300, 400, 3)
    drawn = orange(picture)
    # Every point goes 0.3 mm along x and 0.4 mm down, drawn ten times: along the columns by focal
    # length over distance, toward the middle as it gets farther away.
    distance = HEIGHT - 0.04
    reach = 0.02 * FOCAL / distance
    way = 10.0 * 3e-4 * FOCAL / distance
    assert abs(drawn[:, 1].min() - (199.5 - reach)) < 8.0
    assert 199.5 + reach < drawn[:, 1].max() < 199.5 + reach + way + 6.0
    assert len(drawn) > 50
    # Half as far drawn: half of the way less along the columns, and it ends a little farther out.
    less = orange(
        camera_picture(session, rig, 0, "rest_{camera}.png", flow=shown, magnification=5.0)
    )
    assert 4.0 <= drawn[:, 1].max() - less[:, 1].max() <= 0.5 * way + 1.0


def test_without_a_measurement_there_are_no_arrows(seen):
    session, rig = seen
    assert not len(orange(camera_picture(session, rig, 0, "rest_{camera}.png")))


def test_a_picture_that_is_not_there_is_none(seen):
    session, rig = seen
    assert camera_picture(session, rig, 1, "rest_{camera}.png") is None


def test_the_view_from_a_camera_is_its_own():
    turn, position, fov = camera_view_pose(camera("a"))
    np.testing.assert_allclose(position, [20.0, 20.0, 1e3 * HEIGHT], atol=1e-9)
    # Half a turn about x: it looks down.
    np.testing.assert_allclose(np.abs(turn), [0.0, 1.0, 0.0, 0.0], atol=1e-9)
    assert np.tan(0.5 * fov) == pytest.approx(150.0 / FOCAL)


def test_probings_at_one_place_have_one_label():
    here, there = np.zeros(3), np.array([10.0, 0.0, 0.0])
    starts = {"a": (here, ""), "b": (here + 0.1, "b: 2 N"), "c": (there, "")}
    (first, position), (second, _) = merged_labels(starts, 1.0)
    assert (first, second) == ("b: 2 N and 1 more", "c")
    np.testing.assert_array_equal(position, here)


def test_the_rms_difference_has_a_fitting_unit(cube_session):
    (shown,) = shown_probings(read_subject(cube_session))
    field = np.full_like(shown.points, 2e-3)
    fitted = replace(shown, displacement=field, predicted=0 * field, weight=np.ones_like(field))
    # The square root of three times 2 mm.
    assert rms_text(fitted).endswith(": 3.46 mm")
    assert rms_text(replace(fitted, predicted=0.999 * field)).endswith(": 3.46 µm")


def test_the_cross_is_where_the_constants_are():
    nu, modulus = np.linspace(0.1, 0.4, 31), np.linspace(1.6e4, 2.4e4, 41)
    deviance = ((nu - 0.25) / 0.05)[:, None] ** 2 + ((modulus - 2e4) / 1e3)[None] ** 2
    plot = LikelihoodPlot(LikelihoodMap(nu, modulus, deviance))
    centres = [orange(plot.marked(*pair)).mean(axis=0) for pair in ((0.25, 2e4), (0.3, 2.1e4))]
    # Up and to the right, a sixth of the axes' width and an eighth of their height.
    assert centres[1][1] > centres[0][1] + 20
    assert centres[1][0] < centres[0][0] - 20
    # The middle of the likely region is its darkest: the cross stands on blue.
    row, column = centres[0].astype(int)
    around = plot.marked(0.1, 1.6e4)[row, column]
    assert around[2] > around[0] + 40
