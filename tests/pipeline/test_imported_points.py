"""Matches of other programs in pictures, brought into space, and what of points is believed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from program_files import write_cells

from palpate.errors import CalibrationError, RecordError
from palpate.pipeline import triangulated
from palpate.records import PictureTracks, Rig, read_measured, read_rig
from palpate.vision import project


@pytest.fixture(scope="module")
def rig(shared_data: Path) -> Rig:
    """Two cameras with lenses."""
    found = read_rig(shared_data / "halfball_images" / "rig.toml")
    return Rig(found.cameras[:2], 0, found.source)


def _file(path: Path, rig: Rig, states: list[np.ndarray], *, version: str) -> Path:
    """What DuoDIC's second step writes of points [m] in some states: pixels from 1."""
    pixels = [project(camera, state) + 1.0 for camera in rig.cameras for state in states]
    criteria = [np.full((len(states[0]), 1), 0.01 * i) for i in range(len(pixels))]
    criteria[0][:] = np.nan
    criteria[1][2] = 0.9
    fields = {"Points": pixels, "CorCoeffVec": criteria}
    return write_cells(path, "DIC2DpairResults", fields, version=version)


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_tracks_become_points(tmp_path: Path, rig: Rig, version: str) -> None:
    rng = np.random.default_rng(1)
    place = rng.uniform(-0.02, 0.02, size=(30, 3)) + np.array([0.0, 0.0, 0.02])
    moved = rng.normal(scale=1e-3, size=(30, 3))
    path = _file(tmp_path / "a.mat", rig, [place, place + moved, place], version=version)
    measured = read_measured("duodic", path, frame=1, triangulate=lambda t: triangulated(t, rig))
    # A rounding of pixels, 1e-13, seen from 0.6 m with 1400 px.
    np.testing.assert_allclose(measured.points, place, atol=1e-12)
    good = np.arange(30) != 2
    np.testing.assert_allclose(measured.displacement[good], moved[good], atol=1e-12)
    assert np.isnan(measured.displacement[2]).all()
    assert measured.poorly_correlated == 1


def test_real_matches_of_multidic(shared_data: Path) -> None:
    """A surface moved rigidly: lengths of its motion by the set's README, made another way."""
    folder = shared_data / "real" / "multidic_pair"
    rig = read_rig(folder / "calibrationObjectImages")
    swapped = replace(rig, cameras=rig.cameras[::-1])
    path = folder / "speckledObjectImages" / "DIC2DpairResults_C_201_C_202.mat"
    for frame, length in ((1, 0.420e-3), (2, 0.895e-3), (3, 1.389e-3), (4, 1.872e-3)):
        measured = read_measured(
            "multidic", path, frame=frame, triangulate=lambda t: triangulated(t, swapped)
        )
        found = np.linalg.norm(np.nanmean(measured.displacement, axis=0))
        # Three digits are given.
        assert found == pytest.approx(length, abs=6e-7)


def test_other_cameras_are_refused(rig: Rig) -> None:
    pixels = np.zeros((2, 5, 2))
    tracks = PictureTracks(pixels, pixels, ("201", "202"), None, ())
    one = Rig((*rig.cameras, replace(rig.cameras[0], name="c9")), 0, "rig.toml")
    with pytest.raises(CalibrationError, match=r"rig.toml: has the cameras c0, c1, c9; must have"):
        triangulated(tracks, one)


def test_places_are_no_tracks(tmp_path: Path, rig: Rig) -> None:
    with pytest.raises(RecordError, match="files of vic3d hold places, no pixels; leave --rig out"):
        read_measured("vic3d", tmp_path / "a.csv", triangulate=lambda t: triangulated(t, rig))
    path = write_cells(tmp_path / "a.mat", "a", {"Points": [np.zeros((4, 2))] * 3}, version="7.3")
    with pytest.raises(RecordError, match="Points holds 3 pictures; must be two or more"):
        read_measured("duodic", path, triangulate=lambda t: triangulated(t, rig))
