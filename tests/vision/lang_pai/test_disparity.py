"""Disparity of textures whose shift between the cameras is known."""

import numba
import numpy as np
import pytest
from vision.textures import Speckle, Warp, noisy, window_correlation

from palpate.vision.lang_pai.disparity import COLUMNS, ROWS, Views, disparity_map

SHAPE = (60, 90)
# Left of the reference and above it, as in the paper: the one sees a point to the right of where
# the reference sees it, the other below. The shorter baseline never meets whole pixels together
# with the longer one.
TRIPLE = Views(np.array([0, COLUMNS, ROWS]), np.array([0.0, 1.0, 0.7]), np.array([0.0, -3.4, 1.3]))
PAIR = Views(np.array([0, COLUMNS]), np.array([0.0, 1.0]), np.array([0.0, 0.0]))
# Pixels whose windows meet the texture in every camera, for disparities of 4 to 12.
INNER = (slice(3, -14), slice(10, -14))


def _views(disparity, views=TRIPLE, *, noise=0.0, seed=1):
    """Pictures of a speckled surface; its disparity is a function of the reference's pixels.

    The pixel of another camera shows the reference's x with x + shift(x) there: solved by fixed
    point, for shifts that change slowly.
    """
    texture = Speckle(SHAPE, seed)
    pictures = [texture.image()]
    for k in range(1, len(views.along)):
        along, ratio, offset = views.along[k], views.ratio[k], views.offset[k]

        def inverse(pixel, along=along, ratio=ratio, offset=offset):
            rest = pixel.copy()
            for _ in range(60):
                rest[:, along] = pixel[:, along] - offset - ratio * disparity(rest)
            return rest

        pictures.append(texture.image(Warp(inverse)))
    if noise:
        pictures = [noisy(picture, noise, k) for k, picture in enumerate(pictures)]
    return pictures


def _slanted(pixel):
    """Steep: 6 px over the picture."""
    return 6.0 + 0.05 * pixel[:, 0] + 0.02 * pixel[:, 1]


def _truth(disparity):
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    return disparity(np.stack([column.ravel(), row.ravel()], axis=1)).reshape(SHAPE)


@pytest.mark.parametrize("views", [PAIR, TRIPLE], ids=["pair", "triple"])
@pytest.mark.parametrize("noise", [0.0, 1.5])
def test_a_slanted_surface_is_matched_to_a_fraction_of_a_pixel(views, noise):
    disparity = disparity_map(_views(_slanted, views, noise=noise), views, (3.0, 14.0))
    off = (disparity - _truth(_slanted))[INNER]
    known = np.isfinite(off)
    assert known.mean() > 0.98
    # A parabola through correlations a pixel apart is good to a tenth of one; without it, or with
    # its sign reversed, 0.29 and 0.5 would be left.
    assert np.sqrt((off[known] ** 2).mean()) < 0.1
    assert abs(off[known].mean()) < 0.01


def test_it_is_the_best_sum_of_correlations_and_its_parabola():
    """One pixel at a time with numpy, at disparities that are whole pixels in camera 1."""
    pictures = _views(_slanted, noise=3.0)
    disparity = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    trials = np.arange(-2.0, 13.0) + 3.4
    rng = np.random.default_rng(0)
    column, row = rng.integers(14, SHAPE[1] - 18, 50), rng.integers(4, SHAPE[0] - 18, 50)
    pixel = np.stack([column, row], axis=1)
    score = np.zeros((len(trials), 50))
    for k, trial in enumerate(trials):
        for i in (1, 2):
            shift = TRIPLE.offset[i] + TRIPLE.ratio[i] * trial
            # A whole pixel, but for rounding.
            shift = round(shift) if abs(shift - round(shift)) < 1e-9 else shift
            move = shift * np.eye(2)[TRIPLE.along[i]]
            score[k] += [
                window_correlation(pictures[0], centre, pictures[i], centre + move, 3)
                for centre in pixel
            ]
    top = score.argmax(axis=0)
    before, peak, after = (score[top + k, np.arange(50)] for k in (-1, 0, 1))
    brute = trials[top] + 0.5 * (before - after) / (before - 2.0 * peak + after)
    known = np.isfinite(disparity[row, column])
    assert known.sum() > 45
    # Sums of squares of some 1e6 in double precision.
    np.testing.assert_allclose(disparity[row, column][known], brute[known], atol=1e-8)


def test_a_whole_pixel_between_all_cameras_is_found_as_such():
    """The windows are the same then; what is left is the parabola's: texture is not symmetric."""
    views = Views(TRIPLE.along, np.array([0.0, -1.0, 0.5]), np.array([0.0, 5.0, -2.0]))
    disparity = disparity_map(_views(lambda p: np.full(len(p), 8.0), views), views, (5.0, 11.0))
    off = disparity[INNER] - 8.0
    assert np.isfinite(off).mean() > 0.98
    # The maximum itself is at the whole pixel, so the vertex is no farther than half of one.
    assert np.nanmax(np.abs(off)) < 0.5
    assert np.nanstd(off) < 0.15
    assert abs(np.nanmean(off)) < 0.01


def test_three_cameras_are_better_than_two():
    pictures = _views(_slanted, noise=4.0)
    both = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    pair = Views(*(a[:2] for a in (TRIPLE.along, TRIPLE.ratio, TRIPLE.offset)))
    single = disparity_map(pictures[:2], pair, (3.0, 14.0))
    off = [np.nanstd((disparity - _truth(_slanted))[INNER]) for disparity in (both, single)]
    assert off[0] < 0.9 * off[1]


def test_limits_are_tried_to_their_ends_and_nothing_beyond():
    eight = _views(lambda p: np.full(len(p), 8.0))
    for limits in ((8.0, 12.0), (4.0, 8.0), (7.9, 8.1)):
        disparity = disparity_map(eight, TRIPLE, limits)[INNER]
        assert np.nanmax(np.abs(disparity - 8.0)) < 0.5
        assert np.isfinite(disparity).mean() > 0.98
    # A maximum at the end of the range is none: the surface is farther on.
    far = disparity_map(eight, TRIPLE, (11.0, 18.0))[INNER]
    assert np.isfinite(far).mean() < 0.1


def test_where_there_is_no_texture_there_is_no_disparity():
    pictures = _views(_slanted)
    pictures[0][20:40, 30:60] = noisy(np.full((20, 30), 90.0), 0.8, 3)
    disparity = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    assert np.isnan(disparity[23:37, 33:57]).all()
    # A window of 7 x 7 reaches three pixels out.
    assert np.isfinite(disparity[5:16, 30:60]).mean() > 0.95


def test_a_repeated_texture_is_in_doubt():
    """Stripes of five pixels along the disparity match at 4, 9 and 14."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]]
    grey = 110.0 + 40.0 * np.sin(2.0 * np.pi * column / 5.0) + 10.0 * np.sin(row)
    pictures = [grey, np.roll(grey, 4, axis=1)]
    assert np.isnan(disparity_map(pictures, PAIR, (2.0, 16.0))[INNER]).all()
    assert np.isfinite(disparity_map(pictures, PAIR, (2.0, 6.0))[INNER]).all()


def test_what_the_other_camera_does_not_see_has_no_disparity():
    """A near strip (12 px) hides what is beside it (6 px) from the other camera."""
    texture, strip = Speckle(SHAPE, 1).image(), Speckle(SHAPE, 2).image()
    reference, other = texture.copy(), np.roll(texture, 6, axis=1)
    reference[:, 30:50] = strip[:, 30:50]
    other[:, 42:62] = strip[:, 30:50]
    disparity = disparity_map([reference, other], PAIR, (3.0, 15.0))
    inner = slice(10, 50)
    assert np.nanmax(np.abs(disparity[inner, 33:47] - 12.0)) < 0.5
    assert np.nanmax(np.abs(disparity[inner, 60:75] - 6.0)) < 0.5
    # Columns 50 to 55 of the ground lie behind the strip there; windows around 50 and 51 hold more
    # of the strip than of the ground. Without the check for mutual matches 0.41 would be left.
    assert np.isfinite(disparity[inner, 52:56]).mean() < 0.25


def test_unknown_parts_of_a_picture_match_nothing():
    pictures = [picture.copy() for picture in _views(_slanted)]
    pictures[2][:, 40:60] = np.nan
    disparity = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    assert np.isnan(disparity[:, 37:63]).all()
    assert np.isfinite(disparity[INNER][:, :20]).mean() > 0.95
    edge = np.full(SHAPE, True)
    edge[3:-3, 3:-3] = False
    assert np.isnan(disparity[edge]).all()


def test_the_number_of_threads_does_not_matter():
    pictures = _views(_slanted, noise=2.0)
    before = numba.get_num_threads()
    first = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    try:
        numba.set_num_threads(1)
        second = disparity_map(pictures, TRIPLE, (3.0, 14.0))
    finally:
        numba.set_num_threads(before)
    np.testing.assert_array_equal(first, second)
