"""Numbers as a person reads them."""

import math
from dataclasses import replace

import pytest
from estimate_samples import constants

from palpate.errors import InputError
from palpate.records import (
    BIASED,
    CONSTANT_NAMES,
    FORCE_UNITS,
    LENGTH_UNITS,
    MODULUS_UNITS,
    BudgetEntry,
    Constant,
    ErrorEstimate,
    Estimate,
    LoadDependence,
    RegionEstimate,
    Status,
    quantities,
    quantity,
    region_row,
)
from palpate.records.quantities import (
    FILE_LENGTH_UNITS,
    budget_text,
    constant_text,
    error_texts,
    interval_text,
    length_unit,
    modulus_unit,
    stiffening_text,
    unit_name,
    verdict_text,
)


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
        (315.76340709432, 1e-13, "315.8 ± 0.0"),
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


@pytest.mark.parametrize(
    ("length", "unit"), [(0.99e-4, (1e-6, "µm")), (1.01e-4, (1e-3, "mm")), (math.inf, (1e-6, "µm"))]
)
def test_a_tenth_of_a_millimetre_is_written_in_millimetres(length, unit):
    assert length_unit(length) == unit


@pytest.mark.parametrize(
    ("word", "name"),
    [("MM", "mm"), ("micron", "um"), ("\u00b5m", "um"), ("Inches", "in"), ("px", "px")],
)
def test_units_as_programs_spell_them(word, name):
    assert unit_name(word) == name


def test_units_are_what_they_are():
    assert LENGTH_UNITS == {"um": 1e-6, "mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
    assert FILE_LENGTH_UNITS == {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}


@pytest.mark.parametrize(
    ("unit", "value", "texts"),
    [
        ("", 0.02, ("2.0 %", "1.0 %", "4 %")),
        ("m", 5e-4, ("0.50 mm", "0.25 mm", "1 mm")),
        ("rad", math.pi / 180.0, ("1.00 degrees", "0.50 degrees", "2 degrees")),
        ("m/Pa", 3e-9, ("3.0 mm/MPa", "1.5 mm/MPa", "6 mm/MPa")),
    ],
)
def test_errors_are_written_in_their_units(unit, value, texts):
    error = ErrorEstimate("n01: contact along x", unit, value, 0.5 * value, 2.0 * value)
    assert error_texts(error) == texts


def test_errors_are_never_written_as_powers_of_ten():
    error = ErrorEstimate("mesh", "", -8e-23, 0.996, 1.0)
    assert error_texts(error) == ("0 %", "100 %", "100 %")


def test_a_budget_names_what_counts():
    parts = [("gain", 0.0101, 0.0), ("noise", 0.004, 3e-3), ("mesh", 0.003, 2e-3), ("x", 0.0, 1e-3)]
    budget = [BudgetEntry(name, math.nan, ratio, young) for name, young, ratio in parts]
    assert budget_text(budget, "young_modulus") == "gain 1 %, noise 0.4 %"
    assert budget_text(budget, "poisson_ratio") == "noise 0.003, mesh 0.002"
    assert budget_text(budget, "shear_modulus") == budget_text([], "young_modulus") == ""


def test_a_verdict_says_that_the_estimate_is_biased():
    notes = ("A note.", f"Probing a: pressed far; {BIASED}.", f"Probing b: too; {BIASED}.")
    known = dict.fromkeys(CONSTANT_NAMES, True)
    estimate = Estimate(Status.OK, **constants(), identifiable=known, probes=(), seconds={},
                        method="reduced", settings={}, notes=notes)  # fmt: skip
    load = LoadDependence(Constant(0.12, 0.03, (0.06, 0.18)), (0.51, 1.0), (0.95, 1.05))
    assert (
        "Stiffness rises with load: E is 57 kPa at 0.51 N, 63 kPa at 1 N (4 sigma)."
        in verdict_text(replace(estimate, load=load))
    )
    text = verdict_text(estimate)
    assert text.startswith("All three constants are determined by the data. E = 60.0 kPa")
    assert f"(95 % intervals in brackets). {notes[1]} 2 notes say so." in text
    assert "A note" not in text


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


def test_a_region_has_a_row():
    modulus = Constant(6e4, 1.5e3, (57e3, 63e3))
    ratio = Constant(3.0, 0.1, (2.8, 3.2))
    region = RegionEstimate("insert", ratio, modulus, modulus, "", True, True)
    assert region_row(region) == (
        "insert", "60.0 \u00b1 1.5 kPa", "60.0 \u00b1 1.5 kPa", "57.0 to 63.0 kPa", "2.80 to 3.20"
    )  # fmt: skip
    unknown = replace(region, identifiable=False)
    assert region_row(unknown)[1:4] == ("not determined", "not determined", "(57.0 to 63.0 kPa)")
    assert region_row(replace(unknown, is_seen=False))[1] == "not seen"


@pytest.mark.parametrize(
    ("stiffening", "shown", "text"),
    [
        # 1 + 2 (C2 / C1) 0.2^2.
        (
            Constant(3.0, 0.5, (2.0, 4.0)),
            True,
            "1.24 times as stiff as at small strain",
        ),
        (Constant(0.1, 0.5, (0.0, 1.0)), False, "at most 1.08 times as stiff"),
        (
            Constant(0.0, 10.0, (0.0, 19.6)),
            False,
            "is not determined: in simple shear by 20 % it may be 1 to 2.57",
        ),
    ],
)
def test_stiffening_is_told_in_words(stiffening, shown, text):
    assert text in stiffening_text(stiffening, shown=shown)
