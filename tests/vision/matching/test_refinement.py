"""Windows of all cameras matched jointly: truth on analytic scenes, covariance, laws, states."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision.scenes import (
    MOTIONS,
    PITCH,
    SHAPE,
    Stage,
    example,
    example_views,
    make_rig,
    moved_frame,
    noisy_views,
    projected,
    rigid,
)
from vision.textures import pixel_grid

from palpate.vision.matching.refinement import refine_joint
from palpate.vision.matching.scene import Limits, make_scene
from palpate.vision.matching.window import deformed_frame_kernel, mapping_kernel
from palpate.vision.projection import project_jacobian
from palpate.vision.range_flow import Outcome
from palpate.vision.spline import make_spline_picture

# No low-pass: white noise stays white, so that the bound and the claim are the same thing.
PLAIN = {"subset": 21, "smoothing": 0.0, "step": 6}
NOISE = 1.5


def _scene(views, stage=None):
    stage = stage or example()
    return make_scene(stage.rig, views, *stage.mesh(), **PLAIN)


@pytest.fixture(scope="module")
def still():
    return _scene(example_views("still"))


def _start(scene, motion, seed=0):
    """The truth, wrong by a third of a pixel."""
    start = np.zeros((len(scene.point), 6, 3))
    off = np.random.default_rng(seed).normal(0.0, PITCH / 3.0, scene.point.shape)
    start[:, 0] = motion(scene.point) + off
    return start


class Found:
    """What `refine_joint` finds for all points of a scene, with names for what is asked most."""

    def __init__(self, scene, views, start, *, use=None, noise=None, **limits):
        rows, c = np.arange(len(scene.point)), len(scene.pictures)
        match = refine_joint(
            scene,
            rows,
            [make_spline_picture(view) for view in views],
            start,
            scene.seen if use is None else use,
            np.full(c, NOISE * np.sqrt(2.0)) if noise is None else noise,
            Limits(**{"half": 10, "shading": False} | limits),
        )
        for name, value in match._asdict().items():
            setattr(self, name, value)
        self.good = self.outcome == Outcome.VALID
        self.displacement = self.motion[:, 0]


def _whole(scene, motion, rig):
    """Points whose windows stay within all pictures, at rest and after the motion."""
    rows, columns = scene.pictures[0].grey.shape
    keep = np.ones(len(scene.point), dtype=bool)
    for camera in rig.cameras:
        for position in (scene.point, scene.point + motion(scene.point)):
            x, y = projected(camera, position).T
            keep &= (x > 13.0) & (x < columns - 14.0) & (y > 13.0) & (y < rows - 14.0)
    return keep


@pytest.mark.parametrize(("name", "worse"), [("shift", 1.0), ("turn", 1.0), ("strain", 4.0)])
def test_without_noise_linear_motions_of_a_curved_surface_are_exact(still, name, worse):
    """A thousandth of a pixel as for plane windows; depth is worse by 1 / tan(20 degrees).

    Strain is not exact on a curved surface: what lies h = 75 um off the tangent plane at the edge
    of the window is carried by the normal without its own strain of 2 %, 0.5 um in the mean.
    """
    motion = MOTIONS[name]
    match = Found(still, example_views(name), _start(still, motion))
    keep = _whole(still, motion, example().rig)
    assert keep.sum() > 300
    assert match.good[keep].all()
    error = (match.displacement - motion(still.point))[keep]
    assert np.sqrt((error[:, :2] ** 2).mean()) < worse * 1e-3 * PITCH
    assert np.sqrt((error[:, 2] ** 2).mean()) < worse * 3e-3 * PITCH
    assert np.abs(error).max() < worse * 0.015 * PITCH
    # The gradients: half a window away the motion is as good, or three times worse.
    h = 1e-5
    for a in range(2):
        side = still.point + h * still.tangent[:, a]
        slope = (motion(side) - motion(still.point)) / h
        off = (match.motion[:, 1 + a] / still.half_window[:, None] - slope)[keep]
        assert np.sqrt((off**2).mean()) * still.half_window.mean() < 5e-3 * PITCH


def test_quadratic_windows_follow_a_bump_that_linear_ones_blur(still):
    motion = MOTIONS["bump"]
    errors = []
    for bases in (3, 6):
        match = Found(still, example_views("bump"), _start(still, motion), bases=bases)
        keep = _whole(still, motion, example().rig) & match.good
        errors.append((match.displacement - motion(still.point))[keep])
    linear, quadratic = (np.sqrt((error**2).mean()) for error in errors)
    # Half the curvature, 1.5 mm / (12 mm)^2, times the mean square of half a window, 3 mm^2: 15 um;
    # what is left is of the fourth order, smaller by (3 mm / 12 mm)^2.
    assert 5e-6 < linear < 15e-6
    assert quadratic < 0.1 * linear


def test_second_derivatives_that_are_known_take_the_blur_away(still):
    """`bases` 3 with second-order terms at the start holds them fixed."""
    motion = MOTIONS["bump"]
    start = _start(still, motion)
    t, s = still.tangent[:, 0], still.tangent[:, 1]
    h = still.half_window[:, None]
    u = motion(still.point)

    def away(a, b):
        """The motion at the surface point over a x tangent + b x tangent."""
        flat = still.point + h * (a * t + b * s)
        return motion(np.column_stack([flat[:, :2], example().height(*flat[:, :2].T)]))

    start[:, 3] = 0.5 * (away(1, 0) + away(-1, 0)) - u
    start[:, 5] = 0.5 * (away(0, 1) + away(0, -1)) - u
    start[:, 4] = 0.25 * (away(1, 1) + away(-1, -1) - away(1, -1) - away(-1, 1))
    match = Found(still, example_views("bump"), start)
    np.testing.assert_array_equal(match.motion[match.good, 3:], start[match.good, 3:])
    keep = _whole(still, motion, example().rig) & match.good
    error = (match.displacement - u)[keep]
    # Terms of the third order are left to the gradients, those of the fourth to nobody.
    assert np.sqrt((error**2).mean()) < 3e-6


@pytest.fixture(scope="module")
def repeated():
    """Errors and claims of six draws of noise, with all cameras and with each pair."""
    motion = MOTIONS["shift"]
    result = {}
    for seed in range(6):
        scene = _scene(noisy_views(example_views("still"), NOISE, seed))
        views = noisy_views(example_views("shift"), NOISE, 50 + seed)
        keep = _whole(scene, motion, example().rig)
        for cameras in ((0, 1, 2), (0, 1), (0, 2), (1, 2)):
            use = np.zeros_like(scene.seen)
            use[:, cameras] = keep[:, None]
            match = Found(scene, views, _start(scene, motion), use=use)
            assert match.good[keep].all()
            error = match.displacement - motion(scene.point)
            result.setdefault(cameras, []).append((error[keep], match.covariance[keep], match))
    return result


@pytest.mark.parametrize("cameras", [(0, 1, 2), (0, 1), (1, 2)])
def test_errors_are_as_large_as_claimed(repeated, cameras):
    """Some 60 windows that do not overlap, three components, six draws: 3 % from chance."""
    total, ratio = [], []
    for error, covariance, _ in repeated[cameras]:
        total.append(np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0)
        ratio.append((error**2).sum(axis=0) / np.einsum("nii->i", covariance))
    assert np.sqrt(np.mean(total)) == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(np.sqrt(np.mean(ratio, axis=0)), 1.0, atol=0.12)


def _roof(x, _y):
    """Two slopes of 39 degrees that meet over x = 0, rounded within a pixel."""
    return -0.8 * np.hypot(x, 0.5 * PITCH)


def test_errors_beside_a_crease_are_as_large_as_claimed():
    """There half of a window's points follow the tilt of the normal, by their height.

    Some 70 points, three components, six draws; neighbours overlap: 5 % from chance.
    """
    stage, motion = Stage(make_rig(), _roof), MOTIONS["shift"]
    still, moved = stage.views(), stage.views(motion)
    squares, sides = [], []
    for seed in range(6):
        scene = _scene(noisy_views(still, NOISE, seed), stage)
        match = Found(scene, noisy_views(moved, NOISE, 50 + seed), _start(scene, motion))
        beside = np.abs(scene.point[:, 0]) < 2.0 * PITCH
        keep = _whole(scene, motion, stage.rig) & match.good & beside
        error = (match.displacement - motion(scene.point))[keep]
        inverse = np.linalg.inv(match.covariance[keep])
        squares.append(np.einsum("ni,nij,nj->n", error, inverse, error) / 3.0)
        sides.append(error[:, 1] ** 2 / match.covariance[keep, 1, 1])
    assert len(np.concatenate(squares)) > 50
    assert np.sqrt(np.concatenate(squares).mean()) == pytest.approx(1.0, abs=0.15)
    assert np.sqrt(np.concatenate(sides).mean()) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("bases", [3, 6])
def test_the_mapping_is_the_derivative_of_a_pixel_s_motion(bases):
    """Of a point off the tangent plane, by central differences of what the window is moved by."""
    rng = np.random.default_rng(bases)
    scene = _scene(example_views("still"))
    camera, packed = scene.rig.cameras[1], scene.packed[1]
    point, tangent, half = scene.point[40], np.ascontiguousarray(scene.tangent[40]), 0.004
    # Near the point: the mapping takes the camera's own derivative there.
    xi, eta, height = 0.01 * rng.normal(size=3)
    mapping = np.full((2 * (bases + 1), 3 * bases), np.nan)
    mapping_kernel(packed, point, tangent, bases, np.empty((2, 3)), mapping)
    monomials = np.array([1.0, xi, eta, xi * xi, xi * eta, eta * eta])
    functions = np.append(monomials[:bases], height)

    def pixel(q):
        frame = np.empty((3, 3))
        deformed_frame_kernel(q, tangent, half, frame)
        offset = half * (xi * frame[0] + eta * frame[1] + height * frame[2])
        moved = point + q[0] + offset + monomials[3:] @ q[3:]
        return projected(camera, moved[None])[0]

    for k in range(bases):
        for b in range(3):
            step = np.zeros((6, 3))
            step[k, b] = 1e-5
            expected = (pixel(step) - pixel(-step)) / 2e-5
            column = mapping[:, b * bases + k].reshape(-1, 2)
            # The camera's derivative changes by the size of the offset over the distance.
            size = np.abs(expected).max() + 1e-3 * np.abs(mapping).max() * np.abs(functions).max()
            np.testing.assert_allclose(functions @ column / size, expected / size, atol=5e-3)


def test_three_cameras_beat_the_best_pair_by_the_bound(repeated):
    def rms(cameras):
        return np.sqrt(np.mean([(error**2).sum(axis=1).mean() for error, *_ in repeated[cameras]]))

    def claimed(cameras):
        return np.sqrt(np.mean([np.trace(c, axis1=1, axis2=2).mean()
                                for _, c, _ in repeated[cameras]]))  # fmt: skip

    pairs = [(0, 1), (0, 2), (1, 2)]
    best = min(pairs, key=rms)
    assert rms((0, 1, 2)) < 0.9 * rms(best)
    # A tenth: chance, most of which is the same in both.
    expected = claimed((0, 1, 2)) / min(claimed(pair) for pair in pairs)
    assert rms((0, 1, 2)) / rms(best) == pytest.approx(expected, rel=0.1)


def test_noise_left_over_is_that_of_the_pixels_and_white(repeated):
    for cameras, draws in repeated.items():
        for _, _, match in draws[:2]:
            left = match.residual_variance[match.good][:, cameras]
            np.testing.assert_allclose(left.mean(axis=0), 2.0 * NOISE**2, rtol=0.03)
            # From 18 or 27 blocks a window; the correction for so few overdoes it by up to a third.
            assert 0.9 < match.variance_ratio[match.good].mean() < 1.4
            other = [c for c in range(3) if c not in cameras]
            assert np.isnan(match.score[:, other]).all()
            assert np.isnan(match.own_step[:, other]).all()


def test_what_each_camera_alone_would_add_is_as_large_as_claimed(repeated):
    """Where one of three cameras has a third of the say, it keeps two thirds of its own error."""
    match = repeated[(0, 1, 2)][0][2]
    ratio = match.own_step[match.good] ** 2 / match.own_variance[match.good][..., None]
    assert 0.2 < ratio.mean() < 1.0


def test_a_camera_that_slipped_is_identified_by_what_it_alone_would_add(still):
    """The joint answer is the weighted mean of the cameras'; what is left tells who is off."""
    motion = MOTIONS["shift"]
    views = list(example_views("shift"))
    slip = np.array([0.2, 0.1])
    plain = Found(still, views, _start(still, motion))
    rig = example().rig
    camera = rig.cameras[1]
    matrix = camera.matrix.copy()
    matrix[:2, 2] += slip
    cameras = (rig.cameras[0], replace(camera, matrix=matrix), rig.cameras[2])
    views[1] = Stage(replace(rig, cameras=cameras), example().height, 3).views(motion)[1]
    match = Found(still, views, _start(still, motion))
    keep = _whole(still, motion, rig) & plain.good & match.good
    slope = np.stack([project_jacobian(c, still.point[keep])[1] for c in rig.cameras])
    # Cameras of equal weight: u = (sum J^T J)^-1 sum J^T d.
    word = np.zeros((3, keep.sum(), 2))
    word[1] = slip
    matrix = np.einsum("cnai,cnaj->nij", slope, slope)
    mean = np.linalg.solve(matrix, np.einsum("cnai,cna->ni", slope, word)[..., None])[..., 0]
    expected = word - np.einsum("cnai,ni->cna", slope, mean)
    own_step = np.moveaxis(match.own_step[keep], 1, 0)
    # Textures weigh the directions, by a quarter or so.
    assert np.sqrt(((own_step - expected) ** 2).mean()) < 0.25 * np.sqrt((expected**2).mean())
    shift = (match.displacement - plain.displacement)[keep]
    assert np.sqrt(((shift - mean) ** 2).mean()) < 0.25 * np.sqrt((mean**2).mean())


def test_light_of_one_camera_is_no_matter(still):
    views = noisy_views(example_views("turn"), NOISE, 3)
    start = _start(still, MOTIONS["turn"])
    plain = Found(still, views, start)
    views[1] = (0.7 * views[1] + 25.0).astype(np.float32)
    other = Found(still, views, start)
    np.testing.assert_array_equal(plain.outcome, other.outcome)
    good = plain.good
    # Single precision and the last step.
    assert np.abs(other.displacement - plain.displacement)[good].max() < 1e-3 * PITCH
    np.testing.assert_allclose(
        other.residual_variance[good], plain.residual_variance[good], rtol=1e-3, equal_nan=True
    )


def test_a_shadow_s_edge_moves_nothing():
    """Light that falls by 1 % a pixel before lenses of 0.8 px: what they spread is drawn toward the
    dark by 0.8^2 times 1 %, unless the windows know of the spread."""

    def seen(views, fall):
        light = np.exp(-fall * (np.arange(SHAPE[1]) - SHAPE[1] / 2))
        return [cv2.GaussianBlur(light * view, (0, 0), 0.8) for view in views]

    views = example_views("still")
    scene, later = _scene(seen(views, 0.0)), seen(views, 0.01)
    start = _start(scene, MOTIONS["still"])
    drawn = {}
    for spread in (0.0, 0.8**2):
        match = Found(replace(scene, blur_variance=np.full(3, spread)), later, start, shading=True)
        assert match.good.mean() > 0.7  # the others lie where no window has room
        drawn[spread] = match.displacement[match.good, 0].mean() / PITCH
    assert drawn[0.0] == pytest.approx(0.8**2 * 0.01, rel=0.1)
    # Light that falls by a tenth over a window is not quite linear.
    assert abs(drawn[0.8**2]) < 0.05 * drawn[0.0]


def _reordered(scene, order):
    pick = {
        name: tuple(getattr(scene, name)[k] for k in order)
        for name in ("pictures", "surface", "interior")
    }
    return replace(
        scene, packed=scene.packed[order], seen=np.ascontiguousarray(scene.seen[:, order]), **pick
    )


def test_order_of_the_cameras_does_not_matter(still):
    views = noisy_views(example_views("turn"), NOISE, 3)
    start = _start(still, MOTIONS["turn"])
    plain = Found(still, views, start)
    order = [2, 0, 1]
    other = Found(_reordered(still, order), [views[k] for k in order], start)
    np.testing.assert_array_equal(plain.outcome, other.outcome)
    # Sums in another order, in double precision.
    np.testing.assert_allclose(other.displacement, plain.displacement, atol=1e-9)
    np.testing.assert_allclose(other.covariance, plain.covariance, rtol=1e-6, atol=1e-20)
    np.testing.assert_allclose(other.score, plain.score[:, order], rtol=1e-6)


def test_frame_of_the_object_does_not_matter(still):
    """Another frame turns the answer with it; surface points are kept in single precision, 2 nm."""
    from_axis = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    c, s = np.cos(0.4), np.sin(0.4)
    turn = from_axis @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    shift = np.array([0.01, -0.02, 0.03])
    stage = example()
    vertices, triangles = stage.mesh()
    other = make_scene(
        moved_frame(stage.rig, turn, shift), example_views("still"), vertices @ turn.T + shift,
        triangles, **PLAIN,
    )  # fmt: skip
    np.testing.assert_array_equal(other.pixel, still.pixel)
    start = _start(still, MOTIONS["turn"])
    plain = Found(still, example_views("turn"), start)
    match = Found(other, example_views("turn"), start @ turn.T)
    np.testing.assert_array_equal(match.outcome, plain.outcome)
    good = plain.good
    expected = plain.displacement[good] @ turn.T
    size = np.linalg.norm(expected, axis=1).mean()
    gap = np.abs(match.displacement[good] - expected)
    # The median to a millionth of the motion; a step more or less is the tolerance squared.
    assert np.median(gap) < 2e-6 * size
    assert gap.max() < 1e-4 * size


def test_lengths_in_another_unit_are_lengths_in_another_unit(still):
    stage = example()
    vertices, triangles = stage.mesh()
    poses = [camera.T_camera_object.copy() for camera in stage.rig.cameras]
    for pose in poses:
        pose[:3, 3] *= 0.5
    cameras = tuple(
        replace(camera, T_camera_object=pose)
        for camera, pose in zip(stage.rig.cameras, poses, strict=True)
    )
    rig = replace(stage.rig, cameras=cameras)
    half = make_scene(rig, example_views("still"), 0.5 * vertices, triangles, **PLAIN)
    start = _start(still, MOTIONS["strain"])
    plain = Found(still, example_views("strain"), start)
    match = Found(half, example_views("strain"), 0.5 * start)
    np.testing.assert_array_equal(match.outcome, plain.outcome)
    # A factor of two is exact in binary.
    np.testing.assert_allclose(match.displacement, 0.5 * plain.displacement, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(match.covariance, 0.25 * plain.covariance, rtol=1e-9, atol=1e-25)


def test_each_reason_for_nothing(still):
    motion = MOTIONS["shift"]
    start = _start(still, motion)
    views = example_views("shift")
    good = np.flatnonzero(_whole(still, motion, example().rig))[:8]
    use = still.seen.copy()
    use[good[0]] = [False, True, False]
    start[good[1], 2, 1] = np.nan
    start[good[2], 0] += [3e-3, 0.0, 0.0]
    match = Found(still, views, start, use=use)
    assert match.outcome[good].tolist() == [
        Outcome.HIDDEN, Outcome.LOST, Outcome.LOST, *[Outcome.VALID] * 5
    ]  # fmt: skip
    lost = ~match.good
    for value in (
        match.motion,
        match.covariance,
        match.score,
        match.residual_variance,
        match.own_step,
        match.variance_ratio,
    ):
        assert np.isnan(value[lost].reshape(lost.sum(), -1)).all()
    assert np.isfinite(match.motion[match.good]).all()
    stopped = Found(still, views, start, iterations=1)
    assert not stopped.good.any()
    away = Found(still, views, _start(still, motion), reach=0.05)
    assert away.good.mean() < 0.02
    assert (away.outcome[good] == Outcome.LOST).any()


@pytest.mark.parametrize("shift", [(1e-3, 5e-4, 0.0), (-2e-3, -1e-3, 0.0)])
def test_windows_that_leave_a_picture_are_outside(still, shift):
    motion = rigid((0.0, 0.0, 0.03), shift)
    match = Found(still, example().views(motion), _start(still, motion))
    after = np.stack(
        [projected(c, still.point + motion(still.point)) for c in example().rig.cameras]
    )
    rows, columns = SHAPE
    room = np.minimum(after, np.array([columns - 1.0, rows - 1.0]) - after).min(axis=2).T
    used = np.isfinite(match.score)
    # Half a window, turned by 2 degrees, less the pixel that a mirror image makes up for.
    assert room[used].min() > 9.0
    left = match.outcome == Outcome.OUTSIDE
    assert left.sum() > 5
    assert (room[left].min(axis=1) < 11.0).all()


def test_a_picture_without_texture_at_rest_is_rejected():
    flat = [np.full_like(view, 90.0) for view in example_views("still")]
    scene = _scene(flat)
    match = Found(scene, example_views("still"), np.zeros((len(scene.point), 6, 3)))
    # The sums of squares vanish: no camera has anything to say.
    assert np.isin(match.outcome, (Outcome.TEXTURE, Outcome.HIDDEN)).all()


def test_stripes_say_nothing_along_them():
    """Where the texture varies along x only, the covariance along y is that of rounding: huge."""
    grid = pixel_grid(SHAPE).reshape(-1, 2)
    stripes = [
        100.0 + 50.0 * np.sin(example().rest_points(camera, grid, MOTIONS["still"])[:, 0] / 5e-4)
        for camera in example().rig.cameras
    ]
    stripes = [stripe.reshape(SHAPE).astype(np.float32) for stripe in stripes]
    scene = _scene(stripes)
    match = Found(scene, stripes, np.zeros((len(scene.point), 6, 3)))
    assert np.isin(match.outcome, range(5)).all()
    sigma = np.sqrt(np.einsum("nii->ni", match.covariance[match.good]))
    assert not (sigma[:, 1] < 0.1 * PITCH).any()
    assert (sigma[:, 1] > 10.0 * sigma[:, 0]).all()


@pytest.mark.parametrize("count", [2, 4])
def test_two_cameras_and_four(count):
    motion = MOTIONS["strain"]
    scene = _scene(example_views("still", count), example(count))
    match = Found(scene, example_views("strain", count), _start(scene, motion))
    keep = _whole(scene, motion, example(count).rig)
    assert keep.sum() > 200
    assert match.good[keep].all()
    error = (match.displacement - motion(scene.point))[keep]
    # As with three, and twice worse across the pair's plane.
    assert np.sqrt((error**2).mean(axis=0)).max() < 0.01 * PITCH


def test_frame_turns_with_a_rigid_motion():
    rng = np.random.default_rng(1)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    tangent = np.linalg.qr(rng.normal(size=(3, 2)))[0].T.copy()
    q = np.zeros((6, 3))
    q[1:3] = 0.004 * (tangent @ turn.T - tangent)
    frame = np.full((3, 3), np.nan)
    deformed_frame_kernel(q, tangent, 0.004, frame)
    whole = np.vstack([tangent, np.cross(*tangent)])
    np.testing.assert_allclose(frame, whole @ turn.T, atol=1e-14)


def test_normal_of_a_stretched_surface_stays_of_unit_length():
    rng = np.random.default_rng(2)
    tangent = np.linalg.qr(rng.normal(size=(3, 2)))[0].T.copy()
    q = np.zeros((6, 3))
    q[1:3] = 0.004 * rng.normal(0.0, 0.3, (2, 3))
    frame = np.full((3, 3), np.nan)
    deformed_frame_kernel(q, tangent, 0.004, frame)
    np.testing.assert_allclose(frame[:2], tangent + q[1:3] / 0.004, atol=1e-15)
    np.testing.assert_allclose(frame @ frame[2], [0.0, 0.0, 1.0], atol=1e-15)
    assert np.linalg.det(frame) > 0.0
