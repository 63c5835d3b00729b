"""The model of a fit at other constants than the best."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, misfit_of, uncertainty_at
from estimation.half_space import half_space_probes

from palpate.estimation import FittedModel, ForceGain
from palpate.estimation.intervals.validation import probe_fits
from palpate.estimation.search import total_loss


@pytest.fixture(scope="module")
def probes():
    rng = np.random.default_rng(5)
    found = half_space_probes(rng, count=3, grid=6, noise=5e-5, force_noise=0.01)
    # An error that all probings share: its prior is part of the misfit.
    return [replace(one, nuisances=(ForceGain(0.01),)) for one in found]


@pytest.fixture(scope="module")
def minimum(probes):
    return minimum_of(misfit_of(probes))


def _model(probes, minimum):
    return FittedModel(misfit_of(probes), total_loss(minimum.probes, minimum.errors))


@pytest.fixture(scope="module")
def model(probes, minimum):
    return _model(probes, minimum)


def test_at_the_best_constants_it_is_the_fit(probes, minimum, model):
    found = model.at(minimum.poisson_ratio, minimum.shear_modulus)
    # The search ends where the misfit falls no more by what counts: 6 is the edge of a region.
    assert abs(found.misfit) < 1e-3
    fits = probe_fits(misfit_of(probes), uncertainty_at(probes))
    for mine, fit in zip(found.probings, fits, strict=True):
        np.testing.assert_allclose(mine.predicted, fit.predicted, atol=1e-7)
        np.testing.assert_allclose(mine.residual, fit.residual, atol=1e-7)


def test_the_misfit_is_that_of_the_likelihood(probes, minimum, model):
    misfit = misfit_of(probes)
    nu, modulus = minimum.poisson_ratio, minimum.shear_modulus
    best = misfit(nu, modulus)
    for other in ((nu + 0.05, modulus), (nu, 1.1 * modulus), (nu - 0.1, 0.8 * modulus)):
        found = model.at(*other).misfit
        assert found > 1.0
        assert found == pytest.approx(misfit(*other) - best, abs=1e-3)


def test_forces_that_are_exact_leave_displacements_inverse_to_the_modulus():
    rng = np.random.default_rng(6)
    probes = half_space_probes(rng, count=2, grid=5, noise=5e-5, force_noise=0.0)
    minimum = minimum_of(misfit_of(probes))
    model = _model(probes, minimum)
    soft, stiff = (model.at(0.3, modulus) for modulus in (1e4, 2e4))
    for one, other in zip(soft.probings, stiff.probings, strict=True):
        np.testing.assert_allclose(one.predicted, 2.0 * other.predicted, rtol=1e-12)
