"""Triangulation against closed forms, OpenCV, Monte Carlo and laws."""

from dataclasses import replace

import cv2
import numba
import numpy as np
import pytest
from vision_cameras import BARREL, RATIONAL, make_camera, moved

from palpate.errors import CalibrationError, InputError
from palpate.records import Camera, Rig, RigCovariance
from palpate.vision import calibration_numbers, space_strains
from palpate.vision.projection import project, project_jacobian
from palpate.vision.triangulation import triangulate

POSES = (
    ((0.1, -0.2, 0.3), (0.01, -0.02, 0.6)),
    ((0.1, 0.2, 0.3), (-0.01, 0.02, 0.65)),
    ((-0.25, 0.0, 0.2), (0.0, 0.03, 0.7)),
    ((0.4, 0.3, -0.1), (0.02, 0.0, 0.5)),
)
LENSES = (RATIONAL, BARREL, (), (0.2, 0.05))
FOCAL, BASE, DEPTH = 1000.0, 0.1, 0.4
MATRIX = np.array([[FOCAL, 0.0, 320.0], [0.0, FOCAL, 240.0], [0.0, 0.0, 1.0]])
# Nearly a point: the gradient of what is measured there, not its mean over a volume.
HERE = np.array([0.0, 0.0, DEPTH]) + 1e-4 * np.random.default_rng(1).uniform(-1, 1, (50, 3))


def _rig(count=3, *, lens=True):
    cameras = [
        make_camera(f"c{i}", turn=turn, shift=shift, lens=LENSES[i] if lens else ())
        for i, (turn, shift) in enumerate(POSES[:count])
    ]
    return Rig(tuple(cameras), 0, "here")


def _points(count=100, seed=1):
    return np.random.default_rng(seed).uniform(-0.05, 0.05, (count, 3))


def _seen(rig, points):
    return np.stack([project(camera, points) for camera in rig.cameras])


@pytest.mark.parametrize("count", [2, 3, 4])
def test_exact_pixels_give_the_exact_points(count):
    rig, points = _rig(count), _points()
    triangulated = triangulate(rig, _seen(rig, points), 0.02)
    # 1e-13 px of rounding times a millimetre per pixel.
    np.testing.assert_allclose(triangulated.point, points, rtol=0.0, atol=1e-12)
    assert triangulated.residual.max() < 1e-10
    assert (triangulated.cameras == count).all()


def test_noisy_pixels_give_opencvs_optimal_points():
    """Two views: OpenCV moves the pixels the least to meet, then intersects the rays."""
    rig = _rig(2, lens=False)
    rng = np.random.default_rng(2)
    pixels = _seen(rig, _points(30)) + rng.normal(0.0, 0.5, (2, 30, 2))
    matrices = [camera.matrix @ camera.T_camera_object[:3] for camera in rig.cameras]
    pose = rig.cameras[1].T_camera_object @ np.linalg.inv(rig.cameras[0].T_camera_object)
    x, y, z = pose[:3, 3]
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    inverse = [np.linalg.inv(camera.matrix) for camera in rig.cameras]
    fundamental = inverse[1].T @ cross @ pose[:3, :3] @ inverse[0]
    met = cv2.correctMatches(fundamental, pixels[0][None], pixels[1][None])
    flat = cv2.triangulatePoints(*matrices, met[0][0].T, met[1][0].T)
    theirs = (flat[:3] / flat[3]).T
    triangulated = triangulate(rig, pixels, 0.5)
    # Their root of a polynomial of degree six is good to 1e-7 m: ours has the smaller residual.
    np.testing.assert_allclose(triangulated.point, theirs, rtol=0.0, atol=2e-7)
    left = ((_seen(rig, theirs) - pixels) ** 2).sum(axis=(0, 2))
    assert (4.0 * triangulated.residual**2 <= left * (1.0 + 1e-12)).all()


@pytest.mark.parametrize("sigma", [2.0, 30.0])
def test_point_is_the_minimum_of_the_weighted_distances(sigma):
    """There the gradient vanishes: one more Gauss-Newton step is rounding.

    With 30 px of noise some steps would raise the cost and are halved; no point is lost.
    """
    rig = _rig(3)
    pixels = _seen(rig, _points()) + np.random.default_rng(9).normal(0.0, sigma, (3, 100, 2))
    triangulated = triangulate(rig, pixels, sigma)
    gradient = np.zeros((100, 3))
    for camera, seen in zip(rig.cameras, pixels, strict=True):
        pixel, jacobian = project_jacobian(camera, triangulated.point)
        gradient += np.einsum("nij,ni->nj", jacobian, seen - pixel) / sigma**2
    step = np.einsum("nij,nj->ni", triangulated.covariance, gradient)
    # The stop, 1e-12 of 0.6 m, times the slow rate of convergence at this much noise.
    np.testing.assert_allclose(step, 0.0, atol=1e-12 * sigma)


def test_covariance_of_parallel_cameras_is_the_closed_form():
    """sd of depth: z^2 sqrt(2) s / (f b); across, z s / (f sqrt(2)), at the middle."""
    f, b, z, s = 900.0, 0.1, 0.8, 0.03
    cameras = tuple(
        make_camera(name, turn=(0, 0, 0), shift=(side * b / 2, 0, z), focal=f, skew=0.0)
        for name, side in (("l", 1.0), ("r", -1.0))
    )
    rig = Rig(cameras, 0, "here")
    triangulated = triangulate(rig, _seen(rig, np.zeros((1, 3))), s)
    sd = np.sqrt(np.diag(triangulated.covariance[0]))
    # The rows of make_camera have 1.01 f; columns at +-b/2 add a term of second order to x: none
    # at the middle, by symmetry.
    wanted = [z * s / (f * np.sqrt(2.0)), z * s / (1.01 * f * np.sqrt(2.0)), z**2 * s / (f * b)]
    wanted[2] *= np.sqrt(2.0)
    np.testing.assert_allclose(sd, wanted, rtol=1e-10)


def test_covariance_is_that_of_many_trials():
    """Pixels with their own anisotropic noise, three cameras with lenses."""
    rig, count = _rig(3), 20_000
    rng = np.random.default_rng(3)
    root = np.array(
        [[[0.2, 0.0], [0.1, 0.05]], [[0.1, 0.0], [0.0, 0.1]], [[0.3, 0.0], [-0.2, 0.1]]]
    )
    spread = np.einsum("cij,ckj->cik", root, root)
    point = np.array([[0.02, -0.03, 0.01]])
    noise = np.einsum("cij,cnj->cni", root, rng.normal(size=(3, count, 2)))
    pixels = _seen(rig, point) + noise
    covariance = np.repeat(spread[:, None], count, axis=1)
    triangulated = triangulate(rig, pixels, covariance)
    whitened = np.linalg.solve(
        np.linalg.cholesky(triangulated.covariance[0]), (triangulated.point - point).T
    )
    # Sampling: variances have a relative sd of sqrt(2 / n), 0.01; four of them.
    np.testing.assert_allclose(np.cov(whitened), np.eye(3), atol=0.04)
    np.testing.assert_allclose(whitened.mean(axis=1), 0.0, atol=0.04)


def test_residual_is_the_noise_less_the_three_unknowns():
    rig, sigma = _rig(4), 0.1
    points = _points(4000)
    noise = np.random.default_rng(4).normal(0.0, sigma, (4, 4000, 2))
    triangulated = triangulate(rig, _seen(rig, points) + noise, sigma)
    # Eight coordinates, three unknowns; sampling sd over 20000 degrees of freedom is 0.5 %.
    mean = np.sqrt((triangulated.residual**2).mean())
    assert mean == pytest.approx(sigma * np.sqrt((8 - 3) / 8), rel=0.02)


def test_one_sigma_is_the_round_covariance():
    rig = _rig(3)
    pixels = _seen(rig, _points(20)) + np.random.default_rng(5).normal(0.0, 0.1, (3, 20, 2))
    round_one = np.broadcast_to(0.3**2 * np.eye(2), (3, 20, 2, 2)).copy()
    first, other = triangulate(rig, pixels, 0.3), triangulate(rig, pixels, round_one)
    np.testing.assert_allclose(first.point, other.point, atol=1e-14)
    np.testing.assert_allclose(first.covariance, other.covariance, rtol=1e-10)


def test_moving_the_object_frame_moves_points_and_covariances():
    rig, points = _rig(3), _points()
    pixels = _seen(rig, points) + np.random.default_rng(6).normal(0.0, 0.1, (3, 100, 2))
    motion = np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(np.array([1.0, -2.0, 0.5]))[0]
    motion[:3, 3] = [0.3, -0.1, 0.2]
    other = Rig(tuple(moved(camera, motion) for camera in rig.cameras), 0, "here")
    first, second = triangulate(rig, pixels, 0.1), triangulate(other, pixels, 0.1)
    turn = motion[:3, :3]
    np.testing.assert_allclose(second.point, first.point @ turn.T + motion[:3, 3], atol=1e-12)
    np.testing.assert_allclose(
        second.covariance, turn @ first.covariance @ turn.T, rtol=1e-6, atol=1e-14
    )
    np.testing.assert_allclose(second.residual, first.residual, atol=1e-10)


def test_order_of_the_cameras_does_not_matter():
    rig = _rig(3)
    pixels = _seen(rig, _points()) + np.random.default_rng(7).normal(0.0, 0.1, (3, 100, 2))
    back = Rig(rig.cameras[::-1], 0, "here")
    first, second = triangulate(rig, pixels, 0.1), triangulate(back, pixels[::-1], 0.1)
    np.testing.assert_allclose(second.point, first.point, atol=1e-12)


def test_cameras_that_do_not_see_a_point_are_left_out():
    rig, points = _rig(3), _points(4)
    pixels = _seen(rig, points)
    pixels[2, 0] = np.nan
    pixels[1:, 1] = np.nan
    pixels[0, 2, 1] = np.nan
    triangulated = triangulate(rig, pixels, 0.1)
    np.testing.assert_array_equal(triangulated.cameras, [2, 1, 2, 3])
    np.testing.assert_allclose(triangulated.point[[0, 2, 3]], points[[0, 2, 3]], atol=1e-12)
    pair = triangulate(Rig(rig.cameras[:2], 0, "here"), pixels[:2], 0.1)
    np.testing.assert_allclose(triangulated.covariance[0], pair.covariance[0], rtol=1e-10)
    for lost in (triangulated.point[1], triangulated.covariance[1], triangulated.residual[1]):
        assert np.isnan(lost).all()


def test_rays_that_meet_behind_a_camera_or_nowhere_give_nan():
    cameras = tuple(
        make_camera(name, turn=(0, 0, 0), shift=(x, 0, 1.0), skew=0.0)
        for name, x in (("l", 0.05), ("r", -0.05))
    )
    rig = Rig(cameras, 0, "here")
    # The left camera sees a point before both cameras farther right: 40 px; behind them, left.
    pixels = np.array([[[340.0, 200.0], [300.0, 200.0], [320.0, 200.0]], [[300.0, 200.0]] * 3])
    pixels[1, 1], pixels[1, 2] = [340.0, 200.0], [320.0, 200.0]
    triangulated = triangulate(rig, pixels, 0.1)
    np.testing.assert_array_equal(np.isnan(triangulated.point).all(axis=1), [False, True, True])
    np.testing.assert_array_equal(np.isnan(triangulated.residual), [False, True, True])
    assert (triangulated.cameras == 2).all()


def test_any_number_of_threads_gives_the_same():
    rig = _rig(3)
    pixels = _seen(rig, _points(500)) + np.random.default_rng(8).normal(0.0, 0.1, (3, 500, 2))
    before = numba.get_num_threads()
    results = []
    try:
        for threads in (1, min(2, numba.config.NUMBA_NUM_THREADS)):
            numba.set_num_threads(threads)
            results.append(triangulate(rig, pixels, 0.1))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(results[0].point, results[1].point)
    np.testing.assert_array_equal(results[0].covariance, results[1].covariance)


def test_bad_input_is_refused():
    rig = _rig(2)
    pixels = _seen(rig, _points(3))
    covariance = np.broadcast_to(np.eye(2), (2, 3, 2, 2)).copy()
    covariance[1, 2] = [[1.0, 2.0], [2.0, 1.0]]
    with pytest.raises(InputError, match=r"point 2 in camera 1 .* must be positive definite"):
        triangulate(rig, pixels, covariance)
    covariance[1, 2] = np.nan
    with pytest.raises(InputError, match="must be positive definite where the pixel"):
        triangulate(rig, pixels, covariance)
    pixels[1, 2] = np.nan
    assert np.isnan(triangulate(rig, pixels, covariance).point[2]).all()


def _pair(turned: np.ndarray | None = None) -> Rig:
    T_object = np.eye(4) if turned is None else turned
    right = np.eye(4)
    right[0, 3] = -BASE
    cameras = [
        Camera(name, (640, 480), MATRIX, np.zeros(5), pose @ T_object)
        for name, pose in (("left", np.eye(4)), ("right", right))
    ]
    return Rig(tuple(cameras), 0, "pair")


def _known(rig: Rig, **variances: float) -> RigCovariance:
    names = [f"{camera}.{t}" for camera in ("left", "right") for t in ["fx", "fy", "cx", "cy"]]
    names += [f"right.{term}" for term in ("rx", "ry", "rz", "tx", "ty", "tz")]
    std = np.array([variances.get(name.replace(".", "_"), 0.0) for name in names])
    return RigCovariance(
        tuple(names), calibration_numbers(rig.cameras, names), np.diag(std**2), "known"
    )


def test_a_longer_base_makes_everything_longer() -> None:
    """All lengths are in proportion to the base."""
    rig = _pair()
    (strain,) = space_strains(rig, _known(rig, right_tx=1e-3 * BASE), HERE)
    # Second differences over a step of half a thousandth.
    np.testing.assert_allclose(strain * np.sign(strain[0, 0]), 1e-3 * np.eye(3), atol=1e-8)


def test_focal_lengths_that_are_wrong_alike_stretch_depth() -> None:
    """z = f b / d and x = z (u - c) / f: only depth goes with the focal length."""
    rig = _pair()
    known = _known(rig)
    same = np.zeros((len(known.names), 1))
    same[[known.names.index(f"{c}.{t}") for c in ("left", "right") for t in ("fx", "fy")]] = 1.0
    known = replace(known, covariance=(1e-3 * FOCAL) ** 2 * same @ same.T)
    (strain,) = space_strains(rig, known, HERE)
    expected = np.diag([0.0, 0.0, 1e-3])
    np.testing.assert_allclose(strain * np.sign(strain[2, 2]), expected, atol=3e-6)


def test_independent_errors_add_up_in_the_object_frame() -> None:
    """Against points that are triangulated with drawn errors, in a frame that is turned."""
    turned = np.eye(4)
    turned[:3, :3] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    turned[:3, 3] = [0.0, 0.0, DEPTH]
    rig = _pair(turned)
    std = {"right_tx": 2e-5, "right_ry": 1e-4, "left_fx": 0.3, "right_cx": 0.2, "right_rx": 1e-4}
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.03, 0.03, (100, 3))
    strains = space_strains(rig, _known(rig, **std), points)
    pixels = np.stack([project(camera, points) for camera in rig.cameras])
    draws = []
    for _ in range(300):
        d = {name: size * rng.normal() for name, size in std.items()}
        left, right = rig.cameras
        left = replace(left, matrix=left.matrix + d["left_fx"] * np.diag([1.0, 0.0, 0.0]))
        matrix = right.matrix.copy()
        matrix[0, 2] += d["right_cx"]
        pose = np.eye(4)
        pose[0, 3] = -BASE + d["right_tx"]
        # Small turns about x and y, to first order.
        pose[:3, :3] += np.cross(np.eye(3), [-d["right_rx"], -d["right_ry"], 0.0])
        pose[:3, :3] = np.linalg.qr(pose[:3, :3])[0] * [[-1, -1, -1]]
        pose[:3, :3] *= np.sign(np.diag(pose[:3, :3]))
        right = replace(right, matrix=matrix, T_camera_object=pose @ turned)
        moved = triangulate(Rig((left, right), 0, "drawn"), pixels, 1.0).point - points
        gradient = np.linalg.lstsq(points - points.mean(axis=0), moved - moved.mean(axis=0))[0].T
        draws.append(0.5 * (gradient + gradient.T))
    stretch = np.sqrt(np.square(strains).sum(axis=0))
    drawn = np.sqrt(np.square(draws).mean(axis=0))
    # 300 draws know a standard deviation to 4 %; the depth is along the object's y.
    assert drawn[2, 2] < drawn.max() == drawn[1, 1] or drawn.max() > 1e-4
    np.testing.assert_allclose(np.diag(stretch), np.diag(drawn), rtol=0.15)
    np.testing.assert_allclose(stretch, drawn, atol=0.15 * drawn.max())


def test_beyond_the_pictures_nothing_is_asked() -> None:
    """A lens term that is unknown bends only what the cameras do not see."""
    rig = _pair()
    points = HERE + np.linspace(-0.5, 0.5, len(HERE))[:, None] * [1.0, 0.0, 0.0]
    with pytest.raises(CalibrationError, match=r"two cameras together see \d+ of 300 points"):
        space_strains(rig, _known(rig, right_tx=1e-5), points + np.array([2.0, 0.0, 0.0]))
    (strain,) = space_strains(rig, _known(rig, right_tx=1e-3 * BASE), points)
    assert abs(strain[0, 0]) == pytest.approx(1e-3, rel=1e-3)


def test_the_covariance_of_another_rig_is_refused() -> None:
    rig = _pair()
    known = _known(rig, right_tx=1e-5)
    other = replace(rig.cameras[1], matrix=MATRIX + np.diag([40.0, 40.0, 0.0]))
    with pytest.raises(CalibrationError, match=r"right\.fx is 1000 there and 1040 in pair"):
        space_strains(Rig((rig.cameras[0], other), 0, "pair"), known, HERE)
    named = replace(rig.cameras[1], name="c1")
    with pytest.raises(CalibrationError, match="cameras left, right, the rig has c1, left"):
        space_strains(Rig((rig.cameras[0], named), 0, "pair"), known, HERE)
    odd = replace(known, names=(*known.names[:-1], "right.zoom"))
    with pytest.raises(CalibrationError, match=r"'?right\.zoom'? is no number of a camera"):
        space_strains(rig, odd, HERE)
