"""Numbers with units as people write them."""

import pytest

from palpate.errors import InputError
from palpate.records import FORCE_UNITS, LENGTH_UNITS, MODULUS_UNITS, quantities, quantity


@pytest.mark.parametrize(
    ("text", "units", "value"),
    [
        ("50 kPa", MODULUS_UNITS, 50e3),
        ("3mm", LENGTH_UNITS, 3e-3),
        # 1 psi is 4.4482216152605 N on 0.0254 m squared.
        ("0.3 psi", MODULUS_UNITS, 0.3 * 4.4482216152605 / 0.0254**2),
        ("1.2e-1 N/mm2", MODULUS_UNITS, 0.12e6),
        ("-2 in", LENGTH_UNITS, -0.0508),
        ("100 gf", FORCE_UNITS, 0.980665),
        ("5 µm", LENGTH_UNITS, 5e-6),
        ("0.02", LENGTH_UNITS, 0.02),
        (7, FORCE_UNITS, 7.0),
    ],
)
def test_units_are_understood(text, units, value):
    assert quantity(text, units) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize("bad", ["50 KPA", "3 N", "mm", "", "1 2 mm", "1e999x", float("nan")])
def test_anything_else_is_refused_with_what_is_allowed(bad):
    with pytest.raises(InputError, match=r"radius is .*; must be a finite number, with one of.*mm"):
        quantity(bad, LENGTH_UNITS, "radius")


def test_a_vector_has_three_numbers():
    assert quantities(("1 mm", 0, "2cm"), LENGTH_UNITS, "at") == pytest.approx([1e-3, 0.0, 0.02])
    for bad in ("1 mm", (1, 2)):
        with pytest.raises(InputError, match=r"at is .*; must be three numbers"):
            quantities(bad, LENGTH_UNITS, "at")
