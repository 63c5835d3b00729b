"""Pictures of the bench: exposure, shadows, the rod, blur, and the statistics of noise."""

from dataclasses import replace

import numpy as np
import pytest
from lab.lab_configs import HALF_BALL

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab import Look, Pictures, choose_variant, read_lab_config
from palpate.lab.head import make_head
from palpate.lab.specimens import rod
from palpate.lab.studio import (
    blur_radius,
    defocused,
    exposure,
    exposure_gain,
    grey_picture,
    make_studio,
    photograph,
    shot_noise,
)

QUIET = Pictures(samples=8, noise=0.0)
PLAIN = Pictures(response=0.0, noise=0.0)
GAIN = 100.0
SHAPE = (300, 400)
# Pixels in a picture; the relative error of a variance is sqrt(2 / COUNT) = 0.4 %.
COUNT = SHAPE[0] * SHAPE[1]


@pytest.fixture(scope="module")
def config(tmp_path_factory):
    file = tmp_path_factory.mktemp("photographs") / "config.toml"
    file.write_text(HALF_BALL)
    return replace(read_lab_config(file), pictures=QUIET)


@pytest.fixture(scope="module")
def studio(config):
    rig = make_head(config.head, config.specimen.mesh)
    return make_studio(config, rig, choose_variant(), rng=np.random.default_rng(0))


def _picture(studio, config, arm=None, seed=0):
    """Pictures of the same scene by the chip of another configuration."""
    studio = replace(studio, config=config)
    rest, rng = [studio.mesh.vertices], np.random.default_rng(seed)
    return [picture.astype(float) for picture in photograph(studio, rest, arm, rng=rng)]


@pytest.fixture(scope="module")
def bare(studio, config):
    """What the cameras see of the specimen alone."""
    return _picture(studio, config)


def test_exposure_brings_the_bright_parts_near_white_and_not_beyond(bare):
    for picture in bare:
        lit = picture[picture > 20]
        assert 180 < np.quantile(lit, 0.99) <= 250
        # A few pixels in ten thousand shine brighter than the exposure allows for.
        assert (picture >= 255).mean() < 1e-3
        assert picture[0, 0] == 0.0


def test_a_rod_is_dark_hides_and_casts_a_soft_shadow(studio, config, bare):
    tip = np.array([0.0, 0.0, 0.046])
    upright = rod(np.array([[0.0, -6e-3], [4e-3, 4e-3]]), radius=6e-3, length=0.2)
    arm = TriangleMesh(tip + upright.vertices, upright.triangles)
    bare, probed = bare[0], _picture(studio, config, arm)[0]
    darker = bare - probed
    # Bright speckles behind the rod are gone; around it some light is.
    assert (darker > 100).sum() > 30
    assert ((darker > 5) & (darker < 60)).sum() > 100
    far = probed[120:, :][bare[120:, :] > 20] - bare[120:, :][bare[120:, :] > 20]
    assert abs(far.mean()) < 1.0


def test_noise_is_what_was_asked_for_and_new_in_every_picture(studio, config):
    loud = replace(config, pictures=replace(QUIET, noise=3.0))
    a, b = (_picture(studio, loud, seed=seed)[0] for seed in (1, 2))
    bright = (a > 30) & (a < 225)
    # Rounding adds 1/12; the renderer's own noise is below one grey level.
    assert (a - b)[bright].std() / np.sqrt(2) == pytest.approx(3.05, abs=0.25)
    again = _picture(studio, loud, seed=1)[0]
    np.testing.assert_array_equal(again, a)


def test_gain_drifts_from_picture_to_picture(studio, config, bare):
    drifting = replace(config, pictures=replace(QUIET, gain_drift=0.1))
    ratio = []
    for seed in range(4):
        picture = _picture(studio, drifting, seed=seed)
        for drifted, plain in zip(picture, bare, strict=True):
            middle = (plain > 40) & (drifted < 250)
            ratio.append(np.median(drifted[middle] / plain[middle]))
    # 12 draws: a fifth of chance.
    assert 0.05 < np.std(ratio) < 0.16


def test_blurs_of_motion_and_of_defocus_take_contrast_away(studio, config, bare):
    sharp = bare[0]
    rest = studio.mesh.vertices
    moving = replace(config, pictures=replace(QUIET, motion_blur=0.5))
    frames = exposure(moving, rest, rest + np.array([3e-3, 0.0, 0.0]))
    assert len(frames) == 5
    np.testing.assert_allclose(frames[0] - rest, np.broadcast_to([1.5e-3, 0, 0], rest.shape),
                               atol=1e-12)  # fmt: skip
    assert len(exposure(config, rest, rest)) == 1
    rng = np.random.default_rng(0)
    moved = photograph(replace(studio, config=moving), frames, rng=rng)[0]
    open_lens = replace(config, pictures=replace(QUIET, aperture=0.06))
    soft = _picture(studio, open_lens)[0]
    detail = [
        np.abs(np.diff(picture.astype(float), axis=1)).sum() for picture in (sharp, moved, soft)
    ]
    assert detail[1] < 0.9 * detail[0]
    assert detail[2] < 0.9 * detail[0]


def test_textures_differ_and_a_poor_one_is_refused(config):
    rig = make_head(config.head, config.specimen.mesh)
    grey = {}
    for kind in ("speckle", "natural"):
        look = replace(config, look=Look(texture=kind, size=4e-3))
        grey[kind] = make_studio(look, rig, choose_variant(), rng=np.random.default_rng(0)).grey
    assert grey["speckle"].std() > 1.5 * grey["natural"].std()
    noisy = replace(config, look=Look(texture="poor", size=4e-3), pictures=Pictures(noise=1.5))
    with pytest.raises(InputError, match=r"grey levels of contrast beside a noise of 1\.5"):
        make_studio(noisy, rig, choose_variant(), rng=np.random.default_rng(0))


def _even(value):
    return np.full(SHAPE, value, dtype=np.float32)


def _rng(seed=0):
    return np.random.default_rng(seed)


def _dot():
    picture = np.zeros((41, 51), dtype=np.float32)
    picture[20, 25] = 1.0
    return picture


def _spread(picture):
    """Standard deviation of a spot along the columns and along the rows [px]."""
    weight = picture.astype(float) / picture.sum()
    row, column = np.mgrid[: picture.shape[0], : picture.shape[1]]
    middle = (weight * column).sum(), (weight * row).sum()
    return (
        np.sqrt((weight * (column - middle[0]) ** 2).sum()),
        np.sqrt((weight * (row - middle[1]) ** 2).sum()),
        middle,
    )


def test_grey_is_gain_times_radiance():
    picture = grey_picture(_even(0.5), PLAIN, gain=GAIN, rng=_rng())
    assert picture.dtype == np.uint8
    assert (picture == 50).all()


def test_twelve_bits_lie_at_the_high_end_of_sixteen():
    picture = grey_picture(_even(0.5), replace(PLAIN, bits=12), gain=GAIN, rng=_rng())
    assert picture.dtype == np.uint16
    assert (picture == round(50.0 / 255.0 * 4095.0) << 4).all()
    # As the reader divides it: 255 / 65535.
    assert picture[0, 0] / 257.0 == pytest.approx(50.0, abs=0.05)
    assert (
        grey_picture(_even(9.0), replace(PLAIN, bits=12), gain=GAIN, rng=_rng()).max() == 4095 << 4
    )


def test_grey_levels_are_cut_at_black_and_white():
    noisy = replace(PLAIN, noise=5.0)
    assert grey_picture(_even(9.0), noisy, gain=GAIN, rng=_rng()).min() == 255
    dark = grey_picture(_even(-1.0), noisy, gain=GAIN, rng=_rng())
    assert dark.min() == 0
    # Half of a normal variable is below zero; what is above has a mean of sigma / sqrt(2 pi).
    assert dark.mean() == pytest.approx(5.0 / np.sqrt(2.0 * np.pi), rel=0.02)


@pytest.mark.parametrize("bits", [8, 12])
def test_noise_has_its_variance_and_the_rounding(bits):
    sensor = replace(PLAIN, noise=1.5, bits=bits)
    picture = grey_picture(_even(1.0), sensor, gain=GAIN, rng=_rng()) / (
        1.0 if bits == 8 else 65520 / 255
    )
    step = 1.0 if bits == 8 else 255.0 / 4095.0
    assert picture.mean() == pytest.approx(100.0, abs=4.0 * 1.5 / np.sqrt(COUNT) + 1e-2 * step)
    # Sheppard: rounding adds step^2 / 12. Four times the error of a variance.
    assert picture.var() == pytest.approx(1.5**2 + step**2 / 12.0, rel=4.0 * np.sqrt(2.0 / COUNT))


def test_counting_noise_is_the_root_of_the_electrons():
    sensor = replace(PLAIN, full_well=5_000.0, bits=12)
    for radiance in (0.5, 2.0):
        picture = grey_picture(_even(radiance), sensor, gain=GAIN, rng=_rng()) / (65520 / 255)
        grey = 100.0 * radiance
        variance = grey * 255.0 / 5_000.0 + (255.0 / 4095.0) ** 2 / 12.0
        assert picture.var() == pytest.approx(variance, rel=4.0 * np.sqrt(2.0 / COUNT))
        assert picture.mean() == pytest.approx(grey, abs=4.0 * np.sqrt(variance / COUNT))


def test_noise_of_neighbours_and_of_pictures_is_independent():
    sensor = replace(PLAIN, noise=2.0, full_well=5_000.0)
    rng = _rng()
    first, second = (grey_picture(_even(1.0), sensor, gain=GAIN, rng=rng) - 100.0 for _ in range(2))
    limit = 4.0 / np.sqrt(COUNT)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < limit
    assert abs(np.corrcoef(first[:, :-1].ravel(), first[:, 1:].ravel())[0, 1]) < limit
    assert np.array_equal(grey_picture(_even(1.0), sensor, gain=GAIN, rng=_rng()) - 100.0, first)


def test_response_spreads_a_point_by_its_width_and_keeps_its_light():
    sensor, gain = replace(PLAIN, response=1.2, bits=12), 100.0 * 2 * np.pi
    picture = grey_picture(_dot(), sensor, gain=gain, rng=_rng()) / 16.0 / 4095.0 * 255.0
    across, along, middle = _spread(picture)
    # Rounding cuts the tails off.
    assert across == pytest.approx(1.2, rel=0.01)
    assert along == pytest.approx(1.2, rel=0.01)
    assert middle == pytest.approx((25.0, 20.0), abs=1e-6)
    assert picture.sum() == pytest.approx(gain, rel=5e-3)


@pytest.mark.parametrize("radius", [0.8, 2.3, 5.0])
def test_defocus_is_a_disc(radius):
    picture = defocused(_dot(), radius)
    across, along, middle = _spread(picture)
    # A disc has sigma = radius / 2; each pixel's area spreads it by 1 / 12 more.
    expected = np.sqrt(radius**2 / 4.0 + 1.0 / 12.0)
    # A disc hardly larger than a pixel is sampled too coarsely for that.
    tolerance = 0.02 if radius > 1.5 else 0.06
    assert across == pytest.approx(expected, rel=tolerance)
    assert along == pytest.approx(expected, rel=tolerance)
    # The middle pixel lies wholly inside; the area is counted to 1 %.
    assert picture[20, 25] == pytest.approx(1.0 / (np.pi * radius**2), rel=0.01)
    assert middle == pytest.approx((25.0, 20.0), abs=1e-4)
    assert picture.sum() == pytest.approx(1.0, rel=1e-5)


def test_defocus_that_changes_over_the_picture_takes_each_pixels_own():
    rng = _rng()
    picture = rng.random((40, 60)).astype(np.float32)
    radius = np.broadcast_to(np.where(np.arange(60) < 30, 0.0, 2.0), (40, 60)).copy()
    radius[3, 3] = np.nan
    blurred = defocused(picture, radius)
    assert np.abs(blurred[:, :30] - picture[:, :30]).max() < 1e-6
    assert np.abs(blurred[:, 30:] - defocused(picture, 2.0)[:, 30:]).max() < 1e-6
    between = defocused(picture, np.full((40, 60), 1.0))
    assert np.abs(between - defocused(picture, 1.0)).max() < 1e-6
    assert np.array_equal(defocused(picture, 0.0), picture)
    assert np.array_equal(defocused(picture, 1e-3), picture)


def test_blur_follows_the_thin_lens():
    """A point at twice the focused distance: its disc has half the aperture's image."""
    depth = np.array([[0.5, 1.0, np.inf, np.nan]])
    radius = blur_radius(depth, focus=0.5, aperture=0.01, focal=1000.0)
    assert radius[0, :3] == pytest.approx([0.0, 0.5 * 10.0, 0.5 * 20.0])
    assert np.isnan(radius[0, 3])


def test_exposure_brings_the_bright_parts_to_their_level():
    picture = np.zeros((100, 100), dtype=np.float32)
    picture[:50] = np.linspace(0.5, 1.0, 5000).reshape(50, 100)
    gain = exposure_gain([picture, np.full((9, 9), 0.015, dtype=np.float32)])
    # 995 of 1000 lit pixels stay at or below 220; what is darker than 2 % of white is not lit.
    assert gain * 0.9975 == pytest.approx(220.0, rel=1e-4)
    dark = np.full((100, 100), 0.025, dtype=np.float32)
    assert exposure_gain([picture, dark]) * (1.0 - 0.015 / 2) == pytest.approx(220.0, rel=1e-4)


def test_counting_noise_is_that_of_the_pictures():
    sensor = replace(PLAIN, full_well=5_000.0, bits=12)
    picture = grey_picture(_even(1.275), sensor, gain=GAIN, rng=_rng()) / (65520 / 255)
    # Four times the error of a standard deviation.
    assert shot_noise(sensor, 127.5) == pytest.approx(picture.std(), rel=4 / np.sqrt(2 * COUNT))
    assert shot_noise(PLAIN, 127.5) == 0.0


def test_black_pictures_are_refused():
    with pytest.raises(InputError, match="pictures are black"):
        exposure_gain([_even(0.0)])
