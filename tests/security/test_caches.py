"""What lies in a cache is data: nothing in it runs, leads elsewhere or stops a command."""

import io
import json
import os
import pickle
import sys
import zipfile
from dataclasses import make_dataclass
from types import ModuleType

import numpy as np
import pytest

from palpate import checkpoints
from palpate.checkpoints import Checkpoints
from palpate.records import Constant


@pytest.fixture
def store(tmp_path):
    """A cache that holds a part of some arrays."""
    store = Checkpoints(tmp_path / "cache", "key")
    store.stored("one", (np.arange(3.0), Constant(1.0, 0.1, (0.5, 1.5))))
    return store


def _file(store):
    (file,) = store.folder.iterdir()
    return file


def _npz(tree, **arrays):
    """A part that nobody wrote, with right checksums."""
    file = io.BytesIO()
    np.savez(file, tree=np.frombuffer(tree.encode(), np.uint8), **arrays)
    return file.getvalue()


class _Evil:
    def __reduce__(self):
        return (exec, ("import sys; sys.palpate_was_here = True",))


def _pickled_array():
    file = io.BytesIO()
    np.save(file, np.array([_Evil()], dtype=object), allow_pickle=True)
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as archive:
        archive.writestr("tree.npy", file.getvalue())
    return whole.getvalue()


def _bomb():
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tree.npy", bytes(2**29))
    return file.getvalue()


RECORD = ["record", "palpate.records.estimate", "Constant"]


@pytest.mark.parametrize(
    "content",
    [
        pickle.dumps(_Evil()),
        _pickled_array(),
        _bomb(),
        _npz("[" * 100_000 + "]" * 100_000),
        _npz("1" * 10_000),
        _npz("not JSON"),
        _npz('["array", "nowhere"]'),
        _npz('["known", "nothing"]'),
        _npz('["word of another version", 1]'),
        _npz('["dict", [[["list", []], 1]]]'),
        _npz(json.dumps([*RECORD, {"value": 1.0}])),
        _npz(json.dumps([*RECORD, {"value": "text", "std": None, "interval": None, "x": 1}])),
        _npz(json.dumps(["record", "palpate.records", "read_session", {"path": "/"}])),
        _npz(json.dumps(["record", "palpate.checkpoints", "Path", {}])),
        _npz(json.dumps(["record", "palpate.checkpoints", ["os"], {}])),
        _npz(json.dumps(["record", "builtins", "print", {}])),
        _npz(json.dumps(["enum", "palpate.records.estimate", "Constant", "OK"])),
        # An index far outside of the matrix: a product with it would end the process.
        _npz(
            '["sparse", [["array", "a"], ["array", "b"], ["array", "c"]], [1, 2]]',
            a=np.ones(1), b=np.array([10**6]), c=np.array([0, 1]),
        ),
    ],
)  # fmt: skip
def test_what_was_not_written_as_a_part_is_computed_again(store, content):
    _file(store).write_bytes(content)
    assert store.load("one") is None
    assert store.load_or_make("one", lambda: "new") == "new"
    assert not hasattr(sys, "palpate_was_here")


@pytest.mark.parametrize("module", ["palpate_stranger", "palpate.paper.budget", "antigravity"])
def test_nothing_is_imported_for_a_name_in_a_part(store, tmp_path, monkeypatch, module):
    """Neither from the current folder, nor of Palpate's, nor of Python's own."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, module, raising=False)
    (tmp_path / "palpate_stranger.py").write_text("raise SystemExit('imported')")
    _file(store).write_bytes(_npz(json.dumps(["record", module, "Thing", {}])))
    assert store.load("one") is None
    assert module not in sys.modules


def test_a_record_of_another_package_is_not_made(store, monkeypatch):
    made, module = [], ModuleType("stranger")
    module.Thing = make_dataclass("Thing", [])
    module.Thing.__post_init__ = lambda self: made.append(self)
    module.Thing.__module__ = "stranger"
    monkeypatch.setitem(sys.modules, "stranger", module)
    _file(store).write_bytes(_npz(json.dumps(["record", "stranger", "Thing", {}])))
    assert store.load("one") is None
    assert made == []


def test_a_link_in_a_cache_is_neither_read_nor_written_through(store, tmp_path):
    file, elsewhere = _file(store), tmp_path / "elsewhere"
    os.replace(file, elsewhere)
    file.symlink_to(elsewhere)
    before = elsewhere.read_bytes()
    assert store.load("one") is None
    store.stored("one", "new")
    assert elsewhere.read_bytes() == before
    assert store.load("one") == "new"


def test_a_part_of_another_user_is_not_read(store, monkeypatch):
    assert store.load("one") is not None
    monkeypatch.setattr(os, "geteuid", lambda: os.stat(store.folder).st_uid + 1)
    assert store.load("one") is None


def test_no_cache_is_read_with_pickle():
    """Code in a file runs as soon as somebody unpickles it, whatever is checked then."""
    assert "pickle" not in vars(checkpoints)
