"""Files and folders appear whole or not at all, at whatever step a process dies or a disk fails."""

import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import pytest
from fault_injection import in_child

import palpate
from palpate import disk
from palpate.errors import InUseError, RecordError


def _file(folder: Path, text: str) -> None:
    disk.write_bytes(folder / "a", text.encode())


def _files(folder: Path, text: str) -> None:
    """Two files, and one that names them."""
    session = folder / "session"
    with disk.new_files(session) as write, disk.atomic_replacement(session) as staged:
        named = [write(folder / name, f"{name} {text}".encode()).name for name in ("n01", "n02")]
        staged.write_text(" ".join(named))


def _folder(folder: Path, text: str) -> None:
    with disk.atomic_replacement(folder / "result", folder=True) as staged:
        (staged / "below").mkdir()
        for name in ("one", "below/two"):
            (staged / name).write_text(text)


def _folder_in_two_steps(folder: Path, text: str) -> None:
    """As where the system cannot exchange two names."""
    exchange, disk._exchange = disk._exchange, lambda *_: False
    try:
        _folder(folder, text)
    finally:
        disk._exchange = exchange


def _kept(folder: Path, text: str) -> None:
    """As with --force: a file that is no result stays under another name."""
    with disk.atomic_replacement(
        folder / "a", keep_old=lambda path: path.read_text() == "old"
    ) as staged:
        staged.write_text(text)


# What is done, and what is there before.
_OPERATIONS = {
    "file": (_file, {"a": "old"}),
    "new file": (_file, {}),
    "folder": (_folder, {"result/one": "old", "result/below/two": "old"}),
    "folder in two steps": (_folder_in_two_steps, {"result/one": "old", "result/below/two": "old"}),
    "new folder": (_folder, {}),
    "file kept aside": (_kept, {"a": "old"}),
}
# A reader finds the old or the new state at any moment, without waiting for the next command.
_IN_STEPS = ("folder in two steps", "file kept aside")
_NEVER_WITHOUT = ("file", "new file", "folder", "new folder")


def _content(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): path.read_text()
        for path in folder.rglob("*")
        if path.is_file()
    }


def _start(folder: Path, content: dict[str, str]) -> None:
    folder.mkdir(exist_ok=True)
    for name, text in content.items():
        (folder / name).parent.mkdir(exist_ok=True, parents=True)
        (folder / name).write_text(text)


def _plain(content: dict[str, str]) -> dict[str, str]:
    """What a user sees: no hidden files, nothing in hidden folders."""
    return {name: text for name, text in content.items() if not name.startswith(".")}


@pytest.mark.parametrize(
    "fault",
    [
        "dies",
        "ENOSPC",
        *(pytest.param(error, marks=pytest.mark.slow) for error in ("EIO", "EINTR")),
    ],
)
@pytest.mark.parametrize("name", list(_OPERATIONS))
def test_old_or_new_at_every_step(tmp_path, name, fault, capfd):
    dies = fault == "dies"
    work, before = _OPERATIONS[name]
    _start(tmp_path / "whole", before)
    work(tmp_path / "whole", "new")
    after = _content(tmp_path / "whole")
    outcomes, states = [], []
    while not outcomes or outcomes[-1] != "done":
        folder = tmp_path / str(len(outcomes))
        _start(folder, before)
        step = len(outcomes) + 1
        outcomes.append(in_child(lambda at=folder: work(at, "new"), folder, step=step, fault=fault))
        if name in _NEVER_WITHOUT:
            assert _plain(_content(folder)) in (before, after), len(outcomes)
        disk.put_back_interrupted(folder / "result")
        states.append(_plain(_content(folder)))
        work(folder, "again")
        again = {key: text.replace("new", "again") for key, text in after.items()}
        content = _content(folder)
        # What is kept under another name twice is not lost.
        assert content | again == content, len(outcomes)
        more = content.keys() - again.keys()
        assert not more or (name in _IN_STEPS and {content[key] for key in more} == {"old"})
    assert set(outcomes) <= {"done", "died"} if dies else {"done", "refused", "done all the same"}
    if name != "file kept aside":
        # Nothing between; what was refused has changed nothing.
        assert [state for state in states if state not in (before, after)] == []
        assert states[0] == before or not dies
        assert states[-1] == after
        for outcome, state in zip(outcomes, states, strict=True):
            assert outcome != "refused" or state == before
        # From some step on the new state.
        assert not dies or states == sorted(states, key=lambda state: state == after)
    # The work has as many steps as it takes to be safe: a loop that ends at once tests nothing.
    assert len(outcomes) > 5


@pytest.mark.parametrize("fault", ["dies", "ENOSPC"])
@pytest.mark.parametrize("before", [{}, {"n01": "n01 old", "n02": "n02 old", "session": "n01 n02"}])
def test_files_and_what_names_them_change_together(tmp_path, before, fault):
    """At every step, what the session names has the content of one moment."""
    states = {"": "none"} | {f"n01 {text}n02 {text}": text for text in ("old", "new", "again")}

    def state(folder: Path) -> str:
        content = _content(folder)
        return states["".join(content[name] for name in content.get("session", "").split())]

    outcomes, seen = [], []
    while not outcomes or outcomes[-1] != "done":
        folder = tmp_path / str(len(outcomes))
        _start(folder, before)
        step = len(outcomes) + 1
        work = partial(_files, folder, "new")
        outcomes.append(in_child(work, folder, step=step, fault=fault))
        seen.append(state(folder))
        plain = _plain(_content(folder))
        assert before.items() - {("session", "n01 n02")} <= plain.items()
        if outcomes[-1] == "refused":
            assert plain == before
        # What a killed run has written is taken as it is by the next one.
        _files(folder, "new")
        assert state(folder) == "new"
        assert len(_content(folder)) == max(3, 5 * bool(before))
        _files(folder, "again")
        assert state(folder) == "again"
    assert seen[0] in ("none", "old")
    assert seen[-1] == "new"
    assert len(seen) > 5
    # From some step on the new state.
    assert fault != "dies" or seen == sorted(seen, key=lambda content: content == "new")


def test_a_file_with_the_same_content_is_taken_as_it_is(tmp_path):
    wanted = tmp_path / "n01.csv"
    assert disk.free_name(wanted, b"a") == wanted
    wanted.write_bytes(b"a")
    assert disk.free_name(wanted, b"a") == wanted
    assert disk.free_name(wanted, b"b") == tmp_path / "n01_2.csv"
    # What is no file is never opened: a pipe would wait for ever.
    os.mkfifo(tmp_path / "n01_2.csv")
    (tmp_path / "n01_3.csv").symlink_to("nothing")
    (tmp_path / "n01_4.csv").mkdir()
    assert disk.free_name(wanted, b"") == tmp_path / "n01_5.csv"


def test_a_second_process_is_told_who_writes(tmp_path):
    target = tmp_path / "result"
    with (
        disk.atomic_replacement(target, folder=True),
        pytest.raises(InUseError, match=rf"being written by process {os.getpid()} on "),
        disk.atomic_replacement(target, folder=True),
    ):
        raise AssertionError("the block must not run")
    # The lock of a process that was killed holds nobody up.
    (tmp_path / ".result.lock").write_text("process 1 on this host")
    _folder(tmp_path, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["result"]


def _linked(path: Path) -> None:
    path.with_name("precious").write_text("of somebody else")
    path.symlink_to("precious")


# What may lie where a lock would, in a folder that comes from anywhere.
_FOREIGN = {
    "link": _linked,
    "link to nothing": lambda path: path.symlink_to("nothing"),
    "file": lambda path: path.write_text("of somebody else"),
    "folder": lambda path: path.mkdir(),
    "pipe": lambda path: os.mkfifo(path),
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("kind", _FOREIGN)
def test_what_is_no_lock_stays_as_it_is(tmp_path, kind):
    lock = tmp_path / ".a.lock"
    _FOREIGN[kind](lock)
    before = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(RecordError, match=r"\.a\.lock: is not a lock of Palpate's"):
        _file(tmp_path, "new")
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    for path in tmp_path.iterdir():
        assert not path.is_file() or path.read_text() == "of somebody else"


@pytest.mark.usefixtures("heeded_signals")
def test_a_signal_waits_until_all_is_in_place(tmp_path, monkeypatch):
    _start(tmp_path, {"session": "old"})
    real = os.replace

    def replace(*names):
        signal.raise_signal(signal.SIGINT)
        return real(*names)

    def work():
        session = tmp_path / "session"
        with disk.new_files(session) as write, disk.atomic_replacement(session) as staged:
            write(tmp_path / "n01", b"new")
            staged.write_text("new")
            monkeypatch.setattr(os, "replace", replace)

    with pytest.raises(KeyboardInterrupt):
        work()
    monkeypatch.undo()
    assert _content(tmp_path) == {"n01": "new", "session": "new"}


def test_what_earlier_versions_left(tmp_path, capsys):
    _start(tmp_path, {".a.12.partial": "half", ".a.12.older": "whole", ".b.7.older": "b"})
    (tmp_path / "b").write_text("newer")
    _file(tmp_path, "new")
    assert _content(tmp_path) == {"a": "new", ".b.7.older": "b", "b": "newer"}
    disk.write_bytes(tmp_path / "b", b"new")
    assert _content(tmp_path) == {"a": "new", "b": "new", "b.old": "b"}
    said = capsys.readouterr().err
    assert ".a.12.partial: left by an interrupted run, removed" in said
    assert "a: put back" in said
    assert "kept as" in said


def test_what_is_no_file_or_elsewhere_is_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordError, match="pipe: is no regular file"):
        disk.write_bytes(tmp_path / "pipe", b"")
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "thesis").write_text("years of work")
    with pytest.raises(RecordError, match="below: is a folder"):
        disk.write_bytes(tmp_path / "below", b"")
    (tmp_path / "file").write_text("mine")
    with (
        pytest.raises(RecordError, match="file: is no folder"),
        disk.atomic_replacement(tmp_path / "file", folder=True),
    ):
        raise AssertionError("the block must not run")
    assert _content(tmp_path) == {"below/thesis": "years of work", "file": "mine"}
    (tmp_path / "n01").symlink_to(tmp_path / "below" / "n01")
    # A link to another place is followed.
    disk.write_bytes(tmp_path / "n01", b"new")
    assert (tmp_path / "below" / "n01").read_text() == "new"


def test_an_older_folder_without_rights_is_not_left_behind(tmp_path):
    """As a user who may do only what rights allow: root, here, is asked to give that up."""
    older = tmp_path / "result"
    (older / "plots").mkdir(parents=True)
    (older / "plots" / "one.png").write_text("old")
    code = (
        "import sys, pathlib; from palpate.disk import atomic_replacement\n"
        "with atomic_replacement(pathlib.Path(sys.argv[1]), folder=True) as new:\n"
        "    (new / 'a').write_text('new')"
    )
    drop = [shutil.which("setpriv"), "--inh-caps=-all", "--bounding-set=-all"]
    if os.getuid() != 0:
        drop = []
    elif drop[0] is None:
        pytest.skip("needs setpriv, or another user than root")
    for folder in (older / "plots", older):
        folder.chmod(0o555)
    source = str(Path(palpate.__file__).parents[1])
    subprocess.run(
        [*drop, sys.executable, "-c", code, str(older)], check=True, env={"PYTHONPATH": source}
    )
    assert [path.name for path in tmp_path.iterdir()] == ["result"]
    assert [path.name for path in older.iterdir()] == ["a"]


def test_what_was_made_of_a_folder_goes_again_where_the_block_fails(tmp_path):
    folder = tmp_path / "a" / "b"
    with disk.created_folder(folder):
        pass
    assert folder.is_dir()
    with pytest.raises(RecordError, match="full"), disk.created_folder(folder / "c" / "d"):
        raise RecordError("full")
    assert list(folder.iterdir()) == []
    # What was there before stays, and so does what holds something.
    with pytest.raises(RecordError, match="full"), disk.created_folder(folder):
        raise RecordError("full")
    (folder / "c").mkdir()
    (folder / "c" / "file").touch()
    with pytest.raises(RecordError, match="full"), disk.created_folder(folder / "c"):
        raise RecordError("full")
    assert (folder / "c" / "file").is_file()
    below = folder / "c" / "file" / "d"
    with pytest.raises(RecordError, match="d: cannot be written"), disk.created_folder(below):
        pass
