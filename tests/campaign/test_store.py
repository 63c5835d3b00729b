"""Lists of sessions and folders with sessions."""

import pytest

from palpate.campaign import read_items
from palpate.errors import RecordError


def _session(folder):
    folder.mkdir(parents=True)
    (folder / "session.toml").write_text("")
    return folder


def test_a_list_names_paths_and_groups(tmp_path):
    _session(tmp_path / "a")
    listed = tmp_path / "list.txt"
    listed.write_text("# fruit\n a , ripe  # the first\n\nb c, unripe\nd\n")
    items = read_items(listed)
    assert [(item.name, item.group) for item in items] == [
        ("a", "ripe"),
        ("b c", "unripe"),
        ("d", ""),
    ]
    # A session that is not there is found out when its turn comes, as a row of its own.
    assert [item.path for item in items] == [tmp_path / "a", tmp_path / "b c", tmp_path / "d"]


def test_sessions_below_a_folder_are_grouped_by_the_way_to_them(tmp_path):
    for below in ("z", "ripe/2", "ripe/1", "unripe/day 1/7"):
        _session(tmp_path / below)
    items = [(item.name, item.group) for item in read_items(tmp_path)]
    assert items == [
        ("ripe/1", "ripe"),
        ("ripe/2", "ripe"),
        ("unripe/day 1/7", "unripe"),
        ("z", ""),
    ]


def test_nothing_to_do_is_said(tmp_path):
    with pytest.raises(RecordError, match=r"no session.toml anywhere below it"):
        read_items(tmp_path)
    (tmp_path / "list.txt").write_text("# nothing yet\n")
    with pytest.raises(RecordError, match="names no session"):
        read_items(tmp_path / "list.txt")
    with pytest.raises(RecordError, match="cannot be read"):
        read_items(tmp_path / "no list")
