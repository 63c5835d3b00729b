"""Contrast, coverage and band of the textures."""

import numpy as np
import pytest
from scipy.ndimage import label

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.pictures.textures import RIM, natural, poor, speckle


def _box(side=0.1):
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    triangles = np.array([
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ])  # fmt: skip
    return TriangleMesh(side * corners, triangles)


def _face(n=400, side=0.1):
    """Points of the face z = side, row by row, and their spacing."""
    line = np.linspace(0.0, side, n, endpoint=False)
    x, y = np.meshgrid(line, line)
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, side)]), side / n


def _rng(seed=0):
    return np.random.default_rng(seed)


def _power_beyond(values, spacing, wavelength):
    """Share of the variance in waves shorter than a wavelength."""
    n = int(np.sqrt(values.size))
    window = np.hanning(n)
    picture = (values.reshape(n, n) - values.mean()) * window * window[:, None]
    power = np.abs(np.fft.fft2(picture)) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(n, spacing), np.fft.fftfreq(n, spacing)))
    return power[frequency > 1.0 / wavelength].sum() / power.sum()


@pytest.mark.parametrize("coverage", [0.2, 0.5, 0.8])
def test_speckle_covers_what_is_asked_between_its_two_greys(coverage):
    points, _ = _face()
    grey = speckle(points, _box(), size=1.5e-3, coverage=coverage, dark=0.2, bright=0.8, rng=_rng())
    assert grey.min() == pytest.approx(0.2, abs=1e-9)
    assert grey.max() == pytest.approx(0.8, abs=1e-9)
    # Some 2000 to 10000 dots on this face: the covered share varies by 0.006.
    assert (grey < 0.5).mean() == pytest.approx(coverage, abs=0.02)


def test_dots_have_their_size():
    """Few dots: each covers the area of a disc of that diameter."""
    points, spacing = _face()
    grey = speckle(points, _box(), size=4e-3, coverage=0.02, rng=_rng(4))
    dots, count = label(grey.reshape(400, 400) < 0.5)
    areas = np.bincount(dots.ravel())[1:] * spacing**2
    assert count > 5
    assert np.median(areas) == pytest.approx(np.pi * 4e-6, rel=0.03)


def test_speckle_is_smooth_to_its_stated_rim():
    points, spacing = _face()
    size = 3e-3
    grey = speckle(points, _box(), size=size, coverage=0.5, rng=_rng())
    # Steepest: 1.5 over the rim, times the step between the greys.
    slope = np.abs(np.diff(grey.reshape(400, 400), axis=1)).max() / spacing
    assert slope <= 1.5 * 0.8 / (RIM * size) * (1.0 + 1e-9)
    assert _power_beyond(grey, spacing, RIM * size) < 0.003


def test_speckle_goes_around_corners_and_does_not_depend_on_the_points():
    points, _ = _face(100)
    options = {"size": 3e-3, "coverage": 0.4}
    whole = speckle(points, _box(), rng=_rng(3), **options)
    part = speckle(points[::7], _box(), rng=_rng(3), **options)
    assert np.array_equal(whole[::7], part)
    assert not np.array_equal(whole, speckle(points, _box(), rng=_rng(4), **options))
    shares = [
        (speckle(np.roll(points, k, axis=1), _box(), rng=_rng(3), **options) < 0.5).mean()
        for k in range(3)
    ]
    assert shares == pytest.approx([0.4] * 3, abs=0.06)


def test_almost_no_coverage_may_leave_no_dot():
    points, _ = _face(10)
    grey = speckle(points, _box(1e-3), size=5e-3, coverage=1e-6, rng=_rng())
    assert (grey == 0.9).all()


def test_natural_texture_has_its_mean_contrast_and_band():
    values = []
    for seed in range(8):
        points, spacing = _face(200)
        grey = natural(
            points, coarsest=0.02, finest=0.0025, mean=0.4, contrast=0.12, rng=_rng(seed)
        )
        assert grey.min() >= 0.4 - 0.24
        assert grey.max() <= 0.4 + 0.24
        # What is bent at two standard deviations has overtones: a per cent of the variance.
        assert _power_beyond(grey, spacing, 0.9 * 0.0025) < 0.01
        values.append(grey)
    # The face is five of the longest waves wide: a mean varies by a tenth of the contrast, and
    # bending takes a seventh of it.
    assert np.mean(values) == pytest.approx(0.4, abs=0.02)
    assert np.std(values) == pytest.approx(0.12 * 0.86, rel=0.1)


@pytest.mark.parametrize(
    ("coarsest", "finest", "octaves"),
    [
        (0.016, 0.002, [(0.002, 0.004, 1.0), (0.004, 0.008, 2.0), (0.008, 0.016, 4.0)]),
        (0.006, 0.005, [(0.005, 0.006, 1.0)]),
        (0.010, 0.004, [(0.004, 0.008, 1.0), (0.008, 0.010, 2.0)]),
    ],
)
def test_natural_texture_is_correlated_as_waves_of_all_directions(coarsest, finest, octaves):
    """sin(k d) / (k d) at a distance d, averaged over the wavelengths, weighted by their power."""
    distance = np.array([0.001, 0.002, 0.003, 0.005])
    place = np.random.default_rng(9).uniform(0.0, 0.2, (200, 3))
    moved = place + distance[:, None, None] * np.array([0.6, 0.0, 0.8])
    found = []
    for seed in range(100):
        points = np.concatenate([place[None], moved]).reshape(-1, 3)
        grey = natural(points, coarsest=coarsest, finest=finest, contrast=0.02, rng=_rng(seed))
        first, *others = (grey - 0.5).reshape(5, -1)
        found.append([(first * other).mean() / (first**2).mean() for other in others])
    expected = np.zeros(4)
    for low, high, power in octaves:
        length = low * (high / low) ** ((np.arange(200) + 0.5) / 200)
        expected += power * np.sinc(2.0 * distance / length[:, None]).mean(axis=0)
    expected /= sum(power for _, _, power in octaves)
    # 48 waves in each of 100 textures of an octave, and 200 places: 0.01 of chance.
    assert np.abs(np.mean(found, axis=0) - expected).max() < 0.03


def test_natural_texture_is_a_function_of_the_place():
    points, _ = _face(40)
    options = {"coarsest": 0.02, "finest": 0.005}
    whole = natural(points, rng=_rng(1), **options)
    part = natural(points[::-3].copy(), rng=_rng(1), **options)
    assert np.abs(whole[::-3] - part).max() < 1e-12
    assert np.abs(natural(points, rng=_rng(2), **options) - whole).max() > 0.1


def test_poor_texture_is_faint_and_smooth():
    points, spacing = _face(200)
    grey = poor(points, size=0.01, rng=_rng())
    assert grey.std() < 0.03
    assert grey.mean() == pytest.approx(0.5, abs=0.02)
    assert _power_beyond(grey, spacing, 0.009) < 0.01


def _speckled(**options):
    return speckle(_face(4)[0], _box(), **({"size": 1e-3, "rng": _rng()} | options))


def _natural(**options):
    return natural(_face(4)[0], **({"coarsest": 0.02, "finest": 0.005, "rng": _rng()} | options))


@pytest.mark.parametrize(
    ("texture", "options", "message"),
    [
        (_speckled, {"coverage": 1.0}, "coverage is 1"),
        (_speckled, {"coverage": 0.0}, "coverage is 0"),
        (_speckled, {"dark": -0.1}, "dark is -0.1"),
        (_speckled, {"bright": 1.1}, "bright 1.1"),
        (_speckled, {"size": 0.0}, "size of a dot is 0 m"),
        (_speckled, {"size": 1e-6}, "at most 5e[+]06 are drawn"),
        (_natural, {"finest": 0.0}, "shortest wavelength is 0 m"),
        (_natural, {"coarsest": 0.004}, "swap them"),
        (_natural, {"contrast": 0.3}, "contrast is 0.3 about a mean of 0.5; must be 0 to 0.25"),
        (_natural, {"contrast": -0.1}, "contrast is -0.1"),
        (_natural, {"mean": 0.1}, "must be 0 to 0.05"),
    ],
)
def test_a_texture_that_cannot_be_is_refused(texture, options, message):
    with pytest.raises(InputError, match=message):
        texture(**options)
