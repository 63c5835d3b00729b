"""The model's own error widens both moduli and nothing else."""

import pytest

from palpate.errors import InputError
from palpate.estimation import FitSettings, IntervalSet
from palpate.estimation.intervals.model_error import with_displacement_error, with_model_error
from palpate.records import Constant

RATIO = Constant(0.3, 0.01, (0.28, 0.32))
MODULUS = Constant(1000.0, 3.0, (994.0, 1007.0))
EXACT = Constant(2600.0, 0.0, (2600.0, 2600.0))


def test_independent_errors_add_in_quadrature():
    found = with_model_error(IntervalSet("profile", RATIO, MODULUS, EXACT, False), 0.004)
    assert found.poisson_ratio == RATIO
    # 3 and 4 make 5; the sides of the interval 6 and 7 with 1.96 times 4.
    assert found.shear_modulus.std == pytest.approx(5.0)
    low, high = found.shear_modulus.ci95
    assert (1000 - low) ** 2 == pytest.approx(6**2 + (1.959964 * 4) ** 2)
    assert (high - 1000) ** 2 == pytest.approx(7**2 + (1.959964 * 4) ** 2)
    assert found.young_modulus.std == pytest.approx(0.004 * 2600)


def test_none_changes_nothing():
    intervals = IntervalSet("profile", RATIO, MODULUS, EXACT, False)
    assert with_model_error(intervals, 0.0) == intervals


def test_an_error_of_lengths_reaches_the_ratio_as_in_a_half_space():
    """u along / u across = (1 - 2 nu) / (2 (1 - nu)): its slope turns a share into one of nu."""
    share, step = 0.007, 1e-6

    def ratio(nu):
        return (1 - 2 * nu) / (2 * (1 - nu))

    slope = (ratio(0.3 + step) - ratio(0.3 - step)) / (2 * step) / ratio(0.3)
    exact = Constant(0.3, 0.0, (0.3, 0.3))
    found = with_displacement_error(IntervalSet("profile", exact, MODULUS, EXACT, False), share)
    assert found.poisson_ratio.std == pytest.approx(abs(share / slope), rel=1e-6)
    assert found.young_modulus.std == pytest.approx(share * 2600)
    assert found.poisson_ratio.ci95[1] - 0.3 == pytest.approx(1.959964 * abs(share / slope))


def test_a_ratio_never_passes_one_half():
    near = Constant(0.4999, 0.0001, (0.4997, 0.49999))
    found = with_displacement_error(IntervalSet("profile", near, MODULUS, EXACT, False), 0.5)
    assert found.poisson_ratio.ci95[1] <= 0.5


@pytest.mark.parametrize("error", [-0.1, 1.0, float("nan")])
def test_a_share_of_the_lengths_out_of_range_is_refused(error):
    with pytest.raises(InputError, match="displacement_error"):
        FitSettings(displacement_error=error)


@pytest.mark.parametrize("error", [-0.1, 1.0, float("nan")])
def test_a_share_out_of_range_is_refused(error):
    with pytest.raises(InputError, match="model_error"):
        FitSettings(model_error=error)
