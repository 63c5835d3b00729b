"""The search for a rough pose, and the even groups and samples of points."""

import numpy as np
from scipy.spatial.transform import Rotation
from surfaces import box

from palpate.geometry.closest_point import surface_search
from palpate.geometry.registration.coarse_pose import (
    _nearest_of_the_best,
    coarse_pose,
    compact_groups,
    even_sample,
    facing_surface,
)

SIZE = np.array([0.07, 0.045, 0.02])


def _faces(count, rng):
    """Points of the three faces of a flat box that meet in its far corner."""
    points = rng.uniform(size=(count, 3)) * SIZE
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = SIZE[axis]
    return points


def test_worst_guesses_with_a_table_behind_are_brought_near():
    """A fifth of the points belong to a table below: only a robust norm leaves it there."""
    rng = np.random.default_rng(0)
    search = surface_search(box(SIZE))
    for trial in range(4):
        points = _faces(250, rng)
        points[:50] = rng.uniform(size=(50, 3)) * [0.12, 0.12, 1e-4] + [-0.02, -0.03, -0.012]
        turn, shift = rng.normal(size=(2, 3))
        if trial == 0:  # as thick as the box: its top lies on its bottom
            shift = np.array([0.0, 0.0, -1.0])
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_rotvec(
            np.radians(5.0) * turn / np.linalg.norm(turn)
        ).as_matrix()
        pose[:3, 3] = 0.02 * shift / np.linalg.norm(shift)
        moved = points @ pose[:3, :3].T + pose[:3, 3]
        found = coarse_pose(search, moved, np.eye(4), angle=np.radians(5.0), distance=0.02)
        back = moved @ found[:3, :3].T + found[:3, 3]
        # A hundredth of the diagonal is 0.9 mm.
        assert np.linalg.norm(back - points, axis=1).max() < 9e-4


def test_a_good_guess_is_returned_as_it_is():
    start = np.eye(4)
    start[:3, 3] = 1e-4
    points = _faces(50, np.random.default_rng(1))
    found = coarse_pose(surface_search(box(SIZE)), points, start, angle=1e-4, distance=1e-4)
    np.testing.assert_array_equal(found, start)


def test_groups_are_equal_compact_and_independent_of_the_frame():
    rng = np.random.default_rng(2)
    points = rng.uniform(size=(1024, 3)) * [4.0, 2.0, 0.1]
    label = compact_groups(points, 64)
    count = np.bincount(label)
    assert len(count) == 64
    assert set(count) == {16}
    # 64 groups tile 4 x 2: sides of a third to a half.
    widest = max(np.ptp(points[label == k], axis=0).max() for k in range(64))
    assert widest < 1.0
    turn = Rotation.from_rotvec([0.3, -0.8, 1.2]).as_matrix()
    other = compact_groups(points @ turn.T + 5.0, 64)
    pairs = np.unique(np.stack([label, other]), axis=1)
    assert pairs.shape == (2, 64)


def test_even_samples_cover_what_is_dense_and_what_is_sparse():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(3000, 3))
    chosen = even_sample(points, 256)
    assert len(np.unique(chosen)) == 256
    np.testing.assert_allclose(points[chosen].mean(axis=0), 0.0, atol=0.15)
    np.testing.assert_array_equal(even_sample(points[:100], 256), np.arange(100))


def test_the_side_that_faces_an_eye_is_kept():
    mesh = box(SIZE)
    seen = facing_surface(mesh, np.array([0.03, 0.02, 1.0]), angle=np.radians(1.0))
    centre = seen.vertices[seen.triangles].mean(axis=1)
    np.testing.assert_allclose(centre[:, 2], SIZE[2])
    # From within nothing faces the eye; then nothing is known, and all is kept.
    inside = facing_surface(mesh, 0.5 * SIZE, angle=1e-3)
    assert len(inside.triangles) == len(mesh.triangles)


def test_points_of_another_object_do_not_choose_the_pose():
    """A third of the points lies far off in the right pose; a pose that is moderately wrong for all
    of them has a smaller mean square distance."""
    search = surface_search(box(SIZE))
    right = _faces(300, np.random.default_rng(1))
    right[:100] += [0.0, 0.0, 0.03]
    wrong = _faces(300, np.random.default_rng(2)) + 0.01
    squares = [(search.closest(tried).distance ** 2).mean() for tried in (right, wrong)]
    assert squares[0] > 1.3 * squares[1]
    assert _nearest_of_the_best(search, np.stack([wrong, right]), wrong) == 1
