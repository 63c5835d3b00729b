"""Sessions without displacements, which file is whose, and one key more in session.toml."""

import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from palpate.errors import RecordError
from palpate.records import read_session
from palpate.records.files.session_import import (
    displacement_line,
    import_plan,
    named_displacements,
    with_displacements,
)


@pytest.fixture
def bare(session_folder: Path) -> Path:
    """The session with neither displacement file named."""
    file = session_folder / "session.toml"
    text = file.read_text()
    file.write_text(
        text.replace('displacement = "n01.csv"\n', "").replace('"n02.csv"', '"old.csv"')
    )
    return session_folder


def test_a_session_without_its_observations(bare):
    session = read_session(bare, observations=False)
    assert [(p.name, p.displacement, p.images) for p in session.probings] == [
        ("n01", None, None),
        ("n02", None, None),
    ]
    assert session.probings[0].force.tolist() == [0.0, 0.0, -1.2]
    assert named_displacements(session.path) == {"n02": "old.csv"}


def test_pictures_without_a_rig_do_not_matter_where_nothing_is_observed(bare):
    file = bare / "session.toml"
    images = 'images = { rest = "r_{camera}.png", loaded = ["a_{camera}.png"] }\n'
    file.write_text(file.read_text().replace("force_std = 0.012\n", images))
    assert read_session(bare, observations=False).probings[0].images is None
    file.write_text(file.read_text().replace('displacement = "old.csv"', images))
    with pytest.raises(RecordError, match="probing 'n01' has images, but no rig is given"):
        read_session(bare)


def _plan(folder, files, probes=None, frames=None):
    session = read_session(folder, observations=False)
    plan = import_plan(session, [Path(file) for file in files], probes=probes, frames=frames)
    return [(str(item.file), item.probe, item.frame) for item in plan]


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


HAND_MADE = """\
# My session
name = "x"   # a name

[[probe]]  # first
name = "n01"
force = [0, 0,
         -1]     # N

# second one:
[[probe]]
displacement = 'old.csv'   # by hand
name = "n02"
[probe.contact]
point = [1, 2, 3]

[[probe]]
name = "n03"
"""


def test_only_one_line_changes():
    changed = with_displacements(HAND_MADE, {"n01": "n01.csv"})
    expected = HAND_MADE.replace("-1]     # N\n", '-1]     # N\ndisplacement = "n01.csv"\n')
    assert changed == expected


def test_a_value_is_exchanged_and_its_comment_stays():
    changed = with_displacements(HAND_MADE, {"n02": "new.csv"})
    assert changed == HAND_MADE.replace("'old.csv'   # by", '"new.csv"   # by')


def test_several_and_the_last_line_without_an_end():
    text = HAND_MADE.rstrip("\n")
    changed = with_displacements(text, {"n03": "c.csv", "n01": "a.csv"})
    assert changed.endswith('name = "n03"\ndisplacement = "c.csv"\n')
    probes = tomllib.loads(changed)["probe"]
    assert [probe.get("displacement") for probe in probes] == ["a.csv", "old.csv", "c.csv"]


def test_line_ends_of_windows_stay():
    changed = with_displacements(HAND_MADE.replace("\n", "\r\n"), {"n01": "a.csv", "n02": "b.csv"})
    assert changed.replace("\r\n", "").count("\n") == 0
    assert changed.count("\r\n") == HAND_MADE.count("\n") + 1


def test_one_table_alone():
    text = '[probe]\nname = "n01"\n'
    assert with_displacements(text, {"n01": "a"}) == text + 'displacement = "a"\n'


def test_names_with_quotes():
    assert displacement_line('a"b.csv') == 'displacement = "a\\"b.csv"'


@pytest.mark.parametrize(
    "text",
    [
        'probe = [{ name = "n01", force = [0, 0, 1] }]\n',
        'probe = [{ name = "n00" }, { displacement = "old.csv", name = "n01" }] # two\n',
        '[[probe]]\nname = "n01"\nnotes = """\n[[probe]]\n"""\n[[probe]]\nname = "n02"\n',
        '[[probe]]\nname = "n01"\ndisplacement = """old.csv"""\n',
        '[["probe"]]\nname = "n01"\nimages.rest = "a"\n\n[rig]\n',
        '[[probe]]\ncontact.radius = 1\nname = "n01"\n# end\n[probe.more]\nx = 1\n[[step]]\n',
    ],
)
def test_only_the_named_key_changes_however_the_tables_are_written(text):
    before = tomllib.loads(text)
    name = before["probe"][-1]["name"]
    changed = tomllib.loads(with_displacements(text, {name: 'a"b.csv'}))
    before["probe"][-1]["displacement"] = 'a"b.csv'
    assert changed == before


@settings(max_examples=40, deadline=None)
@given(
    extra=st.lists(
        st.sampled_from(["", "# note", "force_std = 1", "tip = [1,\n  2] # N", "x.y = 'z'"]),
        unique=True,
    ),
    name=st.text(st.characters(exclude_categories=["C"]), min_size=1),
    ending=st.sampled_from(["\n", "\r\n"]),
)
def test_one_line_is_added_to_any_table_and_no_other_changes(extra, name, ending):
    text = "\n".join(["[[probe]]", 'name = "n01"', *extra, "[rig] # the end", "a = 1", ""])
    text = text.replace("\n", ending)
    before = text.split(ending)
    after = with_displacements(text, {"n01": name}).split(ending)
    added = [i for i, line in enumerate(after) if line.startswith("displacement")]
    assert [line for i, line in enumerate(after) if i not in added] == before
    assert tomllib.loads(after[added[0]]) == {"displacement": name}


def test_the_session_reads_as_before(bare):
    path = bare / "session.toml"
    path.write_text(with_displacements(path.read_text(), {"n01": "n01.csv", "n02": "n02.csv"}))
    session = read_session(bare)
    assert [probing.displacement is not None for probing in session.probings] == [True, True]
