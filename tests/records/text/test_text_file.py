"""Whole files and JSON: what comes back, and what a disk refuses."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from palpate.errors import RecordError
from palpate.records.text.json_file import json_text
from palpate.records.text.text_file import read_text, write_text

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
