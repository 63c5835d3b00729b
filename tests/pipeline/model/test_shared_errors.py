"""Shared errors: their effects against differences of the prediction."""

from dataclasses import replace

import numpy as np
import pytest
from estimation.half_space import half_space_probes
from estimation.moved_contact import MovedContact, contact_error_of
from scipy.sparse import csr_array

from palpate.estimation import (
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
)
from palpate.pipeline.model.pose import PoseChanges, pose_error
from palpate.pipeline.model.shared_errors import (
    force_direction,
    force_gain,
    length_scale,
    tool_slip,
)

NU, SHEAR, NOISE = 0.3, 2e4, 2e-5


def _probes(seed: int = 1, **options: object) -> list[ProbeObservations]:
    return half_space_probes(
        np.random.default_rng(seed), **{"count": 4, "grid": 8, "noise": NOISE} | options
    )


def _load(probe: ProbeObservations) -> np.ndarray:
    return np.append(probe.force, 1.0) / SHEAR


def _terms(probe: ProbeObservations) -> ResponseTerms:
    response = probe.response.value(NU)
    return ResponseTerms(np.arange(len(response)), response[:, None], NU)


def _columns(nuisance: Nuisance, probe: ProbeObservations) -> np.ndarray:
    """Displacement under the load of the probing, per standard deviation of each parameter."""
    effects, load = nuisance.effects(_terms(probe)), _load(probe)
    return sum(
        np.einsum("rcp,c->rp", effects[:, term], factor * load)
        for term, factor in zip(range(effects.shape[1]), (1.0, SHEAR), strict=False)
    )


def _predicted(probe: ProbeObservations, force: np.ndarray) -> np.ndarray:
    return probe.response.value(NU)[:, :3] @ force / SHEAR


def test_a_gain_is_a_force_that_is_larger() -> None:
    probe = _probes()[0]
    expected = _predicted(probe, 1.01 * probe.force) - _predicted(probe, probe.force)
    # Linear, so exact but for rounding.
    np.testing.assert_allclose(_columns(force_gain(0.01), probe)[:, 0], expected, rtol=1e-9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_direction_is_a_force_that_is_turned(axis: int) -> None:
    probe, angle = _probes()[0], 1e-5
    turn = np.cross(np.eye(3)[axis], probe.force)
    expected = _predicted(probe, probe.force + angle * turn) - _predicted(probe, probe.force)
    column = _columns(force_direction(angle), probe)[:, axis]
    np.testing.assert_allclose(column, expected, atol=1e-9 * np.abs(expected).max())


def test_a_scale_stretches_one_component() -> None:
    probe = _probes()[0]
    columns = _columns(length_scale(0.002), probe).reshape(-1, 3, 3)
    moved = _predicted(probe, probe.force).reshape(-1, 3)
    for axis in range(3):
        expected = np.zeros_like(moved)
        expected[:, axis] = 0.002 * moved[:, axis]
        np.testing.assert_allclose(columns[:, :, axis], expected, rtol=1e-12)


def test_a_pose_takes_the_field_of_the_vertices() -> None:
    """Slopes along both sides that are the displacement itself: what is seen changes by as much as
    it is shifted along them together, and the tip does not."""
    probe = replace(_probes(tip=True)[0])
    count = len(probe.position)
    whole = csr_array(np.eye(count))
    shifts = np.tile([0.75, -0.5], (1, count, 1))
    change = PoseChanges(whole, (whole, whole), shifts, np.zeros((1, 3, 3)))
    pose = pose_error(
        1e-4, 0.0, change, probe.response.value, lambda _: np.zeros((1, 3 * count, 4))
    )
    columns = _columns(pose, probe)
    moved = _predicted(probe, probe.force)
    np.testing.assert_allclose(columns[:-3, 0], 0.25 * moved[:-3], rtol=1e-12)
    assert not columns[-3:].any()
    assert [parameter.name for parameter in pose.parameters] == [
        f"shift of the object along {axis}" for axis in "xyz"
    ]


def test_a_contact_elsewhere_is_told_to_third_order() -> None:
    """Half as far, an eighth of the error: slope and curvature are both right."""
    probe, steps = _probes(tip=True)[0], np.array([1.4, -0.8])
    rows = np.arange(3 * len(probe.position))
    missed = []
    for std in (2e-4, 1e-4):
        error = contact_error_of(probe, std)
        change = _columns(error, probe)[rows] @ steps
        bend = 0.5 * (error.curvature(_terms(probe))[rows] @ steps) @ steps / SHEAR
        moved = MovedContact(probe, std)
        wanted = (moved.at(steps, NU) - moved.at(np.zeros(2), NU))[rows] / SHEAR
        assert np.abs(bend).max() > 0.01 * np.abs(wanted).max()
        missed.append(np.linalg.norm(change + bend - wanted))
    # Terms of fourth order are a tenth of those of third at the point next to the contact.
    assert missed[0] / missed[1] == pytest.approx(8.0, rel=0.15)


def test_a_measured_tool_moves_with_its_contact() -> None:
    """It stands where the contact is: its square is not that of a point that stays."""
    probe = _probes(tip=True)[0]
    bend = contact_error_of(probe).curvature(_terms(probe))
    assert not bend[-3:].any()
    assert bend[:-3].any()


def test_what_the_gauge_did_not_measure_is_not_turned():
    (probe,) = _probes(count=1)
    turned = _columns(force_direction(0.01), probe)
    along = _columns(force_direction(0.01, measured=(False, False, True)), probe)
    response = probe.response.value(NU)
    force = 0.01 * np.cross(np.eye(3), probe.force / SHEAR)
    np.testing.assert_allclose(along, np.outer(response[:, 2], force[:, 2]), atol=1e-15)
    assert np.abs(turned - along).max() > 0.1 * np.abs(turned).max()


def test_a_tool_that_slips_moves_the_tip_alone() -> None:
    tangents = np.array([[0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    first, second = (NuisanceParameter(name, std, "m") for name, std in (("a", 2e-3), ("b", 5e-3)))
    slip = tool_slip((first, second), tangents, count=2)
    # Two points and the tip, of which z was not measured.
    rows = np.array([0, 1, 2, 4, 6, 7])
    effects = slip.effects(ResponseTerms(rows, np.ones((6, 1, 4)), NU))
    # Whatever the load and the modulus: entry 3 of the load times the modulus is 1.
    columns = effects[:, 1, 3]
    assert np.count_nonzero(effects) == 2
    expected = np.zeros((6, 2))
    expected[4:] = [[1.2e-3, 0.0], [1.6e-3, 0.0]]
    np.testing.assert_allclose(columns, expected, atol=1e-18)
