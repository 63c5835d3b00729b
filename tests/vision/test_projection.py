"""Projection, its Jacobian and its inverse, against OpenCV and laws."""

import cv2
import numba
import numpy as np
import pytest
from vision_cameras import BARREL, RATIONAL, REAL, make_camera, moved, terms

from palpate.errors import InputError
from palpate.records import Camera, Rig, lens_radius_limit
from palpate.vision.projection import (
    camera_sigma,
    jacobian_kernel,
    normalised,
    packed_camera,
    packed_rig,
    pixel_grid,
    project,
    project_jacobian,
    project_kernel,
    rays,
)

LENSES = {
    "none": (),
    "barrel": BARREL,
    "pincushion": (0.25, 0.1, -1e-3, 5e-4, 0.05),
    "rational": RATIONAL,
    "real": REAL,
}
SINGLE = [tuple(0.08 * (i == k) for i in range(8)) for k in range(8)]
GRID_SHAPE = (48, 64)
GRID_LENSES = {
    "none": [],
    "barrel": [-0.3, 0.1, 2e-3, -1e-3, 0.02],
    "cushion": [0.4, 0.1],
    "rational": [-0.3, 0.1, 2e-3, -1e-3, 0.02, 0.05, 0.01, -0.02],
    "tangential": [0.0, 0.0, 5e-3, -4e-3],
}


def _points(count=200, half=0.12, seed=0):
    return np.random.default_rng(seed).uniform(-half, half, (count, 3))


def _grid(camera, step=7):
    columns, rows = camera.size
    column, row = np.meshgrid(np.arange(0.0, columns, step), np.arange(0.0, rows, step))
    return np.stack([column.ravel(), row.ravel()], axis=1)


def _opencv(camera, points):
    """OpenCV's projection; it passes over the skew, which is added."""
    pose, k = camera.T_camera_object, camera.matrix
    turn = cv2.Rodrigues(pose[:3, :3])[0]
    pixels = cv2.projectPoints(points, turn, pose[:3, 3], k, camera.distortion)[0][:, 0]
    pixels[:, 0] += k[0, 1] / k[1, 1] * (pixels[:, 1] - k[1, 2])
    return pixels


@pytest.mark.parametrize("lens", [*LENSES.values(), *SINGLE])
def test_projection_is_opencvs(lens):
    camera, points = make_camera(lens=lens), _points()
    # Both in double precision, pixels of some 500: rounding is 1e-12.
    np.testing.assert_allclose(project(camera, points), _opencv(camera, points), atol=1e-10)


def test_kernel_projects_as_the_arrays_do():
    camera, points = make_camera(lens=RATIONAL), _points(20)
    packed = packed_rig(Rig((camera, make_camera("c1")), 0, "here"))[0]
    np.testing.assert_array_equal(packed, packed_camera(camera))
    pixels = [project_kernel(packed, *point) for point in points]
    np.testing.assert_allclose(pixels, project(camera, points), atol=1e-10)  # rounding


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_jacobian_is_the_finite_difference(lens):
    camera, points = make_camera(lens=lens), _points(50)
    pixels, jacobian = project_jacobian(camera, points)
    np.testing.assert_allclose(pixels, project(camera, points), atol=1e-10)  # rounding
    h = 1e-5
    steps = [
        (project(camera, points + h * axis) - project(camera, points - h * axis)) / (2 * h)
        for axis in np.eye(3)
    ]
    # Central differences: truncation h^2 / 6 times third derivatives of order 1e5, rounding 1e-8.
    np.testing.assert_allclose(jacobian, np.stack(steps, axis=-1), atol=1e-4)
    assert np.abs(jacobian).max() > 1e3


@pytest.mark.parametrize("lens", [*LENSES.values(), *SINGLE])
def test_forward_and_inverse_agree_everywhere_in_the_picture(lens):
    # The real lens is a long one: at 900 px it would fold over within the picture.
    camera = make_camera(lens=lens, focal=6640.0 if lens == REAL else 900.0)
    pixels = _grid(camera)
    origin, direction = rays(camera, pixels)
    back = project(camera, origin + 0.7 * direction)
    # What the issue asks for.
    np.testing.assert_allclose(back, pixels, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(direction, axis=1), 1.0, atol=1e-14)


@pytest.mark.parametrize("lens", [BARREL, RATIONAL, SINGLE[2], SINGLE[3]])
def test_inverse_is_opencvs(lens):
    camera = make_camera(lens=lens, skew=0.0)
    pixels = _grid(camera, step=31)
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)
    theirs = cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion, criteria=stop)[
        :, 0
    ]
    # Their fixed point stops at some 1e-9.
    np.testing.assert_allclose(normalised(camera, pixels), theirs, atol=1e-8)


def test_ray_of_a_pixel_passes_through_the_point_it_shows():
    camera, points = make_camera(lens=RATIONAL), _points()
    origin, direction = rays(camera, project(camera, points))
    np.testing.assert_allclose(camera.T_camera_object @ [*origin, 1.0], [0, 0, 0, 1], atol=1e-15)
    away = np.cross(points - origin, direction)
    np.testing.assert_allclose(away, 0.0, atol=1e-14)  # rounding of 0.6 m
    assert (np.einsum("na,na->n", points - origin, direction) > 0.0).all()


def test_moving_the_object_frame_changes_nothing():
    camera, points = make_camera(lens=RATIONAL), _points()
    motion = np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(np.array([1.0, -2.0, 0.5]))[0]
    motion[:3, 3] = [0.3, -0.1, 0.2]
    other = moved(camera, motion)
    there = points @ motion[:3, :3].T + motion[:3, 3]
    np.testing.assert_allclose(project(other, there), project(camera, points), atol=1e-10)
    turned = project_jacobian(other, there)[1] @ motion[:3, :3]
    np.testing.assert_allclose(turned, project_jacobian(camera, points)[1], atol=1e-8)


def test_reach_of_a_barrel_is_the_closed_form():
    """r + k1 r^3 stops to rise at r^2 = 1 / (3 |k1|), where it is 2 r / 3."""
    for k1 in (-0.5, -0.07):
        assert lens_radius_limit(terms((k1,))) == pytest.approx((-3.0 * k1) ** -0.5)
    # 1 / (1 + k4 r^2) with k4 < 0 has its pole at r^2 = 1 / |k4|.
    assert lens_radius_limit(np.array([0, 0, 0, 0, 0, -0.04, 0, 0.0])) == pytest.approx(5.0)
    assert lens_radius_limit(np.zeros(8)) == np.inf
    assert lens_radius_limit(np.array([0, 0, 0, 0, -1e-310, 0, 0, 1e-320])) == np.inf
    assert lens_radius_limit(np.array([0.2, 0.1, 0, 0, 0.1, 0, 0, 0])) == np.inf


def test_beyond_the_fold_there_is_no_ray_and_no_pixel():
    k1 = -0.5
    reach = (-3.0 * k1) ** -0.5
    camera = Camera("c0", None, np.diag([100.0, 100.0, 1.0]), terms((k1,)), np.eye(4))
    inside, outside = 0.999, 1.001
    pixels = 100.0 * 2.0 / 3.0 * reach * np.array([[inside, 0.0], [0.0, outside]])
    direction_back = normalised(camera, pixels)
    assert 0.9 * reach < direction_back[0, 0] < reach
    assert np.isnan(direction_back[1]).all()
    points = np.array([[reach * inside, 0.0, 1.0], [reach * outside, 0.0, 1.0]])
    seen, jacobian = project_jacobian(camera, points)
    np.testing.assert_array_equal(np.isnan(seen).any(axis=1), [False, True])
    np.testing.assert_array_equal(np.isnan(project(camera, points)).any(axis=1), [False, True])
    np.testing.assert_array_equal(np.isnan(jacobian).any(axis=(1, 2)), [False, True])


def test_inverse_stays_on_the_branch_of_the_axis():
    """k1 < 0 < k2 folds twice: the same radius is reached on two rising branches."""
    lens = np.array([-0.9, 0.35, 0, 0, 0, 0, 0, 0.0])
    reach = lens_radius_limit(lens)
    camera = Camera("c0", None, np.diag([500.0, 500.0, 1.0]), lens, np.eye(4))
    radius = np.linspace(0.0, 0.99 * reach, 40)
    pixel = 500.0 * radius * (1.0 - 0.9 * radius**2 + 0.35 * radius**4)
    angle = np.linspace(0.0, 6.0, 40)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    direction_back = normalised(camera, pixel[:, None] * direction)
    # Near the fold 1e-13 in the picture is some 1e-11 in the ray.
    np.testing.assert_allclose(direction_back, radius[:, None] * direction, atol=1e-10)
    beyond = 500.0 * np.array([[1.1 * pixel.max() / 500.0, 0.0]])
    assert np.isnan(normalised(camera, beyond)).all()


def test_what_is_not_seen_is_nan():
    camera = make_camera(turn=(0, 0, 0), shift=(0, 0, 0.5), lens=BARREL)
    points = np.array([[0.0, 0.0, -0.4], [0.0, 0.0, -0.5], [0.01, 0.02, -0.6], [np.nan, 0, 0]])
    for pixels in (project(camera, points), project_jacobian(camera, points)[0]):
        np.testing.assert_array_equal(np.isnan(pixels).any(axis=1), [False, True, True, True])
    pixels = np.array([[np.nan, 3.0], [300.0, 200.0]])
    for lens in ((), BARREL):
        flat = normalised(make_camera(lens=lens), pixels)
        np.testing.assert_array_equal(np.isnan(flat).any(axis=1), [True, False])
    assert project(camera, np.zeros((0, 3))).shape == (0, 2)


def test_principal_point_of_a_tangential_lens():
    """There the distorted place is 0, which is a ray along the axis and no division by zero."""
    camera = make_camera(lens=(0.1, 0.0, 1e-3, 2e-3), turn=(0, 0, 0), shift=(0, 0, 1.0))
    centre = camera.matrix[:2, 2][None]
    np.testing.assert_allclose(normalised(camera, centre), 0.0, atol=1e-15)


def test_any_number_of_threads_gives_the_same():
    camera = make_camera(lens=RATIONAL)
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append(normalised(camera, _grid(camera)))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(*results)


def test_sigma_of_a_camera_is_that_of_its_own_axes():
    camera = make_camera(turn=(0.3, -0.7, 0.2))
    sigma = np.array([3.0, 1.0, 5.0])
    turn = camera.T_camera_object[:3, :3]
    covariance = (turn.T @ np.diag(sigma**2) @ turn)[None]
    lateral, depth = camera_sigma(covariance, camera)
    np.testing.assert_allclose(lateral, np.sqrt((9.0 + 1.0) / 2.0), rtol=1e-12)
    np.testing.assert_allclose(depth, 5.0, rtol=1e-12)


@pytest.mark.parametrize("lens", [(), BARREL, RATIONAL])
def test_single_point_jacobian_says_where_the_point_lies_too(lens):
    camera, points = make_camera(lens=lens), _points(20)
    pixels, jacobians = project_jacobian(camera, points)
    pose = camera.T_camera_object
    x, y, z = (points @ pose[:3, :3].T + pose[:3, 3]).T
    flat = np.stack([x / z, y / z], axis=1)
    h = 1e-5
    slope = np.stack(
        [(_distortion(camera, flat + h * e) - _distortion(camera, flat - h * e)) / (2 * h)
         for e in np.eye(2)], axis=2,
    )  # fmt: skip
    for i, point in enumerate(points):
        jacobian = np.empty((2, 3))
        *pixel, depth, square, area = jacobian_kernel(packed_camera(camera), *point, jacobian)
        np.testing.assert_allclose(pixel, pixels[i], atol=1e-10)
        np.testing.assert_array_equal(jacobian, jacobians[i])
        assert depth == pytest.approx(z[i], rel=1e-12)
        assert square == pytest.approx((flat[i] ** 2).sum(), rel=1e-12)
        # Central differences leave h^2 / 6 times third derivatives of order one, rounding 1e-11.
        assert area == pytest.approx(np.linalg.det(slope[i]), abs=1e-8)


def _distortion(camera, flat):
    """OpenCV's distorted places of (x / z, y / z), the camera matrix left out."""
    points = np.column_stack([flat, np.ones(len(flat))])
    zero = np.zeros(3)
    return cv2.projectPoints(points, zero, zero, np.eye(3), camera.distortion)[0][:, 0]


def _camera(lens, *, focal=70.0, centre=(31.2, 24.3), skew=0.4, size=GRID_SHAPE[::-1]):
    terms = np.zeros(8)
    terms[: len(lens)] = lens
    matrix = np.array([[focal, skew, centre[0]], [0.0, 1.05 * focal, centre[1]], [0.0, 0.0, 1.0]])
    return Camera("c0", size, matrix, terms, np.eye(4))


@pytest.mark.parametrize("lens", GRID_LENSES.values(), ids=GRID_LENSES.keys())
@pytest.mark.parametrize("centre", [(31.2, 24.3), (-12.0, 60.0), (90.0, -5.0)])
def test_opencv_projects_the_rays_onto_their_pixels(lens, centre):
    camera = _camera(lens, centre=centre, focal=120.0, skew=0.0)
    x, y = pixel_grid(camera, GRID_SHAPE).reshape(2, -1)
    points = np.stack([x, y, np.ones_like(x)], axis=1)
    zero = np.zeros(3)
    pixel = cv2.projectPoints(points, zero, zero, camera.matrix, camera.distortion)[0]
    column, row = np.meshgrid(np.arange(64.0), np.arange(48.0))
    truth = np.stack([column, row], axis=-1).reshape(-1, 1, 2)
    np.testing.assert_allclose(pixel, truth, atol=1e-9)


@pytest.mark.parametrize(
    ("lens", "square", "focal"),
    [
        ([-0.3], 1.0 / 0.9, 30.0),
        # Rises again farther out: those rays reach pixels within the picture a second time.
        ([-0.6, 0.15], (1.8 - np.sqrt(0.24)) / 1.5, 15.0),
    ],
)
def test_pixels_that_no_ray_reaches_are_nan_and_no_others(lens, square, focal):
    """The lens folds over where the derivative of r (1 + k1 r^2 + k2 r^4) is zero."""
    camera = _camera(lens, focal=focal, skew=0.0)
    grid = pixel_grid(camera, GRID_SHAPE)
    column, row = np.meshgrid(np.arange(64.0), np.arange(48.0))
    distorted = np.hypot((column - 31.2) / focal, (row - 24.3) / (1.05 * focal))
    terms = np.polyval([*lens[::-1], 1.0], square)
    np.testing.assert_array_equal(np.isnan(grid[0]), distorted > np.sqrt(square) * terms)
    assert 300 < np.isnan(grid[0]).sum() < 2900
    # What is seen lies before the fold, at the radius that the lens takes to the pixel's.
    radius = np.hypot(*grid)[np.isfinite(grid[0])]
    assert radius.max() < np.sqrt(square)
    forward = radius * np.polyval([*lens[::-1], 1.0], radius**2)
    np.testing.assert_allclose(forward, distorted[np.isfinite(grid[0])], atol=1e-12)


def test_small_pictures_and_other_sizes():
    camera = _camera(GRID_LENSES["barrel"], size=None)
    whole = pixel_grid(camera, GRID_SHAPE)
    for shape in ((1, 1), (1, 9), (7, 1), (29, 37)):
        np.testing.assert_allclose(
            pixel_grid(camera, shape), whole[:, : shape[0], : shape[1]], atol=1e-12
        )
    with pytest.raises(InputError, match="camera 'c0' has 64 x 48 pixels; asked for 37 x 29"):
        pixel_grid(_camera([]), (29, 37))
