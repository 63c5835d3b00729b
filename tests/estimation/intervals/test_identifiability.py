"""What counts as identifiable, and what is said of the rest."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import misfit_of
from estimation.half_space import Cantilever

from palpate.estimation import IntervalSet, ProbeObservations
from palpate.estimation.intervals.identifiability import (
    identifiable_combination,
    identifiable_constants,
    with_prior_ranges,
)
from palpate.estimation.responses.table import response_table
from palpate.estimation.search.variable_projection import FixedWeights, fixed_weights
from palpate.records import Constant

SHEAR, NU = 9e4, 0.1
KNOWN = Constant(SHEAR, 100.0, (SHEAR - 200, SHEAR + 200))


def _beam_weights(poisson_range: tuple[float, float]) -> FixedWeights:
    """A bent beam: its misfit is the same along E = 2 G (1 + nu)."""
    position = np.array([[x, 0.0, 0.0] for x in (0.06, 0.08, 0.1)])
    response = Cantilever(position)
    force = np.array([0.0, 0.0, -0.1])
    moved = (response.value(NU)[:, :3] @ force / SHEAR).reshape(-1, 3)
    probe = ProbeObservations(
        "b", position, moved, np.full_like(moved, 1e-5), force, np.zeros(3), None, None, response
    )
    misfit = misfit_of([probe])
    table = response_table(misfit.probes, poisson_range)
    return fixed_weights(
        misfit.probes, table, misfit.level, [np.ones(len(position))], np.ones(1)
    )  # fmt: skip


def _set(ratio: tuple[float, float], shear: Constant = KNOWN) -> IntervalSet:
    low, high = ratio
    return IntervalSet(Constant(0.5 * (low + high), 0.1, (low, high)), shear, KNOWN)


def test_a_ratio_is_identifiable_below_four_fifths_of_its_range() -> None:
    weights = _beam_weights((0.0, 0.4))
    for width, expected in ((0.319, True), (0.321, False)):
        found = identifiable_constants(_set((0.02, 0.02 + width)), weights)
        assert found["poisson_ratio"] is expected


@pytest.mark.parametrize(("high", "shear"), [(0.245, True), (0.255, False)])
def test_a_modulus_is_identifiable_where_nu_changes_it_by_less_than_a_quarter(
    high: float, shear: bool
) -> None:
    """Along a beam's valley G changes by 1 + nu and E does not."""
    weights = _beam_weights((0.0, high))
    found = identifiable_constants(_set((0.0, high)), weights)
    assert found == {"poisson_ratio": False, "shear_modulus": shear, "young_modulus": True}
    # With a ratio that is identifiable the valley does not matter.
    assert all(identifiable_constants(_set((0.0, 0.1)), weights).values())


def test_without_an_upper_end_nothing_is_identifiable() -> None:
    weights = _beam_weights((0.0, 0.4))
    endless = Constant(SHEAR, np.inf, (1.0, np.inf))
    narrow = replace(_set((0.1, 0.2)), shear_modulus=endless)
    found = identifiable_constants(narrow, weights)
    assert found == {"poisson_ratio": False, "shear_modulus": False, "young_modulus": True}
    ranged = with_prior_ranges(narrow, found, weights)
    assert ranged.shear_modulus.ci95 == (0.0, np.inf)
    assert ranged.shear_modulus.std == np.inf
    assert ranged.shear_modulus.value == SHEAR


def test_a_ratio_that_is_not_identifiable_is_its_prior_range() -> None:
    weights = _beam_weights((0.0, 0.4))
    wide = Constant(SHEAR, 1e4, (7e4, 1e5))
    young = Constant(2e5, 1e4, (1e5, 3e5))
    intervals = IntervalSet(Constant(0.1, 0.2, (0.0, 0.39)), wide, young)
    told = {"poisson_ratio": False, "shear_modulus": False, "young_modulus": True}
    ranged = with_prior_ranges(intervals, told, weights)
    # A uniform distribution over the range.
    assert ranged.poisson_ratio.value == pytest.approx(0.2, rel=1e-12)
    assert ranged.poisson_ratio.std == pytest.approx(0.4 / np.sqrt(12), rel=1e-12)
    assert ranged.poisson_ratio.ci95 == (0.0, 0.4)
    # Moduli move along the valley to its middle: E stays, G is E / (2 * 1.2). The response's
    # interpolation between nine nodes leaves 1e-8.
    young = 2 * SHEAR * (1 + NU)
    assert ranged.young_modulus.value == pytest.approx(young, rel=1e-6)
    assert ranged.shear_modulus.value == pytest.approx(young / 2.4, rel=1e-6)
    assert ranged.shear_modulus.ci95 == (7e4, 1e5)
    # Never out of its own interval.
    tight = replace(intervals, shear_modulus=Constant(9e4, 1e4, (8.8e4, 9.2e4)))
    assert with_prior_ranges(tight, told, weights).shear_modulus.value == 8.8e4


def test_what_is_identifiable_stays() -> None:
    weights = _beam_weights((0.0, 0.4))
    intervals = _set((0.05, 0.15))
    told = dict.fromkeys(("poisson_ratio", "shear_modulus", "young_modulus"), True)
    assert with_prior_ranges(intervals, told, weights) == intervals


def test_a_beam_is_said_to_tell_young_modulus() -> None:
    said = identifiable_combination(_beam_weights((0.0, 0.4)))
    assert said == "E = 2 G (1 + nu) (it changes by 0.0 % over all of nu)"


@pytest.mark.parametrize(
    ("name", "factor"),
    [("G", lambda nu: 1.0), ("G / (1 - nu)", lambda nu: 1 - nu),
     ("G / (1 - 2 nu)", lambda nu: 1 - 2 * nu)],
)  # fmt: skip
def test_each_combination_is_recognised(name: str, factor: object) -> None:
    """A response of the form factor(nu) / G."""

    class Combined(Cantilever):
        def value(self, poisson_ratio: float) -> np.ndarray:
            return self._shape() * factor(poisson_ratio)

    position = np.array([[0.06, 0.0, 0.0], [0.1, 0.0, 0.0]])
    response, force = Combined(position), np.array([0.0, 0.0, -0.1])
    moved = (response.value(NU)[:, :3] @ force / SHEAR).reshape(-1, 3)
    probe = ProbeObservations(
        "b", position, moved, np.full_like(moved, 1e-5), force, np.zeros(3), None, None, response
    )
    misfit = misfit_of([probe])
    weights = fixed_weights(
        misfit.probes, response_table(misfit.probes, (0.0, 0.4)), misfit.level, [np.ones(2)],
        np.ones(1),
    )  # fmt: skip
    assert identifiable_combination(weights).startswith(f"{name} (it changes by 0.0 %")
