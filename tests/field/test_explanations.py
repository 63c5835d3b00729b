"""Effects of each cause on a body against bodies that are solved with it, and which is named."""

from dataclasses import replace

import numpy as np
import pytest
from field.caused import MODULUS, NU, PUSHES, by_tensor, moved_by, noisy, observed, session

from palpate.estimation import FitSettings, joint_minimum
from palpate.field.explanations import (
    Cause,
    Explanation,
    _by_direction,
    _by_support,
    _components,
    _parts,
    evidence_of_errors,
    explanations,
)
from palpate.field.field_fit import information_about
from palpate.field.field_responses import make_field_model
from palpate.solids import with_moduli


@pytest.fixture(scope="module")
def model():
    given = session()
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    bare = make_field_model(given, elements=300)
    return bare.under(given, observed(bare, points, np.zeros_like(bare.load)))


@pytest.fixture(scope="module")
def solutions(model):
    """Stiffness, unit loads' and loads' displacements of the homogeneous body."""
    stiffness = model.stiffness(np.zeros(model.modes.modes.shape[1]), NU)
    loads = model.unit_loads(model.corners), model.load
    return stiffness, *map(stiffness.displacements, loads)


def corners_of(model, moved):
    return moved[(3 * model.corners[:, None] + np.arange(3)).ravel()].T


def test_components_are_orthonormal_and_none_is_isotropic():
    components = _components()
    assert np.einsum("ijc,ijd->cd", components, components) == pytest.approx(np.eye(19), abs=1e-12)
    assert np.abs(components - components.swapaxes(0, 1)).max() < 1e-15
    volume = np.zeros((6, 6))
    volume[:3, :3] = 1.0
    for isotropic in (volume, np.eye(6)):
        assert np.abs(np.einsum("ijc,ij->c", components, isotropic)).max() < 1e-12


def test_the_effect_of_direction_is_that_of_a_body_with_such_a_tensor(model, solutions):
    stiffness, seen, moved = solutions
    derivative, components = _by_direction(model, stiffness, seen)[1](moved), _components()
    weights = np.random.default_rng(1).normal(size=19)
    step = 1e-4 * components @ weights
    change = (by_tensor(model, step) - by_tensor(model, -step)) / 2e-4
    expected = corners_of(model, change)
    # Central differences of an effect that is of the third order beyond.
    assert np.abs(derivative @ weights - expected).max() < 1e-5 * np.abs(expected).max()


def test_reactions_balance_the_loads(model, solutions):
    stiffness, _, moved = solutions
    reaction = stiffness.reactions(moved).reshape(-1, 3, len(PUSHES)).sum(axis=0).T
    np.testing.assert_allclose(reaction, [-np.array(force) for _, force in PUSHES], atol=1e-12)


def test_the_effect_of_a_support_is_that_of_parts_that_move_under_their_reactions(model, solutions):
    stiffness, seen, moved = solutions
    derivative = _by_support(model, stiffness, seen)[1](moved)
    part, normals, areas = _parts(model.body)
    reaction = solutions[0].reactions(solutions[2]).reshape(len(part), 3, -1)
    size = float(model.body.volume.sum()) ** (1.0 / 3.0)
    for number in (0, len(areas) - 1):
        whole = reaction[part == number].sum(axis=0)
        pressed = np.outer(normals[number], normals[number]) @ whole
        for column, total in ((number, whole), (len(areas) + number, pressed)):
            moved = np.zeros_like(reaction)
            moved[part == number] = -size / areas[number] * total
            none = np.zeros((6, 6))
            support = moved.reshape(-1, len(PUSHES))
            change = by_tensor(model, none, moved_support=support) - by_tensor(model, none)
            np.testing.assert_allclose(
                derivative[:, :, column], corners_of(model, change),
                atol=1e-9 * np.abs(change).max(),
            )  # fmt: skip


def test_parts_of_a_support_that_have_come_loose_are_let_go(model):
    given, body = session(), model.body
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    part, *_ = _parts(body)
    # The parts farthest to one side.
    across = [body.solid.nodes[body.held][part == k, 0].mean() for k in range(part.max() + 1)]
    loose, held = np.isin(part, np.argsort(across)[:2]), body.held.copy()
    held[held] = ~loose
    stiffness = with_moduli(replace(body, held=held), np.zeros(body.weight.size), NU)
    seen = observed(model, points, stiffness.displacements(model.load) / MODULUS)
    here, minimum = model.under(given, seen), joint_minimum(seen, FitSettings())
    first = Explanation(Cause.SUPPORT, 0.0, 0.4, here, NU)
    loosened = first.with_parts_let_go(minimum, FitSettings())
    np.testing.assert_array_equal(loosened.loose, loose)

    def missed(explanation):
        at = joint_minimum(explanation.with_field(given, seen), FitSettings())
        return np.sqrt(np.mean(np.square(np.concatenate(at.residual))))

    # The same elements without the same nodes: nothing but the step between Poisson's ratios.
    assert missed(loosened) < 0.1 * missed(first)


@pytest.mark.parametrize("cause", [None, *Cause])
def test_the_cause_is_named(model, cause):
    seen = noisy(model, cause)
    likeliest, second, _ = explanations(session(), seen, joint_minimum(seen, FitSettings()))
    if cause is None:
        assert likeliest.log_evidence < 0.0
    else:
        assert likeliest.cause is cause
        assert likeliest.log_evidence > second.log_evidence + 10.0


def test_forces_that_are_wrong_are_evidence_of_errors(model):
    given = session()
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    right = [
        replace(probe, force_std=0.01 * np.abs(probe.force) + 1e-6)
        for probe in observed(model, points, moved_by(model, None))
    ]
    wrong = [replace(probe, force=(1.0 + 0.15 * k) * probe.force) for k, probe in enumerate(right)]
    assert evidence_of_errors(joint_minimum(right, FitSettings())) < 1.0
    assert evidence_of_errors(joint_minimum(wrong, FitSettings())) > 10.0


def test_what_the_data_say_of_a_field_is_the_same_wherever_they_are_asked(model):
    seen = noisy(model, Cause.PLACE)
    given = model.under(session(), seen)
    plain = joint_minimum(seen, FitSettings())
    none = np.zeros(model.modes.modes.shape[1])
    homogeneous = given.moved(none, plain.poisson_ratio)
    expansion = given.expanded(none, plain.poisson_ratio, homogeneous)
    start = 0.01 * np.random.default_rng(6).normal(size=len(none))
    information = [
        information_about(expansion, plain, coefficients) for coefficients in (none, start)
    ]
    # The objective is one of squares in the coefficients; the rest, at which derivatives are taken,
    # moves with them to first order of what they change.
    (first, here), (second, there) = information
    assert np.abs(second - first).max() < 0.05 * np.abs(first).max()
    posterior = [np.linalg.solve(h + np.eye(len(h)), v) for h, v in information]
    assert np.abs(posterior[1] - posterior[0]).max() < 0.05 * np.abs(posterior[0]).max()
    # Where the data say next to nothing, they say it in any case.
    values, vectors = np.linalg.eigh(first)
    least = vectors[:, values < 1e-4 * values.max()]
    assert least.size
    assert np.linalg.norm(least.T @ (there - here)) < 0.1 * np.linalg.norm(least.T @ start)
