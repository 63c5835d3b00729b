"""Files and folders appear whole or not at all."""

import os

import pytest

from palpate.errors import InputError, RecordError
from palpate.records.files.atomic import CONTENTS_FILE, placed_files, result_folder


def _make(target, **files):
    with result_folder(target) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def test_a_folder_appears_with_what_was_written(tmp_path):
    target = tmp_path / "result"
    with result_folder(target) as folder:
        (folder / "estimate.json").write_text("{}")
        (folder / "residuals").mkdir()
        (folder / "residuals" / "n01.csv").write_text("x")
        assert not target.exists()
    names = {str(path.relative_to(target)) for path in target.rglob("*")}
    assert names == {"estimate.json", "residuals", "residuals/n01.csv", CONTENTS_FILE}
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_nothing_is_left_when_the_block_fails(tmp_path):
    def spoil():
        with result_folder(tmp_path / "result") as folder:
            (folder / "estimate.json").write_text("{")
            raise KeyError("half way")

    with pytest.raises(KeyError, match="half way"):
        spoil()
    assert list(tmp_path.iterdir()) == []


def test_an_older_result_is_replaced_whole(tmp_path):
    _make(tmp_path / "result", first="1", both="1")
    _make(tmp_path / "result", second="2", both="2")
    names = {path.name: path.read_text() for path in (tmp_path / "result").iterdir()}
    assert set(names) == {"second", "both", CONTENTS_FILE}
    assert names["both"] == "2"
    assert [path.name for path in tmp_path.iterdir()] == ["result"]


def test_an_older_result_stays_when_the_next_one_fails(tmp_path):
    _make(tmp_path / "result", first="1")

    def spoil():
        with result_folder(tmp_path / "result"):
            raise KeyError("half way")

    with pytest.raises(KeyError):
        spoil()
    assert (tmp_path / "result" / "first").read_text() == "1"


def test_an_empty_folder_is_used_and_a_strangers_is_not(tmp_path):
    (tmp_path / "result").mkdir()
    _make(tmp_path / "result", first="1")
    (tmp_path / "result" / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match=r"no result of Palpate's, the first: \['thesis\.txt'\]"):
        _make(tmp_path / "result", second="2")
    assert (tmp_path / "result" / "thesis.txt").read_text() == "years of work"


def test_a_folder_that_cannot_be_written_is_said_before_the_work(tmp_path):
    (tmp_path / "file").write_text("")
    ran = []

    def work(target):
        with result_folder(target):
            ran.append(target)

    with pytest.raises(InputError, match=r"cannot be written: .* is not a folder; make it first"):
        work(tmp_path / "none" / "result")
    with pytest.raises(InputError, match="cannot be written"):
        work(tmp_path / "file" / "result")
    with pytest.raises(InputError, match="is not a folder; choose another name"):
        work(tmp_path / "file")
    # A system folder in which not even the administrator can make a folder.
    with pytest.raises(InputError, match=r"/proc/result: cannot be written \("):
        work("/proc/result")
    assert ran == []


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
