"""What becomes of an error that is there: constants, intervals, status."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import HalfSpace, half_space_probes
from estimation.moved_contact import contact_error_of

from palpate.estimation import (
    FitSettings,
    Nuisance,
    ProbeObservations,
    cramer_rao_bound,
    fit,
)
from palpate.pipeline.model.measurement_errors import force_direction, force_gain, length_scale

NU, SHEAR, NOISE = 0.3, 2e4, 2e-5


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    return half_space_probes(
        np.random.default_rng(seed), **{"count": 4, "grid": 8, "noise": NOISE} | options
    )


@pytest.mark.parametrize(
    ("nuisance", "scale"),
    [(force_gain(0.02), 0.02), (length_scale(0.02), 0.02)],
    ids=["gain", "length"],
)
def test_a_shared_error_widens_the_moduli_and_no_number_of_points_helps(
    nuisance: Nuisance, scale: float
) -> None:
    for count in (3, 12):
        probes = [replace(p, nuisances=(nuisance,)) for p in _probes(count=count, noise=1e-7)]
        found = fit(probes).estimate
        # A gain moves both moduli by itself; scales along three axes, by about a weighted mean.
        assert found.young_modulus.std / found.young_modulus.value > 0.5 * scale
        bound = cramer_rao_bound(probes, poisson_ratio=NU, shear_modulus=SHEAR)
        assert bound["young_modulus"] / 5.2e4 > 0.5 * scale


@pytest.mark.slow
def test_intervals_hold_a_gain_that_is_off() -> None:
    """A force scale drawn from its prior: 2 % were eight standard errors without it."""
    held, rng = 0, np.random.default_rng(4)
    for seed in range(30):
        gain = 1.0 + 0.02 * rng.normal()
        probes = [
            replace(p, force=gain * p.force, nuisances=(force_gain(0.02),)) for p in _probes(seed)
        ]
        low, high = fit(probes).estimate.young_modulus.ci95
        held += low <= 5.2e4 <= high
    # 95 % of 30: three standard deviations are 12 %.
    assert held / 30 > 0.83


def test_a_weight_calibrates_the_gauge_of_the_other_probings() -> None:
    """One probing's force is a weight's, exact; the gauge of the others reads 3 % too much."""
    first, *others = _probes(count=3, noise=0.1 * NOISE)
    gauge = force_gain(0.02, "gauge")
    weighed = [replace(first, nuisances=(force_gain(1e-4, "weights"),))]
    weighed += [replace(p, force=1.03 * p.force, nuisances=(gauge,)) for p in others]
    found = fit(weighed).estimate
    # What one probing alone has is its own.
    assert [error.name for error in found.errors] == ["gain of the force sensor 'gauge'"]
    own = [error.name for error in found.probes[0].errors]
    assert own == ["gain of the force sensor 'weights'"]
    # What takes a reading to the true force.
    (gain,) = found.errors
    assert gain.value == pytest.approx(-0.03, abs=4 * gain.std)
    assert gain.std < 0.005
    assert found.young_modulus.value == pytest.approx(5.2e4, abs=4 * found.young_modulus.std)
    # With one sensor for all, the gain is not learnt.
    shared = fit([replace(p, nuisances=(force_gain(0.02),)) for p in weighed])
    assert found.young_modulus.std < 0.3 * shared.intervals.young_modulus.std
    assert {entry.source for entry in found.budget} >= {"gain of the force sensor"}


def test_a_contact_that_is_off_is_found_and_does_no_harm() -> None:
    """1.8 mm beside what the session says, 0.5 mm told: the constants follow the true contact."""
    plain, mended = [], []
    for probe in _probes(grid=14):
        beside = replace(probe, response=HalfSpace(probe.response.offset - [1.8e-3, 0.0, 0.0]))
        plain.append(beside)
        mended.append(replace(beside, nuisances=(contact_error_of(beside),)))
    wrong, right = fit(plain).estimate, fit(mended).estimate
    error = {
        name: abs(found.young_modulus.value / 5.2e4 - 1)
        for name, found in (("wrong", wrong), ("right", right))
    }
    # Four standard deviations away: terms of third order are left.
    assert error["right"] < 0.2 * error["wrong"]
    assert error["right"] < 0.003
    for one in right.probes:
        along = one.errors[0]
        assert along.name == f"contact point of {one.name} toward +x"
        # The same, and the prior pulls.
        assert along.value == pytest.approx(-1.8e-3, rel=0.25)
    assert any("Likely fault: the contact point of" in n for n in right.notes)


@pytest.mark.parametrize(("beside", "status"), [(1.4e-3, "ok"), (4e-3, "model_contradicted")])
def test_an_error_beyond_chance_contradicts_the_model(beside: float, status: str) -> None:
    """One contact of three, 3.5 or ten standard deviations beside its stated point."""
    probes = []
    for shift, probe in zip((beside, 0.0, 0.0), _probes(count=3, grid=10), strict=True):
        moved = replace(probe, response=HalfSpace(probe.response.offset - [shift, 0.0, 0.0]))
        probes.append(replace(moved, nuisances=(contact_error_of(moved, 4e-4),)))
    found = fit(probes).estimate
    off = max(abs(one.value / one.prior_std) for probe in found.probes for one in probe.errors)
    assert (off > 5.0) is (status == "model_contradicted")
    assert found.status == status


def test_errors_that_are_not_there_stay_small() -> None:
    nuisances = (force_gain(0.01), force_direction(0.01), length_scale(0.003))
    probes = [replace(p, nuisances=(*nuisances, contact_error_of(p))) for p in _probes()]
    found = fit(probes).estimate
    every = [*found.errors, *(error for one in found.probes for error in one.errors)]
    assert len(found.errors) == 7
    assert len(every) == 7 + 2 * len(probes)
    assert not any(one.is_surprising for one in every)
    assert not any("Likely fault" in note for note in found.notes)
    for one in every:
        # The data can only say more than the prior.
        assert one.std <= one.prior_std * (1.0 + 1e-9)
    low, high = found.young_modulus.ci95
    assert low < 5.2e4 < high


def test_simplex_and_scoring_agree_with_errors() -> None:
    nuisances = (force_gain(0.01), length_scale(0.003))
    probes = [
        replace(p, nuisances=(*nuisances, contact_error_of(p))) for p in _probes(count=2, grid=5)
    ]
    quick = fit(probes).estimate
    slow = fit(probes, settings=FitSettings(method="nelder-mead")).estimate
    # Columns are taken under the measured force by one, under the true one by the other.
    for name in ("poisson_ratio", "shear_modulus", "young_modulus"):
        one, other = getattr(quick, name), getattr(slow, name)
        assert other.value == pytest.approx(one.value, abs=0.1 * one.std)


@pytest.mark.parametrize("noise", [NOISE, 10 * NOISE])
def test_one_probing_alone_is_no_surer_than_its_gauge(noise):
    """Whether the interval comes from a parabola or from the misfit's profile."""
    (probe,) = _probes(count=1, noise=noise)
    gained = replace(probe, nuisances=(force_gain(0.05),))
    plain, found = (fit([one]).estimate for one in (probe, gained))
    for name in ("shear_modulus", "young_modulus"):
        low, high = getattr(found, name).ci95
        known = np.log(np.divide(*getattr(plain, name).ci95)) / (2 * 1.96)
        # Variances add; the quantile of few degrees of freedom only makes it wider.
        assert np.log(high / low) / (2 * 1.96) > 0.98 * np.hypot(0.05, known), name
