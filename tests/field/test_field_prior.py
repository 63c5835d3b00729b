"""The prior's covariance and the evidence against brute force."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from palpate.field.field_prior import FieldPrior, make_field_modes

# A grid of 125 cells of unlike volume.
LINE = np.arange(5) / 5.0
POINTS = np.stack(np.meshgrid(LINE, LINE, LINE), axis=-1).reshape(-1, 3)
VOLUME = np.random.default_rng(0).uniform(0.5, 1.5, len(POINTS)) / 125


@pytest.fixture(scope="module")
def modes():
    """Modes on the grid, layers below its top."""
    return make_field_modes(POINTS, VOLUME, 1.0 - POINTS[:, 2])


def covariance(modes, prior):
    """Matern's of order 3/2 of distance and of depth, of fields without their mean."""

    def matern(distance, length):
        scaled = np.sqrt(3) * distance / length
        return (1 + scaled) * np.exp(-scaled)

    distance = np.linalg.norm(POINTS[:, None] - POINTS, axis=2)
    depth = np.abs(POINTS[:, None, 2] - POINTS[:, 2])
    whole = prior.std**2 * matern(distance, prior.length)
    whole += prior.layer_std**2 * matern(depth, 0.5 * modes.lengths[0])
    take = np.eye(len(whole)) - VOLUME / VOLUME.sum()
    return take @ whole @ take.T


@pytest.mark.parametrize("layer_std", [0.0, 0.8])
@pytest.mark.parametrize("number", range(3))
def test_modes_have_the_covariance_of_the_prior(modes, number, layer_std):
    prior = FieldPrior(0.4, float(modes.lengths[number]), layer_std)
    fields = modes.modes @ modes.mixing_of(prior)
    # A hundredth of the variance may be left out of the modes.
    most = 0.02 * (prior.std**2 + layer_std**2)
    assert np.abs(fields @ fields.T - covariance(modes, prior)).max() < most


def test_fields_have_no_mean(modes):
    assert np.abs(VOLUME @ modes.modes).max() < 1e-12


def measured(modes, prior, seed):
    """Linear observations of a field drawn from a prior, with noise of unit variance."""
    rng = np.random.default_rng(seed)
    fields = modes.modes @ modes.mixing_of(prior)
    rows = rng.normal(size=(80, len(POINTS)))
    return rows, rows @ fields @ rng.normal(size=fields.shape[1]) + rng.normal(size=80)


def test_evidence_is_the_marginal_likelihood(modes):
    rows, data = measured(modes, FieldPrior(0.4, modes.lengths[1], 0.8), 1)
    effects = rows @ modes.modes
    best = modes.best_prior(effects.T @ effects, effects.T @ data)
    fields = rows @ modes.modes @ modes.mixing_of(best)
    whole = multivariate_normal(cov=np.eye(80) + fields @ fields.T).logpdf(data)
    none = multivariate_normal(cov=np.eye(80)).logpdf(data)
    assert best.log_evidence == pytest.approx(whole - none, rel=1e-8)


@pytest.mark.parametrize("layer_std", [0.0, 0.8])
def test_the_prior_of_most_evidence_is_the_one_that_drew(modes, layer_std):
    truth = FieldPrior(0.4, modes.lengths[1], layer_std)
    sizes = []
    for seed in range(9):
        rows, data = measured(modes, truth, seed)
        effects = rows @ modes.modes
        sizes.append(modes.best_prior(effects.T @ effects, effects.T @ data))
    # Over factors of two the choice scatters by a step.
    assert np.median([prior.std for prior in sizes]) == pytest.approx(truth.std)
    assert np.median([prior.length for prior in sizes]) == pytest.approx(truth.length)
    # Layers that are not there: at most the smallest that is tried.
    assert np.median([prior.layer_std for prior in sizes]) == pytest.approx(layer_std, abs=0.05)


def test_noise_alone_is_no_evidence(modes):
    rng = np.random.default_rng(5)
    rows = rng.normal(size=(80, len(POINTS)))
    effects = rows @ modes.modes
    most = [
        modes.best_prior(effects.T @ effects, effects.T @ rng.normal(size=80)).log_evidence
        for _ in range(12)
    ]
    # 1 in 400 beyond log(400) by Markov's inequality for each prior; 126 priors.
    assert max(most) < np.log(400 * 126)
