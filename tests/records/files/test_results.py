"""Results are known again by their sums; only unchanged ones are replaced."""

import errno
import os
import subprocess

import pytest

from palpate.errors import InputError, RecordError
from palpate.records import (
    folder_changes,
    parts_folder,
    record_inputs,
    result_folder,
    session_files,
)
from palpate.records.files import results
from palpate.records.files.results import CONTENTS_FILE, parsed_sums, sums_text


def _make(target, *, force=False, kind="fit", **files):
    with result_folder(target, kind=kind, force=force) as folder:
        for name, text in files.items():
            (folder / name).write_text(text)


def _names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_folder_appears_with_what_was_written(tmp_path):
    target = tmp_path / "result"
    with result_folder(target, kind="fit") as folder:
        (folder / "estimate.json").write_text("{}")
        (folder / "residuals").mkdir()
        (folder / "residuals" / "n01.csv").write_text("x")
        assert not target.exists()
    names = {str(path.relative_to(target)) for path in target.rglob("*")}
    assert names == {"estimate.json", "residuals", "residuals/n01.csv", CONTENTS_FILE}
    assert _names(tmp_path) == ["result"]


def test_the_sums_are_those_of_sha256sum(tmp_path):
    _make(tmp_path / "result", **{"plain": "1", "a b": "2", "back\\slash": "3", "line\nbreak": "4"})
    command = ["sha256sum", "--check", "--strict", "--quiet", CONTENTS_FILE]
    done = subprocess.run(command, cwd=tmp_path / "result", capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    names = {"a b": "0" * 64, "back\\slash": "1" * 64, "line\nbreak\r": "2" * 64, "\\n": "3" * 64}
    assert parsed_sums("# a comment\n" + sums_text(names)) == names


def test_nothing_is_left_when_the_block_fails(tmp_path):
    def spoil():
        with result_folder(tmp_path / "result", kind="fit") as folder:
            (folder / "estimate.json").write_text("{")
            parts_folder(folder).mkdir()
            raise KeyError("half way")

    with pytest.raises(KeyError, match="half way"):
        spoil()
    assert _names(tmp_path) == []


def test_finished_parts_of_long_work_outlive_an_interruption(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(results, "_MIN_SECONDS_TO_KEEP", -1.0)

    def spoil():
        with result_folder(tmp_path / "result", kind="fit") as folder:
            parts_folder(folder).mkdir()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        spoil()
    assert _names(tmp_path) == [".result.parts"]
    assert "finished parts are kept in " in capsys.readouterr().err
    _make(tmp_path / "result")
    assert _names(tmp_path) == ["result"]


def test_an_older_result_is_replaced_whole(tmp_path):
    _make(tmp_path / "result", first="1", both="1")
    _make(tmp_path / "result", second="2", both="2")
    names = {path.name: path.read_text() for path in (tmp_path / "result").iterdir()}
    assert set(names) == {"second", "both", CONTENTS_FILE}
    assert names["both"] == "2"
    assert _names(tmp_path) == ["result"]


def test_an_older_result_stays_when_the_next_one_fails(tmp_path):
    _make(tmp_path / "result", first="1")

    def spoil():
        with result_folder(tmp_path / "result", kind="fit"):
            raise KeyError("half way")

    with pytest.raises(KeyError):
        spoil()
    assert (tmp_path / "result" / "first").read_text() == "1"


def _edit(result):
    (result / "first").write_text("2")


def _add(result):
    (result / "thesis.txt").write_text("years of work")


def _add_many(result):
    for name in ("a" * 60, "b" * 40, "c", "d", "e"):
        (result / name).write_text("")


def _link(result):
    (result / "link").symlink_to(result.parent)


def _drop(result):
    (result / "first").unlink()


def _forget(result):
    (result / CONTENTS_FILE).write_text("palpate result folder; files:\nfirst\n")


def _strange(result):
    (result / CONTENTS_FILE).unlink()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_edit, r"is a result that was changed since: first \(changed\)"),
        (_add, r"is a result that was changed since: thesis\.txt \(not listed\)"),
        (
            _add_many,
            "since: " + "a" * 37 + r"\.\.\., " + "b" * 37 + r"\.\.\., c \(not listed\)"
            " and 2 more",
        ),
        (_link, r"is a result that was changed since: link \(not listed\)"),
        (_drop, r"is a result that was changed since: first \(missing\)"),
        (_forget, "is a result of an earlier version"),
        (_strange, r"holds files that are no result of Palpate's, e\.g\. first"),
    ],
)
def test_what_was_changed_or_is_somebodys_is_not_replaced(tmp_path, change, message, capsys):
    target = tmp_path / "result"
    _make(target, first="1")
    change(target)
    before = {path.name: path.read_bytes() for path in target.iterdir() if path.is_file()}
    with pytest.raises(InputError, match=message + r".*--out, or give --force"):
        _make(target, second="2")
    assert {p.name: p.read_bytes() for p in target.iterdir() if p.is_file()} == before
    _make(target, second="2", force=True)
    assert _names(target) == [CONTENTS_FILE, "second"]
    old = tmp_path / "result.old"
    assert {p.name: p.read_bytes() for p in old.iterdir() if p.is_file()} == before
    assert "what was there is kept as" in capsys.readouterr().err


def test_what_is_changed_while_the_next_result_is_made_is_kept(tmp_path):
    target = tmp_path / "result"
    _make(target, first="1")
    with result_folder(target, kind="fit") as folder:
        (folder / "second").write_text("2")
        _edit(target)
    assert _names(target) == [CONTENTS_FILE, "second"]
    assert (tmp_path / "result.old" / "first").read_text() == "2"


def test_an_empty_folder_is_used(tmp_path):
    (tmp_path / "result").mkdir()
    _make(tmp_path / "result", first="1")
    assert (tmp_path / "result" / "first").read_text() == "1"
    assert _names(tmp_path) == ["result"]


def test_a_place_that_cannot_be_written_is_said_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    ran = []

    def work(target):
        with result_folder(target, kind="fit"):
            ran.append(target)

    with pytest.raises(InputError, match=r"cannot be written: .* is not a folder; make it first"):
        work(tmp_path / "none" / "result")
    with pytest.raises(InputError, match="cannot be written"):
        work(tmp_path / "file" / "result")
    with pytest.raises(InputError, match="is not a folder; choose another name"):
        work(tmp_path / "file")
    for above in (".", "..", "/"):
        with pytest.raises(InputError, match="this one holds more than that"):
            work(above)
    # A system folder in which not even the administrator can make a folder.
    with pytest.raises(InputError, match=r"/proc/result: cannot be written \("):
        work("/proc/result")
    assert ran == []


def test_a_full_disk_is_said(tmp_path):
    with (
        pytest.raises(RecordError, match=r"result: cannot be written \(No space left on device\)"),
        result_folder(tmp_path / "result", kind="fit"),
    ):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert _names(tmp_path) == []


def test_what_cannot_be_read_is_not_said_of_the_result(tmp_path):
    picture = str(tmp_path / "session" / "a.png")
    with (
        pytest.raises(PermissionError, match=r"a\.png"),
        result_folder(tmp_path / "result", kind="fit"),
    ):
        raise PermissionError(errno.EACCES, "Permission denied", picture)


def test_changes_of_results_and_inputs_are_found(tmp_path):
    """As `sha256sum -c` tells them, too."""
    (tmp_path / "one.csv").write_text("1")
    (tmp_path / "two.csv").write_text("2")
    with result_folder(tmp_path / "result", kind="fit") as folder:
        record_inputs(folder, [tmp_path / "one.csv", tmp_path / "two.csv"])
        (folder / "kept").write_text("1")
        (folder / "edited").write_text("1")
    result = tmp_path / "result"
    assert folder_changes(result)[1] == {}
    check = ["sha256sum", "--check", "--quiet", "contents.txt", "inputs.txt"]
    assert subprocess.run(check, cwd=result, capture_output=True, check=False).returncode == 0
    (tmp_path / "one.csv").write_text("3")
    (result / "edited").write_text("2")
    (result / "more").write_text("2")
    (result / "kept").unlink()
    assert folder_changes(result)[1] == {
        "edited": "changed", "kept": "missing", "more": "not listed"
    }  # fmt: skip
    checked = subprocess.run(check, cwd=result, capture_output=True, text=True, check=False)
    assert checked.returncode == 1
    for name in ("edited", "kept", "../one.csv"):
        assert f"{name}: FAILED" in checked.stdout


def test_files_of_a_session(tmp_path):
    session = """\
name = "../secret"
[object]
mesh = "mesh.ply"
[rig]
cameras = "calibration"
[[probe]]
name = "n[1]"
displacement = "n[1].csv"
images = { rest = "rest_{camera}.png", loaded = ["n01_{camera}.png"] }
"""
    names = ("session.toml", "mesh.ply", "n[1].csv", "n1.csv", "rest_c0.png", "rest_c1.png",
             "n01_c0.png", "other.png")  # fmt: skip
    for name in names:
        (tmp_path / name).write_text(session)
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "cam0.xml").write_text("")
    listed = {path.relative_to(tmp_path).as_posix() for path in session_files(tmp_path)}
    assert listed == {*names, "calibration/cam0.xml"} - {"n1.csv", "other.png"}
