"""Files as they are opened: what stands in their place is named, and nothing waits or floods."""

import os
import stat
import sys

import pytest
from fault_injection import without_rights

from palpate.errors import InputError, MeshError, PalpateError, RecordError, quoted
from palpate.files import checked_file, damage, is_file, read_bytes


def test_content_and_beginning(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")
    assert read_bytes(tmp_path / "a") == b"abc"
    assert read_bytes(tmp_path / "a", 2) == b"ab"
    assert checked_file(tmp_path / "a", most=3) == tmp_path / "a"


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
    with pytest.raises(RecordError, match=said), damage(tmp_path / "a.x", "save it again"):
        raise error


def test_own_errors_pass_and_others_prints_do_not(tmp_path, capsys):
    with pytest.raises(InputError, match="own"), damage(tmp_path, ""):
        raise InputError("own")
    with pytest.raises(KeyboardInterrupt), damage(tmp_path, ""):
        raise KeyboardInterrupt
    with damage(tmp_path, ""):
        print("of a reader")
    assert capsys.readouterr().out == ""


def test_long_values_and_messages_lose_their_middle():
    assert quoted("abc") == "'abc'"
    assert len(quoted(list(range(10**5)))) < 100
    assert "too many digits" in quoted(10**5000)
    text = str(PalpateError("begin " + "x" * 10**5 + " end"))
    assert len(text) < 1200
    assert text.startswith("begin")
    assert text.endswith("end")
