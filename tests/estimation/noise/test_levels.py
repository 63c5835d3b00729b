"""Noise levels: right for Gaussian noise, deaf to outliers, faithful to claims."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import half_space_probes

from palpate.estimation import ProbeObservations
from palpate.estimation.noise.levels import noise_levels
from palpate.estimation.observed_rows import ObservedRows, observed_rows_of

# Median absolute deviation of Gaussian noise over its sigma, and the standard error of a sigma
# from it, over sigma and times the root of the number of values.
MAD, MAD_ERROR = 1.4826022, 1.166


def _levels(scale: float, *, claimed: bool, outliers: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(1)
    probes = half_space_probes(rng, count=8, grid=16, noise=3e-5)
    if not claimed:
        probes = [replace(probe, std=None) for probe in probes]
    rows = [observed_rows_of(probe) for probe in probes]
    residuals = [scale * 3e-5 * rng.normal(size=len(one.measured)) for one in rows]
    for residual in residuals:
        residual[rng.random(len(residual)) < outliers] *= 30
    return noise_levels(rows, residuals, parameters=2)


def test_estimated_level_is_the_standard_deviation() -> None:
    # 2000 values a component: the median absolute deviation is known to 2.6 %.
    np.testing.assert_allclose(_levels(1.0, claimed=False)[:3], 3e-5, rtol=0.08)
    # 5 % outliers lift the median by 7 %.
    np.testing.assert_allclose(_levels(1.0, claimed=False, outliers=0.05)[:3], 3.2e-5, rtol=0.1)


def test_claims_hold_until_residuals_exceed_them() -> None:
    assert np.all(_levels(1.0, claimed=True) == 1.0)
    assert np.all(_levels(0.2, claimed=True) == 1.0)
    assert np.all(_levels(1.0, claimed=True, outliers=0.05) == 1.0)
    np.testing.assert_allclose(_levels(3.0, claimed=True)[4:7], 3.0, rtol=0.08)


def _probe(**options: object) -> ProbeObservations:
    return half_space_probes(np.random.default_rng(2), count=1, grid=7, **options)[0]


def _alternating(rows: ObservedRows, size: float) -> np.ndarray:
    """Residuals of one size and changing sign."""
    return size * rows.unit * (-1.0) ** np.arange(len(rows.measured))


@pytest.mark.parametrize("parameters", [0, 2, 40])
def test_residuals_of_one_size(parameters: int) -> None:
    """Their median is that size; fitted parameters took a share of the squares."""
    rows = observed_rows_of(_probe())
    count = len(rows.measured)
    level = noise_levels([rows], [_alternating(rows, 1e-4)], parameters=parameters)
    expected = MAD * 1e-4 * np.sqrt(count / (count - parameters))
    np.testing.assert_allclose(level[:3], expected, rtol=1e-6)
    np.testing.assert_array_equal(level[3:], 1.0)


def test_more_parameters_than_rows() -> None:
    """No more than half of the rows are taken for lost."""
    rows = observed_rows_of(_probe())
    level = noise_levels([rows], [_alternating(rows, 1e-4)], parameters=10_000)
    count = len(rows.measured)
    lost = count // 2
    np.testing.assert_allclose(level[:3], MAD * 1e-4 * np.sqrt(count / (count - lost)), rtol=1e-6)


def test_a_claim_gives_way_beyond_what_chance_and_outliers_explain() -> None:
    rows = observed_rows_of(_probe(noise=1e-5))
    points = len(rows.start)
    # A tenth of outliers lifts the median by 0.12; 2.5 standard errors come on top.
    limit = 1 + 0.12 + 2.5 * MAD_ERROR / np.sqrt(points)
    for share in (0.999, 1.001):
        level = noise_levels([rows], [_alternating(rows, share * limit / MAD)], parameters=0)
        expected = share * limit if share > 1 else 1.0
        np.testing.assert_allclose(level[4:7], expected, rtol=1e-6)


def test_exact_data_have_a_floor() -> None:
    probe = _probe()
    rows = observed_rows_of(probe)
    level = noise_levels([rows], [np.zeros_like(rows.measured)], parameters=2)
    # No field is measured better than 1e-5 of its largest displacement.
    largest = np.abs(probe.displacement).max(axis=0)
    np.testing.assert_allclose(level[:3], 1e-5 * largest, rtol=1e-12)
    claimed = observed_rows_of(replace(probe, std=np.full_like(probe.displacement, 1e-12)))
    raised = noise_levels([claimed], [np.zeros_like(rows.measured)], parameters=2)
    np.testing.assert_allclose(raised[4:7], 1e-5 * largest / 1e-12, rtol=1e-12)


def test_a_tip_leans_on_the_field() -> None:
    """Its three rows count as much as three of the field's: the mean of both variances."""
    rows = observed_rows_of(_probe(tip=True))
    residual = _alternating(rows, 1e-4)
    residual[-3:] *= 5
    level = noise_levels([rows], [residual], parameters=0)
    expected = MAD * 1e-4 * np.sqrt((1 + 25) / 2)
    assert level[3] == pytest.approx(expected, rel=1e-6)


def test_a_tip_alone_has_its_own_level() -> None:
    probe = _probe(tip=True)
    blind = np.full_like(probe.displacement, np.nan)
    rows = observed_rows_of(replace(probe, displacement=blind))
    level = noise_levels([rows], [_alternating(rows, 2e-4)], parameters=0)
    assert level[3] == pytest.approx(MAD * 2e-4, rel=1e-6)
