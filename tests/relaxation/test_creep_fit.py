"""Terms, times and intervals from motion under a known force."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.creep import (
    AT,
    ELASTIC,
    HOLD,
    ONE,
    RISE,
    TRUTHS,
    TWO,
    ball,
    by_quadrature,
    draws,
    pressed,
)
from palpate.errors import InputError
from palpate.relaxation import Motion, fit_creep

TIMES, FORCE = pressed()
LAST = len(TIMES) - 1


def motion(truth, *, noise=0.0, seed=0, every=1, scale=1.0):
    instant = np.arange(1, len(TIMES), every)
    moved = scale * truth.response(TIMES, FORCE)[instant]
    moved = moved + noise * np.random.default_rng(seed).standard_normal(len(moved))
    return Motion(TIMES, FORCE, instant, moved, np.full(len(moved), max(noise, 1e-3)), LAST)


def fitted(*motions):
    return fit_creep(motions, shortest=RISE, longest=HOLD / 3.0)


@pytest.mark.parametrize("name", TRUTHS)
def test_what_was_put_in_comes_out(name):
    truth = TRUTHS[name]
    fit = fitted(motion(truth))
    assert fit.terms == len(truth.times)
    # The tolerance of the search on the sum of squares, 1e-9, leaves its root.
    np.testing.assert_allclose(fit.compliance.times, truth.times, rtol=1e-3)
    unit = truth.response(TIMES, FORCE)[LAST]
    wanted = truth.relaxation().at(AT) * unit
    np.testing.assert_allclose(fit.compliance.relaxation().at(AT), wanted, rtol=1e-4)
    np.testing.assert_allclose(fit.predicted(0), truth.response(TIMES, FORCE), atol=1e-4)


def test_each_motion_has_a_scale_of_its_own():
    fit = fitted(motion(TWO), motion(TWO, scale=3.0, every=2))
    assert fit.terms == 2
    np.testing.assert_allclose(fit.compliance.times, TWO.times, rtol=1e-3)
    np.testing.assert_allclose(fit.predicted(1), 3.0 * fit.predicted(0), rtol=1e-4)


@pytest.mark.parametrize("correlation", [0.0, 0.6])
@pytest.mark.parametrize("name", TRUTHS)
def test_terms_and_intervals_hold_in_repeats(name, correlation):
    statistics = draws(TRUTHS[name], noise=0.01, count=40, correlation=correlation)
    # At most one of forty wrong, as stated in the theory.
    assert statistics["terms"][len(TRUTHS[name].times)] >= 39
    # Of 95 % of forty draws 31 or fewer hold once in ten thousand.
    assert np.mean(statistics["hold"], axis=0).min() > 31.5 / 40


def test_an_elastic_body_stays_elastic_where_noise_is_all_there_is():
    elastic = fitted(motion(ELASTIC, noise=0.3, seed=4))
    assert elastic.terms == 0
    # Nothing is known but the static modulus, which has its own interval.
    assert elastic.logarithm(lambda fit: fit.relaxation().at(AT))[1] == pytest.approx(0.0)


def test_the_level_of_the_noise_is_found():
    fit = fitted(motion(ONE, noise=0.02))
    claimed = fitted(replace(motion(ONE, noise=0.02), std=np.full(LAST, 0.1)))
    # Of 319 residuals, to 4 % each; three standard deviations.
    assert fit.noise == pytest.approx(1.0, abs=0.12)
    assert claimed.noise == pytest.approx(0.2 * fit.noise, rel=1e-3)
    np.testing.assert_allclose(claimed.covariance, fit.covariance, rtol=1e-2)


def test_few_instants_allow_few_terms():
    assert fitted(motion(TWO, every=35)).terms <= 2
    with pytest.raises(InputError, match="measured at 4 instants; at least 7 are needed"):
        fitted(motion(TWO, every=100))


@pytest.mark.parametrize("change", [{"time": TIMES[::-1]}, {"std": np.zeros(LAST)}])
def test_impossible_motions_are_refused(change):
    with pytest.raises(InputError, match="the times of a motion increase"):
        replace(motion(ONE), **change)


def test_a_ball_s_growing_contact_hardly_counts_beyond_three_radii():
    # 0.12 %, as the theory says; a contact radius away it is ten times as much.
    assert np.abs(ball(3.0)).max() < 0.0015
    assert np.abs(ball(1.0)).max() > 0.01
    # Quadrature and recursion agree to rounding, so the tip's depth is exact up to the search.
    assert np.abs(ball(0.0, tip=True)).max() < 1e-6
    np.testing.assert_allclose(
        by_quadrature(TWO, TIMES, FORCE), TWO.response(TIMES, FORCE), atol=1e-12
    )
