"""The prior's covariance and the evidence against brute force."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from palpate.field.field_prior import FieldPrior, make_field_modes


@pytest.fixture(scope="module")
def modes():
    """Modes on a grid of 216 cells of unlike volume."""
    line = np.arange(6) / 6.0
    centre = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    return make_field_modes(centre, np.random.default_rng(0).uniform(0.5, 1.5, len(centre)) / 216)


def covariance(modes, std, length):
    """Matern's of order 3/2, of fields without their mean over the volume."""
    distance = np.linalg.norm(modes.centre[:, None] - modes.centre, axis=2)
    scaled = np.sqrt(3) * distance / length
    whole = std**2 * (1 + scaled) * np.exp(-scaled)
    take = np.eye(len(whole)) - modes.volume / modes.volume.sum()
    return take @ whole @ take.T


@pytest.mark.parametrize("number", range(4))
def test_modes_have_the_covariance_of_the_prior(modes, number):
    prior = FieldPrior(0.4, float(modes.lengths[number]))
    fields = modes.modes @ modes.mixing_of(prior)
    expected = covariance(modes, prior.std, prior.length)
    # A hundredth of the variance may be left out of the modes.
    assert np.abs(fields @ fields.T - expected).max() < 0.02 * prior.std**2


def test_fields_have_no_mean(modes):
    assert np.abs(modes.volume @ modes.modes).max() < 1e-12


def measured(modes, std, length, seed):
    """Linear observations of a field drawn from a prior, with noise of unit variance."""
    rng = np.random.default_rng(seed)
    fields = modes.modes @ modes.mixing_of(FieldPrior(std, length))
    rows = rng.normal(size=(80, len(modes.centre)))
    return rows, rows @ fields @ rng.normal(size=fields.shape[1]) + rng.normal(size=80)


def test_evidence_is_the_marginal_likelihood(modes):
    rows, data = measured(modes, 0.4, modes.lengths[2], 1)
    effects = rows @ modes.modes
    best = modes.best_prior(effects.T @ effects, effects.T @ data)
    fields = rows @ modes.modes @ modes.mixing_of(best)
    whole = multivariate_normal(cov=np.eye(80) + fields @ fields.T).logpdf(data)
    none = multivariate_normal(cov=np.eye(80)).logpdf(data)
    assert best.log_evidence == pytest.approx(whole - none, rel=1e-8)


def test_the_prior_of_most_evidence_is_the_one_that_drew(modes):
    found = []
    for seed in range(20):
        rows, data = measured(modes, 0.4, modes.lengths[2], seed)
        effects = rows @ modes.modes
        found.append(modes.best_prior(effects.T @ effects, effects.T @ data))
    # Over factors of two the choice scatters by a step.
    assert np.median([prior.std for prior in found]) == pytest.approx(0.4)
    assert np.median([prior.length for prior in found]) == pytest.approx(modes.lengths[2])


def test_noise_alone_is_no_evidence(modes):
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(80, len(modes.centre)))
    effects = rows @ modes.modes
    most = [
        modes.best_prior(effects.T @ effects, effects.T @ rng.normal(size=80)).log_evidence
        for _ in range(50)
    ]
    # 1 in 400 beyond log(400) by Markov's inequality for each prior; 24 priors.
    assert max(most) < np.log(400 * 24)
