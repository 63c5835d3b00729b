"""The map of the likelihood against the misfit itself."""

import numpy as np
import pytest
from estimation.fitted import RANGE, misfit_of, uncertainty_at
from estimation.half_space import half_space_probes
from scipy.stats import chi2

from palpate.estimation import LikelihoodMap
from palpate.estimation.intervals.likelihood import likelihood_map
from palpate.estimation.intervals.uncertainty import interval_set


def test_it_is_the_misfit_above_its_minimum() -> None:
    """For Gaussian claims and probings that agree, nothing is to be calibrated."""
    probes = half_space_probes(np.random.default_rng(3), count=1, grid=5, noise=1e-4)
    uncertainty = uncertainty_at(probes)
    intervals = interval_set(uncertainty)
    found = likelihood_map(uncertainty, intervals)
    misfit, minimum = misfit_of(probes), uncertainty.minimum
    best = misfit(minimum.poisson_ratio, minimum.shear_modulus)
    for i, j in ((0, 0), (10, 40), (25, 25), (50, 3)):
        expected = misfit(found.poisson_ratio[i], found.shear_modulus[j]) - best
        # The ridge and interpolation: 1e-8 of the squares' sum.
        assert found.deviance[i, j] == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert found.deviance.shape == (51, 51)
    # Three quarters of the interval on either side, unless the range ends.
    low, high = intervals.poisson_ratio.ci95
    margin = 0.75 * (high - low)
    expected = (max(low - margin, RANGE[0]), min(high + margin, RANGE[1]))
    np.testing.assert_allclose(found.poisson_ratio[[0, -1]], expected, rtol=1e-12)
    soft, stiff = np.log(intervals.shear_modulus.ci95)
    room = 0.75 * (stiff - soft)
    ends = np.log(found.shear_modulus[[0, -1]])
    np.testing.assert_allclose(ends, (soft - room, stiff + room), rtol=1e-12)


def test_wide_noise_lowers_it_in_proportion() -> None:
    """Residuals four times the claim: every height a sixteenth, where the probing is alone."""
    probes = half_space_probes(np.random.default_rng(3), count=1, grid=9, noise=4e-5)
    object.__setattr__(probes[0], "std", probes[0].std / 4)
    uncertainty = uncertainty_at(probes)
    found = likelihood_map(uncertainty, interval_set(uncertainty))
    misfit, minimum = misfit_of(probes), uncertainty.minimum
    best = misfit(minimum.poisson_ratio, minimum.shear_modulus)
    above = misfit(found.poisson_ratio[5], found.shear_modulus[8]) - best
    power = uncertainty.noise.power * uncertainty.noise.excess
    assert found.deviance[5, 8] == pytest.approx(above / power, rel=1e-3)
    # The residuals' own variance over the claimed one, 16, is known to 10 % from 250 rows.
    assert uncertainty.noise.power == pytest.approx(16, rel=0.3)


def test_without_signal_it_ends_somewhere() -> None:
    probes = half_space_probes(np.random.default_rng(1), count=1, grid=5, noise=1.0)
    uncertainty = uncertainty_at(probes)
    intervals = interval_set(uncertainty)
    found = likelihood_map(uncertainty, intervals)
    best = intervals.shear_modulus.value
    assert np.isfinite(found.deviance).all()
    # Thirty times the best, and three quarters of that factor more.
    room = (30.0 * best / max(intervals.shear_modulus.ci95[0], best / 30.0)) ** 0.75
    assert found.shear_modulus[-1] == pytest.approx(30.0 * best * room, rel=1e-9)
    assert found.shear_modulus[0] >= best / 30.0 / room * (1 - 1e-9)


@pytest.mark.parametrize("share", [0.5, 0.95])
def test_heights_bound_joint_regions(share: float) -> None:
    assert LikelihoodMap.height(share) == pytest.approx(chi2.ppf(share, 2), rel=1e-12)
