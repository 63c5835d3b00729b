"""Noise levels: right for Gaussian noise, deaf to outliers, faithful to claims."""

from dataclasses import replace

import numpy as np
from estimation.half_space import half_space_probes

from palpate.estimation.noise.levels import noise_levels
from palpate.estimation.observations import observed_rows_of


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
