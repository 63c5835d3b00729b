"""What a probing may hold, and how its measured components become rows."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import HalfSpace, half_space_probes
from estimation.moved_contact import contact_error_of

from palpate.errors import InputError
from palpate.estimation import (
    FitSettings,
    Nuisance,
    ProbeObservations,
    fisher_information,
    fit,
)
from palpate.estimation.measured_components import observed_rows_of
from palpate.pipeline.model.shared_errors import force_direction, force_gain, length_scale

NU, SHEAR, NOISE = 0.3, 2e4, 2e-5


def _probe(**options: object) -> ProbeObservations:
    return half_space_probes(np.random.default_rng(1), count=1, grid=4, noise=1e-5, **options)[0]


def test_a_std_that_is_not_positive_is_refused_where_something_was_measured() -> None:
    probe = _probe()
    std = probe.std.copy()
    std[2, 1] = 0.0
    with pytest.raises(InputError, match=r"'n01': std is 0.0 at index \(2, 1\), and 1 entries"):
        replace(probe, std=std)
    field = probe.displacement.copy()
    field[2] = np.nan
    assert np.isnan(replace(probe, std=std, displacement=field).displacement[2]).all()


def test_wrong_entries_are_refused() -> None:
    probe = _probe(tip=True)
    with pytest.raises(InputError, match=r"force_std is .* every component must be >= 0"):
        replace(probe, force_std=np.array([0.0, -1e-3, 0.0]))
    with pytest.raises(InputError, match=r"tip_displacement_std is -1\.0 at index"):
        replace(probe, tip_displacement_std=np.array([1e-5, -1.0, 1e-5]))
    with pytest.raises(InputError, match=r"'n01': position has .* not finite"):
        replace(probe, position=np.full_like(probe.position, np.nan))


def test_rows_follow_the_response() -> None:
    probe = _probe(tip=True, force_noise=0.1)
    field = probe.displacement.copy()
    field[0, 1] = np.nan
    field[3] = np.nan
    rows = observed_rows_of(replace(probe, displacement=field, force_std=np.array([1.0, 0.0, 1.0])))
    n = len(field)
    remaining = np.setdiff1d(np.arange(3 * n + 3), [1, 9, 10, 11])
    np.testing.assert_array_equal(rows.rows, remaining)
    np.testing.assert_array_equal(rows.component_of_row, remaining % 3)
    measured = np.concatenate([field.ravel(), probe.tip_displacement])
    np.testing.assert_array_equal(rows.measured, measured[remaining])
    # Three points a row at most: the first has two components left, the tip comes last.
    assert rows.components[0] == 2.0
    assert (rows.point[-1], rows.components[-1]) == (n, 3.0)
    assert np.isnan(rows.position[-1]).all()
    assert rows.group[:3].tolist() == [4, 6, 4]
    assert rows.group[-3:].tolist() == [7, 7, 7]
    assert rows.has_claims
    values = np.arange(float(len(rows.start)))
    assert values[rows.point_of_row][:5].tolist() == [0.0, 0.0, 1.0, 1.0, 1.0]
    lengths = rows.squared_length(np.full(len(rows.measured), 2.0))
    np.testing.assert_array_equal(lengths, 4.0 * rows.components)
    level = np.arange(1.0, 9.0)
    np.testing.assert_allclose(rows.sigma(level)[:2], [5e-5, 7e-5], rtol=1e-12)


def test_without_claims_levels_are_lengths() -> None:
    rows = observed_rows_of(replace(_probe(tip=True), std=None, tip_displacement_std=None))
    assert not rows.has_claims
    assert set(rows.group.tolist()) == {0, 1, 2, 3}
    np.testing.assert_array_equal(rows.unit, 1.0)


def test_a_body_force_alone_pushes() -> None:
    class Heavy(HalfSpace):
        def value(self, poisson_ratio: float) -> np.ndarray:
            table = super().value(poisson_ratio)
            table[:, 3] = 1.0
            return table

    probe = _probe()
    silent = replace(probe, force=np.zeros(3))
    with pytest.raises(InputError, match="has zero force and no other load"):
        observed_rows_of(silent)
    heavy = replace(silent, response=Heavy(probe.response.offset))
    assert len(observed_rows_of(heavy).measured) == 3 * len(probe.position)


def _covariances(count: int, *, depth: float = 4.0) -> np.ndarray:
    """As of cameras in one direction: `depth` times as uncertain along it."""
    rng = np.random.default_rng(3)
    along = np.array([0.5, -0.3, 0.81])
    along /= np.linalg.norm(along)
    shape = np.eye(3) + (depth**2 - 1.0) * np.outer(along, along)
    return 1e-10 * rng.uniform(0.5, 2.0, (count, 1, 1)) * shape


def _with_covariance(**options: object) -> ProbeObservations:
    probe = _probe(**options)
    covariance = _covariances(len(probe.position))
    return replace(probe, std=np.sqrt(np.einsum("naa->na", covariance)), covariance=covariance)


def test_rows_of_known_covariance_are_independent_and_equal() -> None:
    probe = _with_covariance(tip=True)
    field = probe.displacement.copy()
    field[3] = np.nan
    rows = observed_rows_of(replace(probe, displacement=field))
    plain = observed_rows_of(replace(probe, displacement=field, covariance=None))
    level = np.ones(8)
    remaining = np.delete(np.arange(len(field)), 3)
    # The squared length of a residual is what its covariance makes of it.
    value = probe.response.value(0.2)[rows.rows, 2]
    left = (plain.measured - value)[:-3].reshape(-1, 3)
    inverse = np.linalg.inv(probe.covariance[remaining])
    expected = np.einsum("pa,pab,pb->p", left, inverse, left)
    squared = rows.squared_length((rows.measured - rows.whitened(value)) / rows.sigma(level))
    np.testing.assert_allclose(squared[:-1], expected, rtol=1e-9)
    variance = rows.sigma(level) ** 2
    np.testing.assert_allclose(
        rows.component_variance(variance), plain.sigma(level) ** 2, rtol=1e-9
    )
    np.testing.assert_array_equal(plain.component_variance(variance), variance)
    np.testing.assert_allclose(rows.unwhitened(rows.measured), plain.measured, rtol=1e-9)
    # The tip, behind the points, is as it was.
    np.testing.assert_array_equal(rows.measured[-3:], plain.measured[-3:])


def test_whitening_mixes_the_components_of_each_point_alone() -> None:
    rows = observed_rows_of(_with_covariance(tip=True))
    n = len(rows.whitening)
    columns = np.random.default_rng(1).normal(size=(len(rows.measured), 2))
    mixed = rows.whitening @ columns[: 3 * n].reshape(n, 3, 2)
    np.testing.assert_allclose(rows.whitened(columns)[: 3 * n], mixed.reshape(-1, 2), rtol=1e-12)
    np.testing.assert_array_equal(rows.whitened(columns)[3 * n :], columns[3 * n :])
    # Variance of a row for components of variance 1, and weights of pairs of components.
    matrix = np.zeros((3 * n, 3 * n))
    for k in range(n):
        matrix[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = rows.whitening[k]
    np.testing.assert_allclose(rows.whitening_power()[: 3 * n], np.diag(matrix @ matrix.T))
    weight = np.random.default_rng(2).uniform(1, 2, len(rows.measured))
    expected = matrix.T @ np.diag(weight[: 3 * n]) @ matrix
    products = rows.component_products(weight)
    np.testing.assert_allclose(products[1], expected[3:6, 3:6], rtol=1e-9)
    np.testing.assert_array_equal(products[-1], np.diag(weight[-3:]))


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
        estimate = fit(probes).estimate
        # A gain moves both moduli by itself; scales along three axes, by about a weighted mean.
        assert estimate.young_modulus.std / estimate.young_modulus.value > 0.5 * scale
        bound = fisher_information(probes, poisson_ratio=NU, shear_modulus=SHEAR).bound()
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
    estimate = fit(weighed).estimate
    # What one probing alone has is its own.
    assert [error.name for error in estimate.errors] == ["gain of the force sensor 'gauge'"]
    of_the_weight = [error.name for error in estimate.probes[0].errors]
    assert of_the_weight == ["gain of the force sensor 'weights'"]
    # What takes a reading to the true force.
    (gain,) = estimate.errors
    assert gain.value == pytest.approx(-0.03, abs=4 * gain.std)
    assert gain.std < 0.005
    assert estimate.young_modulus.value == pytest.approx(5.2e4, abs=4 * estimate.young_modulus.std)
    # With one sensor for all, the gain is not learnt.
    shared = fit([replace(p, nuisances=(force_gain(0.02),)) for p in weighed])
    assert estimate.young_modulus.std < 0.3 * shared.intervals.young_modulus.std
    assert {entry.source for entry in estimate.budget} >= {"gain of the force sensor"}


def test_a_contact_that_is_off_is_found_and_does_no_harm() -> None:
    """1.8 mm beside what the session says, 0.5 mm told: the constants follow the true contact."""
    plain, mended = [], []
    for probe in _probes(grid=14):
        beside = replace(probe, response=HalfSpace(probe.response.offset - [1.8e-3, 0.0, 0.0]))
        plain.append(beside)
        mended.append(replace(beside, nuisances=(contact_error_of(beside),)))
    wrong, right = fit(plain).estimate, fit(mended).estimate
    error = {
        name: abs(estimate.young_modulus.value / 5.2e4 - 1)
        for name, estimate in (("wrong", wrong), ("right", right))
    }
    # Four standard deviations away: terms of third order are left.
    assert error["right"] < 0.2 * error["wrong"]
    assert error["right"] < 0.003
    for fitted in right.probes:
        along = fitted.errors[0]
        assert along.name == f"contact point of {fitted.name} toward +x"
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
    estimate = fit(probes).estimate
    off = max(
        abs(error.value / error.prior_std) for probe in estimate.probes for error in probe.errors
    )
    assert (off > 5.0) is (status == "model_contradicted")
    assert estimate.status == status


def test_errors_that_are_not_there_stay_small() -> None:
    nuisances = (force_gain(0.01), force_direction(0.01), length_scale(0.003))
    probes = [replace(p, nuisances=(*nuisances, contact_error_of(p))) for p in _probes()]
    estimate = fit(probes).estimate
    every = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    assert len(estimate.errors) == 7
    assert len(every) == 7 + 2 * len(probes)
    assert not any(error.is_surprising for error in every)
    assert not any("Likely fault" in note for note in estimate.notes)
    for estimated in every:
        # The data can only say more than the prior.
        assert estimated.std <= estimated.prior_std * (1.0 + 1e-9)
    low, high = estimate.young_modulus.ci95
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
        first, other = getattr(quick, name), getattr(slow, name)
        assert other.value == pytest.approx(first.value, abs=0.1 * first.std)


@pytest.mark.parametrize("noise", [NOISE, 10 * NOISE])
def test_one_probing_alone_is_no_surer_than_its_gauge(noise):
    """Whether the interval comes from a parabola or from the misfit's profile."""
    (probe,) = _probes(count=1, noise=noise)
    gained = replace(probe, nuisances=(force_gain(0.05),))
    plain, gained_fit = (fit([observed]).estimate for observed in (probe, gained))
    for name in ("shear_modulus", "young_modulus"):
        low, high = getattr(gained_fit, name).ci95
        known = np.log(np.divide(*getattr(plain, name).ci95)) / (2 * 1.96)
        # Variances add; the quantile of few degrees of freedom only makes it wider.
        assert np.log(high / low) / (2 * 1.96) > 0.98 * np.hypot(0.05, known), name
