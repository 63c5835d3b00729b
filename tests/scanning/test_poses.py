"""Poses of views that nobody gave: found where the shape tells them, refused where it does not."""

import numpy as np
import pytest
from broken_surfaces import ball, made
from scan_views import camera_at, toy, views_around
from scipy.spatial.transform import Rotation

from palpate.errors import InputError
from palpate.progress import silent
from palpate.scanning import poses
from palpate.scanning.poses import posed


@pytest.mark.slow
def test_a_round_of_views_finds_its_poses():
    count = 9
    views = views_around(toy(), count, known=False)
    placed = posed(views)
    first = camera_at(0.0).T_camera_object
    for k, view in enumerate(placed):
        T_camera_object = camera_at(2.0 * np.pi * k / count).T_camera_object
        expected = first @ np.linalg.inv(T_camera_object)
        position = views[k].points @ expected[:3, :3].T + expected[:3, 3]
        turn, _ = Rotation.align_vectors(
            view.points - view.points.mean(axis=0), position - position.mean(axis=0)
        )
        # 1500 points of 0.05 mm on each view, the chain closed: a tenth of the limits of a bench.
        assert np.degrees(turn.magnitude()) < 0.06
        assert np.linalg.norm(view.points.mean(axis=0) - position.mean(axis=0)) < 6e-5


@pytest.mark.slow
def test_errors_of_a_chain_are_taken_back_by_the_loop():
    views = views_around(toy(), 9)
    clouds = [poses._cloud(view, 2000) for view in views]
    true = [view.T_object_view for view in views]
    rng = np.random.default_rng(0)
    off = [np.eye(4) for _ in views]
    for pose in off[1:]:
        pose[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, np.radians(0.3), 3)).as_matrix()
        pose[:3, 3] = rng.normal(0.0, 2e-4, 3)
    start = [true[0], *(a @ b for a, b in zip(off[1:], true[1:], strict=True))]
    adjusted = poses._adjusted(clouds, start, progress=silent)
    for pose, expected in zip(adjusted, true, strict=True):
        turn = Rotation.from_matrix(pose[:3, :3] @ expected[:3, :3].T)
        # A tenth of the 0.3 degrees that each was off.
        assert np.degrees(turn.magnitude()) < 0.05


@pytest.mark.slow
def test_a_ball_does_not_tell_how_it_was_turned():
    with pytest.raises(InputError, match="the shape does not fix how view 'v01' lies"):
        posed(views_around(made(ball(0.04, (0.0, 0.0, 0.03), fine=4)), 9, known=False, seen=3))


def test_views_from_opposite_sides_do_not_overlap():
    views = views_around(toy(), 9, known=False)
    with pytest.raises(InputError, match=r"'v00' and 'v05' do not overlap: \d+ % of"):
        posed([views[0], views[5]])
