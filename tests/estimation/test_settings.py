"""Choices that make no sense are refused with what is allowed."""

import pytest

from palpate.errors import InputError
from palpate.estimation import FitMethod, FitSettings, IntervalMethod


@pytest.mark.parametrize("error", [-0.1, 1.0, float("nan")])
@pytest.mark.parametrize("name", ["model_error", "displacement_error"])
def test_a_relative_error_is_in_0_to_1(name, error):
    with pytest.raises(InputError, match=rf"{name} is {error}; must be in \[0, 1\)"):
        FitSettings(**{name: error})
    assert getattr(FitSettings(**{name: 0.999}), name) == 0.999
    assert getattr(FitSettings(**{name: 0.0}), name) == 0.0


@pytest.mark.parametrize(
    "ends", [(0.3, 0.3), (0.4, 0.1), (-1.0, 0.4), (0.0, 0.5), (float("nan"), 0.4)]
)
def test_a_range_that_cannot_be_is_refused(ends):
    with pytest.raises(InputError, match=r"both ends must be in \[-0.99, 0.4999\]"):
        FitSettings(poisson_range=ends)
    assert FitSettings(poisson_range=(-0.99, 0.4999)).poisson_range == (-0.99, 0.4999)


@pytest.mark.parametrize("name", ["method", "interval", "noise"])
def test_an_unknown_choice_is_refused_with_those_there_are(name):
    with pytest.raises(InputError, match=rf"{name} is 'guess'; must be one of '"):
        FitSettings(**{name: "guess"})


def test_members_are_as_good_as_their_names():
    chosen = FitSettings(method=FitMethod.NELDER_MEAD, interval=IntervalMethod.FISHER)
    assert chosen == FitSettings(method="nelder-mead", interval="fisher")
