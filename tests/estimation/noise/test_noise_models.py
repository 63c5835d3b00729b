"""Laws of every noise model, and each model against its own density."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import quad
from scipy.stats import chi2, multivariate_normal, multivariate_t, t

from palpate.estimation.noise.gaussian import Gaussian
from palpate.estimation.noise.noise_model import (
    NoiseModel,
    gaussian_moments,
    relative_weight,
    score_moments,
)
from palpate.estimation.noise.registry import NOISE_MODELS
from palpate.estimation.noise.student_t import StudentT

EVERY = [pytest.param(model, id=name) for name, model in NOISE_MODELS.items()]
SQUARED = np.array([0.0, 0.3, 1.0, 4.0, 30.0, 2500.0])


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


@pytest.mark.parametrize("model", EVERY)
def test_nothing_measured_counts_nothing(model: NoiseModel) -> None:
    zero = np.zeros(1)
    assert model.loss(zero, zero) == 0
    assert np.isfinite(model.weight(zero, zero))
    np.testing.assert_array_equal(model.loss(np.zeros(3), np.array([1.0, 2.0, 3.0])), 0)
    np.testing.assert_array_equal(relative_weight(model, np.zeros(2), np.array([1.0, 3.0])), 1)


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


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_the_weight_is_the_mean_of_the_hidden_scale(dimension: int) -> None:
    """Student's t is Gaussian noise whose precision w is chi-square / nu; the EM weight is its mean
    for a known residual, here by quadrature."""
    degrees = 6.0
    for squared in (0.0, 1.0, 25.0):

        def joint(w: float, d2: float = squared) -> float:
            return chi2.pdf(degrees * w, degrees) * w ** (dimension / 2) * np.exp(-w * d2 / 2)

        mean = quad(lambda w: w * joint(w), 0, np.inf)[0] / quad(joint, 0, np.inf)[0]
        found = StudentT(degrees).weight(np.array([squared]), np.array([float(dimension)]))[0]
        # Adaptive quadrature to 1e-8.
        assert found == pytest.approx(mean, rel=1e-6)


def test_few_degrees_hold_outliers_back_and_many_are_gaussian() -> None:
    p = _full(3)
    np.testing.assert_allclose(StudentT(1e9).loss(SQUARED, p), Gaussian().loss(SQUARED, p), 1e-5)
    np.testing.assert_allclose(relative_weight(StudentT(8.0), SQUARED, p), 8 / (8 + SQUARED))


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
    # Adaptive quadrature of an integrand that is singular at 0 for one component.
    assert gaussian_moments(model, components) == pytest.approx((power, slope), rel=1e-6)


def test_moments_of_the_residuals_own_distribution() -> None:
    """Residuals from Student's t itself: both moments are the Fisher information of its location,
    (nu + p) / (nu + p + 2) per component."""
    draws = multivariate_t(np.zeros(3), np.eye(3), df=8.0, seed=3).rvs(200_000)
    found = score_moments(StudentT(8.0), (draws**2).sum(1), np.full(200_000, 3.0))
    # 200 000 draws: 0.3 % of Monte Carlo error.
    assert found == pytest.approx((11 / 13, 11 / 13), rel=0.01)


def test_moments_are_per_component() -> None:
    """Points of one and three components together: sums of both over four components."""
    one, three = t.rvs(8, size=500, random_state=1) ** 2, chi2.rvs(3, size=500, random_state=2)
    apart = [
        np.array(score_moments(StudentT(), squared, np.full(500, count)))
        for squared, count in ((one, 1.0), (three, 3.0))
    ]
    both = score_moments(StudentT(), np.concatenate([one, three]), np.repeat([1.0, 3.0], 500))
    assert both == pytest.approx((apart[0] + 3 * apart[1]) / 4, rel=1e-12)
