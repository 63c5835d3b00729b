"""Noise: laws of every model, each model against its own density, levels from residuals."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import half_space_probes
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.stats import chi2, multivariate_normal, multivariate_t

from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import (
    NOISE_MODELS,
    Gaussian,
    NoiseModel,
    StudentT,
    _settle_tip,
    gaussian_moments,
    moments_of,
    noise_levels,
    relative_weight,
)

EVERY = [pytest.param(model, id=name) for name, model in NOISE_MODELS.items()]
SQUARED = np.array([0.0, 0.3, 1.0, 4.0, 30.0, 2500.0])
# Median of the absolute value of Gaussian noise over its sigma.
MEDIAN = 0.6744898


def _full(count: float) -> np.ndarray:
    return np.full_like(SQUARED, count)


@pytest.mark.parametrize("model", EVERY)
@given(squared=st.floats(0, 1e6), components=st.sampled_from([1.0, 2.0, 3.0]))
@settings(max_examples=60, deadline=None)
def test_laws_of_every_model(model: NoiseModel, squared: float, components: float) -> None:
    assert isinstance(model, NoiseModel)
    d2, p = np.array([squared]), np.array([components])
    step = 1e-5 * (1 + squared)
    higher, lower = d2 + step, np.maximum(d2 - step, 0.0)
    between = higher - lower
    weight, slope = model.weight(d2, p), model.weight_slope(d2, p)
    # Central differences with a relative step of 1e-5; one-sided at 0, where they err by the step.
    change = (model.loss(higher, p) - model.loss(lower, p)) / between
    assert change == pytest.approx(weight, rel=1e-4, abs=1e-9)
    bend = (model.weight(higher, p) - model.weight(lower, p)) / between
    assert bend == pytest.approx(slope, rel=1e-3, abs=1e-9)
    assert weight > 0
    assert slope <= 0
    assert 0 < relative_weight(model, d2, p)[0] <= 1


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_the_loss_is_minus_twice_the_log_density(dimension: int) -> None:
    """Of the vector's own dimension: nu + 3 in place of nu + p would be another distribution."""
    point = np.zeros((len(SQUARED), dimension))
    point[:, 0] = np.sqrt(SQUARED)
    densities = {
        StudentT(5.0): multivariate_t(np.zeros(dimension), np.eye(dimension), df=5.0),
        Gaussian(): multivariate_normal(np.zeros(dimension), np.eye(dimension)),
    }
    for model, density in densities.items():
        expected = -2 * (density.logpdf(point) - density.logpdf(np.zeros(dimension)))
        # Both are a logarithm away from each other: rounding.
        np.testing.assert_allclose(
            model.loss(SQUARED, _full(dimension)), expected, rtol=1e-10, atol=1e-12
        )


@pytest.mark.parametrize("components", [1, 2, 3])
@pytest.mark.parametrize("model", EVERY)
def test_moments_for_gaussian_noise_by_plain_integration(
    model: NoiseModel, components: int
) -> None:
    """E[psi^2] / p and E[psi'] / p over the chi-square distribution; the slope by Stein's lemma:
    E[psi'] = E[e psi] for Gaussian e."""
    p = np.array([float(components)])

    def mean(value: object) -> float:
        return quad(lambda d2: value(np.array([d2]))[0] * chi2.pdf(d2, components), 0, np.inf)[0]

    power = mean(lambda d2: model.weight(d2, p) ** 2 * d2) / components
    slope = mean(lambda d2: model.weight(d2, p) * d2) / components
    moments = gaussian_moments(model, components)
    # Adaptive quadrature of an integrand that is singular at 0 for one component.
    assert (moments.power, moments.slope) == pytest.approx((power, slope), rel=1e-6)
    assert moments.information == pytest.approx(slope / power, rel=1e-6)


def test_moments_of_the_residuals_own_distribution() -> None:
    """Residuals from Student's t itself: both moments are the Fisher information of its location,
    (nu + p) / (nu + p + 2) per component, and the loss is the right likelihood as it is."""
    draws = multivariate_t(np.zeros(3), np.eye(3), df=8.0, seed=3).rvs(200_000)
    moments = moments_of(StudentT(8.0), (draws**2).sum(1), np.full(200_000, 3.0))
    # 200 000 draws: 0.3 % of Monte Carlo error.
    assert (moments.power, moments.slope) == pytest.approx((11 / 13, 11 / 13), rel=0.01)
    assert moments.information == pytest.approx(1.0, rel=0.01)


def _rows(*, claimed: float | None = None, **options: object):
    (probe,) = half_space_probes(np.random.default_rng(2), count=1, grid=16, **options)
    if claimed:
        probe = replace(probe, std=np.full_like(probe.displacement, claimed))
    return observed_rows_of(probe)


def _levels(rows, residual, model_variance=0.0):
    known = np.broadcast_to(model_variance, residual.shape)
    return noise_levels([rows], [residual**2], [np.array(known)])


def test_an_estimated_level_is_the_standard_deviation() -> None:
    rows, rng = _rows(), np.random.default_rng(1)
    residual = 3e-5 * rng.normal(size=len(rows.measured))
    # 240 values a component: known to 7 %.
    np.testing.assert_allclose(_levels(rows, residual)[:3], 3e-5, rtol=0.2)
    residual[rng.random(len(residual)) < 0.05] *= 30
    # 5 % outliers lift the median by 7 %.
    np.testing.assert_allclose(_levels(rows, residual)[:3], 3.2e-5, rtol=0.2)


def test_what_the_model_explains_is_no_noise() -> None:
    rows = _rows()
    residual = 5e-5 * MEDIAN * (-1.0) ** np.arange(len(rows.measured))
    np.testing.assert_allclose(_levels(rows, residual)[:3], 5e-5, rtol=1e-4)
    np.testing.assert_allclose(_levels(rows, residual, 9e-10)[:3], 4e-5, rtol=1e-4)
    # All of it explained: what is left is the accuracy of numbers.
    largest = np.abs(rows.measured).max()
    assert _levels(rows, residual, 1e-8)[:3].max() <= 1e-5 * largest


def test_a_claim_stands_until_residuals_exceed_it_by_more_than_chance() -> None:
    rows = _rows(claimed=1e-5)
    alternating = 1e-5 * MEDIAN * (-1.0) ** np.arange(len(rows.measured))
    limit = np.sqrt(1.0 + 2.5 * 2.33 / np.sqrt(len(rows.measured)))
    assert (_levels(rows, 0.999 * limit * alternating) == 1.0).all()
    raised = _levels(rows, 1.001 * limit * alternating)
    np.testing.assert_allclose(raised[4:7], 1.001 * limit, rtol=1e-4)
    assert (_levels(rows, 0.01 * alternating) == 1.0).all()


def test_a_tip_leans_on_the_field() -> None:
    """Its three rows count as much as three of the field's: the mean of both variances."""
    rows = _rows(tip=True)
    residual = 1e-4 * MEDIAN * (-1.0) ** np.arange(len(rows.measured))
    residual[-3:] *= 5
    assert _levels(rows, residual)[3] == pytest.approx(1e-4 * np.sqrt((1 + 25) / 2), rel=1e-4)


def test_a_tip_alone_or_none_keeps_its_level() -> None:
    """Only with a field beside it is the tip's level drawn towards that of the field."""
    count, level = np.zeros(8, dtype=np.int64), np.arange(1.0, 9.0)
    for groups in ([3], [0, 1, 2]):
        estimated = level.copy()
        _settle_tip(estimated, np.where(np.isin(np.arange(8), groups), 3, count))
        np.testing.assert_array_equal(estimated, level)
    both = level.copy()
    _settle_tip(both, np.full(8, 3))
    # Mean of the field 2, three rows against three.
    assert both[3] == pytest.approx(0.5 * (2.0 + 4.0))
