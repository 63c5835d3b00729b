"""Range flow from whole pictures: truth, claims, laws, and what must be rejected."""

from dataclasses import replace
from functools import cache

import cv2
import numba
import numpy as np
import pytest
from vision.scenes import (
    LENS,
    MOTIONS,
    PITCH,
    SHAPE,
    example,
    example_views,
    first_instant,
    followed,
    make_rig,
    moved_frame,
    noisy_views,
    projected,
)

from palpate.errors import InputError
from palpate.vision import JointFlow
from palpate.vision.joint import flow as joint_flow
from palpate.vision.joint.flow import _followable, composed_motion
from palpate.vision.range_flow import Outcome, is_valid

NOISE = 1.5
# Noise that drowns the bias which is claimed on top of it: then the whole covariance is tested.
LOUD = 4.0


def _state(views, stage=None, method=JointFlow()):
    return first_instant(stage or example(), views, method)


@cache
def _still():
    """The first instant of the example, which no flow changes (`tests/pipeline`)."""
    return _state(noisy_views(example_views("still"), NOISE, 1))


def _flow(state, views, method=JointFlow()):
    return next(followed(state, [views], method))


def _flows(name, count=3, lens=(), noise=NOISE, seed=1):
    stage = example(count, lens)
    state = _state(noisy_views(example_views("still", count, lens), noise, seed), stage)
    return _flow(state, noisy_views(example_views(name, count, lens), noise, 100 + seed))


def _error(flow, motion):
    return flow.displacement - motion(flow.point)


def _sigma(flow):
    return np.sqrt(np.einsum("nii->ni", flow.covariance))


def _fits(flow, motion):
    """Root mean square of error over claim in all directions together."""
    good = is_valid(flow)
    error, covariance = _error(flow, motion)[good], flow.covariance[good]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error) / 3.0
    return np.sqrt(square.mean())


def _room(flow, motion, rig):
    """Distance to the edge of the pictures, at rest and after the motion, over all cameras [px]."""
    room = np.full(len(flow.point), np.inf)
    for camera in rig.cameras:
        for position in (flow.point, flow.point + motion(flow.point)):
            pixel = projected(camera, position)
            far = np.array(SHAPE[::-1]) - 1.0 - pixel
            room = np.minimum(room, np.minimum(pixel, far).min(axis=1))
    return room


@pytest.fixture(scope="module")
def flows():
    return {name: _flows(name) for name in MOTIONS}


@pytest.mark.parametrize("name", MOTIONS)
def test_every_point_is_found_and_none_is_wrong(flows, name):
    flow, motion = flows[name], MOTIONS[name]
    good = is_valid(flow)
    inside = _room(flow, motion, example().rig) > 14.0
    assert inside.sum() > 550
    assert good[inside].all()
    error = _error(flow, motion)[good]
    # Five standard deviations of 900 points, three components, and room for the claim's own error.
    assert np.abs(error / _sigma(flow)[good]).max() < 6.0
    # The bound for noise of 1.5: 0.007 px of plane windows, less for three cameras, times three in
    # depth; a fifth more for second derivatives taken from the neighbours.
    assert np.sqrt((error[:, :2] ** 2).mean()) < 0.008 * PITCH
    assert np.sqrt((error[:, 2] ** 2).mean()) < 0.025 * PITCH


@pytest.mark.parametrize("name", ["shift", "bump"])
def test_errors_are_as_large_as_claimed(name):
    flow = _flows(name, noise=LOUD)
    # Some 80 windows that do not overlap: 5 % from chance. The claim holds a bias that is not there
    # (0.005 px and more) and leaves out what second derivatives from the neighbours cost (20 %).
    assert 0.7 < _fits(flow, MOTIONS[name]) < 1.3


def test_noise_of_the_gradients_is_part_of_the_claim():
    """Noise that makes up a seventh of the squared gradients, as no low-pass takes it away: errors
    are 1.25 to 1.3 times what a claim from the gradients as they are would say."""
    still, moved = (example_views(name) for name in ("still", "turn"))
    method = JointFlow(smoothing=0.0)
    state = _state(noisy_views(still, 2 * LOUD, 1), method=method)
    flow = _flow(state, noisy_views(moved, 2 * LOUD, 101), method)
    # Windows of the texture: 5 % from chance.
    assert _fits(flow, MOTIONS["turn"]) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("name", ["turn", "bump"])
def test_fewer_unknowns_of_a_window_leave_less_noise_and_no_bias(flows, name):
    """What a window does not determine itself comes from its neighbours, to second order."""
    motion = MOTIONS[name]
    state = _still()
    views = noisy_views(example_views(name), NOISE, 101)
    by_shape = {"affine": flows[name]}
    for shape in ("shift", "quadratic"):
        by_shape[shape] = _flow(state, views, JointFlow(shape=shape))
    good = np.logical_and.reduce([is_valid(flow) for flow in by_shape.values()])
    assert good.sum() > 0.95 * is_valid(flows[name]).sum()
    rms = {}
    for shape, flow in by_shape.items():
        error = _error(flow, motion)[good]
        assert np.abs(error / _sigma(flow)[good]).max() < 6.0
        rms[shape] = np.sqrt((error[:, :2] ** 2).mean())
    # Of white noise on an even texture a shift knows as much alone as beside a gradient, for the
    # two are orthogonal; speckles are uneven. Second derivatives are not orthogonal to it: 9/4 of
    # the variance in one direction (Gram determinant of 1, x^2), here in two.
    assert rms["shift"] < 1.02 * rms["affine"]
    assert 1.15 * rms["affine"] < rms["quadratic"] < 2.3 * rms["affine"]


def test_reprojection_says_how_well_the_cameras_agree(flows):
    flow = flows["turn"]
    good = is_valid(flow)
    # 0.007 px for each camera and component, two thirds of that left over: 0.008 px.
    assert np.median(flow.reprojection[good]) == pytest.approx(0.008, rel=0.4)
    assert flow.reprojection[good].max() < 0.05
    assert (flow.score[good] > 0.97).all()
    assert np.isin(flow.cameras[good], (2, 3)).all()
    assert (flow.cameras[good] == 3).mean() > 0.7


def test_gradient_is_that_of_the_motion_along_the_tangents(flows):
    flow, motion = flows["strain"], MOTIONS["strain"]
    good = is_valid(flow)
    h = 1e-5
    for a in range(2):
        slope = (motion(flow.point + h * flow.tangent[:, a]) - motion(flow.point)) / h
        error = (flow.gradient[:, a] - slope)[good]
        # The shift's noise over half a window, times sqrt(3); depth three times worse.
        assert np.sqrt((error**2).mean()) < 3.0 * np.sqrt(3.0) * 0.008 / 10.0


def test_rejected_points_are_empty_and_counted(flows):
    for flow in flows.values():
        bad = ~is_valid(flow)
        for value in (flow.displacement, flow.gradient, flow.covariance, flow.bias):
            assert np.isnan(value[bad].reshape(bad.sum(), -1)).all()
            assert np.isfinite(value[~bad]).all()
        assert (flow.cameras[bad] == 0).all()
        assert np.isin(flow.outcome, list(Outcome)).all()
        assert np.isfinite(flow.point).all()
        eigen = np.linalg.eigvalsh(flow.covariance[~bad] - flow.bias[~bad])
        assert (eigen > 0.0).all()


@pytest.mark.parametrize(("count", "lens"), [(2, ()), (4, LENS)])
def test_two_cameras_and_four_with_lenses(count, lens):
    motion = MOTIONS["turn"]
    flow = _flows("turn", count, lens)
    good = is_valid(flow)
    inside = _room(flow, motion, example(count, lens).rig) > 14.0
    assert good[inside].mean() > 0.99
    error = _error(flow, motion)[good]
    assert np.abs(error / _sigma(flow)[good]).max() < 6.0
    assert np.sqrt((error[:, 2] ** 2).mean()) < 0.04 * PITCH
    assert flow.cameras.max() == count


def test_lenses_are_no_matter(flows):
    """The same scene through lenses that bend by pixels: other noise, the same errors."""
    motion = MOTIONS["turn"]
    bent, plain = _flows("turn", 3, LENS), flows["turn"]
    size = [np.sqrt((_error(f, motion)[is_valid(f)] ** 2).mean(axis=0)) for f in (bent, plain)]
    np.testing.assert_allclose(size[0], size[1], rtol=0.3)
    assert np.abs(_error(bent, motion)[is_valid(bent)].mean(axis=0)).max() < 0.004 * PITCH


def _paint(views, rig, ends, half_width, level=12.0, only=None):
    """A dark rod between two points, painted into the pictures of some cameras."""
    result = []
    for k, (view, camera) in enumerate(zip(views, rig.cameras, strict=True)):
        painted = view.copy()
        if only is None or k in only:
            a, b = (tuple(int(v) for v in p) for p in projected(camera, np.array(ends)))
            cv2.line(painted, a, b, level, 2 * half_width)
        result.append(painted)
    return result


def _touched(flow, motion, rig, ends, half_width, camera):
    """Distance of the moved points from the rod's outline in one camera [px]; negative within."""
    pixel = projected(rig.cameras[camera], flow.point + motion(flow.point))
    a, b = projected(rig.cameras[camera], np.array(ends))
    along = np.clip(((pixel - a) @ (b - a)) / ((b - a) @ (b - a)), 0.0, 1.0)
    return np.linalg.norm(pixel - a - along[:, None] * (b - a), axis=1) - half_width


ROD = [(0.0, 0.002, 0.0), (-0.03, 0.03, 0.03)]


@pytest.mark.parametrize("name", ["shift", "bump"])
def test_a_rod_over_the_surface_is_rejected_and_never_averaged_in(name):
    motion, rig = MOTIONS[name], example().rig
    views = _paint(example_views(name), rig, ROD, 9)
    state = _still()
    flow = _flow(state, noisy_views(views, NOISE, 2))
    good = is_valid(flow)
    away = np.stack([_touched(flow, motion, rig, ROD, 9, k) for k in range(3)])
    seen = (away > 15.0).sum(axis=0)
    inside = _room(flow, motion, rig) > 14.0
    # Where no two cameras see the surface nothing may be found.
    covered = ((away < 0.0).sum(axis=0) >= 2) & inside
    assert covered.sum() > 20
    assert not good[covered].any()
    reasons = flow.outcome[covered]
    changed = (Outcome.SCORE, Outcome.LOST, Outcome.REPROJECTION, Outcome.NEIGHBOURS)
    assert np.isin(reasons, changed).all()
    assert np.isin(reasons, (Outcome.SCORE, Outcome.LOST)).mean() > 0.8
    # Beside it nothing is lost.
    assert good[(seen == 3) & inside].mean() > 0.98
    assert np.abs(_error(flow, motion)[good] / _sigma(flow)[good]).max() < 6.0


def test_what_covers_one_camera_costs_that_camera_only():
    motion, rig = MOTIONS["shift"], example().rig
    views = _paint(example_views("shift"), rig, ROD, 9, only=(1,))
    state = _still()
    flow = _flow(state, noisy_views(views, NOISE, 2))
    good = is_valid(flow)
    covered = (_touched(flow, motion, rig, ROD, 9, 1) < 3.0) & (_room(flow, motion, rig) > 14.0)
    assert covered.sum() > 60
    assert good[covered].mean() > 0.9
    assert (flow.cameras[covered & good] == 2).all()
    assert np.abs(_error(flow, motion)[good] / _sigma(flow)[good]).max() < 6.0


def test_a_camera_behind_an_obstacle_of_the_mesh_drops_out():
    """A plate close before one camera, part of the known surface, at rest and later."""
    stage = example()
    vertices, triangles = stage.mesh()
    camera = stage.rig.cameras[1].T_camera_object
    eye = -camera[:3, :3].T @ camera[:3, 3]
    frame = camera[:3, :3]
    middle = 0.6 * eye
    across = 0.006
    corners = [middle + across * (a * frame[0] + b * frame[1])
               for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]  # fmt: skip
    plate = np.array([[0, 1, 2], [0, 2, 3]]) + len(vertices)
    mesh = np.vstack([vertices, corners]), np.vstack([triangles, plate])
    views = []
    for seed, name in enumerate(("still", "shift")):
        pictures = noisy_views(example_views(name), NOISE, seed)
        box = projected(stage.rig.cameras[1], np.array(corners)).round().astype(np.int32)
        cv2.fillConvexPoly(pictures[1], box, 200.0)
        views.append(pictures)
    state = JointFlow().start_on(stage.rig, views[0], *mesh)
    flow = _flow(state, views[1])
    motion = MOTIONS["shift"]
    good = is_valid(flow)
    pixel = projected(stage.rig.cameras[1], state.scene.point)
    behind = (np.abs(pixel - box.mean(axis=0)) < 0.5 * np.ptp(box, axis=0) - 4.0).all(axis=1)
    behind &= _room(flow, motion, stage.rig) > 14.0
    assert behind.sum() > 20
    assert not state.scene.seen[behind, 1].any()
    assert good[behind].mean() > 0.95
    assert (flow.cameras[behind & good] == 2).all()
    assert np.abs(_error(flow, motion)[good] / _sigma(flow)[good]).max() < 6.0


def test_light_of_one_camera_is_no_matter(flows):
    views = noisy_views(example_views("turn"), NOISE, 101)
    views[1] = (0.7 * views[1] + 20.0).astype(np.float32)
    flow = _flow(_still(), views)
    both = is_valid(flow) & is_valid(flows["turn"])
    assert both.sum() > 0.99 * is_valid(flows["turn"]).sum()
    gap = flow.displacement[both] - flows["turn"].displacement[both]
    # The noise of one camera weighs less; a tenth of the error.
    assert np.sqrt((gap**2).mean(axis=0) / (_sigma(flow)[both] ** 2).mean(axis=0)).max() < 0.15


def test_same_bits_with_one_thread_and_with_more(flows):
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("needs two threads")
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        single = _flows("bump")
        numba.set_num_threads(2)
        double = _flows("bump")
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(single.outcome, double.outcome)
    np.testing.assert_array_equal(single.displacement, double.displacement)
    np.testing.assert_array_equal(single.covariance, double.covariance)


def test_another_frame_turns_the_answer(flows):
    turn = cv2.Rodrigues(np.array([0.4, -0.8, 1.1]))[0]
    shift = np.array([0.02, 0.05, -0.03])
    stage = example()
    vertices, triangles = stage.mesh()
    rig = moved_frame(stage.rig, turn, shift)
    still = noisy_views(example_views("still"), NOISE, 1)
    state = JointFlow().start_on(rig, still, vertices @ turn.T + shift, triangles)
    flow = _flow(state, noisy_views(example_views("turn"), NOISE, 101))
    both = is_valid(flow) & is_valid(flows["turn"])
    assert both.sum() >= is_valid(flows["turn"]).sum() - 2
    expected = flows["turn"].displacement[both] @ turn.T
    gap = np.linalg.norm(flow.displacement[both] - expected, axis=1)
    # Surface points in single precision, to a millionth of the motion; the steps end alike.
    assert np.median(gap) < 3e-6 * np.linalg.norm(expected, axis=1).mean()
    claim = np.einsum("ai,nij,bj->nab", turn, flows["turn"].covariance[both], turn)
    size = np.trace(claim, axis1=1, axis2=2)[:, None, None]
    np.testing.assert_allclose(flow.covariance[both] / size, claim / size, atol=1e-2)


def test_order_of_the_cameras_is_no_matter(flows):
    order = (2, 0, 1)
    rig = make_rig(3, reference=1, order=order)
    still = noisy_views(example_views("still"), NOISE, 1)
    later = noisy_views(example_views("turn"), NOISE, 101)
    state = JointFlow().start_on(rig, [still[k] for k in order], *example().mesh())
    flow = _flow(state, [later[k] for k in order])
    np.testing.assert_array_equal(flow.pixel, flows["turn"].pixel)
    both = is_valid(flow) & is_valid(flows["turn"])
    assert both.sum() >= is_valid(flows["turn"]).sum() - 2
    gap = np.abs(flow.displacement - flows["turn"].displacement)[both]
    # Sums in another order; the last step, 1e-3 px, is far longer than what is left after it.
    assert gap.max() < 1e-3 * PITCH


def test_a_series_is_measured_against_the_first_instant():
    """Each step as good as alone: nothing accumulates over a motion of 30 px in all."""
    state = _still()
    steps = [(2.5e-3, 0.0, 0.0), (5e-3, 1e-3, -1e-3), (8e-3, 2e-3, -1e-3)]
    motions = [lambda points, s=s: np.zeros_like(points) + np.array(s) for s in steps]
    series = [
        noisy_views(example().views(motion), NOISE, 10 + k) for k, motion in enumerate(motions)
    ]
    for flow, motion in zip(followed(state, series), motions, strict=True):
        good = is_valid(flow)
        inside = _room(flow, motion, example().rig) > 14.0
        assert good[inside].mean() > 0.98
        error = _error(flow, motion)[good]
        assert np.abs(error / _sigma(flow)[good]).max() < 6.0
        assert np.sqrt((error[:, :2] ** 2).mean()) < 0.009 * PITCH


def test_what_hardly_moves_between_instants_is_not_searched_for(monkeypatch):
    """Steps of 0.4 px end as they would; a bump of 6 px in a part of it is searched for."""
    searches, search = [], joint_flow.dense_start
    monkeypatch.setattr(joint_flow, "dense_start", lambda *a: searches.append(1) or search(*a))
    slow = [lambda points, x=x: np.zeros_like(points) + np.array([x, 0.0, 0.0])
            for x in (0.0, 1e-4, 2e-4)]  # fmt: skip
    views = [*map(example().views, slow), example_views("bump")]
    series = [noisy_views(pictures, NOISE, 20 + k) for k, pictures in enumerate(views)]
    counts = []
    for flow, motion in zip(followed(_still(), series), [*slow, MOTIONS["bump"]], strict=True):
        counts.append(len(searches))
        inside = _room(flow, motion, example().rig) > 14.0
        good = is_valid(flow)
        assert good[inside].mean() > 0.98
        assert np.abs((_error(flow, motion) / _sigma(flow))[good]).max() < 6.0
    assert counts == [3, 3, 3, 6]


@pytest.mark.parametrize("step", [3, 5, 9, 15])
def test_what_goes_under_a_tool_is_not_looked_for_in_the_last_instant(step):
    """Half of the surface was covered before. Further windows at its rim show too little of what
    was followed; one in the open does."""
    method = JointFlow(step=step)
    state = _state(noisy_views(example_views("still"), NOISE, 1), method=method)
    state, flow = method.follow(state, noisy_views(example_views("still"), NOISE, 2))
    column, row = np.rint((flow.pixel - flow.pixel.min(axis=0)) / step).astype(int).T
    rim, top = int(np.median(column)), int(np.median(row))
    last = replace(flow, outcome=np.where(column < rim, Outcome.SCORE, flow.outcome))
    inner = (column == rim + 2) & (row == top)
    assert inner.sum() == 1
    lost = (column == rim) | inner
    direct = replace(last, outcome=np.where(lost, Outcome.SCORE, last.outcome))
    np.testing.assert_array_equal(_followable(state.scene, last, direct), np.flatnonzero(inner))


def test_pictures_that_show_something_else_are_rejected():
    state = _still()
    other = replace(example(), seed=77).views()
    flow = _flow(state, noisy_views(other, NOISE, 2))
    assert is_valid(flow).mean() < 0.01


def test_black_pictures_are_rejected():
    state = _still()
    flow = _flow(state, [np.zeros(SHAPE, dtype=np.float32)] * 3)
    assert not is_valid(flow).any()


def test_a_scene_without_points_gives_a_flow_without_points():
    stage = example()
    vertices, triangles = stage.mesh()
    away = vertices * [0.02, 0.02, 1.0] + [0.2, 0.0, 0.0]
    state = JointFlow().start_on(stage.rig, example_views("still"), away, triangles)
    flow = _flow(state, example_views("shift"))
    assert flow.displacement.shape == (0, 3)


@pytest.mark.parametrize(
    ("wrong", "text"), [({"subset": 20}, "subset is 20"), ({"subset": 3}, "subset is 3"),
                        ({"step": 0}, "step is 0")],
)  # fmt: skip
def test_settings_out_of_range_are_refused(wrong, text):
    with pytest.raises(InputError, match=text):
        JointFlow(**wrong)


def test_one_motion_after_another_multiplies_their_deformations():
    """Any deformation of the tangent plane, then any of space: F = F2 F1."""
    rng = np.random.default_rng(3)
    tangent = np.linalg.qr(rng.normal(size=(3, 2)))[0].T
    plane = rng.normal(0.0, 0.1, (2, 2))
    extent = np.array([0.004])
    before, after = np.zeros((2, 1, 6, 3))
    before[0, 0], after[0, 0] = [1e-3, 2e-3, 3e-3], [-2e-3, 1e-3, 5e-4]
    # F1 turns the plane by R and stretches it within; the moved tangents are those of R.
    turn = cv2.Rodrigues(np.array([0.3, -0.2, 0.5]))[0]
    moved = tangent @ turn.T
    image = (np.eye(2) + plane) @ moved
    before[0, 1:3] = extent * (image - tangent)
    second = np.eye(3) + rng.normal(0.0, 0.1, (3, 3))
    after[0, 1:3] = extent * (moved @ second.T - moved)
    whole = composed_motion(before, after, tangent[None], moved[None], extent)
    np.testing.assert_allclose(whole[0, 0], before[0, 0] + after[0, 0], atol=1e-18)
    np.testing.assert_allclose(whole[0, 1:3] / extent, image @ second.T - tangent, atol=1e-14)
    assert not whole[0, 3:].any()
