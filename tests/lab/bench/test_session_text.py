"""TOML as the facility writes it: read again by the standard reader, nothing lost."""

import tomllib

import numpy as np
import pytest

from palpate.lab.bench.session_text import toml_table, toml_value


@pytest.mark.parametrize(
    "value",
    [
        'a "quoted" \\ text\nwith ümlauts', True, 3, -0.1, 1e-300, [1, 2.5, "x"], [[1.0, 2.0], []],
        {"point": [0.0, 0.1], "profile": "hertz"}, [{"plane": {"normal": [0, 0, 1]}}, {"a": 1}],
    ],
)  # fmt: skip
def test_values_come_back_as_they_were(value):
    assert tomllib.loads(f"key = {toml_value(value)}")["key"] == value


def test_arrays_and_their_scalars_come_back_bit_for_bit():
    array = np.random.default_rng(0).normal(size=(3, 3))
    found = tomllib.loads(f"a = {toml_value(array)}\nb = {toml_value(array[0, 0])}")
    np.testing.assert_array_equal(found["a"], array)
    assert found["b"] == array[0, 0]
    assert toml_value(np.True_) == "true"
    assert toml_value(np.int64(4)) == "4"


def test_tables_leave_out_what_is_none():
    text = toml_table("", {"a": 1}) + toml_table("[[probe]]", {"name": "n", "std": None})
    assert tomllib.loads(text) == {"a": 1, "probe": [{"name": "n"}]}


def test_what_has_no_toml_is_an_error():
    with pytest.raises(TypeError, match="no TOML for a object"):
        toml_value(object())
