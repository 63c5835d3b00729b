"""What a fit says of a body that one modulus does not explain."""

import pytest
from field.caused import NU, noisy, session

from palpate.estimation import FitSettings, fit
from palpate.field import Cause
from palpate.field.field_responses import make_field_model
from palpate.pipeline.heterogeneous import Material, fit_other_causes
from palpate.progress import silent
from palpate.records import Reciprocity, Status


@pytest.fixture(scope="module")
def model():
    return make_field_model(session(), elements=300)


def fitted(model, cause, **options):
    seen = noisy(model, cause)
    plain = fit(seen)
    args = (Material.AUTO, session(), seen, plain, FitSettings(), silent)
    return plain, *fit_other_causes(*args, **options)


def test_a_stiffness_that_depends_on_direction_is_named_and_has_no_interval(model):
    _, result, cause = fitted(model, Cause.DIRECTION)
    assert cause.cause is Cause.DIRECTION
    assert result.estimate.status is Status.MODEL_CONTRADICTED
    assert "depends on direction" in result.estimate.notes[0]
    low, high = result.estimate.young_modulus.ci95
    assert low != low
    assert high != high


def test_a_body_of_one_modulus_stays_as_it_is(model):
    plain, result, cause = fitted(model, None)
    assert cause is None
    assert result is plain
    assert result.estimate.poisson_ratio.value == pytest.approx(NU, abs=5e-3)


def test_no_material_explains_pushes_that_contradict_each_other(model):
    broken = Reciprocity((), (), 300.0, 10, 0.0, None, (), grows=False, holds=False)
    plain, result, cause = fitted(model, Cause.DIRECTION, tested=broken)
    assert cause is None
    assert result.estimate.young_modulus == plain.estimate.young_modulus
    assert "--material field" in result.estimate.notes[-1]
