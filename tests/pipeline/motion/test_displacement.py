"""Motion that a result keeps: the same to the last bit, and only for the same pictures."""

import re
import shutil
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from pipeline.picture_session import measured_motion, with_pictures
from pipeline.seen_session import PROBINGS, write_probings, write_seen_session

import palpate
from palpate.geometry import TriangleMesh, write_mesh
from palpate.pipeline import (
    MOTION_FILE,
    MotionNotes,
    keep_motion,
    kept_motion,
    measure_motion,
    measure_pictures,
    with_motions,
    with_pictures_measured,
)
from palpate.records import read_session, result_folder
from palpate.vision import JointFlow

ALL = {"n01", "n02", "n03"}
ONE_MORE = """
[[probe]]
name = "n04"
contact = { point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }
force = [0, 0, -1]
images = { rest = "rest_{camera}.png", loaded = ["n04_{camera}.png"] }
"""


@pytest.fixture
def three(cube_session):
    """The folder of a session with three probings: the first two share their pictures at rest."""
    file = with_pictures(cube_session) / "session.toml"
    head, probe = file.read_text().split("[[probe]]")
    tables = [probe.replace("loaded_", f"{name}_").replace("n01", name) for name in sorted(ALL)]
    tables[2] = tables[2].replace("rest_", "other_")
    file.write_text("[[probe]]".join([head, *tables]))
    for name in ("other", *ALL):
        for camera in ("c0", "c1"):
            (cube_session / f"{name}_{camera}.png").write_bytes(f"{name}_{camera}".encode())
    return cube_session


@pytest.fixture
def kept(three, tmp_path):
    """Session as it was read, the motions of its probings, and a result that keeps these."""
    given = read_session(three)
    motions = {
        probing.name: measured_motion(given, probing, seed=k, notes=(f"{probing.name} is dark",))
        for k, probing in enumerate(given.probings)
    }
    with result_folder(tmp_path / "result", kind="fit") as folder:
        keep_motion(folder, given, motions)
    return given, motions, tmp_path / "result"


def _still(folder, result, **options):
    """Probings of the session as it is now whose motion need not be measured."""
    return set(kept_motion(read_session(folder), result, **options))


def _changed(folder, pattern, by, count=1):
    """Change the session file."""
    file = folder / "session.toml"
    text, replaced = re.subn(pattern, by, file.read_text(), flags=re.DOTALL)
    assert replaced == count
    file.write_text(text)


def test_the_kept_motion_is_the_measured_one(kept):
    given, motions, folder = kept
    again = kept_motion(given, folder)
    assert list(again) == list(motions) == ["n01", "n02", "n03"]
    for name, motion in motions.items():
        mine, theirs = again[name].field, motion.field
        for part in ("points", "displacement", "std", "vertex", "covariance"):
            np.testing.assert_array_equal(getattr(mine, part), getattr(theirs, part))
        # Without it the next fit's intervals would be those of independent errors.
        for part in ("pair", "value"):
            found_there = getattr(theirs.correlation, part)
            np.testing.assert_array_equal(getattr(mine.correlation, part), found_there)
        # Without what each displacement is the average of, it would have other constants.
        np.testing.assert_array_equal(mine.average.points, theirs.average.points)
        assert abs(mine.average.weights - theirs.average.weights).sum() == 0.0
        assert mine.average.has_weights.any()
        assert mine.source == theirs.source
        assert again[name].notes == motion.notes


def test_nothing_is_kept_where_there_is_no_result(kept, tmp_path):
    assert kept_motion(kept[0], tmp_path / "elsewhere") == {}


def test_a_session_without_pictures_has_no_motion_to_keep(kept, tmp_path):
    measured = with_motions(*kept[:2])
    with result_folder(tmp_path / "none", kind="fit") as folder:
        keep_motion(folder, measured, {})
    assert kept_motion(measured, tmp_path / "none") == kept_motion(kept[0], tmp_path / "none") == {}


@pytest.mark.parametrize(
    ("name", "still"),
    [
        ("n02_c1.png", {"n01", "n03"}),
        ("rest_c0.png", {"n03"}),
        ("other_c1.png", {"n01", "n02"}),
    ],
)
def test_a_picture_that_changed_has_its_probings_measured_again(kept, three, name, still):
    (three / name).write_bytes(b"another")
    assert _still(three, kept[2]) == still
    # So has one that is gone; the measurement says so.
    (three / name).unlink()
    assert _still(three, kept[2]) == still


def test_other_cameras_have_all_measured_again(kept, three):
    file = three / "rig.toml"
    text = file.read_text()
    # What a rig says counts, not how.
    file.write_text(f"# calibrated on Monday\n{text}")
    assert _still(three, kept[2]) == ALL
    assert "1000.0" in text
    file.write_text(text.replace("1000.0", "1000.5", 1))
    assert _still(three, kept[2]) == set()


def test_another_mesh_has_all_measured_again(kept, three):
    mesh = read_session(three).mesh
    moved = mesh.vertices + np.array([0.0, 0.0, 1e-9])
    write_mesh(three / "mesh.ply", TriangleMesh(mesh.vertices, mesh.triangles))
    assert _still(three, kept[2]) == ALL
    write_mesh(three / "mesh.ply", TriangleMesh(moved, mesh.triangles))
    assert _still(three, kept[2]) == set()


@pytest.mark.parametrize(
    ("pattern", "by", "still"),
    [
        (r"(.*)force = \[0, 0, -1.2\]", r"\1force = [0, 0, -1.3]", ALL),
        (r"(.*)radius = 0.006", r"\1radius = 0.007", ALL),
        (r"tolerance = 1e-6", "tolerance = 1e-5", ALL),
        ('length_unit = "m"', 'length_unit = "cm"', set()),
        # A rig that is called something else is named so in notes.
        ('cameras = "rig.toml"', 'cameras = "rig2.toml"', set()),
        (r'"n02_\{camera\}.png"', '"n04_{camera}.png"', {"n01", "n03"}),
        # The last one is at full force; an earlier one has a part in it, too.
        (r'\["n02_', '["n04_{camera}.png", "n02_', {"n01", "n03"}),
        ("other_", "rest_", {"n01", "n02"}),
        # Its notes name it.
        ('name = "n02"', 'name = "n04"', {"n01", "n03"}),
        (r'\[\[probe\]\]\nname = "n01".*?(?=\[\[probe\]\])', "", {"n02", "n03"}),
        (r"\Z", ONE_MORE, ALL),
        (r'(\[\[probe\]\]\nname = "n01".*?)(\[\[probe\]\].*)', r"\2\1", ALL),
    ],
)
def test_only_what_motion_depends_on_has_it_measured_again(kept, three, pattern, by, still):
    (three / "rig2.toml").write_bytes((three / "rig.toml").read_bytes())
    for camera in ("c0", "c1"):
        (three / f"n04_{camera}.png").write_bytes((three / f"n02_{camera}.png").read_bytes())
    _changed(three, pattern, by)
    assert _still(three, kept[2]) == still


def test_a_file_of_displacements_is_not_replaced(kept):
    given, motions, folder = kept
    known = replace(given.probings[1], displacement=motions["n02"].field)
    given = replace(given, probings=(given.probings[0], known, given.probings[2]))
    assert set(kept_motion(given, folder)) == {"n01", "n03"}
    assert kept_motion(replace(given, probings=(known,)), folder) == {}


def test_another_choice_of_the_pose_measures_again(kept, three):
    assert _still(three, kept[2], pose="auto") == ALL
    assert _still(three, kept[2], pose="given") == set()


def test_another_version_measures_again(kept, monkeypatch):
    monkeypatch.setattr(palpate, "__version__", "9.9")
    assert kept_motion(kept[0], kept[2]) == {}


def test_a_note_goes_with_the_motion_that_it_is_on(kept, three):
    given, _, folder = kept
    assert with_motions(given, kept_motion(given, folder)).notes == (
        *given.notes, "n01 is dark", "n02 is dark", "n03 is dark",
    )  # fmt: skip
    (three / "n02_c0.png").write_bytes(b"brighter")
    session = with_motions(given, kept_motion(given, folder))
    assert session.notes == (*given.notes, "n01 is dark", "n03 is dark")
    assert [probing.displacement is None for probing in session.probings] == [False, True, False]


def test_every_kind_of_note_is_kept(kept, tmp_path):
    given, motions, _ = kept
    notes = MotionNotes(("a", "b"), ("c",), ("d",), ("e", "f", "g"))
    with result_folder(tmp_path / "noted", kind="fit") as folder:
        keep_motion(folder, given, {"n02": replace(motions["n02"], notes=notes)})
    assert {
        name: motion.notes for name, motion in kept_motion(given, tmp_path / "noted").items()
    } == {"n02": notes}


def test_names_need_not_suit_an_archive(three, tmp_path):
    names = ["n 01", "n.npy", "ключ [b] \N{SNOWMAN}"]
    given = read_session(three)
    probings = tuple(
        replace(probing, name=name) for probing, name in zip(given.probings, names, strict=True)
    )
    given = replace(given, probings=probings)
    motions = {p.name: measured_motion(given, p, seed=k) for k, p in enumerate(given.probings)}
    with result_folder(tmp_path / "odd", kind="fit") as folder:
        keep_motion(folder, given, motions)
    again = kept_motion(given, tmp_path / "odd")
    assert list(again) == names
    for name in names:
        np.testing.assert_array_equal(
            again[name].field.displacement, motions[name].field.displacement
        )


@pytest.mark.parametrize("damage", [b"", b"PK\x03\x04 nothing"])
def test_a_damaged_file_is_measured_again(kept, damage):
    (kept[2] / MOTION_FILE).write_bytes(damage)
    assert kept_motion(kept[0], kept[2]) == {}


@pytest.mark.parametrize("part", ["format", "keys", "vertex 1", "start notes 2", "pairs 0"])
@pytest.mark.parametrize("value", [None, np.array(-1)])
def test_a_file_with_a_sum_and_without_sense_is_measured_again(kept, tmp_path, part, value):
    with np.load(kept[2] / MOTION_FILE) as stored:
        arrays = dict(stored)
    assert part in arrays
    if value is None:
        del arrays[part]
    else:
        arrays[part] = value
    with result_folder(tmp_path / "odd", kind="fit") as folder:
        np.savez(folder / MOTION_FILE, **arrays)
    assert kept_motion(kept[0], tmp_path / "odd") == {}


def test_motion_without_a_sum_is_measured_again(kept):
    (kept[2] / "contents.txt").unlink()
    assert kept_motion(kept[0], kept[2]) == {}


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


def _assert_same(actual, expected):
    """All bits of all fields, and the notes."""
    assert list(actual) == list(expected)
    for name, motion in actual.items():
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
    known = kept_motion(session, result, pose="given")
    return measure_pictures(session, known=known, pose="given", **options)


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
    motions = _measured(folder, tmp_path / "two")
    assert counted == {"start": 1, "follow": 1}
    _assert_same(motions, whole[2])
    # Whoever is measured when: the session is told what it is told at once.
    session = read_session(folder)
    assert with_motions(session, motions).notes == with_motions(session, whole[2]).notes


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
    motions = _measured(folder, whole[1])
    assert counted == count
    _assert_same(motions, measure_pictures(read_session(folder), pose="given"))


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
    motions = measure_pictures(read_session(folder), pose="given", parts=parts)
    assert counted == {"start": 1}
    _assert_same(motions, {name: whole[2][name] for name in ("n02", "n01")})
    # Another picture leaves those of other probings.
    for camera in ("c0", "c1"):
        shutil.copy(folder / f"n01_1_{camera}.png", folder / f"n02_{camera}.png")
    measure_pictures(read_session(folder), pose="given", parts=parts)
    assert counted == {"start": 2, "follow": 1}
    # So does another choice of the pose leave all of them, even if it comes to the same pose.
    measure_pictures(read_session(folder), pose="auto", parts=parts)
    assert counted == {"start": 3, "follow": 4}
