"""The dense start on analytic and rendered pictures: truth, what must not be trusted, laws."""

import tomllib
from functools import cache

import cv2
import numpy as np
import pytest
from vision.textures import STILL, Speckle, affine, inverse_quadratic, noisy, pixel_grid, turned

from palpate.errors import InputError
from palpate.vision.matching.dense_flow import DenseStart, _finished, dense_start
from palpate.vision.matching.features import Samples
from palpate.vision.normalisation import make_normalised_image

SHAPE = (255, 301)
CENTRE = (150.0, 127.0)
WHOLE = np.eye(2)
BENT = np.array([[-9.0, 0.0, 0.0, 3e-4, 1e-4, -2e-4], [6.0, 0.02, 0.0, -2e-4, 3e-4, 2e-4]])
CASES = {
    "still": {"warp": STILL},
    "little": {"warp": affine(WHOLE, (0.4, -0.3), CENTRE)},
    "shift": {"warp": affine(WHOLE, (6.3, -2.4), CENTRE)},
    "far": {"warp": affine(WHOLE, (26.3, -15.4), CENTRE)},
    "turned": {"warp": affine(turned(10.0), (0.0, 0.0), CENTRE)},
    "stretched": {"warp": affine(turned(0.0, 0.1), (0.0, 0.0), CENTRE)},
    "all": {"warp": affine(turned(10.0, 0.1), (-40.0, 25.0), CENTRE)},
    "bent": {"warp": inverse_quadratic(BENT, CENTRE)},
    "darker": {"warp": affine(turned(4.0, 0.03), (6.0, 3.0), CENTRE), "gain": 0.7, "offset": 20.0},
    "noise": {"warp": affine(turned(4.0, 0.03), (6.0, 3.0), CENTRE), "noise": 5.0},
    "fine": {"warp": affine(turned(4.0, 0.03), (16.0, 9.0), CENTRE), "sigma": 1.2},
    "wide": {"warp": affine(turned(4.0, 0.03), (6.0, 3.0), CENTRE), "sigma": 5.0},
}


def _pair(warp, *, shape=SHAPE, sigma=1.7, noise=1.5, gain=1.0, offset=0.0):
    texture = Speckle(shape, 5, sigma)
    moved = gain * texture.image(warp) + offset
    return noisy(texture.image(), noise, 1), noisy(moved, noise, 2)


@cache
def _case(name):
    """Pictures of one of `CASES`."""
    return _pair(**CASES[name])


def _error(start, truth):
    return np.hypot(*np.moveaxis(start.flow - truth, -1, 0))


def _in_picture(truth):
    pixel = pixel_grid(truth.shape[:2]) + truth
    last = np.array(truth.shape[1::-1]) - 1
    return ((pixel >= 0.0) & (pixel <= last)).all(axis=-1)


@pytest.mark.parametrize("name", CASES)
def test_affine_and_bent_motions_are_found(name):
    """Half a pixel is promised, a pixel near edges: so for 95 and 99 of a hundred pixels.

    Halving the pictures for wide texture makes the start twice as coarse.
    """
    case = CASES[name]
    start = dense_start(*_case(name))
    truth = case["warp"].flow(SHAPE)
    inside = _in_picture(truth)
    wrong = _error(start, truth)[start.trusted]
    scale = 2.0 if name == "wide" else 1.0
    assert np.median(wrong) < 0.25 * scale
    assert np.percentile(wrong, 95) < 0.6 * scale
    assert np.percentile(wrong, 99) < 1.0 * scale
    # A margin of a window around the picture may be lost where the motion is large: 10 %.
    assert start.trusted[inside].mean() > 0.9
    assert start.trusted[~inside].mean() < 0.1 if (~inside).any() else True
    assert start.flow.dtype == np.float32


def test_small_motions_are_not_hurt_by_the_search_for_large_ones():
    warp = CASES["little"]["warp"]
    wrong = _error(dense_start(*_case("little")), warp.flow(SHAPE))
    # A tenth of a pixel is what OpenCV's search alone leaves of half a pixel.
    assert np.percentile(wrong, 99) < 0.1


@pytest.mark.parametrize("sigma", [1.7, 5.0])
def test_a_hundred_pixels_with_a_turn_and_a_strain(sigma):
    shape = (400, 480)
    warp = affine(turned(10.0, 0.1), (-80.0, 60.0), (240.0, 200.0))
    start = dense_start(*_pair(warp, shape=shape, sigma=sigma))
    truth = warp.flow(shape)
    wrong = _error(start, truth)[start.trusted]
    scale = 1.0 if sigma < 3.0 else 2.0
    assert np.percentile(wrong, 95) < 0.6 * scale
    assert np.percentile(wrong, 99) < 1.0 * scale
    assert start.trusted[_in_picture(truth)].mean() > 0.85


@pytest.mark.parametrize("name", [*CASES, "swung"])
def test_features_are_only_needed_where_a_search_explains_next_to_nothing(name, monkeypatch):
    """They cost more than all the rest; where some of the motion is found, it is continued."""
    looked_for = []

    def count(*_):
        looked_for.append(1)
        return Samples(np.zeros((0, 2)), np.zeros((0, 2)))

    monkeypatch.setattr("palpate.vision.matching.dense_flow.feature_matches", count)
    swung = {"warp": affine(turned(5.0, 0.05), (25.0, 0.0), (240.0, 200.0)), "shape": (400, 480)}
    start = dense_start(*(_case(name) if name in CASES else _pair(**swung)))
    assert bool(looked_for) == (name in ("far", "all"))
    if not looked_for:
        assert start.trusted.mean() > 0.8


def test_the_last_search_makes_up_for_a_start_that_is_off():
    """A pixel and a half off, in a turn and a strain: the start is taken from where it applies."""
    warp = affine(turned(10.0, 0.1), (4.0, 2.0), CENTRE)
    a, b = (make_normalised_image(grey) for grey in _pair(warp))
    truth = warp.flow(SHAPE)
    off = (truth + np.array([1.2, -0.9])).astype(np.float32)
    flow, trusted = _finished(a, b, off)
    wrong = np.hypot(*np.moveaxis(flow - truth, -1, 0))[trusted]
    # Taken from the pixel itself it would be wrong by slope times change, 0.2 x 1.5 px.
    assert np.median(wrong) < 0.15


def _ball(pixel):
    return np.hypot(pixel[..., 0] - CENTRE[0], pixel[..., 1] - CENTRE[1]) < 80.0


def _scene(warp, *, rod=None, background=None):
    """A textured ball that moves before a dark or a textured ground, behind a rod at last."""
    texture = Speckle(SHAPE, 5)
    at_rest, source = _ball(pixel_grid(SHAPE)), warp.source(SHAPE)
    ground = np.full(SHAPE, 12.0) if background is None else background
    rest = np.where(at_rest, texture.image(), ground)
    moved = np.where(_ball(source), texture.image(warp), ground)
    if rod is not None:
        moved = np.where(rod(pixel_grid(SHAPE)), 15.0, moved)
    return noisy(rest, 1.5, 1), noisy(moved, 1.5, 2), at_rest


@pytest.mark.parametrize("shift", [(6.0, -3.0), (45.0, -30.0)])
def test_a_ball_before_a_dark_ground(shift):
    warp = affine(turned(5.0, 0.03), shift, CENTRE)
    rest, moved, ball = _scene(warp)
    start = dense_start(rest, moved)
    wrong = _error(start, warp.flow(SHAPE))[start.trusted & ball]
    assert np.percentile(wrong, 99) < 1.0
    assert start.trusted[ball].mean() > 0.95
    # Of the ground only what is in a window with the outline may be trusted, 10.5 px along the
    # diagonal too.
    column, row = np.moveaxis(pixel_grid(SHAPE), -1, 0)
    assert not start.trusted[
        np.hypot(column - CENTRE[0], row - CENTRE[1]) > 80.0 + 10.5 * np.sqrt(2.0)
    ].any()


def _rod(pixel):
    column, row = pixel[..., 0], pixel[..., 1]
    return (np.abs(column - 140.0 - 0.3 * (row - 127.0)) < 15.0) & (row < 140.0)


@pytest.mark.parametrize("shift", [(1.0, -1.0), (15.0, 12.0)])
def test_what_a_rod_hides_is_not_trusted(shift):
    """Less than 1 % of the trusted pixels may be wrong, here by more than a pixel."""
    warp = affine(turned(2.0, 0.02), shift, CENTRE)
    rest, moved, ball = _scene(warp, rod=_rod)
    start = dense_start(rest, moved)
    truth = warp.flow(SHAPE)
    trusted = start.trusted & ball
    hidden = ball & _rod(pixel_grid(SHAPE) + truth)
    assert hidden.mean() > 0.02  # the rod is there
    assert (_error(start, truth)[trusted] > 1.0).mean() < 0.01
    assert (trusted & hidden).sum() < 0.01 * trusted.sum()
    # A strip of half a window on both sides of the rod goes with it.
    assert trusted[ball & ~hidden].mean() > 0.85


def test_what_is_hidden_is_not_searched_for(monkeypatch):
    """The rod hides a tenth of the ball; the moved picture has nothing that is not explained."""

    def refuse(*_):
        pytest.fail("the motion was continued")

    monkeypatch.setattr("palpate.vision.matching.dense_flow._repaired", refuse)
    rest, moved, ball = _scene(affine(turned(0.3, 0.01), (1.0, -1.0), CENTRE), rod=_rod)
    assert dense_start(rest, moved).trusted[ball].mean() > 0.7


def test_a_mask_holds_the_object_against_a_textured_ground():
    warp = affine(turned(5.0, 0.03), (32.0, -24.0), CENTRE)
    rest, moved, ball = _scene(warp, background=Speckle(SHAPE, 6).image())
    start = dense_start(rest, moved, mask=ball)
    assert not start.trusted[~ball].any()
    wrong = _error(start, warp.flow(SHAPE))[start.trusted]
    assert (wrong > 1.0).mean() < 0.02
    # Half a window inside the outline the ball's circle keeps (70 / 80)^2 = 77 % of its area.
    assert start.trusted[ball].mean() > 0.75


def test_a_masked_object_may_be_small_in_a_large_textured_picture():
    """Less than a hundredth of the picture, but all that is wanted."""
    shape, centre = (400, 480), np.array([240.0, 200.0])
    texture, ground = Speckle(shape, 5), Speckle(shape, 6).image()
    warp = affine(WHOLE, (40.0, -30.0), tuple(centre))
    inside = np.linalg.norm(pixel_grid(shape) - centre, axis=2) < 24.0
    moved_inside = np.linalg.norm(warp.source(shape) - centre, axis=2) < 24.0
    rest = noisy(np.where(inside, texture.image(), ground), 1.5, 1)
    moved = noisy(np.where(moved_inside, texture.image(warp), ground), 1.5, 2)
    start = dense_start(rest, moved, mask=inside)
    assert inside.mean() < 0.01
    # Half a window inside the outline (13.5 / 24)^2 = 32 % of its area are left, along the
    # window's diagonal (9.2 / 24)^2 = 15 %.
    assert start.trusted[inside].mean() > 0.1
    assert np.percentile(_error(start, warp.flow(shape))[start.trusted], 95) < 1.0


def test_the_same_for_any_number_of_threads():
    rest, moved, _ = _scene(affine(turned(6.0, 0.05), (35.0, -20.0), CENTRE))
    before = cv2.getNumThreads()
    try:
        results = []
        for threads in (1, 2, 3):
            cv2.setNumThreads(threads)
            results.append(dense_start(rest, moved))
    finally:
        cv2.setNumThreads(before)
    for other in results[1:]:
        np.testing.assert_array_equal(other.flow, results[0].flow)
        np.testing.assert_array_equal(other.trusted, results[0].trusted)


def test_scale_of_the_grey_levels_does_not_matter():
    rest, moved = _pair(CASES["shift"]["warp"])
    start = dense_start(rest, moved)
    other = dense_start(257.0 * rest + 1000.0, 257.0 * moved + 1000.0)
    # Roundings flip single levels of the evened pictures: hundredths of a pixel.
    assert np.abs(other.flow - start.flow)[start.trusted].max() < 0.1
    assert (other.trusted != start.trusted).mean() < 1e-3


def test_there_and_back_is_nowhere():
    rest, moved = _pair(CASES["bent"]["warp"])
    there, back = dense_start(rest, moved), dense_start(moved, rest)
    target = (pixel_grid(SHAPE) + there.flow).astype(np.float32)
    left = there.flow + cv2.remap(back.flow, target, None, cv2.INTER_LINEAR)
    both = there.trusted & (cv2.remap(back.trusted.astype(np.float32), target, None, 1) > 0.99)
    # Two errors of half a pixel.
    assert both.mean() > 0.8
    assert np.percentile(np.hypot(*np.moveaxis(left[both], -1, 0)), 99) < 1.0


@pytest.mark.parametrize("sigma", [1.2, 1.7, 5.0])
def test_different_textures_are_not_trusted(sigma):
    first = noisy(Speckle(SHAPE, 5, sigma).image(), 1.5, 1)
    other = noisy(Speckle(SHAPE, 6, sigma).image(), 1.5, 2)
    # Chance agreement in one of a hundred windows is what the threshold on the correlation allows.
    assert dense_start(first, other).trusted.mean() < 0.02


def test_without_texture_nothing_is_trusted():
    rest, moved = _pair(STILL)
    flat = np.full(SHAPE, 80.0, dtype=np.float32)
    for first, second in ((flat, flat), (flat, moved), (rest, flat), (noisy(flat, 2.0, 1), flat)):
        start = dense_start(first, second)
        assert not start.trusted.any()
        assert np.isfinite(start.flow).all()
    nothing = dense_start(rest, moved, mask=np.zeros(SHAPE, dtype=bool))
    assert not nothing.trusted.any()
    assert not nothing.flow.any()


def test_a_small_object_may_touch_a_corner():
    """The part that is searched is cut out and put back at its place."""
    warp = affine(WHOLE, (3.0, 2.0), CENTRE)
    texture, dark = Speckle(SHAPE, 5), np.full(SHAPE, 12.0)
    corner = np.zeros(SHAPE, dtype=bool)
    corner[-34:, -30:] = True
    rest = noisy(np.where(corner, texture.image(), dark), 1.5, 1)
    moved = noisy(np.where(np.roll(corner, (2, 3), (0, 1)), texture.image(warp), dark), 1.5, 2)
    start = dense_start(rest, moved)
    inner = np.zeros(SHAPE, dtype=bool)
    inner[-24:-8, -20:-8] = True
    assert start.trusted[inner].all()
    assert _error(start, warp.flow(SHAPE))[inner].max() < 1.0
    assert start.flow.shape == (*SHAPE, 2)


def test_bad_pictures_are_refused():
    rest, moved = _pair(STILL)
    with pytest.raises(InputError, match="must be one shape"):
        dense_start(rest, moved[:-1].copy())
    with pytest.raises(InputError, match="must be one shape"):
        dense_start(rest, moved, mask=np.ones((3, 4), dtype=bool))
    with pytest.raises(InputError, match="41 rows and 301 columns; must have 42"):
        dense_start(rest[:41].copy(), moved[:41].copy())
    for first, second, name in ((rest, moved, "moved"), (moved, rest, "rest")):
        hole = moved.copy()
        hole[3, 4] = np.nan
        pair = (first, hole) if second is moved else (hole, second)
        with pytest.raises(InputError, match=f"1 of {rest.size} grey levels of the {name}"):
            dense_start(*pair)


def _rendered(folder, step):
    """Pictures, true displacement of the reference camera's pixels, and where it is known."""
    camera = tomllib.loads((folder / "rig.toml").read_text())["camera"][0]
    motion = tomllib.loads((folder / "truth.toml").read_text())["step"][step]
    truth = np.load(folder / "truth_s0.npz")
    point = truth["X"].astype(np.float64)
    turn, shift = cv2.Rodrigues(np.array(camera["R"]))[0], np.array(camera["t"])

    def project(points):
        inner, bent = np.array(camera["K"]), np.array(camera["distortion"])
        return cv2.projectPoints(points, turn, shift, inner, bent)[0][:, 0]

    shape = tuple(int(n) for n in truth["shape"])
    flow, known = np.full((*shape, 2), np.nan), np.zeros(shape, dtype=bool)
    moved = point @ np.array(motion["R"]).T + np.array(motion["t"])
    flow.reshape(-1, 2)[truth["pixel"]] = project(moved) - project(point)
    known.ravel()[truth["pixel"]] = True
    names = (folder / "images" / f"{name}_c0.png" for name in ("s0", f"s{step}"))
    rest, loaded = (cv2.imread(str(name), cv2.IMREAD_GRAYSCALE) for name in names)
    return rest.astype(np.float32), loaded.astype(np.float32), flow, known


@pytest.mark.parametrize(("name", "step"), [("rigid_translation_x", 8), ("rigid_rotation_z", 4)])
def test_rendered_solid(shared_data, name, step):
    """35 px of translation; 8 degrees of turn, by which faces shrink by a quarter."""
    rest, moved, flow, known = _rendered(shared_data / name, step)
    start = dense_start(rest, moved)
    wrong = _error(start, flow)[start.trusted & known]
    assert start.trusted[known].mean() > 0.9
    assert np.median(wrong) < 0.3
    assert np.percentile(wrong, 95) < 1.0
    # The reach of a refinement is 2 to 3 px.
    assert np.percentile(wrong, 99) < 2.0


def test_any_number_of_places_is_sampled():
    """More than the 32,766 columns of a picture that OpenCV maps at once; some beyond the edge."""
    column, row = np.meshgrid(np.arange(60.0), np.arange(50.0))
    flow = np.stack([0.1 * column - 0.3 * row, 0.2 * row + 1.0], axis=-1).astype(np.float32)
    start = DenseStart(flow, column < 30.0)
    pixel = np.random.default_rng(3).uniform(-4.0, [63.0, 53.0], size=(40_000, 2))
    step, trusted = start.at(pixel)
    x, y = pixel.T
    inside = (pixel >= 0.0).all(axis=1) & (pixel <= [59.0, 49.0]).all(axis=1)
    # OpenCV rounds places to a 32nd of a pixel: half of it times the slopes of the flow.
    wanted = np.stack([0.1 * x - 0.3 * y, 0.2 * y + 1.0], axis=1)
    np.testing.assert_allclose(step[inside], wanted[inside], atol=0.4 / 64.0 + 1e-5)
    sure = np.abs(x - 29.5) > 1.0 / 64.0
    np.testing.assert_array_equal(trusted[inside & sure], (x < 29.5)[inside & sure])
    assert not trusted[(pixel < -1.0).any(axis=1) | (pixel > [60.0, 50.0]).any(axis=1)].any()
    assert start.at(pixel[:0])[0].shape == (0, 2)
