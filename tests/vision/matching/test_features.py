"""Displacements of scattered points: features under a known warp, interpolation, outliers."""

import numpy as np
import pytest
from vision.textures import Speckle, affine, noisy, turned

from palpate.vision.matching.features import (
    Features,
    Samples,
    feature_matches,
    find_features,
    interpolated,
    match_features,
    nodes,
)
from palpate.vision.normalisation import NormalisedImage, make_normalised_image

SHAPE = (180, 220)
WARP = affine(turned(25.0, 0.08), (22.0, -17.0), (110.0, 90.0))
ALL = np.ones(SHAPE, dtype=bool)


def _pair(warp=WARP):
    texture = Speckle(SHAPE, 4)
    return (
        noisy(texture.image(w), 1.5, 1).astype(np.uint8)
        for w in (affine(np.eye(2), (0, 0), (0, 0)), warp)
    )


def test_features_follow_a_turn_a_strain_and_a_shift():
    matches = feature_matches(*_pair(), ALL, ALL)
    gap = np.linalg.norm(matches.displacement - WARP.displacement(matches.point), axis=1)
    assert len(matches.point) > 80
    # Features are good to about a pixel; the agreement of neighbours leaves no mistaken one.
    assert np.median(gap) < 0.5
    assert gap.max() < 5.0


def test_features_keep_to_their_areas():
    left, right = ALL.copy(), ALL.copy()
    left[:, 100:], right[:, :90] = False, False
    matches = feature_matches(*_pair(), left, right)
    assert len(matches.point) > 5
    assert matches.point[:, 0].max() < 100.5
    assert (matches.point + matches.displacement)[:, 0].min() > 89.0


def test_no_features_where_there_is_nothing():
    rest, moved = _pair()
    none, flat = np.zeros(SHAPE, dtype=bool), np.full(SHAPE, 128, dtype=np.uint8)
    few = none.copy()
    few[60:63, 60:63] = True
    for first, second, area in ((rest, moved, none), (flat, moved, ALL), (rest, moved, few)):
        assert len(feature_matches(first, second, area, ALL).point) == 0
        assert len(feature_matches(second, first, ALL, area).point) == 0


def test_unrelated_pictures_give_next_to_no_matches():
    rest, _ = _pair()
    other = noisy(Speckle(SHAPE, 9).image(), 1.5, 1).astype(np.uint8)
    # Of some hundred mistaken pairs three neighbours agree by chance in a few at most.
    assert len(feature_matches(rest, other, ALL, ALL).point) < 10


def _scattered(count, seed, warp=WARP):
    point = np.random.default_rng(seed).uniform(0.0, 1.0, (count, 2)) * [219.0, 179.0]
    return Samples(point, warp.displacement(point))


def test_affine_motion_is_interpolated_but_for_the_ridge():
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    truth = WARP.displacement(np.stack([column.ravel(), row.ravel()], axis=1).astype(float))
    gap = interpolated(_scattered(400, 1), SHAPE) - truth.reshape(*SHAPE, 2)
    inner = np.abs(gap[16:-16, 16:-16])
    # The ridge takes half a per cent of the slope, 0.45, over the 11 px to the next samples.
    assert np.median(inner) < 0.03
    assert inner.max() < 0.5


def test_mistaken_samples_are_overruled():
    samples = _scattered(400, 1)
    bad = np.random.default_rng(2).permutation(400)[:80]
    displacement = samples.displacement.copy()
    displacement[bad] += np.random.default_rng(3).uniform(-90.0, 90.0, (80, 2))
    clean = interpolated(samples, SHAPE)[16:-16, 16:-16]
    gap = np.abs(interpolated(Samples(samples.point, displacement), SHAPE)[16:-16, 16:-16] - clean)
    # A fifth mistaken, two or three of each dozen: within the reach of a search nearly everywhere.
    assert np.median(gap) < 0.1
    assert np.percentile(gap, 95) < 2.0


def test_at_a_jump_one_side_wins():
    samples = _scattered(1500, 1, affine(np.eye(2), (0.0, 0.0), (0.0, 0.0)))
    right = samples.point[:, 0] > 110.0
    jump = np.where(right[:, None], [30.0, 0.0], 0.0)
    motion = interpolated(Samples(samples.point, jump), SHAPE)
    column = nodes(SHAPE)[1][0]
    at_nodes = motion[nodes(SHAPE)][..., 0]
    between = (np.abs(at_nodes) > 2.0) & (np.abs(at_nodes - 30.0) > 2.0)
    assert between.mean() < 0.03
    assert (np.abs(at_nodes[:, column < 90]) < 1.0).all()
    assert (np.abs(at_nodes[:, column > 130] - 30.0) < 1.0).all()


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_samples_give_their_shift(count):
    samples = Samples(np.full((count, 2), 50.0), np.tile([4.0, -3.0], (count, 1)))
    # The ridge on the shift is 1/2000 of that on the slope, which takes as much of it.
    np.testing.assert_allclose(
        interpolated(samples, SHAPE), [[[4.0, -3.0]] * SHAPE[1]] * SHAPE[0], atol=0.01
    )


def test_there_and_back_are_the_same_samples():
    samples = _scattered(20, 1)
    back = samples.reversed()
    # Where the points went, the inverse of the warp leads back.
    np.testing.assert_allclose(back.point + back.displacement, samples.point, atol=1e-12)
    np.testing.assert_allclose(WARP.inverse(back.point), samples.point, atol=1e-10)
    again = back.reversed()
    np.testing.assert_allclose(again.point, samples.point, atol=1e-12)
    np.testing.assert_allclose(again.displacement, samples.displacement)
    both = samples.joined(again)
    assert both.point.shape == both.displacement.shape == (40, 2)


def _picture(grey: np.ndarray) -> NormalisedImage:
    """A picture as given, all of it textured."""
    flat = np.zeros(grey.shape, dtype=np.float32)
    return NormalisedImage(
        grey.astype(np.float32),
        grey.astype(np.uint8),
        flat,
        flat,
        np.ones(grey.shape, dtype=bool),
        2.0,
    )


@pytest.mark.parametrize("shape", [(300, 400), (1700, 1600)])
def test_a_blob_is_found_where_it_is(shape):
    """The larger picture is halved; places are those of the whole one."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    square = (column - 201.0) ** 2 + (row - 133.0) ** 2
    features = find_features(_picture(30.0 + 200.0 * np.exp(-0.5 * square / 6.0**2)))
    distance = np.linalg.norm(features.point - [201.0, 133.0], axis=1)
    # A twentieth of the blob's width; half a pixel would be a pixel's corner taken for its centre.
    assert distance.min() < 0.3


def test_blank_pictures_have_none():
    blank = make_normalised_image(np.full((80, 90), 70.0, dtype=np.float32))
    features = find_features(blank)
    assert features.point.shape == (0, 2)
    assert match_features(features, features).point.shape == (0, 2)


def test_only_clear_mutual_choices_match():
    rng = np.random.default_rng(0)
    words = np.rint(rng.uniform(0.0, 100.0, size=(6, 128))).astype(np.float32)
    pixel = rng.uniform(0.0, 100.0, size=(6, 2))
    first = Features(pixel, words)
    # The third feature occurs twice, the fifth and sixth not at all.
    twice = words[2] + np.rint(rng.normal(size=128)).astype(np.float32)
    second = Features(
        np.vstack([pixel[:4] + 5.0, [[1.0, 1.0]]]), np.vstack([words[:4] + 1.0, [twice]])
    )
    matches = match_features(first, second)
    np.testing.assert_array_equal(matches.point, pixel[[0, 1, 3]])
    np.testing.assert_array_equal(matches.moved, pixel[[0, 1, 3]] + 5.0)
