"""Poses, sessions without displacements, which file is whose, and one line more in session.toml."""

import os
import tomllib
from pathlib import Path

import numpy as np
import pytest

from palpate.errors import MeshError, RecordError
from palpate.records import read_session
from palpate.records.files.placed import placed_files
from palpate.records.files.session_edit import displacement_line, with_displacements
from palpate.records.files.session_outline import import_plan, read_session_outline
from palpate.records.import_pose import read_import_pose

TURN = "R = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]"


# Pose ------------------------------------------------------------------------------------------


def _pose(tmp_path, text):
    path = tmp_path / "pose.toml"
    path.write_text(text)
    return read_import_pose(path)


@pytest.mark.parametrize(
    "text",
    [
        f'length_unit = "mm"\n{TURN}\nt = [1, 2, 3]',
        'length_unit = "mm"\nT = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]',
    ],
)
def test_pose(tmp_path, text):
    pose, notes = _pose(tmp_path, text)
    # x_object = R x_file + t: the file's x axis is the object's y axis.
    np.testing.assert_allclose(pose @ [1.0, 0.0, 0.0, 1.0], [1e-3, 1.002, 3e-3, 1.0], rtol=1e-15)
    assert notes == ()


def test_pose_typed_with_few_digits_is_made_a_rotation(tmp_path):
    text = 'length_unit = "m"\nR = [[0.866, -0.5, 0], [0.5, 0.866, 0], [0, 0, 1]]\nt = [0, 0, 0]'
    pose, notes = _pose(tmp_path, text)
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-15)
    # The nearest rotation to two typed numbers is theirs over their length.
    assert pose[0, 0] == pytest.approx(0.866 / np.hypot(0.866, 0.5), rel=1e-14)
    assert "R was made orthogonal; it was 4e-05 off" in notes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{TURN}\nt = [0, 0, 0]", "the key 'length_unit' is missing"),
        ('length_unit = "km"', "is 'km'.*allowed: um, mm, cm, m, in"),
        ('length_unit = "m"', "must have either R and t, or T; for example: length_unit"),
        (f'length_unit = "m"\n{TURN}', "the key 't' is missing"),
        (f'length_unit = "m"\n{TURN}\nt = [0, 0, 0]\nT = [1]', "must have either R and t, or T"),
        ('length_unit = "m"\nR = [[1, 0], [0, 1]]\nt = [0, 0, 0]', "must be 3 rows of 3 finite"),
        ('length_unit = "m"\nR = "I"\nt = [0, 0, 0]', "must be 3 rows of 3 finite numbers"),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0.1], [0, 0, 1]]\nt = [0, 0, 0]',
            "R: is no rotation: R R.T is 0.1 off the identity",
        ),
        (
            'length_unit = "m"\nR = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\nt = [0, 0, 0]',
            "is a mirror image",
        ),
        (
            'length_unit = "m"\nT = [[1,0,0,0], [0,1,0,0], [0,0,1,0], [0,0,0,2]]',
            r"has the last row \[0.0, 0.0, 0.0, 2.0\]",
        ),
        ('length_unit = "m"\nrotation = 1', "unknown key 'rotation'"),
        ("length_unit =", "is not valid TOML"),
    ],
)
def test_pose_refusals(tmp_path, text, message):
    with pytest.raises(RecordError, match=message):
        _pose(tmp_path, text)


# Outline and plan ------------------------------------------------------------------------------


@pytest.fixture
def bare(session_folder: Path) -> Path:
    """The session with neither displacement file named."""
    file = session_folder / "session.toml"
    text = file.read_text()
    file.write_text(
        text.replace('displacement = "n01.csv"\n', "").replace('"n02.csv"', '"old.csv"')
    )
    return session_folder


def test_outline_of_a_session_without_displacements(bare):
    outline = read_session_outline(bare)
    assert outline.path == bare / "session.toml"
    assert [(probe.name, probe.displacement) for probe in outline.probes] == [
        ("n01", None),
        ("n02", "old.csv"),
    ]
    assert outline.metres_per_unit == 1.0
    assert len(outline.mesh.vertices) == 98
    assert read_session_outline(bare / "session.toml").path == outline.path


def _edit(folder, old, new):
    file = folder / "session.toml"
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))


def test_outline_refusals(bare, tmp_path):
    with pytest.raises(RecordError, match="is no session; name its folder"):
        read_session_outline(tmp_path / "n02.csv")
    with pytest.raises(RecordError, match="is no session"):
        read_session_outline(tmp_path / "nowhere")
    _edit(bare, 'name = "n02"', 'name = "n01"')
    with pytest.raises(RecordError, match=r"probings share the names \['n01'\]"):
        read_session_outline(bare)
    (bare / "mesh.ply").write_text("ply")
    with pytest.raises(MeshError, match=r"mesh\.ply"):
        read_session_outline(bare)
    (bare / "session.toml").unlink()
    with pytest.raises(RecordError, match="is no session"):
        read_session_outline(bare)


def test_outline_without_probings(bare):
    file = bare / "session.toml"
    file.write_text(file.read_text().partition("[[probe]]")[0])
    with pytest.raises(RecordError, match=r"has no \[\[probe\]\] table; displacements belong to"):
        read_session_outline(bare)


def _plan(folder, files, probes=None, frames=None):
    outline = read_session_outline(folder)
    plan = import_plan(outline, [Path(file) for file in files], probes=probes, frames=frames)
    return [(str(item.file), item.probe.name, item.frame) for item in plan]


def test_plan(bare):
    by_name = [("a/n02.csv", "n02", None), ("n01.txt", "n01", None)]
    assert _plan(bare, ["a/n02.csv", "n01.txt"]) == by_name
    assert _plan(bare, ["x.csv", "y.csv"], ["n02", "n01"]) == [
        ("x.csv", "n02", None),
        ("y.csv", "n01", None),
    ]
    assert _plan(bare, ["x.e", "y.e"], ["n02", "n01"], [7]) == [
        ("x.e", "n02", 7),
        ("y.e", "n01", 7),
    ]
    assert _plan(bare, ["x.e"], ["n02", "n01"], [1, 2]) == [("x.e", "n02", 1), ("x.e", "n01", 2)]
    assert _plan(bare, ["x.e"], ["n02"], [1]) == [("x.e", "n02", 1)]


def test_plan_of_the_only_probing(bare):
    file = bare / "session.toml"
    text = file.read_text()
    file.write_text(text[: text.rindex("[[probe]]")])
    assert _plan(bare, ["B0001.csv"]) == [("B0001.csv", "n01", None)]


@pytest.mark.parametrize(
    ("files", "probes", "frames", "message"),
    [
        (["B1.csv"], None, None, r"named 'B1' \(there are: n01, n02\).*e.g. --probe n01"),
        (["x.csv"], ["n03"], None, r"no probing 'n03'; did you mean 'n02'|'n01'"),
        (["x.csv", "y.csv"], ["n01"], None, "names 1 probings for 2 files"),
        (["x.csv"], ["n01", "n02"], None, "names 2 probings for 1 files.*one --frame for each"),
        (["x.csv", "y.csv"], ["n01", "n01"], None, "two results are given for the probing 'n01'"),
        (["x.csv"], ["n01"], [1, 2], "gives 2 numbers for 1 probings"),
    ],
)
def test_plan_refusals(bare, files, probes, frames, message):
    with pytest.raises(RecordError, match=message):
        _plan(bare, files, probes, frames)


# One line more ---------------------------------------------------------------------------------

HAND_MADE = """\
# My session
name = "x"   # a name

[[probe]]  # first
name = "n01"
force = [0, 0,
         -1]     # N

# second one:
[[ probe ]]
displacement = 'old.csv'   # by hand
name = "n02"
[probe.contact]
point = [1, 2, 3]

[[probe]]
name = "n03"
"""


def test_only_one_line_changes():
    changed = with_displacements(Path("s.toml"), HAND_MADE, {"n01": "n01.csv"})
    expected = HAND_MADE.replace("-1]     # N\n", '-1]     # N\ndisplacement = "n01.csv"\n')
    assert changed == expected


def test_a_value_is_exchanged_and_its_comment_stays():
    changed = with_displacements(Path("s.toml"), HAND_MADE, {"n02": "new.csv"})
    assert changed == HAND_MADE.replace("'old.csv'   # by", '"new.csv"   # by')


def test_several_and_the_last_line_without_an_end():
    text = HAND_MADE.rstrip("\n")
    changed = with_displacements(Path("s.toml"), text, {"n03": "c.csv", "n01": "a.csv"})
    assert changed.endswith('name = "n03"\ndisplacement = "c.csv"\n')
    probes = tomllib.loads(changed)["probe"]
    assert [probe.get("displacement") for probe in probes] == ["a.csv", "old.csv", "c.csv"]


def test_line_ends_of_windows_stay():
    changed = with_displacements(
        Path("s.toml"), HAND_MADE.replace("\n", "\r\n"), {"n01": "a.csv", "n02": "b.csv"}
    )
    assert changed.replace("\r\n", "").count("\n") == 0
    assert changed.count("\r\n") == HAND_MADE.count("\n") + 1


def test_one_table_alone():
    text = '[probe]\nname = "n01"\n'
    assert with_displacements(Path("s.toml"), text, {"n01": "a"}) == text + 'displacement = "a"\n'


def test_names_with_quotes():
    assert displacement_line('a"b.csv') == 'displacement = "a\\"b.csv"'


@pytest.mark.parametrize(
    "text",
    [
        'probe = [{ name = "n01", force = [0, 0, 1] }]\n',
        '[[probe]]\nname = "n01"\nnotes = """\n[[probe]]\n"""\n[[probe]]\nname = "n02"\n',
        '[[probe]]\nname = "n01"\ndisplacement = """old.csv"""\n',
        '[["probe"]]\nname = "n01"\n',
    ],
)
def test_what_cannot_be_edited_is_left_alone(text):
    wanted = tomllib.loads(text)["probe"][-1]["name"]
    with pytest.raises(RecordError, match=r"cannot be edited safely; nothing was changed.*add by"):
        with_displacements(Path("s.toml"), text, {wanted: "a.csv"})


def test_the_session_reads_as_before(bare):
    path = bare / "session.toml"
    path.write_text(
        with_displacements(path, path.read_text(), {"n01": "n01.csv", "n02": "n02.csv"})
    )
    session = read_session(bare)
    assert [probing.displacement is not None for probing in session.probings] == [True, True]


# Files together --------------------------------------------------------------------------------


def _names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_files_appear_together(tmp_path):
    (tmp_path / "b").write_text("old")
    with placed_files([tmp_path / "a", tmp_path / "b"]) as staged:
        staged[0].write_text("1")
        staged[1].write_text("2")
        assert (tmp_path / "b").read_text() == "old"
    assert _names(tmp_path) == ["a", "b"]
    assert (tmp_path / "b").read_text() == "2"


def test_files_vanish_together(tmp_path):
    (tmp_path / "b").write_text("old")

    def spoil():
        with placed_files([tmp_path / "a", tmp_path / "b"]) as staged:
            staged[0].write_text("1")
            raise KeyError

    with pytest.raises(KeyError):
        spoil()
    assert _names(tmp_path) == ["b"]
    assert (tmp_path / "b").read_text() == "old"


def test_a_file_that_cannot_take_its_place_brings_the_others_back(tmp_path):
    (tmp_path / "a").write_text("old")

    def spoil():
        with placed_files([tmp_path / "a", tmp_path / "b", tmp_path / "c"]) as staged:
            for path in staged:
                path.write_text("new")
            staged[2].unlink()

    with pytest.raises(RecordError, match=r"c: cannot be written .*nothing was changed"):
        spoil()
    assert _names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "old"


def test_a_folder_that_does_not_allow_it(tmp_path):
    with (
        pytest.raises(RecordError, match=r"cannot be written .*--out"),
        placed_files([tmp_path / "a", tmp_path / "none" / "b"]),
    ):
        raise AssertionError("the block must not run")
    assert _names(tmp_path) == []


def test_rights_and_links_stay(tmp_path):
    real = tmp_path / "real"
    real.write_text("old")
    real.chmod(0o640)
    (tmp_path / "link").symlink_to(real)
    with placed_files([tmp_path / "link"]) as staged:
        staged[0].write_text("new")
    assert os.path.islink(tmp_path / "link")
    assert real.read_text() == "new"
    assert real.stat().st_mode & 0o777 == 0o640
