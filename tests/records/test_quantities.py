"""Numbers as a person reads them."""

import math

import pytest

from palpate.records import Constant
from palpate.records.quantities import constant_text, interval_text, modulus_unit


@pytest.mark.parametrize(
    ("modulus", "unit"),
    [
        (950.0, (1.0, "Pa")),
        (2.1e4, (1e3, "kPa")),
        (3e6, (1e6, "MPa")),
        (7e10, (1e9, "GPa")),
        (math.nan, (1.0, "Pa")),
    ],
)
def test_unit_leaves_few_digits_before_the_point(modulus, unit):
    assert modulus_unit(modulus) == unit


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (21.0432, 0.1512, "21.04 ± 0.15"),
        (0.21234, 0.0061, "0.2123 ± 0.0061"),
        (1234.5, 56.0, "1234 ± 56"),
        (1.0, 0.0, "1.000 ± 0.000"),
        (0.3, math.inf, "0.3000"),
        (math.nan, math.nan, "unknown"),
    ],
)
def test_a_value_has_two_digits_of_its_deviation(value, std, text):
    assert constant_text(Constant(value, std, (-math.inf, math.inf))) == text


def test_units_scale_value_and_interval():
    constant = Constant(2.1e4, 150.0, (2.07e4, 2.13e4))
    assert constant_text(constant, factor=1e3) == "21.00 ± 0.15"
    assert interval_text(constant, factor=1e3) == "20.70 to 21.30"
    assert interval_text(Constant(math.nan, math.inf, (-math.inf, math.inf))) == "-inf to inf"
