"""A cube that is pushed on four sides, with the displacements that one cause or another gives."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.sparse.linalg import spsolve
from surfaces import box

from palpate.estimation import ProbeObservations
from palpate.field.explanations import Cause, _parts
from palpate.field.field_responses import at_points
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


def session(pushes=PUSHES, cells=6):
    mesh = box(size=(SIDE, SIDE, SIDE), cells=cells)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    probings = tuple(
        Probing(f"n{k}", Contact(np.array(point), 6e-3, "smooth"), np.array(force), None, None,
                None, None, None)
        for k, (point, force) in enumerate(pushes)
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
        stiff = model.body.points.reshape(-1, 3)[:, 0] < 0.5 * SIDE
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


def noisy(model, cause):
    """Observations of a body that a cause changes, with noise."""
    given, rng = session(), np.random.default_rng(4)
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    return [
        replace(probe, displacement=probe.displacement + 2e-6 * rng.normal(size=points.shape))
        for probe in observed(model, points, moved_by(model, cause))
    ]
