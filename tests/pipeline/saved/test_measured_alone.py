"""Probings whose pictures are measured alone: the same as all at once, and no other is measured."""

import shutil
from collections import Counter

import numpy as np
import pytest
from pipeline.saved.seen_session import PROBINGS, write_probings, write_seen_session

from palpate.pipeline import (
    keep_motion,
    kept_motion,
    measure_motion,
    measure_pictures,
    with_motions,
    with_pictures_measured,
)
from palpate.records import read_session, result_folder
from palpate.vision import JointFlow


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a session, a result that keeps its motion, and the motions of its probings."""
    folder = write_seen_session(tmp_path_factory.mktemp("whole") / "seen")
    session = read_session(folder)
    motions = measure_pictures(session, pose="given")
    with result_folder(folder.parent / "result", kind="fit") as result:
        keep_motion(result, session, motions, pose="given")
    return folder, folder.parent / "result", motions


@pytest.fixture
def folder(whole, tmp_path):
    """A copy of the session that may be changed."""
    return shutil.copytree(whole[0], tmp_path / "seen")


@pytest.fixture
def counted(monkeypatch):
    """Numbers of first pictures begun with, and of later ones followed."""
    count, start, follow = Counter(), JointFlow.start, JointFlow.follow

    def counted_start(*given):
        count["start"] += 1
        return start(*given)

    def counted_follow(*given):
        count["follow"] += 1
        return follow(*given)

    monkeypatch.setattr(JointFlow, "start", counted_start)
    monkeypatch.setattr(JointFlow, "follow", counted_follow)
    return count


def _assert_same(found, expected):
    """All bits of all fields, and the notes."""
    assert list(found) == list(expected)
    for name, motion in found.items():
        mine, theirs = motion.field, expected[name].field
        for part in ("points", "displacement", "std", "vertex", "covariance"):
            np.testing.assert_array_equal(getattr(mine, part), getattr(theirs, part))
        for part in ("pair", "value"):
            np.testing.assert_array_equal(
                getattr(mine.correlation, part), getattr(theirs.correlation, part)
            )
        np.testing.assert_array_equal(mine.average.points, theirs.average.points)
        # In the same order, too: products with them are sums in that order.
        for part in ("data", "indices", "indptr"):
            np.testing.assert_array_equal(
                getattr(mine.average.weights, part), getattr(theirs.average.weights, part)
            )
        assert mine.source == theirs.source
        assert motion.notes == expected[name].notes


def _measured(folder, result, **options):
    """The motions of a session, those that the result holds not measured."""
    session = read_session(folder)
    kept = kept_motion(session, result, pose="given")
    return measure_pictures(session, known=kept, pose="given", **options)


@pytest.mark.parametrize("name", list(PROBINGS))
def test_a_probing_alone_moves_as_along_with_others(whole, folder, name):
    write_probings(folder, {name: PROBINGS[name]})
    alone = measure_pictures(read_session(folder), pose="given")
    assert np.isfinite(alone[name].field.displacement[:, 0]).sum() > 20
    _assert_same(alone, {name: whole[2][name]})


def test_nothing_is_measured_twice(whole, folder, counted):
    _assert_same(_measured(folder, whole[1]), whole[2])
    assert counted == {}


def test_one_more_probing_is_measured_alone(whole, folder, counted, tmp_path):
    write_probings(folder, {name: PROBINGS[name] for name in ("n01", "n03")})
    two = measure_pictures(read_session(folder), pose="given")
    with result_folder(tmp_path / "two", kind="fit") as result:
        keep_motion(result, read_session(folder), two, pose="given")
    write_probings(folder, PROBINGS)
    counted.clear()
    found = _measured(folder, tmp_path / "two")
    assert counted == {"start": 1, "follow": 1}
    _assert_same(found, whole[2])
    # Whoever is measured when: the session is told what it is told at once.
    session = read_session(folder)
    assert with_motions(session, found).notes == with_motions(session, whole[2]).notes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("picture", "by", "count"),
    [
        ("n01_1", "n01_2", {"start": 1, "follow": 2}),
        ("n02", "n01_1", {"start": 1, "follow": 1}),
        ("rest", "other", {"start": 1, "follow": 3}),
        ("other", "n01_1", {"start": 1, "follow": 1}),
    ],
)
def test_another_picture_is_measured_as_if_it_had_always_been_there(
    whole, folder, counted, picture, by, count
):
    for camera in ("c0", "c1"):
        shutil.copy(folder / f"{by}_{camera}.png", folder / f"{picture}_{camera}.png")
    found = _measured(folder, whole[1])
    assert counted == count
    _assert_same(found, measure_pictures(read_session(folder), pose="given"))


@pytest.mark.slow
def test_notes_on_shared_pictures_are_told_once_and_name_who_is_there(whole, folder):
    session = read_session(folder)
    colours = "cameras c0, c1: colours were turned into luminance"
    (note,) = with_motions(session, whole[2]).notes
    assert note.startswith(f"probing 'n01', {colours}")
    assert measure_motion(session, pose="given").notes == (note,)
    write_probings(folder, {name: PROBINGS[name] for name in ("n02", "n03")})
    (note,) = with_motions(read_session(folder), _measured(folder, whole[1])).notes
    assert note.startswith(f"probing 'n02', {colours}")
    assert with_pictures_measured(read_session(folder), pose="given").notes == (note,)


@pytest.mark.slow
def test_parts_of_all_probings_are_those_of_each(whole, folder, counted, tmp_path):
    parts = tmp_path / "parts"
    measure_pictures(read_session(folder), pose="given", parts=parts)
    counted.clear()
    write_probings(folder, {name: PROBINGS[name] for name in ("n02", "n01")})
    found = measure_pictures(read_session(folder), pose="given", parts=parts)
    assert counted == {"start": 1}
    _assert_same(found, {name: whole[2][name] for name in ("n02", "n01")})
    # Another picture leaves those of other probings.
    for camera in ("c0", "c1"):
        shutil.copy(folder / f"n01_1_{camera}.png", folder / f"n02_{camera}.png")
    measure_pictures(read_session(folder), pose="given", parts=parts)
    assert counted == {"start": 2, "follow": 1}
    # So does another choice of the pose leave all of them, even if it comes to the same pose.
    measure_pictures(read_session(folder), pose="auto", parts=parts)
    assert counted == {"start": 3, "follow": 4}
