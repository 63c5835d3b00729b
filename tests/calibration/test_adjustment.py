"""Bundle adjustment: exact corners, honest sigmas, gross errors, views that are too alike."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.boards import SIZE, board_points, bundle_errors, seen_corners, true_bundle
from palpate.calibration.adjustment import Adjusted, Bundle, Corners, adjust, seen_points
from palpate.errors import CalibrationError
from palpate.records import Camera, camera_matrix
from palpate.vision import project


def _start(truth: Bundle, rng: np.random.Generator) -> Bundle:
    """As far off as a calibration of each camera alone."""
    view = truth.view.copy()
    turn = Rotation.from_rotvec(0.02 * rng.normal(size=(len(view), 3))).as_matrix()
    view[:, :3, :3] = turn @ view[:, :3, :3]
    view[:, :3, 3] += 0.005 * rng.normal(size=(len(view), 3))
    intrinsics = truth.intrinsics.copy()
    intrinsics[:, :4] *= 1.0 + 0.02 * rng.normal(size=(len(intrinsics), 4))
    intrinsics[:, 4:] = 0.0
    return Bundle(intrinsics, truth.camera, view)


def test_pixels_are_those_of_the_camera_model() -> None:
    """Projected by the code that the flow uses, which was written apart from this."""
    rng = np.random.default_rng(0)
    truth = true_bundle(rng)
    camera = Camera(
        "c", SIZE, camera_matrix(truth.intrinsics[1, :4]), truth.intrinsics[1, 4:], truth.camera[1]
    )
    points = rng.uniform(-0.05, 0.05, (50, 3)) + np.array([0.0, 0.0, 0.3])
    position = points @ truth.camera[1, :3, :3].T + truth.camera[1, :3, 3]
    pixel, _, _ = seen_points(truth.intrinsics[1], position)
    np.testing.assert_allclose(pixel, project(camera, points), atol=1e-9)


def test_derivatives_are_differences() -> None:
    rng = np.random.default_rng(1)
    intrinsics = true_bundle(rng).intrinsics[0]
    points = rng.uniform(-0.05, 0.05, (20, 3)) + np.array([0.0, 0.0, 0.3])
    _, by_intrinsics, by_point = seen_points(intrinsics, points)
    for k in range(9):
        step = np.eye(9)[k] * 1e-6 * max(abs(intrinsics[k]), 1.0)
        ends = [seen_points(intrinsics + side * step, points)[0] for side in (1.0, -1.0)]
        slope = (ends[0] - ends[1]) / (2.0 * step[k])
        # Rounding of pixels near 1e3 over the step.
        np.testing.assert_allclose(by_intrinsics[:, :, k], slope, atol=1e-5)
    for k in range(3):
        step = 1e-7 * np.eye(3)[k]
        ends = [seen_points(intrinsics, points + side * step)[0] for side in (1.0, -1.0)]
        np.testing.assert_allclose(
            by_point[:, :, k], (ends[0] - ends[1]) / 2e-7, rtol=1e-6, atol=1e-2
        )


def test_exact_corners_give_the_rig() -> None:
    rng = np.random.default_rng(2)
    truth = true_bundle(rng, cameras=2, views=8)
    corners = seen_corners(truth, board_points(), rng, noise=0.0)
    adjusted = adjust(_start(truth, rng), corners)
    # The last step is short against the noise, which is none: 1e-9 px.
    assert np.abs(adjusted.residual).max() < 1e-6
    np.testing.assert_allclose(
        adjusted.bundle.intrinsics[:, :4], truth.intrinsics[:, :4], rtol=1e-7
    )
    np.testing.assert_allclose(adjusted.bundle.camera, truth.camera, atol=1e-8)


def _adjusted(seed: int, **options: int) -> tuple[Adjusted, Bundle, Corners]:
    rng = np.random.default_rng(seed)
    truth = true_bundle(rng, **options)
    corners = seen_corners(truth, board_points(), rng, noise=0.1)
    return adjust(_start(truth, rng), corners), truth, corners


def test_errors_are_as_large_as_the_covariance_says() -> None:
    """Mean of the squared error in its own metric: chi-squared over its degrees of freedom."""
    ratios = []
    for seed in range(6):
        adjusted, truth, _ = _adjusted(seed, cameras=2, views=10)
        error = bundle_errors(adjusted.bundle, truth)
        ratios.append(error @ np.linalg.solve(adjusted.covariance, error) / len(error))
        np.testing.assert_allclose(adjusted.noise, 0.1, rtol=0.1)
    # 6 x 84 degrees of freedom: a standard deviation of sqrt(2 / 504) = 0.063.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.25)


def test_gross_errors_have_no_say() -> None:
    rng = np.random.default_rng(5)
    truth = true_bundle(rng, cameras=2, views=10)
    corners = seen_corners(truth, board_points(), rng, noise=0.1)
    wrong = rng.random(len(corners.pixel)) < 0.02
    pixel = corners.pixel + np.where(
        wrong[:, None], rng.uniform(5.0, 20.0, corners.pixel.shape), 0.0
    )
    spoiled = Corners(corners.camera, corners.view, corners.point, pixel)
    adjusted = adjust(_start(truth, rng), spoiled)
    assert not adjusted.good[wrong].any()
    # One in a million of the others.
    assert adjusted.good[~wrong].mean() > 0.995
    np.testing.assert_allclose(adjusted.noise, 0.1, rtol=0.15)


def test_boards_that_all_face_the_camera_are_refused() -> None:
    rng = np.random.default_rng(6)
    truth = true_bundle(rng, cameras=1, views=6)
    view = truth.view.copy()
    view[:, :3, :3] = np.eye(3)
    truth = Bundle(truth.intrinsics, truth.camera, view)
    corners = seen_corners(truth, board_points(), rng, noise=0.0)
    with pytest.raises(CalibrationError, match="too alike"):
        adjust(truth, corners)
