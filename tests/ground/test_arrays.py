"""Checked read-only copies: what passes, and what each refusal says; rows replaced in a copy."""

from dataclasses import dataclass

import numpy as np
import pytest

from palpate.arrays import fix_fields, fixed_array, lengths, tangents_of, with_rows
from palpate.errors import InputError


def test_lists_become_read_only_float64():
    array = fixed_array([[1, 2, 3]], name="points", shape=(None, 3))
    assert array.dtype == np.float64
    assert not array.flags.writeable


def test_whole_numbers_become_int64():
    array = fixed_array([0, 2], name="triangle", shape=(2,), integer=True)
    assert array.dtype == np.int64


def test_nan_may_stand_for_not_measured():
    array = fixed_array([np.nan, 1.0], name="displacement", shape=(2,), nan_allowed=True)
    assert np.isnan(array[0])


@pytest.mark.parametrize(
    ("value", "options", "message"),
    [
        ([[1, 2]], {"shape": (None, 3)}, r"p has shape \(1, 2\); must be \(n, 3\)"),
        ([1, 2], {"shape": (3,)}, r"p has shape \(2,\); must be \(3\)"),
        (["a"], {"shape": (1,)}, "p is not an array of numbers"),
        ([1, np.nan], {"shape": (2,)}, r"1 entries that are not finite, the first at index \(1,\)"),
        ([np.inf], {"shape": (1,), "nan_allowed": True}, "not finite"),
        ([0.5], {"shape": (1,), "integer": True}, "must hold whole numbers"),
    ],
)
def test_refusals_name_the_value(value, options, message):
    with pytest.raises(InputError, match=message):
        fixed_array(value, name="p", **options)


def test_rows_are_replaced_in_a_copy():
    array = np.arange(6.0).reshape(3, 2)
    changed = with_rows(array, np.array([2, 0]), np.array([[8.0, 9.0], [6.0, 7.0]]))
    np.testing.assert_array_equal(changed, [[6.0, 7.0], [2.0, 3.0], [8.0, 9.0]])
    np.testing.assert_array_equal(array, np.arange(6.0).reshape(3, 2))


def test_lengths_are_those_of_each_vector():
    vectors = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -2.0], [1.0, 2.0, 2.0]])
    assert lengths(vectors).tolist() == [5.0, 2.0, 3.0]


@pytest.mark.parametrize("normal", [[0.0, 0.0, -2.0], [1.0, 0.0, 0.0], [0.3, -0.4, 5e-3]])
def test_tangents_and_normal_are_orthogonal(normal):
    frame = np.vstack([tangents_of(np.array(normal)), np.array(normal) / np.linalg.norm(normal)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-14)


@dataclass(frozen=True)
class _Record:
    place: object
    weight: object = None

    def __post_init__(self) -> None:
        fix_fields(self, place=(3,))
        fix_fields(self, none_allowed=True, weight=(None,))


def test_fields_of_records_are_fixed():
    given = np.zeros(3)
    record = _Record(given, [1, 2])
    given[:] = 1.0
    assert (record.place.tolist(), record.weight.tolist()) == ([0.0] * 3, [1.0, 2.0])
    assert not record.place.flags.writeable
    assert _Record(given).weight is None
    for bad in (None, [0, 1]):
        with pytest.raises(InputError, match="place has shape"):
            _Record(bad)
