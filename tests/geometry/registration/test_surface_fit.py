"""Distances from a surface and their derivatives, and the scaling of motions."""

import numpy as np
from surfaces import box, sphere

from palpate.geometry import closest_points
from palpate.geometry.closest_point import surface_search
from palpate.geometry.registration.surface_fit import (
    MeasuredPoints,
    fit_pose,
    linearised,
    motion_pose,
    motion_scale,
    null_space_basis,
    placed,
)


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
    own = placed(np.linalg.inv(pose), points)
    at = linearised(surface_search(mesh), MeasuredPoints(own, covariance), pose)
    # x of the points points along -z of the mesh.
    np.testing.assert_allclose(at.sigma, [2e-4, 2e-4, 0.0, 0.0], atol=1e-6)


def test_a_step_is_a_tenth_of_the_object_at_most():
    """From far away, across faces of a small box: the nearest points there are others anyway."""
    mesh = box((0.01, 0.02, 0.02))
    points = np.random.default_rng(3).normal(size=(200, 3))
    points = 0.01 * points / np.abs(points).max(axis=1, keepdims=True) + [0.04, 0.01, 0.01]
    fit = fit_pose(
        surface_search(mesh),
        _measured(points),
        np.eye(4),
        constraints=np.zeros((0, 6)),
        iterations=1,
    )
    moved = placed(fit.pose, points) - points
    # The scaled motions move the points by their length, but for the square of the turn.
    rms = np.sqrt((moved**2).sum(axis=1).mean())
    np.testing.assert_allclose(rms, 0.1 * 0.03, rtol=0.02)
