"""Files as they are opened: what stands in their place is named, and nothing waits or floods."""

import os
import stat
import sys
import tracemalloc
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
    with stored_arrays(tmp_path / "a.npz", "") as arrays:
        assert list(arrays) == list(ARRAYS)
        for name, array in ARRAYS.items():
            np.testing.assert_array_equal(arrays[name], array)
            assert arrays[name].dtype == array.dtype
            assert arrays[name].flags.writeable


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
    with stored_arrays(tmp_path / "b.npz", "cure") as arrays:
        assert arrays["a"].size == 2**20
