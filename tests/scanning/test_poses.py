"""Poses of views that nobody gave: found where the shape tells them, refused where it does not."""

import numpy as np
import pytest
from broken_surfaces import ball, made
from scan_views import camera_at, toy, views_around
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.scanning.joining import posed


def test_a_round_of_views_finds_its_poses():
    count = 9
    views = views_around(toy(), count, known=False)
    found = posed(views)
    first = camera_at(0.0).T_camera_object
    for k, view in enumerate(found):
        own = camera_at(2.0 * np.pi * k / count).T_camera_object
        expected = first @ np.linalg.inv(own)
        place = views[k].points @ expected[:3, :3].T + expected[:3, 3]
        turn, _ = Rotation.align_vectors(
            view.points - view.points.mean(axis=0), place - place.mean(axis=0)
        )
        # 1500 points of 0.05 mm on each view, the chain closed: a tenth of the limits of a bench.
        assert np.degrees(turn.magnitude()) < 0.06
        assert np.linalg.norm(view.points.mean(axis=0) - place.mean(axis=0)) < 6e-5


def test_a_ball_does_not_tell_how_it_was_turned():
    with pytest.raises(InputError, match="the shape does not fix how view 'v01' lies"):
        posed(views_around(made(ball(0.04, (0.0, 0.0, 0.03), fine=4)), 9, known=False)[:3])


def test_views_from_opposite_sides_do_not_overlap():
    views = views_around(toy(), 9, known=False)
    with pytest.raises(InputError, match=r"'v00' and 'v05' do not overlap: \d+ % of"):
        posed([views[0], views[5]])
