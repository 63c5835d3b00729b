"""Predictions of a fit: at its own constants, at others, and from all other probings."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.fitted import RANGE, minimum_of, problem_of
from estimation.half_space import half_space_probes

from palpate.estimation import (
    Evaluation,
    IntervalSet,
    ProbeFit,
    at_constants,
    fisher_information,
    predictions_of,
)
from palpate.estimation.predictions import probe_estimate, probe_fits, size_of_errors
from palpate.pipeline.model.shared_errors import force_gain
from palpate.records import Constant

KNOWN = {"shear_modulus": True, "poisson_ratio": True, "young_modulus": True}


@pytest.fixture(scope="module")
def probes():
    rng = np.random.default_rng(5)
    exact = half_space_probes(rng, count=3, grid=6, noise=5e-5, force_noise=0.01)
    # An error that all probings share: its prior is part of the objective.
    return [replace(observed, nuisances=(force_gain(0.01),)) for observed in exact]


@pytest.fixture(scope="module")
def minimum(probes):
    return minimum_of(problem_of(probes))


def test_at_the_best_constants_it_is_the_fit(minimum):
    evaluated = at_constants(minimum, minimum.poisson_ratio, minimum.shear_modulus)
    # The search ends where the objective falls no more by what counts: 6 is the edge of a region.
    assert abs(evaluated.value - minimum.value) < 1e-3
    for index, fit in enumerate(probe_fits(minimum, RANGE)):
        predicted = evaluated.problem.predicted_points(index, evaluated.theta)
        np.testing.assert_allclose(predicted, fit.predicted, atol=1e-7)


def test_elsewhere_errors_are_those_that_fit_best(minimum):
    nu, modulus = minimum.poisson_ratio, minimum.shear_modulus
    rng = np.random.default_rng(3)
    for other in ((nu + 0.05, modulus), (nu, 1.1 * modulus), (nu - 0.1, 0.8 * modulus)):
        held = at_constants(minimum, *other)
        assert (held.poisson_ratio, held.shear_modulus) == pytest.approx(other)
        assert held.value > minimum.value + 1.0
        for _ in range(5):
            step = 0.1 * rng.normal(size=len(held.theta))
            step[:2] = 0.0
            assert Evaluation(held.problem, held.theta + step).value > held.value


def test_forces_that_are_exact_leave_displacements_inverse_to_the_modulus():
    rng = np.random.default_rng(6)
    probes = half_space_probes(rng, count=2, grid=5, noise=5e-5, force_noise=0.0)
    minimum = minimum_of(problem_of(probes))
    soft, stiff = (at_constants(minimum, 0.3, modulus) for modulus in (1e4, 2e4))
    for index in range(2):
        first, other = (at.problem.predicted_points(index, at.theta) for at in (soft, stiff))
        np.testing.assert_allclose(first, 2.0 * other, rtol=1e-12)


def test_predictions_are_those_of_the_constants(probes) -> None:
    plain = [replace(probe, nuisances=()) for probe in probes]
    field = plain[0].displacement.copy()
    field[4] = np.nan
    field[5, 0] = np.nan
    field[6] += 2e-3
    plain[0] = replace(plain[0], displacement=field)
    minimum = minimum_of(problem_of(plain, "student-t"))
    layout = minimum.problem.layout
    for probe, block, fit in zip(plain, layout.blocks, probe_fits(minimum, RANGE), strict=True):
        force = probe.force + probe.force_std * minimum.theta[block.force]
        value = probe.response.value(minimum.poisson_ratio)
        expected = (value[:, :3] @ force / minimum.shear_modulus).reshape(-1, 3)
        # The same products in another order.
        np.testing.assert_allclose(fit.predicted, expected, rtol=1e-12)
        np.testing.assert_array_equal(fit.residual, probe.displacement - fit.predicted)
        left = (fit.residual / 5e-5) ** 2
        weight = 8 / (8 + np.nansum(left, axis=1))
        # The model is expanded about a ratio up to 1e-3 away: 1e-6 of what moves.
        np.testing.assert_allclose(
            fit.weight, np.where(np.isfinite(left), weight[:, None], 0.0), rtol=1e-2, atol=1e-3
        )
        np.testing.assert_allclose(fit.sigma[np.isfinite(probe.displacement)], 5e-5)
    assert probe_fits(minimum, RANGE)[0].weight[6].max() < 0.02


@pytest.mark.parametrize("noise", [1e-6, 2e-5])
def test_left_out_is_a_fit_of_the_others(noise: float) -> None:
    rng = np.random.default_rng(2)
    probes = half_space_probes(rng, count=3, grid=8, noise=noise, force_noise=0.01)
    joint = minimum_of(problem_of(probes))
    fits = probe_fits(joint, RANGE)
    for k, probe in enumerate(probes):
        others = minimum_of(problem_of(probes[:k] + probes[k + 1 :]))

        def predicted(minimum, seen=probe):
            value = seen.response.value(minimum.poisson_ratio)[:, :3]
            return (value @ seen.force / minimum.shear_modulus).reshape(-1, 3)

        move = np.linalg.norm(predicted(others) - predicted(joint))
        missed = np.linalg.norm(fits[k].left_out_predicted - predicted(others))
        # One step of a problem that is nearly linear.
        assert missed < 0.05 * move


def test_left_out_ends_at_the_bounds_of_a_ratio_that_is_hardly_determined() -> None:
    # Normal displacements tell (1 - nu) / G alone, one other component a little of nu: without the
    # last push it would leave its range, and the modulus must follow it no farther.
    probes = []
    for probe in half_space_probes(
        np.random.default_rng(2), count=3, grid=8, noise=3e-4, force_noise=0.01
    ):
        seen = np.full_like(probe.displacement, np.nan)
        seen[:, 2] = seen[0, 0] = 1.0
        scale = 1.0 + 0.05 * len(probes)
        probes.append(replace(probe, displacement=scale * seen * probe.displacement))
    joint = minimum_of(problem_of(probes))
    for k, fit in enumerate(probe_fits(joint, RANGE)):
        others = minimum_of(problem_of(probes[:k] + probes[k + 1 :]))
        value = probes[k].response.value(others.poisson_ratio)[:, :3]
        refit = (value @ probes[k].force / others.shear_modulus).reshape(-1, 3)[:, 2]
        missed = np.linalg.norm(fit.left_out_predicted[:, 2] - refit)
        # One step across a third of the range of nu.
        assert missed < 0.03 * np.linalg.norm(refit)
    assert others.poisson_ratio == pytest.approx(RANGE[1])


def test_left_out_is_as_uncertain_as_what_a_fit_of_the_others_predicts():
    rng, noise = np.random.default_rng(4), 5e-5
    probes = half_space_probes(rng, count=3, grid=4, noise=noise, force_noise=0.0)
    for k, fit in enumerate(probe_fits(minimum_of(problem_of(probes)), RANGE)):
        others = minimum_of(problem_of(probes[:k] + probes[k + 1 :]))
        (prediction,) = predictions_of(others, probes[k : k + 1])
        spread = np.sqrt((fit.left_out_sigma**2 - noise**2).mean())
        # At constants that are a standard deviation apart, of a tenth at most.
        assert spread == pytest.approx(np.sqrt((prediction.std**2).mean()), rel=0.1)
        assert spread > 0.1 * noise


def test_points_are_counted_and_residuals_averaged() -> None:
    modulus, ratio = Constant(1.0, 0.1, (0.8, 1.2)), Constant(0.3, 0.1, (0.1, 0.5))
    residual = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, 5.0], [9.0, 9.0, 9.0], [np.nan] * 3,
                         [np.nan, 1.0, np.nan]])  # fmt: skip
    weight = np.array([0.25, 0.9, 0.249, 0.0, 0.5])[:, None] * np.isfinite(residual)
    fit = ProbeFit("n", np.zeros((5, 3)), residual, weight, np.full((5, 3), 2.0))
    estimate = probe_estimate(IntervalSet(ratio, modulus, modulus), KNOWN, fit)
    assert (estimate.observed, estimate.missing, estimate.rejected) == (4, 1, 1)
    # Lengths 5, 5 and 1 of the three that are kept.
    assert estimate.rms_residual == pytest.approx(np.sqrt(51 / 3), rel=1e-12)
    squares = 1 + 4 + 4 + 4 + 4 + 9 + 1
    assert estimate.prediction_error == pytest.approx(np.sqrt(squares / 3), rel=1e-12)
    assert (estimate.prediction_score, estimate.prediction_within) == (None, None)
    alone = probe_estimate(
        IntervalSet(ratio, modulus, modulus), KNOWN, replace(fit, left_out_predicted=None)
    )
    assert alone.prediction_error is None
    sigma = np.full((5, 3), 2.0)
    sigma[1, 2], sigma[4, 1] = 1.0, 0.5
    known = probe_estimate(
        IntervalSet(ratio, modulus, modulus), KNOWN, replace(fit, left_out_sigma=sigma)
    )
    # Of seven errors, 3 over 1 and 1 over 0.5 are beyond 1.96 of theirs.
    assert known.prediction_score == pytest.approx(np.sqrt(17.25 / 7), rel=1e-12)
    assert known.prediction_within == pytest.approx(5 / 7)


def test_the_size_of_errors_is_that_with_which_they_were_drawn():
    rng = np.random.default_rng(8)
    count, draws = 30, 300
    for size in (0.2, 1.0, 3.0):
        for noise in (0.1, 0.5):
            logs = []
            for _ in range(draws):
                measured = size * rng.normal(size=count) + noise * rng.normal(size=count)
                determined = 1.0 / (1.0 + noise**2)
                std = np.full(count, np.sqrt(1.0 - determined))
                logs.append(np.log(size_of_errors(determined * measured, std) / size))
            # A standard deviation from 30 of them has a relative error of 1 / sqrt(60), more by
            # what the noise hides of the smaller ones.
            expected = (1.0 + (noise / size) ** 2) / np.sqrt(2.0 * count)
            assert abs(np.median(logs)) < expected
            # Six tenths: what noise hides is not known better than before.
            assert np.std(logs) < max(1.6 * expected, 0.2)


def test_where_the_data_tell_nothing_errors_are_as_large_as_their_prior_says():
    nothing = size_of_errors(np.zeros(5), np.ones(5))
    # The nearest size of those that are looked at.
    assert nothing == pytest.approx(1.0, rel=0.02)
    assert size_of_errors(np.zeros(0), np.zeros(0)) == nothing


def test_planned_pushes_predict_as_well_as_a_fit_of_them_does():
    rng = np.random.default_rng(9)
    probes = half_space_probes(rng, count=4, grid=8, noise=5e-5)
    probes = [replace(probe, nuisances=(force_gain(0.01),)) for probe in probes]
    fitted = minimum_of(problem_of(probes[:3]))
    (prediction,) = predictions_of(fitted, probes[3:])
    information = fisher_information(probes, poisson_ratio=0.3, shear_modulus=2e4)
    expected = np.sqrt((prediction.std**2).sum() / (prediction.predicted**2).sum())
    # At the true constants in place of the fitted ones, which are off by a percent.
    assert information.prediction([0, 1, 2], [3]) == pytest.approx(expected, rel=0.05)
    assert information.prediction([0], [3]) > 1.2 * expected
