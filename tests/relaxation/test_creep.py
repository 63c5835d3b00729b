"""The response to a force, and the conversion to a modulus, against closed forms and quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad

from palpate.errors import InputError
from palpate.relaxation import CreepCompliance, memory

TWO = CreepCompliance(2.0, np.array([0.5, 1.5]), np.array([0.3, 7.0]))
TIME = np.array([0.0, 0.1, 0.25, 1.0, 1.7, 4.0, 30.0])
FORCE = np.array([0.0, 0.4, 1.1, 1.0, -0.3, 0.8, 0.8])
# Rounding of a few dozen operations on numbers of order one.
ROUNDING = 1e-13


def test_a_step_of_the_force_gives_the_compliance_itself():
    response = TWO.response(TIME, np.ones_like(TIME))
    np.testing.assert_allclose(response, TWO.at(TIME), rtol=ROUNDING)
    assert TWO.at(np.array([0.0])) == 2.0
    np.testing.assert_allclose(TWO.at(np.array([1e3])), 4.0, rtol=ROUNDING)


def test_a_ramp_gives_the_closed_form():
    # Of one term: J_0 t + J_1 (t - tau (1 - exp(-t / tau))), per unit rate.
    term = CreepCompliance(2.0, np.array([1.5]), np.array([7.0]))
    wanted = 2.0 * TIME + 1.5 * (TIME - 7.0 * (1.0 - np.exp(-TIME / 7.0)))
    # The closed form loses four digits in its difference at t = 0.1.
    np.testing.assert_allclose(term.response(TIME, TIME), wanted, rtol=1e-11)


def test_any_piecewise_linear_force_gives_the_integral():
    response = TWO.response(TIME, FORCE)
    for k, at in enumerate(TIME):
        wanted = 0.0
        for j in range(k):
            rate = (FORCE[j + 1] - FORCE[j]) / (TIME[j + 1] - TIME[j])
            part = quad(lambda s, at=at: TWO.at(np.array([at - s]))[0], *TIME[j : j + 2])[0]
            wanted += rate * part
        assert response[k] == pytest.approx(wanted, abs=1e-10)  # of the quadrature


def test_more_knots_on_the_same_force_change_nothing():
    finer = np.unique(np.concatenate([TIME, np.linspace(0.0, 30.0, 3001)]))
    response = TWO.response(finer, np.interp(finer, TIME, FORCE))
    known = np.searchsorted(finer, TIME)
    # Three thousand steps of the recursion.
    np.testing.assert_allclose(response[known], TWO.response(TIME, FORCE), rtol=1e-10, atol=1e-12)


def test_knots_closer_than_rounding_are_a_step():
    time, force = np.array([0.0, 1.0, 1.0 + 1e-15, 2.0]), np.array([0.0, 0.0, 1.0, 1.0])
    response = TWO.response(time, force)
    np.testing.assert_allclose(response[3], TWO.at(np.array([1.0]))[0], rtol=ROUNDING)


def test_the_derivative_is_that_of_finite_differences():
    step = 1e-5
    ends = [memory(TIME, FORCE, 0.7 * np.exp(sign * step))[0] for sign in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / (2.0 * step)
    # Rounding over the step, and its square.
    np.testing.assert_allclose(memory(TIME, FORCE, 0.7)[1], slope, atol=1e-9)


def test_one_term_relaxes_by_the_closed_form():
    relaxation = CreepCompliance(2.0, np.array([3.0]), np.array([5.0])).relaxation()
    # Zener's solid: rho = tau J_0 / (J_0 + J_1), G_inf = 1 / (J_0 + J_1).
    assert relaxation.times[0] == pytest.approx(2.0, rel=ROUNDING)
    assert relaxation.long_term == pytest.approx(0.2, rel=ROUNDING)
    assert relaxation.instantaneous == pytest.approx(0.5, rel=ROUNDING)


@pytest.mark.parametrize("s", [1e-3, 0.1, 1.0, 1e3])
def test_creep_and_relaxation_are_inverse_in_the_laplace_domain(s):
    modulus = TWO.relaxation()
    compliance = TWO.instantaneous + (TWO.terms / (1.0 + s * TWO.times)).sum()
    stiffness = modulus.long_term + (modulus.terms * s / (s + 1.0 / modulus.times)).sum()
    assert compliance * stiffness == pytest.approx(1.0, rel=ROUNDING)
    assert (modulus.terms > 0.0).all()


def test_a_motion_lags_by_the_angle_of_the_complex_compliance():
    frequency = np.array([1e-3, 0.02, 0.7, 30.0])
    turned = 2j * np.pi * frequency[:, None] * TWO.times
    compliance = TWO.instantaneous + (1.0 / (1.0 + turned)) @ TWO.terms
    wanted = -np.angle(compliance)
    angles = TWO.relaxation().loss_angle(frequency)
    np.testing.assert_allclose(angles, wanted, rtol=1e-9, atol=1e-15)
    # And as it is seen: many periods of a force that oscillates, after which no start is left.
    time = np.linspace(0.0, 200.0, 200001)
    turn = 2.0 * np.pi * 0.7 * time
    moved = TWO.response(time, np.sin(turn))[100000:]
    both = np.column_stack([np.sin(turn), np.cos(turn)])[100000:]
    along, behind = np.linalg.lstsq(both, moved, rcond=None)[0]
    # Straight pieces of a thousandth of a second, and what is left of the start.
    assert np.arctan2(-behind, along) == pytest.approx(angles[2], rel=1e-4)


def test_a_held_displacement_needs_the_force_that_relaxes():
    # The force G(t) of a unit step of displacement, as straight pieces, moves the body by 1.
    time = np.concatenate([[0.0], np.geomspace(1e-4, 50.0, 4000)])
    moved = TWO.response(time, TWO.relaxation().at(time))
    # Straight pieces of 0.3 % of the time each: their error goes with the square, about 1e-6.
    np.testing.assert_allclose(moved, 1.0, atol=3e-6)


def test_an_elastic_body_has_one_modulus():
    elastic = CreepCompliance(4.0, np.zeros(0), np.zeros(0))
    np.testing.assert_array_equal(elastic.relaxation().at(TIME), 0.25)
    np.testing.assert_array_equal(elastic.response(TIME, FORCE), 4.0 * FORCE)


@pytest.mark.parametrize(
    ("first", "terms", "times"), [(0.0, [1.0], [1.0]), (1.0, [-1.0], [1.0]), (1.0, [1.0], [0.0])]
)
def test_impossible_compliances_are_refused(first, terms, times):
    with pytest.raises(InputError, match="J_0 and times are positive, no term is negative"):
        CreepCompliance(first, np.array(terms), np.array(times))
