"""Pictures of the bench: exposure, shadows, the rod, blur, and their noise."""

from dataclasses import replace

import numpy as np
import pytest
from lab.lab_configs import HALF_BALL

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab import Look, Pictures, choose_variant, read_lab_config
from palpate.lab.head import make_head
from palpate.lab.specimens import rod
from palpate.lab.studio import exposure, make_studio, photograph
from palpate.solids.tips import Sphere

QUIET = Pictures(samples=8, noise=0.0)


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
    place = np.array([0.0, 0.0, 0.046])
    end = Sphere(6e-3, place, np.array([0.0, 0.0, -1.0])).outline()
    upright = rod(end, radius=6e-3, length=0.2)
    arm = TriangleMesh(place + upright.vertices, upright.triangles)
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
        found = _picture(studio, drifting, seed=seed)
        for drifted, plain in zip(found, bare, strict=True):
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
