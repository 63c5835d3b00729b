"""Whole files and JSON: what comes back, and what a disk refuses."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from palpate.errors import RecordError
from palpate.records import file_stems
from palpate.records.text.text_file import read_text, write_text
from palpate.records.text.toml_table import json_text

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.text() | st.floats(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def _known(value):
    """The same with None for numbers that JSON does not know."""
    if isinstance(value, dict):
        return {key: _known(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_known(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


@settings(max_examples=60, deadline=None)
@given(content=st.dictionaries(st.text(), VALUES, max_size=4))
def test_json_comes_back_but_for_what_it_does_not_know(content):
    text = json_text(content)
    assert json.loads(text) == _known(content)
    assert text.endswith("}\n")


def test_numpys_types_become_numbers_and_lists():
    content = {"a": np.float64(0.1), "b": np.int64(3), "c": np.array([[1.0, np.inf]]), "d": (1, 2)}
    assert json.loads(json_text(content)) == {"a": 0.1, "b": 3, "c": [[1.0, None]], "d": [1, 2]}


def test_text_comes_back_without_its_mark(tmp_path):
    path = tmp_path / "a.txt"
    write_text(path, "\ufeffµ\n")
    assert path.read_bytes() == b"\xef\xbb\xbf\xc2\xb5\n"
    assert read_text(path) == "µ\n"


def test_what_cannot_be_read_or_written_is_named(tmp_path):
    with pytest.raises(RecordError, match=r"cannot be read \(Is a directory"):
        read_text(tmp_path)
    (tmp_path / "a").write_bytes(b"\xff\xfe")
    with pytest.raises(RecordError, match="a: is not a text file in UTF-8; save it as such"):
        read_text(tmp_path / "a")
    with pytest.raises(RecordError, match=r"b: cannot be written \(No such file"):
        write_text(tmp_path / "none" / "b", "")


def test_a_motion_has_its_own_name_where_that_is_a_file_name():
    names = ["n01", "n05_1", "0.5-N"]
    assert file_stems(names, kind="motion") == names


# A file system counts bytes, two for each of these letters.
_LONG = 190 * "\N{GREEK SMALL LETTER PI}"


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", "", "a b", "[bold]", "contents", _LONG])
def test_other_names_are_replaced_by_a_number(name):
    assert file_stems(["n01", name], kind="motion") == ["n01", "motion-2"]


@pytest.mark.parametrize("names", [["a", "a_flow"], ["a_quality", "a"], ["a", "A"], ["a", "a"]])
def test_no_two_motions_write_the_same_file(names):
    stems = file_stems(names, kind="motion")
    files = [stem + end for stem in stems for end in ("", "_flow", "_quality")]
    assert len({file.lower() for file in files}) == 6


@pytest.mark.parametrize("names", [["motion-2", "?", "motion-2"], ["a/b", "motion-1"]])
def test_a_name_that_is_another_ones_number_is_no_trap(names):
    assert len(set(file_stems(names, kind="motion"))) == len(names)
