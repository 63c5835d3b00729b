"""Files as they are opened: what stands in their place is named, and nothing waits or floods."""

import os
import stat
import sys
import tracemalloc
import zipfile
from io import BytesIO

import numpy as np
import pytest
from fault_injection import without_rights

from palpate import files
from palpate.errors import InputError, MeshError, PalpateError, RecordError, quoted
from palpate.files import checked_file, is_file, parse_array, read_bytes, read_errors, stored_arrays


def test_content_and_beginning(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert read_bytes(tmp_path / "a") == b"abc"
    assert read_bytes(tmp_path / "a", 2) == b"ab"
    assert checked_file(tmp_path / "a", max_bytes=3) == tmp_path / "a"


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("none", r"cannot be read \(No such file"),
        (".", "Is a directory"),
        ("pipe", "a pipe, no regular file"),
        ("endless", "a device, no regular file"),
        ("loop", "symbolic link"),
        ("n" * 300, "File name too long"),
        ("a\0b", "null byte"),
    ],
)
def test_what_is_no_file_is_named(tmp_path, name, what):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "endless").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(RecordError, match=what):
        read_bytes(tmp_path / name)


def test_too_large_a_file_is_not_read(tmp_path):
    (tmp_path / "a").touch()
    os.truncate(tmp_path / "a", 2**40)  # a hole: it takes no place on the disk
    with pytest.raises(MeshError, match="has 1099511627776 bytes, more than the 4294967296"):
        read_bytes(tmp_path / "a", kind=MeshError)


def test_a_file_without_rights_is_named(tmp_path):
    (tmp_path / "a").touch()
    (tmp_path / "a").chmod(stat.S_IWUSR)

    def refused():
        with pytest.raises(RecordError) as raised:
            read_bytes(tmp_path / "a")
        print(raised.value, file=sys.stderr)
        return 2

    code, said = without_rights(refused)
    assert (code, "Permission denied" in said) == (2, True), said


def test_files_are_told_from_folders_and_names_that_cannot_be(tmp_path):
    (tmp_path / "a").touch()
    names = ["a", "none", ".", "n" * 300, "a\0b"]
    assert [is_file(tmp_path / name) for name in names] == [True, False, False, False, False]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("odd\n  bytes"), r"a\.x: is damaged or cut off \(odd bytes\); save it"),
        (KeyError("points"), r"\(KeyError 'points'\)"),
        (SystemExit(1), r"\(SystemExit 1\)"),
        (RecursionError(), r"\(RecursionError\)"),
        (ValueError("long" * 1000), r"^.{120,300}$"),
    ],
)
def test_whatever_a_reader_raises_is_one_message(tmp_path, error, said):
    with pytest.raises(RecordError, match=said), read_errors(tmp_path / "a.x", "save it again"):
        raise error


def test_own_errors_pass_and_others_prints_do_not(tmp_path, capsys):
    with pytest.raises(InputError, match="own"), read_errors(tmp_path, ""):
        raise InputError("own")
    with pytest.raises(KeyboardInterrupt), read_errors(tmp_path, ""):
        raise KeyboardInterrupt
    with read_errors(tmp_path, ""):
        print("of a reader")
    assert capsys.readouterr().out == ""


ARRAYS = {
    "number": np.array(0.1),
    "text": np.array("grün"),
    "none": np.array([], dtype=str),
    "flags": np.array([True, False]),
    "columns": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "pairs": np.zeros(2, dtype=[("a", "<i4"), ("b", "<f8", 3)]),
}


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_read_as_they_were_saved(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    with stored_arrays(tmp_path / "a.npz", "") as found:
        assert list(found) == list(ARRAYS)
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(found[name], array)
            assert found[name].dtype == array.dtype
            assert found[name].flags.writeable


def _npy(array: np.ndarray) -> bytes:
    content = BytesIO()
    np.save(content, array, allow_pickle=True)
    return content.getvalue()


def test_an_array_of_another_length_than_it_says_is_refused():
    good = _npy(np.arange(60.0).reshape(20, 3))
    np.testing.assert_array_equal(parse_array(good), np.arange(60.0).reshape(20, 3))
    spoilt = {
        r"480 bytes, and holds 472": good[:-8],
        r"480 bytes, and holds 481": good + b"x",
        r"2400000000000 bytes": good.replace(b"(20, 3), }" + b" " * 10, b"(100000000000, 3), }"),
        r"bytes": good.replace(b"'<f8'", b"'<U0'"),
        r"Object arrays": _npy(np.array([{}])),
        r"version \(9, 0\)": good[:6] + b"\x09" + good[7:],
        r"magic": b"no array",
    }
    for said, content in spoilt.items():
        with pytest.raises(ValueError, match=said):
            parse_array(content)


def test_packed_gigabytes_are_refused_before_memory_is_taken(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", zeros=np.zeros(2 * 10**6), more=np.zeros(3))
    tracemalloc.start()
    with (
        pytest.raises(
            RecordError, match=r"a\.npz: its arrays take 16000\d+ bytes, more than the 100"
        ),
        stored_arrays(tmp_path / "a.npz", "", max_bytes=10**6),
    ):
        pass
    assert tracemalloc.get_traced_memory()[1] < 10**6
    tracemalloc.stop()


def _cut(content: bytes) -> bytes:
    return content[:-30]


def _flipped(content: bytes) -> bytes:
    return content[:200] + bytes([content[200] ^ 1]) + content[201:]


@pytest.mark.parametrize("spoil", [lambda _: b"", lambda _: b"PK\x03\x04", _cut, _flipped])
@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_a_damaged_archive_is_one_message(tmp_path, save, spoil):
    file = tmp_path / "a.npz"
    save(file, rows=np.arange(1000.0))
    file.write_bytes(spoil(file.read_bytes()))
    with (
        pytest.raises(RecordError, match=r"a\.npz: is no map \(.+\); make it again"),
        stored_arrays(file, "make it again", what="is no map"),
    ):
        pass


def test_what_is_wrong_with_arrays_is_said_of_their_file(tmp_path):
    np.savez(tmp_path / "a.npz", rows=np.zeros(3))
    with (
        pytest.raises(RecordError, match=r"a\.npz: is damaged or cut off \(KeyError 'columns'\)"),
        stored_arrays(tmp_path / "a.npz", "make it again") as found,
    ):
        found["columns"]
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RecordError, match="no regular file"), stored_arrays(tmp_path / "pipe", ""):
        pass


def test_an_archive_of_anything_else_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("notes.txt", "no array")
    with pytest.raises(RecordError, match="magic"), stored_arrays(tmp_path / "a.npz", ""):
        pass


def test_long_values_and_messages_lose_their_middle():
    assert quoted("abc") == "'abc'"
    assert len(quoted(list(range(10**5)))) < 100
    assert "too many digits" in quoted(10**5000)
    text = str(PalpateError("begin " + "x" * 10**5 + " end"))
    assert len(text) < 1200
    assert text.startswith("begin")
    assert text.endswith("end")


def test_a_small_archive_may_not_hold_much(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_ANY_RATIO_BYTES", 2**16)
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(2**20))
    with (
        pytest.raises(RecordError, match="its arrays take 8388736 bytes, more than the"),
        stored_arrays(tmp_path / "a.npz", "cure"),
    ):
        pass
    # What is not packed may be of any size.
    np.savez(tmp_path / "b.npz", a=np.zeros(2**20))
    with stored_arrays(tmp_path / "b.npz", "cure") as found:
        assert found["a"].size == 2**20
