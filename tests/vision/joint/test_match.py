"""Which points are believed, in a wrong rig or a changed picture; noise carried from neighbours."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from vision.scenes import (
    PITCH,
    SHAPE,
    example,
    example_views,
    first_instant,
    followed,
    noisy_views,
    rigid,
)

from palpate.vision.joint.match import (
    BEND_REACH,
    _inflation,
    _matching_bias,
    accepted_flow,
    match_scene,
)
from palpate.vision.matching.local_regression import Scatter, local_field
from palpate.vision.matching.scene import Match
from palpate.vision.range_flow import Outcome, is_valid
from palpate.vision.spline import spline_pictures

NOISE = 1.5
SHIFT = rigid((0.0, 0.0, 0.0), (1.2e-3, 6e-4, 0.0))
PIXEL_PITCH, SUBSET, PIXELS, DRAWS = 3e-4, 21, 141, 60
HALF_WINDOW = SUBSET // 2 * PIXEL_PITCH


def _error(flow, motion):
    return flow.displacement - motion(flow.point)


def _flow_with_wrong_focal_length(factor):
    """The second camera's focal length is `factor` times what the rig says."""
    stage = example()
    cameras = list(stage.rig.cameras)
    matrix = cameras[1].matrix.copy()
    matrix[:2, :2] /= factor
    cameras[1] = replace(cameras[1], matrix=matrix)
    rig = replace(stage.rig, cameras=tuple(cameras))
    still = noisy_views(example_views("still"), NOISE, 1)
    later = noisy_views(stage.views(SHIFT), NOISE, 2)
    return next(followed(first_instant(replace(stage, rig=rig), still), [later]))


@pytest.fixture(scope="module")
def wrong():
    # A shift of 4 px seen as 3.3: the cameras contradict each other by more than half a pixel.
    return _flow_with_wrong_focal_length(1.2)


def test_a_wrong_rig_is_no_lack_of_texture(wrong):
    right = _flow_with_wrong_focal_length(1.0)
    # Cameras pull a window two ways; where its texture is weakest, the rough rest counts as noise.
    assert (wrong.outcome == Outcome.TEXTURE).mean() < 0.08
    assert is_valid(wrong).sum() > 0.95 * is_valid(right).sum()


def test_a_wrong_rig_is_part_of_the_interval(wrong):
    good = is_valid(wrong)
    error = _error(wrong, SHIFT)[good]
    sigma = np.sqrt(np.einsum("nii->ni", wrong.covariance[good]))
    ratio = np.sqrt(np.mean(np.square(error / sigma)))
    # One error, the same at all points: of a normal quantity with the claimed sigma, three times
    # it is seen once in 400 rigs. Noise alone would say that it is known twice as well and more.
    assert ratio < 3.0
    assert np.sqrt(np.mean(error**2)) > 5.0 * 0.008 * PITCH
    noise = wrong.covariance[good] - wrong.bias[good]
    assert np.median(np.trace(noise, axis1=1, axis2=2)) < 0.2 * np.median(
        np.trace(wrong.covariance[good], axis1=1, axis2=2)
    )


LOUD = 4.0


_STEPS = 5


@pytest.fixture(scope="module")
def changing():
    """A shift in five steps, while the right half of the surface takes on another texture."""
    stage = example()
    motions = [rigid((0.0, 0.0, 0.0), (3e-4 * k, 1e-4 * k, 0.0)) for k in range(_STEPS + 1)]
    right = np.linspace(0.0, 1.0, SHAPE[1]) > 0.55
    series = []
    for k, motion in enumerate(motions):
        # Each step changes what the low-passed noise hides (2 of 60 grey levels), all steps more.
        share = np.where(right, 0.03 * k, 0.0)
        views = [
            (1.0 - share) * a + share * b
            for a, b in zip(*stage.textured_views(motion, stage.seed, 91), strict=True)
        ]
        series.append(noisy_views(views, LOUD, 20 + k))
    return motions, list(followed(first_instant(stage, series[0]), series[1:]))


def test_what_the_first_picture_no_longer_shows_is_followed_from_instant_to_instant(changing):
    motions, flows = changing
    last, motion = flows[-1], motions[-1]
    far_right = last.pixel[:, 0] > 0.7 * SHAPE[1]
    far_left = last.pixel[:, 0] < 0.4 * SHAPE[1]
    taken = last.through_last
    # Most of what looks too different from the first picture; the rest changed too much in a step.
    lost = np.isin(last.outcome, (Outcome.SCORE, Outcome.LOST))
    assert taken[far_right].sum() > 1.2 * lost[far_right].sum() > 0
    assert not taken[far_left].any()
    assert is_valid(last)[taken].all()
    error = _error(last, motion)[taken]
    sigma = np.sqrt(np.einsum("nii->ni", last.covariance[taken]))
    # The claims add up over the steps. They know white noise; a look that changes has the size of
    # the speckles, which counts for more. No window is wrong: half a speckle is 1.7 px.
    assert 0.6 < np.sqrt(np.mean(np.square(error / sigma))) < 2.0
    assert np.abs(error).max() < 0.7 * PITCH
    direct = is_valid(last) & ~taken
    assert np.median(np.trace(last.covariance[taken], axis1=1, axis2=2)) > np.median(
        np.trace(last.covariance[direct], axis1=1, axis2=2)
    )


def test_drift_is_how_far_the_two_motions_are_apart(changing):
    motions, flows = changing
    assert np.isnan(flows[0].drift)
    last = flows[-1]
    # Both motions carry the noise of a window, 0.02 px at this noise and three times that in depth;
    # the one through the instants carries it once more.
    assert 0.01 * PITCH < last.drift < 0.15 * PITCH
    assert last.drift < np.linalg.norm(motions[-1](np.zeros((1, 3))))


@pytest.mark.parametrize("cameras", [2, 3, 4])
def test_what_cameras_contradict_each_other_by_beyond_noise_is_their_bias(cameras):
    """Normal errors of each camera's match, less the common displacement they are explained by."""
    rng = np.random.default_rng(cameras)
    n, noise, bias = 40000, 0.02, 0.05
    word = rng.normal(0.0, np.hypot(noise, bias), (n, cameras, 2))
    slope = rng.normal(size=(cameras, 2, 3)) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    # What a fit of three unknowns leaves of 2 c numbers.
    design = slope.reshape(2 * cameras, 3)
    rest = np.eye(2 * cameras) - design @ np.linalg.pinv(design)
    own_step = (word.reshape(n, -1) @ rest).reshape(n, cameras, 2)
    nothing = np.zeros((n, cameras))
    used = np.ones((n, cameras), dtype=bool)
    match = Match(
        np.zeros((n, 6, 3)), np.zeros((n, 3, 3)), nothing, nothing, own_step,
        np.full((n, cameras), noise**2), np.zeros(n), used, np.zeros(n, dtype=np.int64),
    )  # fmt: skip
    # The rest is not the same in all cameras, and its median not quite that of two degrees of
    # freedom: a sixth. Twice the share taken up by the fit would be off by a third and more.
    assert _matching_bias(match, used) == pytest.approx(bias, rel=0.17 if cameras > 2 else 0.5)
    quiet = match._replace(own_step=0.3 * own_step)
    assert _matching_bias(quiet, used) == 0.002


def test_points_beside_what_covers_the_surface_are_less_certain():
    still = noisy_views(example_views("still"), NOISE, 1)
    later = noisy_views(example().views(SHIFT), NOISE, 2)
    rows, columns = SHAPE
    covered = [view.copy() for view in later]
    for view in covered:
        view[rows // 3 : rows // 2, columns // 3 : columns // 2] = 30.0
    plain = next(followed(first_instant(example(), still), [later]))
    flow = next(followed(first_instant(example(), still), [covered]))
    away, before = (
        np.linalg.norm(
            measured.pixel[:, None]
            - measured.pixel[np.isin(measured.outcome, (Outcome.SCORE, Outcome.LOST))],
            axis=2,
        ).min(axis=1, initial=np.inf)
        for measured in (flow, plain)
    )
    both = is_valid(flow) & is_valid(plain) & (before > flow.subset / 2)
    near, far = both & (away <= flow.subset / 2), both & (away > flow.subset / 2)
    assert near.sum() > 10
    assert far.sum() > 100
    same = flow.cameras == plain.cameras
    bias = np.trace(flow.bias, axis1=1, axis2=2) / np.trace(plain.bias, axis1=1, axis2=2)
    # One number for all points is what the cameras show of their bias in each flow.
    usual = np.median(bias[far & same])
    assert 0.5 < usual < 2.0
    np.testing.assert_allclose(bias[far & same], usual, rtol=1e-9)
    # Beside it an error of 0.006 px in place of what all points have.
    sure = np.trace(flow.bias, axis1=1, axis2=2)
    ratio = sure[near & same] / (sure / bias * usual)[near & same]
    assert ratio.max() - ratio.min() < 1e-9 * ratio.max()
    assert 4.0 < ratio.max() <= (0.006 / 0.002) ** 2 * (1.0 + 1e-9)


def test_points_that_noise_moves_by_a_tenth_of_a_pixel_have_too_little_texture():
    state = first_instant(example(), noisy_views(example_views("still"), NOISE, 1))
    scene = state.scene
    later = spline_pictures(noisy_views(example_views("still"), NOISE, 2), scene.smoothing)
    still = np.zeros((len(scene.point), 6, 3))
    match, noise = match_scene(scene, later, still, shape="affine")
    flow = accepted_flow(scene, match, noise)
    good = np.flatnonzero(is_valid(flow))[:200:2]
    # The first camera looks straight down: x and y are across its axis.
    by_noise = (flow.covariance - flow.bias)[good]
    lateral = np.sqrt(np.maximum(by_noise[:, 0, 0], by_noise[:, 1, 1]))
    for pixels, outcome in ((0.09, Outcome.VALID), (0.12, Outcome.TEXTURE)):
        # A pixel is as wide as the pitch, within the 2 % by which the surface is not a plane.
        covariance = match.covariance.copy()
        covariance[good] *= ((pixels * PITCH / lateral) ** 2)[:, None, None]
        flow = accepted_flow(scene, match._replace(covariance=covariance), noise)
        assert (flow.outcome[good] == outcome).all()


@pytest.mark.parametrize("step", [2, 5, 10])
def test_carried_noise_is_that_of_many_draws(step):
    """White noise of pixels, averaged over windows, is the noise of their displacements."""
    line = np.arange(SUBSET // 2, PIXELS - SUBSET // 2, step, dtype=float)
    pixel = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    point = np.column_stack([(pixel - pixel.mean(axis=0)) * PIXEL_PITCH, np.zeros(len(pixel))])
    tangent = np.tile(np.eye(3)[:2], (len(point), 1, 1))
    half_window = np.full(len(point), HALF_WINDOW)
    sigma = 1e-6
    covariance = np.tile(sigma**2 * np.eye(3), (len(point), 1, 1))
    rng, columns, squares = np.random.default_rng(0), pixel.astype(int).T, 0.0
    for _ in range(DRAWS):
        noise = rng.normal(size=(PIXELS, PIXELS, 3))
        window = sigma * SUBSET * cv2.blur(noise, (SUBSET, SUBSET))[columns[1], columns[0]]
        scatter = Scatter(point, pixel, window, covariance, 0.0 * covariance, SUBSET)
        field = local_field(scatter, point, tangent, reach=BEND_REACH * HALF_WINDOW)
        # The mean of a window whose curvature is known, when the curvature is wrong.
        bend = field.curvature[:, 0] + field.curvature[:, 2]
        moment = ((SUBSET * PIXEL_PITCH) ** 2 - PIXEL_PITCH**2) / 12.0
        squares += ((window - moment * bend) ** 2).mean(axis=1) / sigma**2 / DRAWS
    claimed = _inflation(scatter, field, half_window)
    # Neighbours lie on all sides in the middle, on one side at the rim, too few in a corner.
    # Squares of 180 draws scatter by a tenth, their mean over the points by a fiftieth. The half
    # window of 10 px claims a second moment that is a tenth smaller than that of 21 pixels.
    middle = np.abs(pixel - pixel.mean(axis=0)).max(axis=1) < 20.0
    known = np.isfinite(claimed)
    for chosen in (middle & known, ~middle & known):
        assert claimed[chosen].mean() == pytest.approx(squares[chosen].mean(), rel=0.08)
    assert claimed[middle & known].mean() > 1.3
