"""Elements of unlike moduli against another assembly, laws, bounds and finite differences."""

import numpy as np
import pytest
from surfaces import box

from palpate.solids.finite_elements import held_nodes, make_body, solve_load
from palpate.solids.graded_body import make_graded_body, with_moduli
from palpate.solids.tetrahedra import make_solid

RATIO = 0.3
# Sensitivities are sums of some thousand terms in single precision, each rounded to 6e-8: its
# errors add up as their root, 40 times that.
SINGLE = 40 * 6e-8


@pytest.fixture(scope="module")
def body():
    """A block of some hundred elements, held at its base."""
    mesh = box(np.array([0.04, 0.03, 0.02]), cells=3)
    solid = make_solid(mesh, edge=0.012)
    base = (mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1)
    return make_graded_body(solid, held_nodes(solid, np.flatnonzero(base)))


@pytest.fixture(scope="module")
def forces(body):
    """Three loads on all nodes."""
    return np.random.default_rng(1).normal(size=(3 * len(body.solid.nodes), 3))


def compliance(body, log_modulus, forces):
    return forces.T @ with_moduli(body, log_modulus, RATIO).displacements(forces)


def test_one_modulus_is_the_homogeneous_body(body, forces):
    other = make_body(body.solid, body.held, shear_modulus=np.exp(0.7), poisson_ratio=RATIO)
    moved = with_moduli(body, np.full(body.weight.size, 0.7), RATIO).displacements(forces)
    for load, displacement in zip(forces.T, moved.T, strict=True):
        expected = solve_load(other, load.reshape(-1, 3)).ravel()
        assert np.abs(displacement - expected).max() < 1e-10 * np.abs(expected).max()


def test_volumes_fill_the_block(body):
    assert body.volume.sum() == pytest.approx(0.04 * 0.03 * 0.02, rel=1e-12)


def test_means_of_linear_functions_are_those_of_the_corners(body):
    means = body.means(body.points.reshape(-1, 3))
    assert np.allclose(means, body.solid.nodes[body.solid.elements[:, :4]].mean(axis=1))


def test_derivatives_are_those_of_the_displacements(body, forces):
    rng = np.random.default_rng(2)
    field, basis = rng.normal(size=body.weight.size), rng.normal(size=(body.weight.size, 4))
    at = with_moduli(body, field, RATIO)
    seen = rng.normal(size=(len(forces), 5))
    derivative = at.sensitivities(at.displacements(seen), at.displacements(forces), basis)
    step = 1e-5
    for k in range(4):
        more, less = (
            with_moduli(body, field + side * step * basis[:, k], RATIO).displacements(forces)
            for side in (1, -1)
        )
        expected = (seen.T @ (more - less) / (2 * step)).T
        assert np.abs(derivative[:, :, k] - expected).max() < SINGLE * np.abs(expected).max()


def test_both_ways_to_the_derivatives_agree(body, forces):
    rng = np.random.default_rng(5)
    field, basis = rng.normal(size=body.weight.size), rng.normal(size=(body.weight.size, 2))
    at = with_moduli(body, field, RATIO)
    moved, seen = at.displacements(forces), np.eye(len(forces))[:, 60:90]
    expected = at.sensitivities(at.displacements(seen), moved, basis)
    change = at.changes(moved, basis)[:, 60:90]
    assert np.abs(change - expected).max() < SINGLE * np.abs(expected).max()


def test_scaling_the_modulus_divides_the_displacement(body, forces):
    # Euler: the derivative along a constant field is minus the displacement.
    field = np.random.default_rng(3).normal(size=body.weight.size)
    at = with_moduli(body, field, RATIO)
    moved, seen = at.displacements(forces), np.eye(len(forces))[:, 60:90]
    derivative = at.sensitivities(at.displacements(seen), moved, np.ones((len(field), 1)))
    error = derivative[:, :, 0].T + moved[60:90]
    assert np.abs(error).max() < SINGLE * np.abs(moved[60:90]).max()


def test_stiffer_everywhere_yields_less_under_every_load(body, forces):
    # Loewner order of the compliances (Eberle and Harrach, arXiv 2208.06865).
    field = np.random.default_rng(4).normal(size=body.weight.size)
    low, middle, high = (
        compliance(body, m, forces)
        for m in (np.full_like(field, field.max()), field, np.full_like(field, field.min()))
    )
    assert np.linalg.eigvalsh(middle - low).min() > 0.0
    assert np.linalg.eigvalsh(high - middle).min() > 0.0
    assert np.abs(middle - middle.T).max() < 1e-10 * np.abs(middle).max()


def test_energies_are_minus_the_derivatives_of_the_work(body, forces):
    field = np.random.default_rng(4).normal(size=body.weight.size)
    at = with_moduli(body, field, RATIO)
    energies = at.energies(at.displacements(forces))
    # All together the work itself: Clapeyron.
    work = np.diag(compliance(body, field, forces))
    np.testing.assert_allclose(energies.sum(axis=0), work, rtol=1e-9)
    step = np.zeros(len(field))
    step[7] = 1e-5
    more, less = (np.diag(compliance(body, field + side * step, forces)) for side in (1, -1))
    np.testing.assert_allclose(energies[7], -(more - less) / 2e-5, rtol=1e-4)
