"""Probings left out, and what is counted of each."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import minimum_of, misfit_of, uncertainty_at
from estimation.half_space import half_space_probes

from palpate.estimation import IntervalSet, ProbeFit, ProbeObservations
from palpate.estimation.intervals.validation import (
    left_out_constants,
    probe_estimate,
    probe_fits,
)
from palpate.records import Constant

TOLD = {"shear_modulus": True, "poisson_ratio": True, "young_modulus": True}


def _probes(noise: float, **options: object) -> list[ProbeObservations]:
    rng = np.random.default_rng(2)
    return half_space_probes(rng, count=3, grid=6, noise=noise, force_noise=0.01, **options)


@pytest.mark.parametrize(
    ("noise", "tolerance"),
    # A step of 0.003 is taken at once and errs by its square; larger moves are searched on the
    # grid, whose parabola errs by 1e-3 of 0.5.
    [(1e-6, 1e-5), (2e-4, 1e-3)],
)
def test_left_out_is_a_fit_of_the_others(noise: float, tolerance: float) -> None:
    probes = _probes(noise)
    found = left_out_constants(uncertainty_at(probes))
    for k in range(3):
        others = minimum_of(misfit_of(probes[:k] + probes[k + 1 :]))
        assert found[k, 0] == pytest.approx(others.poisson_ratio, abs=tolerance)
        assert found[k, 1] == pytest.approx(others.shear_modulus, rel=3 * tolerance)


def test_at_a_bound_the_others_are_searched() -> None:
    """One step would leave the range."""
    probes = _probes(1e-5, poisson_ratio=0.0)
    found = left_out_constants(uncertainty_at(probes))
    assert found[:, 0].min() >= 0.0
    for k in range(3):
        others = minimum_of(misfit_of(probes[:k] + probes[k + 1 :]))
        assert found[k, 0] == pytest.approx(others.poisson_ratio, abs=1e-3)


def test_predictions_are_those_of_the_constants() -> None:
    probes = _probes(5e-5)
    field = probes[0].displacement.copy()
    field[4] = np.nan
    field[5, 0] = np.nan
    field[6] += 2e-3
    probes[0] = replace(probes[0], displacement=field)
    uncertainty = uncertainty_at(probes, "student-t")
    fits = probe_fits(misfit_of(probes, "student-t"), uncertainty)
    minimum = uncertainty.minimum
    for probe, one, fit in zip(probes, minimum.probes, fits, strict=True):
        force = probe.force + probe.force_std * one.shift
        value = probe.response.value(minimum.poisson_ratio)
        expected = (value[:, :3] @ force / minimum.shear_modulus).reshape(-1, 3)
        # The same products in another order.
        np.testing.assert_allclose(fit.predicted, expected, rtol=1e-12)
        np.testing.assert_array_equal(fit.residual, probe.displacement - fit.predicted)
        left = (fit.residual / 5e-5) ** 2
        weight = 8 / (8 + np.nansum(left, axis=1))
        np.testing.assert_allclose(
            fit.weight, np.where(np.isfinite(left), weight[:, None], 0.0), rtol=1e-6
        )
    constants = left_out_constants(uncertainty)
    value = probes[1].response.value(constants[1, 0])
    expected = (value[:, :3] @ probes[1].force / constants[1, 1]).reshape(-1, 3)
    np.testing.assert_allclose(fits[1].left_out_predicted, expected, rtol=1e-12)
    assert fits[0].weight[6].max() < 0.02


def test_points_are_counted_and_residuals_averaged() -> None:
    modulus, ratio = Constant(1.0, 0.1, (0.8, 1.2)), Constant(0.3, 0.1, (0.1, 0.5))
    residual = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 5.0], [9.0, 9.0, 9.0], [np.nan] * 3,
                         [np.nan, 1.0, np.nan]])  # fmt: skip
    weight = np.array([0.25, 0.9, 0.249, 0.0, 0.5])[:, None] * np.isfinite(residual)
    fit = ProbeFit("n", np.zeros((5, 3)), residual, weight, np.full((5, 3), 2.0))
    found = probe_estimate(IntervalSet(ratio, modulus, modulus), TOLD, fit)
    assert (found.observed, found.missing, found.rejected) == (4, 1, 1)
    # Lengths 5, 5 and 1 of the three that are kept.
    assert found.rms_residual == pytest.approx(np.sqrt(51 / 3), rel=1e-12)
    squares = 1 + 4 + 4 + 4 + 4 + 9 + 1
    assert found.prediction_error == pytest.approx(np.sqrt(squares / 3), rel=1e-12)
    alone = probe_estimate(
        IntervalSet(ratio, modulus, modulus), TOLD, replace(fit, left_out_predicted=None)
    )
    assert alone.prediction_error is None


def test_nothing_kept_has_no_residual() -> None:
    modulus, ratio = Constant(1.0, 0.1, (0.8, 1.2)), Constant(0.3, 0.1, (0.1, 0.5))
    fit = ProbeFit("n", np.zeros((1, 3)), np.ones((1, 3)), np.zeros((1, 3)), None)
    found = probe_estimate(IntervalSet(ratio, modulus, modulus), TOLD, fit)
    assert (found.rms_residual, found.rejected) == (0.0, 1)
