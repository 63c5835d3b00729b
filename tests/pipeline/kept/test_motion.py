"""Motion that a result keeps: the same to the last bit, and only for the same pictures."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from pipeline.kept.picture_session import given_and_measured

import palpate
from palpate.pipeline import MOTION_FILE, keep_motion, with_kept_motion
from palpate.records import read_session, result_folder


@pytest.fixture
def kept(cube_session, tmp_path):
    """Session as it was read, the same measured, and a result that keeps the motion."""
    given, found = given_and_measured(cube_session)
    with result_folder(tmp_path / "result", kind="fit") as folder:
        keep_motion(folder, given, found)
    return given, found, tmp_path / "result"


def test_the_kept_motion_is_the_measured_one(kept):
    given, found, folder = kept
    again = with_kept_motion(given, folder)
    mine, theirs = again.probings[0].displacement, found.probings[0].displacement
    for name in ("points", "displacement", "std", "vertex", "covariance"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(theirs, name))
    # Without it the next fit's intervals would be those of independent errors.
    for name in ("pair", "value"):
        found_there = getattr(theirs.correlation, name)
        np.testing.assert_array_equal(getattr(mine.correlation, name), found_there)
    # Without what each displacement is the average of, it would have other constants.
    np.testing.assert_array_equal(mine.average.points, theirs.average.points)
    assert abs(mine.average.weights - theirs.average.weights).sum() == 0.0
    assert mine.average.has_weights.any()
    assert (mine.source, mine.scale_error) == (theirs.source, theirs.scale_error)
    assert again.notes == found.notes


def test_nothing_is_kept_where_there_is_no_result(kept, tmp_path):
    assert with_kept_motion(kept[0], tmp_path / "elsewhere") is None


@pytest.mark.parametrize("name", ["loaded_c1.png", "rig.toml", "mesh.ply"])
def test_a_file_that_changed_has_the_motion_measured_again(kept, cube_session, name):
    file = cube_session / name
    file.write_bytes(file.read_bytes() + b"\n")
    assert with_kept_motion(kept[0], kept[2]) is None


@pytest.mark.parametrize(
    ("before", "after", "still"),
    [
        ("force = [0, 0, -1.2]", "force = [0, 0, -1.3]", True),
        ("radius = 0.006", "radius = 0.007", True),
        ('length_unit = "m"', 'length_unit = "cm"', False),
        ('loaded = ["loaded_', 'loaded = ["later_', False),
        ('cameras = "rig.toml"', 'cameras = "rig2.toml"', False),
    ],
)
def test_only_what_motion_depends_on_has_it_measured_again(
    kept, cube_session, before, after, still
):
    shutil.copy(cube_session / "rig.toml", cube_session / "rig2.toml")
    for camera in ("c0", "c1"):
        shutil.copy(cube_session / f"loaded_{camera}.png", cube_session / f"later_{camera}.png")
    file = cube_session / "session.toml"
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after))
    again = with_kept_motion(read_session(cube_session), kept[2])
    assert (again is not None) == still


def test_another_version_measures_again(kept, monkeypatch):
    monkeypatch.setattr(palpate, "__version__", "9.9")
    assert with_kept_motion(kept[0], kept[2]) is None


def test_other_probings_measure_again(kept):
    given, _, folder = kept
    (probing,) = given.probings
    assert (
        with_kept_motion(replace(given, probings=(replace(probing, name="n02"),)), folder) is None
    )


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nothing"])
def test_a_damaged_file_is_measured_again(kept, damage):
    (kept[2] / MOTION_FILE).write_bytes(damage)
    assert with_kept_motion(kept[0], kept[2]) is None


def test_motion_without_a_sum_is_measured_again(kept):
    (kept[2] / "contents.txt").unlink()
    assert with_kept_motion(kept[0], kept[2]) is None
