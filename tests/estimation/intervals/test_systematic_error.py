"""What all probings share widens the intervals as independent errors do, and nothing more."""

import numpy as np
import pytest
from scipy.stats import norm

from palpate.estimation import IntervalSet
from palpate.estimation.intervals.systematic_error import (
    poisson_ratio_error,
    with_systematic_errors,
)
from palpate.records import Constant

RATIO = Constant(0.3, 0.01, (0.28, 0.33))
MODULUS = Constant(1000.0, 3.0, (994.0, 1007.0))
EXACT = Constant(2600.0, 0.0, (2600.0, 2600.0))
QUANTILE = norm.ppf(0.975)
# Every closed form below holds to rounding: a few additions of 1e-16 each.
ROUNDING = 1e-9


def _widened(ratio=RATIO, shear=MODULUS, young=EXACT, *, model=0.0, lengths=0.0) -> IntervalSet:
    intervals = IntervalSet(ratio, shear, young)
    return with_systematic_errors(intervals, model_error=model, displacement_error=lengths)


def test_independent_errors_add_in_quadrature():
    found = _widened(model=0.004)
    assert found.poisson_ratio == RATIO
    # 3 and 4 make 5; the sides of the interval 6 and 7 with 1.96 times 4.
    assert found.shear_modulus.std == pytest.approx(5.0, rel=ROUNDING)
    low, high = found.shear_modulus.ci95
    assert 1000 - low == pytest.approx(np.hypot(6.0, QUANTILE * 4), rel=ROUNDING)
    assert high - 1000 == pytest.approx(np.hypot(7.0, QUANTILE * 4), rel=ROUNDING)
    assert found.young_modulus.std == pytest.approx(0.004 * 2600, rel=ROUNDING)
    assert found.shear_modulus.value == 1000.0


def test_both_ends_of_the_ratio_move_outwards():
    found = _widened(lengths=0.05).poisson_ratio
    extra = 0.05 * 0.7 * 0.4
    assert found.std == pytest.approx(np.hypot(0.01, extra), rel=ROUNDING)
    assert 0.3 - found.ci95[0] == pytest.approx(np.hypot(0.02, QUANTILE * extra), rel=ROUNDING)
    assert found.ci95[1] - 0.3 == pytest.approx(np.hypot(0.03, QUANTILE * extra), rel=ROUNDING)


def test_model_and_lengths_are_independent():
    found = _widened(model=0.003, lengths=0.004)
    assert found.young_modulus.std == pytest.approx(0.005 * 2600, rel=ROUNDING)
    assert found.shear_modulus.std == pytest.approx(np.hypot(3.0, 5.0), rel=ROUNDING)


def test_none_changes_nothing():
    assert _widened() == IntervalSet(RATIO, MODULUS, EXACT)


def test_what_is_not_known_stays_unknown():
    unknown = Constant(1000.0, np.inf, (0.0, np.inf))
    assert _widened(shear=unknown, model=0.1).shear_modulus == unknown


@pytest.mark.parametrize("poisson_ratio", [-0.5, 0.0, 0.3, 0.45])
def test_an_error_of_lengths_reaches_the_ratio_as_in_a_half_space(poisson_ratio):
    """u along / u across = (1 - 2 nu) / (2 (1 - nu)): its slope turns a share into one of nu."""
    share, step = 0.007, 1e-6

    def ratio(nu):
        return (1 - 2 * nu) / (2 * (1 - nu))

    slope = (ratio(poisson_ratio + step) - ratio(poisson_ratio - step)) / (2 * step)
    expected = abs(share / (slope / ratio(poisson_ratio)))
    # A central difference of step 1e-6: error 1e-12 / step of rounding.
    assert poisson_ratio_error(poisson_ratio, share) == pytest.approx(expected, rel=1e-6)


def test_intervals_stay_inside_what_is_possible():
    near = Constant(0.4, 0.0001, (0.3997, 0.4001))
    found = _widened(near, Constant(10.0, 5.0, (1.0, 25.0)), lengths=0.9)
    # 0.9 * 0.6 * 0.2 is more than the tenth that is left; nu is not known from below.
    assert found.poisson_ratio.ci95[1] == 0.5
    assert found.poisson_ratio.ci95[0] < 0.2
    assert found.shear_modulus.ci95[0] == 0.0
