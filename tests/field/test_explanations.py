"""Effects of each cause on a body against bodies that are solved with it, and which is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve
from surfaces import box

from palpate.estimation import FitSettings, ProbeObservations, joint_minimum
from palpate.field.explanations import (
    Cause,
    _by_direction,
    _by_support,
    _components,
    _parts,
    evidence_of_errors,
    explanations,
)
from palpate.field.field_responses import at_points, make_field_model
from palpate.records import Contact, Probing, Session
from palpate.solids.finite_elements import hooke_moduli, quadratic_basis, stiffness_matrix

SIDE, NU, MODULUS = 0.04, 0.3, 2e4
PUSHES = (
    ((0.025, 0.02, 0.04), (0.3, 0.1, -1.0)),
    ((0.01, 0.0, 0.025), (0.0, 2.0, 0.5)),
    ((0.04, 0.025, 0.03), (-1.5, 0.0, 0.3)),
    ((0.0, 0.015, 0.02), (1.0, 0.5, 0.0)),
)
# Mandel's order of pairs of axes, and what a shear counts.
PAIRS, COUNTS = ((0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (2, 0)), np.sqrt([1, 1, 1, 2, 2, 2])


def session():
    mesh = box(size=(SIDE, SIDE, SIDE), cells=6)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    probings = tuple(
        Probing(f"n{k}", Contact(np.array(point), 6e-3, "smooth"), np.array(force), None, None,
                None, None, None)
        for k, (point, force) in enumerate(PUSHES)
    )  # fmt: skip
    return Session("cube", Path(), mesh, held, probings, None, None, None, ())


class Solved:
    """The homogeneous body's response, quadratic between three Poisson's ratios."""

    def __init__(self, moved, force):
        self.moved, self.along = moved, np.array(force) / np.dot(force, force)

    def value(self, poisson_ratio):
        ratios = np.array([0.25, 0.3, 0.35])
        off = poisson_ratio - ratios
        share = [np.prod(np.delete(off, k)) / np.prod(np.delete(ratios[k] - ratios, k))
                 for k in range(3)]  # fmt: skip
        columns = np.zeros((self.moved.shape[1], 4))
        columns[:, :3] = (share @ self.moved)[:, None] * self.along
        return columns


def observed(model, points, moved):
    """Observations of displacements of all nodes [m], with the homogeneous response."""
    at, none = at_points(model.body.solid, points), np.zeros(model.modes.modes.shape[1])
    plain = np.stack([at @ model.moved(none, ratio) for ratio in (0.25, 0.3, 0.35)])
    zero = np.zeros(3)
    return [
        ProbeObservations(f"n{k}", points, (at @ moved[:, k]).reshape(-1, 3),
                          np.full(points.shape, 2e-6), np.array(force), zero, None, None,
                          Solved(plain[:, :, k], force))
        for k, (_, force) in enumerate(PUSHES)
    ]  # fmt: skip


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
    return stiffness, *(stiffness.displacements(each) for each in (model.unit_loads, model.load))


def by_tensor(model, tensor, *, moved_support=None):
    """Displacement of all nodes for a shear modulus of 1 Pa plus a tensor of Mandel's; with the
    support's nodes moved, where that is given."""
    moduli = hooke_moduli(1.0, NU)
    for a, (i, j) in enumerate(PAIRS):
        for b, (k, m) in enumerate(PAIRS):
            size = tensor[a, b] / (COUNTS[a] * COUNTS[b])
            for left in {(i, j), (j, i)}:
                for right in {(k, m), (m, k)}:
                    moduli[(*left, *right)] += size
    body = model.body
    matrix = stiffness_matrix(quadratic_basis(body.solid), moduli).tocsc()
    free = np.repeat(~body.held, 3)
    moved = np.zeros_like(model.load)
    if moved_support is not None:
        moved[~free] = moved_support
    right = model.load - matrix @ moved
    moved[free] = spsolve(matrix[free][:, free], right[free])
    return moved


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
    derivative, components = _by_direction(*solutions), _components()
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
    derivative = _by_support(model.body, *solutions)
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


def moved_by(model, cause):
    """Displacements of all nodes [m] of a body that a cause changes much."""
    if cause is Cause.DIRECTION:
        fibre = np.zeros((6, 6))
        fibre[2, 2] = 1.5
        return by_tensor(model, fibre) / MODULUS
    plain = by_tensor(model, np.zeros((6, 6)))
    if cause is None:
        return plain / MODULUS
    coefficients = np.zeros(model.modes.modes.shape[1])
    if cause is Cause.PLACE:
        stiff = model.body.corners[:, 0] < 0.5 * SIDE
        coefficients = np.linalg.lstsq(model.modes.modes, 1.2 * stiff - 0.6)[0]
        return model.moved(coefficients, NU) / MODULUS
    # A quarter of the support has come loose.
    part, _, areas = _parts(model.body)
    stiffness = model.stiffness(coefficients, NU)
    reaction = stiffness.reactions(plain).reshape(len(part), 3, -1)
    moved = np.zeros_like(reaction)
    for number in (0, 1):
        here = part == number
        moved[here] = -0.1 * SIDE / areas[number] * reaction[here].sum(axis=0)
    support = moved.reshape(-1, len(PUSHES))
    return by_tensor(model, np.zeros((6, 6)), moved_support=support) / MODULUS


@pytest.mark.parametrize("cause", [None, *Cause])
def test_the_cause_is_named(model, cause):
    given = session()
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    moved = moved_by(model, cause)
    rng = np.random.default_rng(4)
    seen = [
        ProbeObservations(one.name, one.position,
                          one.displacement + 2e-6 * rng.normal(size=one.position.shape), one.std,
                          one.force, one.force_std, None, None, one.response)
        for one in observed(model, points, moved)
    ]  # fmt: skip
    likeliest, second, _ = explanations(given, seen, joint_minimum(seen, FitSettings()))
    if cause is None:
        assert likeliest.log_evidence < 0.0
    else:
        assert likeliest.cause is cause
        assert likeliest.log_evidence > second.log_evidence + 10.0


def test_forces_that_are_wrong_are_evidence_of_errors(model):
    given = session()
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    right = [
        replace(one, force_std=0.01 * np.abs(one.force) + 1e-6)
        for one in observed(model, points, moved_by(model, None))
    ]
    wrong = [replace(one, force=(1.0 + 0.15 * k) * one.force) for k, one in enumerate(right)]
    assert evidence_of_errors(joint_minimum(right, FitSettings())) < 1.0
    assert evidence_of_errors(joint_minimum(wrong, FitSettings())) > 10.0
