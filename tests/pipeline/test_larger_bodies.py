"""A fit and a push of a larger body are those of the dense model."""

import numpy as np
import pytest

from benchmarks.ball_session import POISSON_RATIO, SHEAR_MODULUS, write_ball_session
from palpate.bem import CompressedSystem
from palpate.bem.compressed import system as bem_system
from palpate.estimation import FitSettings
from palpate.pipeline import fit_session, make_object_model, poke_session
from palpate.records import read_session


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    return read_session(write_ball_session(tmp_path_factory.mktemp("ball"), 2, probings=2))


@pytest.fixture
def compressed(monkeypatch):
    """Everything is large."""
    monkeypatch.setattr(bem_system, "LARGEST_DENSE", 50)


# Narrow: fewer solutions serve it.
SETTINGS = FitSettings(poisson_range=(0.2, 0.4))


def constants(session):
    estimate = fit_session(session, settings=SETTINGS).estimate
    return [
        part
        for constant in (estimate.shear_modulus, estimate.poisson_ratio)
        for part in (constant.value, constant.std, *constant.ci95)
    ]


@pytest.mark.slow
def test_the_estimate_and_its_intervals_are_those_of_the_dense_model(session, request):
    wanted = constants(session)
    request.getfixturevalue("compressed")
    assert isinstance(make_object_model(session).system, CompressedSystem)
    # The 1e-5; the operator's error is 1e-7.
    assert np.allclose(constants(session), wanted, rtol=1e-5, atol=0.0)


@pytest.mark.slow
def test_a_push_is_that_of_the_dense_model(session, request):
    first = session.probings[0]
    material = {"shear_modulus": SHEAR_MODULUS, "poisson_ratio": POISSON_RATIO}
    wanted = poke_session(session, first.force, first.contact, **material)
    request.getfixturevalue("compressed")
    poked = poke_session(session, first.force, first.contact, **material)
    assert np.allclose(poked.displacement, wanted.displacement, rtol=1e-5)
    assert np.allclose(poked.reaction, wanted.reaction, rtol=1e-5)
