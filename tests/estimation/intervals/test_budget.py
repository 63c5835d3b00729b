"""What each source adds to the uncertainty: how far its standard deviation moves the estimate."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, misfit_of, uncertainty_at
from estimation.half_space import half_space_probes

from palpate.estimation import (
    ForceGain,
    LengthScale,
    LoadedResponse,
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    fisher_information,
)
from palpate.estimation.intervals.budget import POINTS, SCATTER
from palpate.estimation.intervals.sandwich import FORCES
from palpate.records import CONSTANT_NAMES, BudgetEntry

# A hundredth of the noise: what is not linear is a thousandth of that.
NOISE, LIFT = 2e-5, 2e-7
ALL, NONE = (dict.fromkeys(CONSTANT_NAMES, known) for known in (True, False))
GAIN, SCALE = "gain of the force sensor", "scale of lengths"


@dataclass(frozen=True)
class _Offset:
    """The same displacement for every point of a probing."""

    name: str
    of: str = ""
    size: float = LIFT

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        return (NuisanceParameter(self.name, self.size, "m", self.of),)

    def columns(self, at: LoadedResponse) -> np.ndarray:
        return np.where(at.rows[:, None] % 3 == 2, self.size, 0.0)


def _probes(
    *nuisances: Nuisance, considered: tuple[Nuisance, ...] = (), **options: object
) -> list[ProbeObservations]:
    """Exact displacements that claim noise; each probing with an offset of its own."""
    rng = np.random.default_rng(5)
    made = half_space_probes(rng, **{"count": 3, "grid": 5, "noise": 0.0} | options)
    return [
        replace(
            probe,
            std=np.full_like(probe.displacement, NOISE),
            nuisances=(*nuisances, _Offset(f"offset of {probe.name}", "offsets")),
            considered=considered,
        )
        for probe in made
    ]


def _budget(probes: list[ProbeObservations]) -> dict[str, BudgetEntry]:
    found = uncertainty_at(probes).budget(ALL)
    return {one.source: one for one in found}


def _moved(
    probes: list[ProbeObservations], change: Callable[[int, ProbeObservations], np.ndarray]
) -> np.ndarray:
    """How far displacements that are changed move log G, nu and log E."""
    changed = [
        replace(one, displacement=one.displacement + change(k, one)) for k, one in enumerate(probes)
    ]
    start, end = (minimum_of(misfit_of(some)) for some in (probes, changed))
    ratio = end.poisson_ratio - start.poisson_ratio
    shear = np.log(end.shear_modulus / start.shear_modulus)
    young = shear + np.log((1 + end.poisson_ratio) / (1 + start.poisson_ratio))
    return np.array([shear, ratio, young])


def _values(entry: BudgetEntry) -> np.ndarray:
    return np.array([getattr(entry, name) for name in CONSTANT_NAMES])


@pytest.mark.parametrize("reference", [None, "rest"])
def test_the_squares_add_up_to_the_variance(reference: str | None) -> None:
    made = _probes(
        ForceGain(0.01), LengthScale(0.004), considered=(_Offset("lift"),), force_noise=0.02
    )
    probes = [replace(one, reference=reference) for one in made]
    joint, found = uncertainty_at(probes), _budget(probes)
    assert set(found) == {GAIN, SCALE, "offsets", "lift", POINTS, FORCES}
    for name in CONSTANT_NAMES:
        squares = sum(getattr(one, name) ** 2 for one in found.values())
        assert np.sqrt(squares) == pytest.approx(joint.error(name), rel=1e-9)
    whole = [one.young_modulus for one in joint.budget(ALL)]
    assert whole == sorted(whole, reverse=True)


def test_a_shared_error_moves_the_estimate_by_its_entry() -> None:
    probes = _probes(ForceGain(1e-4), LengthScale(1e-4))
    found = _budget(probes)
    gain = np.abs(_moved(probes, lambda k, one: 1e-4 * one.displacement))
    # Second order: 1e-4 of a step of 1e-4.
    np.testing.assert_allclose(_values(found[GAIN]), gain, rtol=1e-3, atol=1e-9)
    axes = [_moved(probes, lambda k, one, e=e: 1e-4 * one.displacement * e) for e in np.eye(3)]
    scale = np.sqrt(np.square(axes).sum(axis=0))
    np.testing.assert_allclose(_values(found[SCALE]), scale, rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("considered", [False, True])
def test_errors_of_single_probings_add_square_to_square(considered: bool) -> None:
    """What is considered only is shared, and adds as it is."""
    name = "lift" if considered else "offsets"
    probes = _probes(considered=(_Offset("lift"),) if considered else ())
    up = np.array([0.0, 0.0, LIFT])
    if considered:
        expected = np.abs(_moved(probes, lambda k, one: up * np.ones((len(one.position), 1))))
    else:
        each = [
            _moved(probes, lambda k, one, m=m: float(k == m) * up * np.ones((len(one.position), 1)))
            for m in range(3)
        ]
        expected = np.sqrt(np.square(each).sum(axis=0))
    # Where probings agree perfectly, as these do, all that differs between them is smaller by the
    # same factor for each constant.
    found = _values(_budget(probes)[name])
    factor = [1.0] * 3
    if not considered:
        joint = uncertainty_at(probes)
        factor = [np.sqrt(joint.scatters[constant].factor) for constant in CONSTANT_NAMES]
    np.testing.assert_allclose(found, expected * factor, rtol=5e-3)


def test_forces_count_as_their_robust_scores_do() -> None:
    """With points of no noise and forces of 2 % nothing is left for the points."""
    probes = [
        replace(one, std=np.full_like(one.displacement, 1e-9), nuisances=())
        for one in _probes(force_noise=0.02)
    ]
    found = {one.source: one for one in uncertainty_at(probes, "student-t").budget(ALL)}
    joint = uncertainty_at(probes, "student-t")
    squares = sum(one.young_modulus**2 for one in found.values())
    assert np.sqrt(squares) == pytest.approx(joint.error("young_modulus"), rel=1e-6)
    assert found[POINTS].young_modulus < 1e-3 * found[FORCES].young_modulus


def test_probings_that_disagree_are_a_source() -> None:
    probes = _probes()
    assert SCATTER not in _budget(probes)
    moved = [
        replace(one, displacement=factor * one.displacement)
        for one, factor in zip(probes, (0.8, 1.0, 1.2), strict=True)
    ]
    found, joint = _budget(moved), uncertainty_at(moved)
    squares = sum(one.young_modulus**2 for one in found.values())
    assert np.sqrt(squares) == pytest.approx(joint.error("young_modulus"), rel=1e-9)
    assert found[SCATTER].young_modulus > 0.05
    assert found[SCATTER].young_modulus > 3 * found[POINTS].young_modulus


def test_what_is_not_determined_has_no_budget() -> None:
    probes = _probes()
    joint = uncertainty_at(probes)
    (first, *_) = joint.budget(NONE | {"poisson_ratio": True})
    assert first.poisson_ratio > 0.0
    assert np.isnan([first.shear_modulus, first.young_modulus]).all()
    # Moduli are given for all of Poisson's ratio where that is open.
    assert joint.budget(ALL | {"poisson_ratio": False}) == ()


def test_what_is_planned_has_the_same_parts() -> None:
    probes = _probes(ForceGain(0.01), considered=(_Offset("lift"),), force_noise=0.02)
    found = fisher_information(probes, poisson_ratio=0.3, shear_modulus=2e4)
    bound = found.bound(range(3))
    for name, size in (("young_modulus", 5.2e4), ("poisson_ratio", 1.0)):
        squares = sum(getattr(one, name) ** 2 for one in found.budget)
        assert size * np.sqrt(squares) == pytest.approx(bound[name], rel=1e-9)
    assert {one.source for one in found.budget} == {GAIN, "offsets", "lift", POINTS, FORCES}
