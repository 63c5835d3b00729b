"""Features: where they are, also in halved pictures, and which are taken for the same."""

import numpy as np
import pytest

from palpate.vision.images.features import Features, find_features, match_features
from palpate.vision.images.normalisation import NormalisedImage, make_normalised_image


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
    found = find_features(_picture(30.0 + 200.0 * np.exp(-0.5 * square / 6.0**2)))
    distance = np.linalg.norm(found.point - [201.0, 133.0], axis=1)
    # A twentieth of the blob's width; half a pixel would be a pixel's corner taken for its centre.
    assert distance.min() < 0.3


def test_blank_pictures_have_none():
    blank = make_normalised_image(np.full((80, 90), 70.0, dtype=np.float32))
    found = find_features(blank)
    assert found.point.shape == (0, 2)
    assert match_features(found, found).first.shape == (0, 2)


def test_only_clear_mutual_choices_match():
    rng = np.random.default_rng(0)
    words = np.rint(rng.uniform(0.0, 100.0, size=(6, 128))).astype(np.float32)
    place = rng.uniform(0.0, 100.0, size=(6, 2))
    first = Features(place, words)
    # The third feature occurs twice, the fifth and sixth not at all.
    twice = words[2] + np.rint(rng.normal(size=128)).astype(np.float32)
    second = Features(
        np.vstack([place[:4] + 5.0, [[1.0, 1.0]]]), np.vstack([words[:4] + 1.0, [twice]])
    )
    found = match_features(first, second)
    np.testing.assert_array_equal(found.first, place[[0, 1, 3]])
    np.testing.assert_array_equal(found.second, place[[0, 1, 3]] + 5.0)
