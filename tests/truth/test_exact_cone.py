"""Exact displacements of a cone from another program's finite elements, no noise, nothing claimed:
the first test of any sceptic."""

from dataclasses import replace
from pathlib import Path

import pytest

from palpate.pipeline import fit_session
from palpate.records import Estimate, Session, Status, read_session

FOLDER = Path(__file__).parents[3] / "shared" / "data" / "exact_cone"
YOUNG, RATIO = 50e3, 0.0

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason="the shared data are not here")


@pytest.fixture(scope="module")
def cone() -> Session:
    return read_session(FOLDER)


@pytest.fixture(scope="module")
def estimate(cone: Session) -> Estimate:
    return fit_session(cone).estimate


def test_a_right_model_calls_itself_right(estimate: Estimate) -> None:
    assert estimate.status is Status.OK
    # The model's own error on 600 vertices; the finite elements' is below 0.1 %.
    assert estimate.young_modulus.value == pytest.approx(YOUNG, rel=0.003)
    assert estimate.poisson_ratio.value == pytest.approx(RATIO, abs=0.002)
    for constant, truth in ((estimate.young_modulus, YOUNG), (estimate.poisson_ratio, RATIO)):
        assert constant.ci95[0] <= truth <= constant.ci95[1]
    # What the sensor's gain leaves open, 1 %, and the forces' own.
    assert estimate.young_modulus.std == pytest.approx(0.0107 * YOUNG, rel=0.05)
    # That linear elements strain as far as they are told is no fault of theirs.
    assert len([note for note in estimate.notes if "small strain" not in note]) <= 1
    assert not any("left out" in note for note in estimate.notes)


def test_no_posterior_is_wider_than_its_prior(estimate: Estimate) -> None:
    every = [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]
    assert len(every) > 30
    assert max(error.std / error.prior_std for error in every) <= 1.0 + 1e-9
    # What displacements do not show stays as it was told: the gain is not moved.
    (gain,) = [error for error in every if error.name == "gain of the force sensor"]
    assert abs(gain.value) < 0.1 * gain.prior_std


@pytest.mark.slow
def test_with_an_exact_sensor_the_mesh_is_what_errs(cone: Session) -> None:
    errors = replace(cone.errors, force_gain=0.0, force=0.0, force_direction=0.0)
    fitted = fit_session(replace(cone, errors=errors)).estimate
    assert fitted.status is Status.OK
    assert fitted.young_modulus.value == pytest.approx(YOUNG, rel=0.003)
    assert fitted.young_modulus.std < 0.004 * YOUNG


def test_a_force_that_is_5_per_cent_off_is_left_out(cone: Session) -> None:
    wrong = replace(cone.probings[6], force=1.05 * cone.probings[6].force)
    probings = (*cone.probings[:6], wrong, cone.probings[7])
    fitted = fit_session(replace(cone, probings=probings)).estimate
    assert fitted.status is Status.OK
    assert [note for note in fitted.notes if "left out" in note and "'n07' by" in note]
    assert fitted.young_modulus.value == pytest.approx(YOUNG, rel=0.005)
