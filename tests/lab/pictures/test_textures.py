"""Contrast, coverage and band of the textures."""

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.render_mesh import RIM, natural, speckle, texture


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


def test_speckle_covers_half_of_the_surface_between_its_two_greys():
    points, _ = _face()
    grey = speckle(points, _box(), size=1.5e-3, rng=_rng())
    assert grey.min() == pytest.approx(0.1, abs=1e-9)
    assert grey.max() == pytest.approx(0.9, abs=1e-9)
    # Some 4000 dots on this face: the covered share varies by 0.006.
    assert (grey < 0.5).mean() == pytest.approx(0.5, abs=0.02)


def test_dots_have_their_size():
    """The power spectrum of dots of diameter D has its first zero where J1(pi D f) = 0."""
    points, spacing = _face()
    size = 3e-3
    power = np.zeros((400, 400))
    for seed in range(4):
        grey = speckle(points, _box(), size=size, rng=_rng(seed)).reshape(400, 400)
        window = np.hanning(400)
        power += np.abs(np.fft.fft2((grey - grey.mean()) * window * window[:, None])) ** 2
    frequency = np.hypot(*np.meshgrid(*2 * [np.fft.fftfreq(400, spacing)]))
    edges = np.linspace(0.0, 2.0 / size, 41)
    ring = np.digitize(frequency.ravel(), edges)
    mean = np.bincount(ring, power.ravel())[1:41] / np.bincount(ring)[1:41]
    # 3.8317 / pi = 1.22 for a lone disc; overlaps and the soft rim leave the dip where it is.
    dip = edges[10 + mean[10:34].argmin()] + 0.5 * edges[1]
    # The mean over rings 0.05 wide, and the valley's bottom is flat.
    assert dip * size == pytest.approx(1.22, abs=0.15)


def test_speckle_is_smooth_to_its_stated_rim():
    points, spacing = _face()
    size = 3e-3
    grey = speckle(points, _box(), size=size, rng=_rng())
    # Steepest: 1.5 over the rim, times the step between the greys.
    slope = np.abs(np.diff(grey.reshape(400, 400), axis=1)).max() / spacing
    assert slope <= 1.5 * 0.8 / (RIM * size) * (1.0 + 1e-9)
    assert _power_beyond(grey, spacing, RIM * size) < 0.003


def test_speckle_goes_around_corners_and_does_not_depend_on_the_points():
    points, _ = _face(100)
    options = {"size": 3e-3}
    whole = speckle(points, _box(), rng=_rng(3), **options)
    part = speckle(points[::7], _box(), rng=_rng(3), **options)
    assert np.array_equal(whole[::7], part)
    assert not np.array_equal(whole, speckle(points, _box(), rng=_rng(4), **options))
    shares = [
        (speckle(np.roll(points, k, axis=1), _box(), rng=_rng(3), **options) < 0.5).mean()
        for k in range(3)
    ]
    assert shares == pytest.approx([0.5] * 3, abs=0.06)


def test_a_surface_smaller_than_a_dot_may_have_none():
    points, _ = _face(10)
    grey = speckle(points, _box(1e-5), size=5e-3, rng=_rng())
    assert (grey == 0.9).all()


def test_natural_texture_has_its_mean_contrast_and_band():
    values = []
    for seed in range(8):
        points, spacing = _face(120)
        grey = natural(points, coarsest=0.02, finest=0.0025, contrast=0.12, rng=_rng(seed))
        assert grey.min() >= 0.5 - 0.24
        assert grey.max() <= 0.5 + 0.24
        # What is bent at two standard deviations has overtones: a per cent of the variance.
        assert _power_beyond(grey, spacing, 0.9 * 0.0025) < 0.01
        values.append(grey)
    # The face is five of the longest waves wide: a mean varies by a tenth of the contrast, and
    # bending takes a seventh of it.
    assert np.mean(values) == pytest.approx(0.5, abs=0.02)
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
    options = {"coarsest": 0.02, "finest": 0.005, "contrast": 0.15}
    whole = natural(points, rng=_rng(1), **options)
    part = natural(points[::-3].copy(), rng=_rng(1), **options)
    assert np.abs(whole[::-3] - part).max() < 1e-12
    assert np.abs(natural(points, rng=_rng(2), **options) - whole).max() > 0.1


@pytest.mark.parametrize(("kind", "longest", "contrast"), [("poor", 4, 0.02), ("natural", 8, 0.15)])
def test_kinds_of_texture_have_their_waves_and_their_contrast(kind, longest, contrast):
    points, spacing = _face(200)
    grey = texture(kind, points, _box(), size=0.005, rng=_rng())
    same = natural(points, coarsest=longest * 0.005, finest=0.005, contrast=contrast, rng=_rng())
    np.testing.assert_array_equal(grey, same)
    assert grey.mean() == pytest.approx(0.5, abs=0.05)
    assert _power_beyond(grey, spacing, 0.0045) < 0.01


def test_a_speckle_is_one_of_the_textures():
    points, _ = _face(40)
    grey = texture("speckle", points, _box(), size=0.005, rng=_rng())
    np.testing.assert_array_equal(grey, speckle(points, _box(), size=0.005, rng=_rng()))


def test_more_dots_than_can_be_drawn_are_refused():
    with pytest.raises(InputError, match=r"at most 5e[+]06 are drawn"):
        speckle(_face(4)[0], _box(), size=1e-6, rng=_rng())
