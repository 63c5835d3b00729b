"""The outcome of the test of reciprocity is kept with an estimate, and says what it means."""

from dataclasses import replace

import pytest
from estimate_samples import CONSTANT_NAMES, constants

from palpate.records import (
    Estimate,
    ForceExcess,
    Reciprocity,
    Status,
    WorkPair,
    read_estimate,
    write_estimate,
)

FOUND = Reciprocity(
    pairs=(WorkPair("a", "b", 1.0, 1.1, 0.05),),
    pushes=(ForceExcess("a", 0.1, 0.05, 2.0), ForceExcess("b", -0.1, 0.05, -2.0)),
    chi_square=4.0,
    degrees=1,
    chance=0.05,
    growth=ForceExcess("", 0.3, 0.1, 3.0),
    odd=(),
    grows=False,
    holds=True,
    own_work=0.4,
    own_work_std=0.1,
    passive=("a", "b"),
    untested=("Nothing of c.",),
)


def test_it_comes_back_from_the_file(tmp_path):
    known = dict.fromkeys(CONSTANT_NAMES, True)
    estimate = Estimate(
        Status.OK, **constants(), identifiable=known, probes=(), seconds={}, method="reduced",
        settings={}, notes=(), reciprocity=FOUND,
    )  # fmt: skip
    write_estimate(tmp_path / "estimate.json", estimate)
    assert read_estimate(tmp_path / "estimate.json").reciprocity == FOUND


def test_sigmas_are_of_the_difference():
    assert FOUND.pairs[0].sigmas == pytest.approx(-2.0)


@pytest.mark.parametrize(
    ("change", "phrase"),
    [
        ({}, "1 pair of pushes agree"),
        ({"odd": ("a",)}, "p = 0.05). But one stands out. It is a: 10 % (+- 5) more force is"),
        ({"holds": False, "odd": ("a",)}, "It is a: 10 % (+- 5) more force is stated"),
        ({"holds": False, "odd": ("b",)}, "10 % (+- 5) less force is stated"),
        ({"holds": False, "odd": ("a", "b")}, "one of a, b explains it"),
        ({"holds": False, "grows": True}, "the less it moves than in proportion"),
        ({"holds": False}, "No single force explains it"),
        ({"degrees": 0}, "cannot be tested. Nothing of c."),
    ],
)
def test_its_sentence(change, phrase):
    tested = replace(FOUND, **change)
    assert phrase in tested.text
    assert tested.is_unexplained == ("No single force" in tested.text)
