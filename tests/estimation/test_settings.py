"""Choices that make no sense are refused with what is allowed."""

import pytest

from palpate.errors import InputError
from palpate.estimation import FitMethod, FitSettings


@pytest.mark.parametrize(
    "ends", [(0.3, 0.3), (0.4, 0.1), (-1.0, 0.4), (0.0, 0.5), (float("nan"), 0.4)]
)
def test_a_range_that_cannot_be_is_refused(ends):
    with pytest.raises(InputError, match=r"both ends must be in \[-0.99, 0.4999\]"):
        FitSettings(poisson_range=ends)
    assert FitSettings(poisson_range=(-0.99, 0.4999)).poisson_range == (-0.99, 0.4999)


@pytest.mark.parametrize("name", ["method", "noise"])
def test_an_unknown_choice_is_refused_with_those_there_are(name):
    with pytest.raises(InputError, match=rf"{name} is 'guess'; must be one of '"):
        FitSettings(**{name: "guess"})


def test_members_are_as_good_as_their_names():
    assert FitSettings(method=FitMethod.NELDER_MEAD) == FitSettings(method="nelder-mead")
