"""Pictures that focus or motion blurs as a whole: found, evened out, and no longer an error."""

import cv2
import numpy as np
import pytest
from vision.scenes import (
    PITCH,
    STILL,
    Stage,
    bump,
    dome,
    first_instant,
    followed,
    make_rig,
    noisy_views,
    rigid,
)

from palpate.vision.joint.sharpness import (
    _SMOOTHING,
    _window_variances,
    blur_difference,
    equally_sharp,
)
from palpate.vision.matching.scene import Match
from palpate.vision.range_flow import Outcome, is_valid
from palpate.vision.spline import spline_pictures

MOTION = bump((3e-4, -2e-4, 4e-4), 0.02)
NOISE = 1.5
STAGE = Stage(make_rig(3), dome(0.05), 4)


def _blurred(views, width):
    return [cv2.GaussianBlur(view, (0, 0), width) if width else view for view in views]


def _instants(first, later, motion=MOTION):
    return (
        noisy_views(_blurred(STAGE.views(), first), NOISE, 1),
        noisy_views(_blurred(STAGE.views(motion), later), NOISE, 2),
    )


def _prepared(state, moved):
    later = spline_pictures(moved, state.scene.smoothing)
    difference = blur_difference(state.scene, moved, later, state.motion)
    return equally_sharp(state.scene, moved, later, difference)


@pytest.mark.parametrize(("first", "later"), [(0.0, 1.2), (1.2, 0.0)])
def test_the_sharper_picture_is_blurred_as_the_other_is(first, later):
    rest, moved = _instants(first, later, STILL)
    state = first_instant(STAGE, rest)
    there, pictures = _prepared(state, moved)
    # Both show the view behind 1.2 px and the usual low-pass.
    for ours, theirs, plain in zip(there.pictures, pictures, STAGE.views(), strict=True):
        wanted = cv2.GaussianBlur(plain, (0, 0), float(np.hypot(1.2, _SMOOTHING)))
        inner = np.s_[6:-6, 6:-6]
        for grey in (ours.grey, theirs.grey):
            # Noise of 1.5 is 0.4 after the low-pass; unlike widths differ by 5 grey levels.
            assert np.sqrt(np.mean((grey[inner] - wanted[inner]) ** 2)) < 1.5
    # Noise is correlated as far as in the picture that is not blurred further: that has most of it.
    assert there.smoothing == _SMOOTHING


def test_pictures_that_are_equally_sharp_stay_as_they_are():
    rest, moved = _instants(0.8, 0.8)
    state = first_instant(STAGE, rest)
    there, pictures = _prepared(state, moved)
    for ours, before in zip(there.pictures, state.scene.pictures, strict=True):
        # A hundredth of a pixel is found where there is none.
        np.testing.assert_allclose(ours.grey, before.grey, atol=0.5)
    assert len(pictures) == 3


@pytest.mark.parametrize(("first", "later"), [(0.0, 1.2), (1.2, 0.0)])
def test_blur_costs_contrast_and_nothing_else(first, later):
    """Without it the errors are 1.5 claimed sigmas and three times as large."""
    rest, moved = _instants(first, later)
    flow = next(followed(first_instant(STAGE, rest), [moved]))
    good = is_valid(flow)
    assert good.sum() > 850
    error = (flow.displacement - MOTION(flow.point))[good]
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(flow.covariance[good]), error)
    assert 0.8 < np.sqrt(square.mean() / 3.0) < 1.2
    assert np.sqrt((error[:, :2] ** 2).mean()) < 0.03 * PITCH


@pytest.mark.parametrize("turn", [0.0, 0.1])
def test_a_window_tells_by_how_much_it_was_blurred(turn):
    """A slight blur adds half its variance times the Laplacian; light that is added, shading along
    the rows, and a turn that the match has found are no blur."""
    spin = rigid((0.0, 0.0, turn), (0.0, 0.0, 0.0))
    scene = first_instant(STAGE, STAGE.views()).scene
    rows = np.flatnonzero(scene.seen.all(axis=1))[::40]
    motion = np.zeros((len(rows), 6, 3))
    motion[:, 0] = spin(scene.point[rows])
    ahead = scene.half_window[rows, None, None] * scene.tangent[rows]
    motion[:, 1:3] = spin(ahead)
    variance = 0.2
    slight = np.array([variance / 2, 1.0 - variance, variance / 2])
    plain = STAGE.views(spin)
    blurred = [cv2.sepFilter2D(view, -1, slight, slight) for view in plain]
    shaded = [view + 12.0 + np.linspace(0.0, 30.0, view.shape[1]) for view in blurred]
    for views, wanted in ((plain, 0.0), (blurred, variance), (shaded, variance)):
        for camera, later in enumerate(spline_pictures(views, scene.smoothing)):
            estimated = _window_variances(scene, later, rows, matched(motion), camera)
            # The mean of both Laplacians leaves the third order; a picture that was rendered turned
            # is as sharp as the first to a hundredth of a square pixel.
            np.testing.assert_allclose(np.median(estimated), wanted, rtol=0.03, atol=0.01)


def matched(motion):
    """All windows found, in all cameras."""
    count = len(motion)
    return Match(
        motion, *[None] * 6, np.ones((count, 3), dtype=bool), np.full(count, Outcome.VALID)
    )
