"""Fits of the pose of points on a surface, and the coarse search before them."""

import numpy as np
from scipy.spatial.transform import Rotation
from surfaces import box, sphere

from palpate.geometry import closest_points
from palpate.geometry.closest_point import surface_search
from palpate.geometry.surface_fit import (
    MeasuredPoints,
    _nearest_of_the_best,
    coarse_pose,
    compact_groups,
    even_sample,
    facing_surface,
    fit_pose,
    linearised,
    motion_pose,
    motion_scale,
    null_space_basis,
    placed,
)

SIZE = np.array([0.07, 0.045, 0.02])


def _measured(points):
    return MeasuredPoints(points, np.zeros((len(points), 3, 3)))


def test_scaled_motions_move_points_by_one_metre_rms_and_independently():
    rng = np.random.default_rng(0)
    offset = rng.normal(size=(500, 3)) * [3.0, 1.0, 0.2]
    offset -= offset.mean(axis=0)
    scale = motion_scale(offset)
    moves = np.stack([np.cross(motion[:3], offset) + motion[3:] for motion in scale.T]).reshape(
        6, -1
    )
    np.testing.assert_allclose(moves @ moves.T / 500.0, np.eye(6), atol=1e-12)


def test_derivatives_are_those_of_the_distance_also_beyond_edges():
    """Central differences of the exact distance, outside a box: faces, edges and corners."""
    rng = np.random.default_rng(1)
    mesh = box((1.0, 2.0, 3.0))
    points = rng.uniform(-0.6, 3.6, size=(400, 3))
    points = points[((points < -0.05) | (points > np.array([1.05, 2.05, 3.05]))).any(axis=1)]
    at = linearised(surface_search(mesh), _measured(points), np.eye(4))
    np.testing.assert_allclose(at.residual, closest_points(mesh, points).distance, atol=1e-12)
    beyond = (np.abs(at.normal).max(axis=1) < 0.99).sum()
    assert beyond > 100
    step = 1e-5
    for k, motion in enumerate(at.scale.T):
        ends = [
            closest_points(mesh, placed(motion_pose(side * step * motion, at.centre), points))
            for side in (1.0, -1.0)
        ]
        slope = (ends[0].distance - ends[1].distance) / (2.0 * step)
        # Second differences of a distance of 0.05 and more: step^2 / 0.05, and rounding.
        np.testing.assert_allclose(at.row[:, k], slope, atol=1e-7)


def test_points_inside_have_a_negative_distance():
    at = linearised(surface_search(sphere(2)), _measured(0.9 * sphere(1).vertices), np.eye(4))
    assert (at.residual < 0.0).all()


def test_held_combinations_stay_at_zero():
    rng = np.random.default_rng(2)
    constraints = rng.normal(size=(2, 6))
    basis = null_space_basis(constraints)
    assert basis.shape == (6, 4)
    np.testing.assert_allclose(constraints @ basis, 0.0, atol=1e-12)
    np.testing.assert_allclose(basis.T @ basis, np.eye(4), atol=1e-12)
    assert null_space_basis(np.zeros((0, 6))).shape == (6, 6)


def test_expected_noise_is_that_across_the_surface_at_the_pose():
    """Noise along one axis of the points' frame, turned with them by the pose."""
    mesh = box((1.0, 1.0, 1.0))
    points = np.array([[0.5, 0.5, 1.0], [0.2, 0.7, 1.0], [1.0, 0.4, 0.4], [1.0, 0.6, 0.3]])
    covariance = np.broadcast_to(np.diag([4.0, 0.0, 0.0]) * 1e-8, (4, 3, 3)).copy()
    pose = motion_pose(np.array([0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, 0.0]), np.zeros(3))
    in_own_frame = placed(np.linalg.inv(pose), points)
    at = linearised(surface_search(mesh), MeasuredPoints(in_own_frame, covariance), pose)
    # x of the points points along -z of the mesh.
    np.testing.assert_allclose(at.sigma, [2e-4, 2e-4, 0.0, 0.0], atol=1e-6)


def test_a_step_is_a_tenth_of_the_object_at_most():
    """From far away, across faces of a small box: the nearest points there are others anyway."""
    mesh = box((0.01, 0.02, 0.02))
    points = np.random.default_rng(3).normal(size=(200, 3))
    points = 0.01 * points / np.abs(points).max(axis=1, keepdims=True) + [0.04, 0.01, 0.01]
    pose, _, _ = fit_pose(
        surface_search(mesh),
        _measured(points),
        np.eye(4),
        constraints=np.zeros((0, 6)),
        iterations=1,
    )
    moved = placed(pose, points) - points
    # The scaled motions move the points by their length, but for the square of the turn.
    rms = np.sqrt((moved**2).sum(axis=1).mean())
    np.testing.assert_allclose(rms, 0.1 * 0.03, rtol=0.02)


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
        fitted_pose = coarse_pose(search, moved, np.eye(4), angle=np.radians(5.0), distance=0.02)
        back = moved @ fitted_pose[:3, :3].T + fitted_pose[:3, 3]
        # A hundredth of the diagonal is 0.9 mm.
        assert np.linalg.norm(back - points, axis=1).max() < 9e-4


def test_a_good_guess_is_returned_as_it_is():
    start = np.eye(4)
    start[:3, 3] = 1e-4
    points = _faces(50, np.random.default_rng(1))
    pose = coarse_pose(surface_search(box(SIZE)), points, start, angle=1e-4, distance=1e-4)
    np.testing.assert_array_equal(pose, start)


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
