"""MATLAB's files: what SciPy would end the process over is refused."""

import numpy as np
import pytest
from scipy.io import savemat

from palpate import files
from palpate.errors import RecordError
from palpate.records.text.mat_file import read_mat

CONTENT = {
    "cell": np.array([np.eye(2), np.arange(3.0), "text"], dtype=object),
    "struct": {"a": 1 + 2j, "b": {"c": np.float32(3.0), "d": np.zeros((0, 3))}},
    "flags": np.array([True, False]),
    "whole": np.array([[1, 2, 3]], dtype=np.int16),
}


def _read(path):
    return read_mat(path, what="is odd", cure="save it again")


@pytest.mark.parametrize("compressed", [False, True])
def test_what_was_saved_comes_back(tmp_path, compressed):
    savemat(tmp_path / "a.mat", CONTENT, do_compression=compressed)
    found = _read(tmp_path / "a.mat")
    np.testing.assert_array_equal(found["cell"][0], np.eye(2))
    assert found["cell"][2] == "text"
    assert found["struct"]["a"] == 1 + 2j
    assert found["struct"]["b"]["c"] == 3.0
    np.testing.assert_array_equal(found["whole"], [1, 2, 3])


def test_a_wrong_bit_anywhere_in_the_structure_is_survived(tmp_path):
    """Each of these bits ended the process in SciPy 1.16, or is one beside such a bit."""
    path = tmp_path / "a.mat"
    savemat(path, CONTENT)
    whole = path.read_bytes()
    refused = 0
    for place in range(128, len(whole), 3):
        for bit in (0, 3, 7):
            content = bytearray(whole)
            content[place] ^= 1 << bit
            path.write_bytes(content)
            try:
                _read(path)
            except RecordError as error:
                refused += "is odd" in str(error)
    # Types, sizes and counts are refused; names, padding and numbers pass.
    assert refused > 200


def test_a_size_that_is_only_claimed_takes_no_memory(tmp_path):
    path = tmp_path / "a.mat"
    savemat(path, {"cell": np.array([1.0, 2.0], dtype=object)})
    content = bytearray(path.read_bytes())
    place = content.index((2).to_bytes(4, "little"), 150)
    content[place : place + 4] = (2**31 - 1).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(RecordError, match=r"is odd .*do not belong together.*save it again"):
        _read(path)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.mat").write_bytes(b"MATLAB 7.3 MAT-file")
    with pytest.raises(RecordError, match=r"it starts with b'MATLAB 7\.3 MAT-file'"):
        _read(tmp_path / "a.mat")


def test_a_few_bytes_that_unpack_to_many_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "_ANY_RATIO_BYTES", 2**16)
    path = tmp_path / "a.mat"
    savemat(path, {"a": np.zeros(2**18)}, do_compression=True)
    with pytest.raises(RecordError, match="cut off, or too large"):
        _read(path)
    # Nor may many elements together, none of which is too large.
    savemat(path, {f"a{k}": np.zeros(2**12) for k in range(40)}, do_compression=True)
    with pytest.raises(RecordError, match="cut off, or too large"):
        _read(path)
