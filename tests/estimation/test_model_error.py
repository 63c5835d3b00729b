"""The model's own error widens both moduli and nothing else."""

import pytest

from palpate.errors import InputError
from palpate.estimation import FitSettings, IntervalSet
from palpate.estimation.model_error import with_model_error
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


@pytest.mark.parametrize("error", [-0.1, 1.0, float("nan")])
def test_a_share_out_of_range_is_refused(error):
    with pytest.raises(InputError, match="model_error"):
        FitSettings(model_error=error)
