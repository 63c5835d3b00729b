"""Parts of long work are read as they were made, and only by the work that made them."""

import os
import shutil
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.sparse import bsr_array, csr_array

from palpate import checkpoints
from palpate.checkpoints import Checkpoints, content_digest
from palpate.disk import atomic_replacement
from palpate.records import Constant, Status

PART = (
    np.arange(6.0).reshape(2, 3)[:, ::-1],
    {"status": Status.OK, "constant": Constant(1.0, np.float64(0.1), (0.5, 1.5)), "text": b"x"},
    {1: np.asfortranarray(np.arange(6).reshape(2, 3)), None: np.float32(np.nan), "odd": "\ud800\n"},
    [None, True, 3, np.nan],
    csr_array(np.diag([1.0, 0.0, 2.0])),
    bsr_array(np.kron(np.eye(2), np.full((3, 3), np.float32(0.5))), blocksize=(3, 3)),
)


def _made(asked, part):
    asked.append(1)
    return part


def test_a_part_is_made_once_and_read_to_the_last_bit(tmp_path):
    asked = []
    store = Checkpoints(tmp_path / "parts", "key")
    first = store.load_or_make("one", lambda: _made(asked, PART))
    again = store.load_or_make("one", lambda: _made(asked, PART))
    assert content_digest(first) == content_digest(again) == content_digest(PART)
    assert len(asked) == 1
    store.load_or_make("two", lambda: _made(asked, PART))
    Checkpoints(tmp_path / "parts", "other").load_or_make("one", lambda: _made(asked, PART))
    assert len(asked) == 3
    Checkpoints(None).load_or_make("one", lambda: _made(asked, PART))
    assert len(asked) == 4


def test_known_objects_are_put_in_again(tmp_path):
    store, large = Checkpoints(tmp_path, "key"), np.zeros(10**6)
    store.load_or_make("one", lambda: {"large": large, "small": 1}, {"field": large})
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 1000
    other = np.ones(3)
    assert store.load_or_make("one", dict, {"field": other})["large"] is other
    # A part that rests on something that is not there is made anew.
    assert store.load_or_make("one", lambda: "new") == "new"


def test_what_is_cut_off_or_strange_is_made_anew(tmp_path):
    store = Checkpoints(tmp_path, "key")
    store.load_or_make("one", lambda: PART)
    (file,) = tmp_path.iterdir()
    content = file.read_bytes()

    changed = content.replace(np.float64(0.1).tobytes(), np.float64(0.2).tobytes())
    assert changed != content
    for bad in (b"", content[:-10], content[: len(content) // 2], changed):
        file.write_bytes(bad)
        assert store.load_or_make("one", lambda: "new") == "new"


def test_a_disk_that_keeps_nothing_is_no_reason_to_stop(tmp_path):
    (tmp_path / "file").write_text("")
    store = Checkpoints(tmp_path / "file" / "parts", "key")
    assert store.load_or_make("one", lambda: "new") == "new"


def test_a_part_whose_time_cannot_be_set_is_read(tmp_path, monkeypatch):
    def refused(path):
        raise PermissionError(1, "Operation not permitted", str(path))

    parts = Checkpoints(tmp_path, "key")
    parts.load_or_make("one", lambda: 1)
    monkeypatch.setattr(os, "utime", refused)
    assert parts.load("one") == 1


def test_a_part_that_another_process_is_storing_is_left_to_it(tmp_path):
    parts = Checkpoints(tmp_path, "key")
    parts.load_or_make("one", lambda: PART)
    (file,) = tmp_path.iterdir()
    file.unlink()
    with atomic_replacement(file) as other:
        other.write_bytes(b"the other's")
        assert parts.load_or_make("one", lambda: "own") == "own"
    assert file.read_bytes() == b"the other's"


@dataclass(frozen=True)
class _Pair:
    first: object
    second: object


@pytest.mark.parametrize(
    ("first", "other"),
    [
        (_Pair("ab", "c"), _Pair("a", "bc")),
        (np.zeros(3), np.zeros((3, 1))),
        (np.zeros(1), np.zeros(1, dtype=np.float32)),
        ([1, [2]], [1, 2]),
        ({"a": 1}, {"a": 1.0}),
        (np.zeros(2000), np.eye(1, 2000, 1000)[0]),
        (csr_array(np.diag([1.0, 2.0])), csr_array(np.diag([1.0, 3.0]))),
    ],
)
def test_digests_tell_apart(first, other):
    assert content_digest(first) != content_digest(other)


def test_a_pipe_in_the_place_of_a_part_is_no_part(tmp_path):
    """Reading it would wait for ever."""
    parts = Checkpoints(tmp_path, "key")
    parts.load_or_make("a", lambda: 1)
    (file,) = tmp_path.iterdir()
    file.unlink()
    os.mkfifo(file)
    assert parts.load_or_make("a", lambda: 2) == 2


def _parts_of_ten_bytes(folder, count):
    """Files with the names of parts, each used a second before the last one."""
    paths = [folder / f"{number:064x}" for number in range(count)]
    for number, path in enumerate(paths):
        path.write_bytes(bytes(10))
        os.utime(path, (1e9 - number, 1e9 - number))
    return paths


def test_a_cache_loses_what_was_not_used_for_longest(tmp_path, monkeypatch):
    new, older, oldest = _parts_of_ten_bytes(tmp_path, 3)
    Checkpoints(tmp_path, "a").stored("part", 1)
    (part,) = set(tmp_path.iterdir()) - {new, older, oldest}
    os.utime(part, (1e9 - 9, 1e9 - 9))
    # Reading a part is using it: its time is now.
    assert Checkpoints(tmp_path, "a", cache=True).load("part") == 1
    # Somebody's own file, what another process is writing, and what it removes at this moment: a
    # broken link stands for that.
    (tmp_path / "notes.txt").write_bytes(bytes(1000))
    (tmp_path / f".{oldest.name}.part").write_bytes(bytes(1000))
    (tmp_path / f"{9:064x}").symlink_to(tmp_path / "nowhere")
    before = set(tmp_path.iterdir())
    size = part.stat().st_size
    monkeypatch.setattr(checkpoints, "_MOST_BYTES", 2 * size + 20)
    Checkpoints(tmp_path, "a").stored("another", 2)
    Checkpoints(tmp_path, "b", cache=True).stored("part", 3)
    # The newest are those two, `part`, which is one too many, and what is older.
    assert before - set(tmp_path.iterdir()) == {part, new, older, oldest}
    assert Checkpoints(tmp_path, "a").load("another") == 2
    assert Checkpoints(tmp_path, "b").load("part") == 3


def test_a_cache_takes_a_quarter_of_what_is_free_without_it(tmp_path, monkeypatch):
    files = _parts_of_ten_bytes(tmp_path, 5)
    usage = shutil.disk_usage(tmp_path)
    # With the 50 bytes of the cache 120 would be free, of which a quarter are three parts.
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=70))
    checkpoints._trim(tmp_path)
    assert sorted(tmp_path.iterdir()) == files[:3]


def test_finished_parts_of_long_work_are_all_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(checkpoints, "_MOST_BYTES", 10)
    store = Checkpoints(tmp_path, "a")
    for number in range(3):
        store.stored(str(number), number)
    assert [store.load(str(number)) for number in range(3)] == [0, 1, 2]
