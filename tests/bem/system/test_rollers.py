"""Supports that hold some directions only, against exact linear fields and their own algebra."""

import numpy as np
import pytest
from elastic_bodies import Material, cube_with_faces, element_traction, linear_field

from palpate.bem import (
    Quadrature,
    body_force_columns,
    boundary_system,
    dilation_factor,
    factorise,
    make_surface,
    solve,
    support_columns,
    system_slope,
    traction_column,
    unrestrained_motions,
)
from palpate.bem.system.matrix import system_matrix

FINE = Quadrature(tolerance=1e-9)
MESH, FACE = cube_with_faces(2)
NORMALS = np.repeat(np.eye(3), 2, axis=0) * np.array([-1, 1, -1, 1, -1, 1])[:, None]
GENERAL = np.array([[0.1, 0.4, -0.2], [-0.3, 0.2, 0.5], [0.6, 0.0, -0.1]])


def along(*directions):
    """Projector onto what some directions span."""
    basis, _ = np.linalg.qr(np.array(directions, dtype=float).T)
    return basis @ basis.T


X, Y, Z, ALL = along([1, 0, 0]), along([0, 1, 0]), along([0, 0, 1]), np.eye(3)
# Held faces (2 axis + 1 on the far side) with their projectors, and how many motions are left.
SUPPORTS = {
    "a bed": ({4: Z}, 3),
    "two platens": ({4: Z, 5: Z}, 3),
    "a corner of three": ({4: Z, 0: X, 2: Y}, 0),
    "one direction on two faces": ({4: Z, 0: Z}, 3),
    "glued beside a roller": ({4: ALL, 0: Z}, 0),
    "aslant beside two": ({4: along([1, 0, 0], [0, 1, 0]), 0: along([1, 1, 1])}, 0),
    "held all but down": ({4: along([1, 0, 0], [0, 1, 0])}, 3),
}


@pytest.fixture(scope="module", params=SUPPORTS)
def rolling(request):
    faces, left = SUPPORTS[request.param]
    held = np.flatnonzero(np.isin(FACE, list(faces)))
    surface = make_surface(MESH, held, directions=np.array([faces[f] for f in FACE[held]]))
    return boundary_system(surface, quadrature=FINE), left


def boundary_data(system, field, material):
    """Right-hand side of a known field: its tractions where nothing holds, its displacements where
    something does."""
    surface = system.surface
    given = np.eye(3) - surface.held_directions
    loaded = np.flatnonzero(given.any(axis=(1, 2)))
    traction = element_traction(surface, loaded, field) / material.shear
    traction = np.einsum("kij,kqj->kqi", given[loaded], traction)
    right = traction_column(system, loaded, traction, quadrature=FINE).at(material.poisson)
    moved = field.displacement(surface.mesh.vertices)
    return right + support_columns(system, moved[:, :, None]).at(material.poisson)


@pytest.mark.parametrize("kind", ["tension", "general"])
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
def test_linear_fields_between_rollers(rolling, kind, nu):
    system, left = rolling
    unknowns, material = system.unknowns, Material(2.5, nu)
    gradient = np.diag([-nu, -nu, 1.0]) if kind == "tension" else GENERAL
    field = linear_field(gradient, material)
    x = solve(factorise(system, nu), boundary_data(system, field, material))[:, 0]
    exact = field.displacement(MESH.vertices)
    found = np.zeros_like(exact)
    found[unknowns.held_vertices] = np.einsum(
        "hij,hj->hi", unknowns.vertex_directions, exact[unknowns.held_vertices]
    )
    count = 3 * unknowns.free_vertices.size
    found[unknowns.free_vertices] += x[:count].reshape(-1, 3)
    unrestrained = unrestrained_motions(system.surface).reshape(exact.size, left)
    away = (found - exact).ravel()
    away -= unrestrained @ np.linalg.lstsq(unrestrained, away, rcond=None)[0]
    # The elements hold a linear field exactly: what is left is round-off, times the condition of
    # the supports (2e-6 at worst) and the pressure that belongs to the field.
    assert np.abs(away).max() < 1e-11 * np.abs(exact).max()
    sigma = field.stress(np.zeros((1, 3)))[0]
    side_face = np.zeros(system.surface.traction.n_nodes, dtype=np.int64)
    side_face[system.surface.sides.corner.ravel()] = np.repeat(FACE, 3)
    traction = (NORMALS @ sigma)[side_face[unknowns.held_sides]]
    answered = np.einsum("sij,sj->si", unknowns.side_directions, traction)
    held = x[count:-3].reshape(-1, 3) * material.shear / system.traction_length
    assert np.abs(held - answered).max() < 1e-10 * np.abs(sigma).max()


def test_motions_that_are_left(rolling):
    system, left = rolling
    unrestrained = unrestrained_motions(system.surface)
    assert unrestrained.shape[2] == left
    held = system.unknowns.held_vertices
    # Nothing that is held moves with them, and each is rigid: no length changes.
    answered = np.einsum("hij,hjq->hiq", system.unknowns.vertex_directions, unrestrained[held])
    assert np.abs(answered).max(initial=0.0) < 1e-12
    offset = MESH.vertices[:, None] - MESH.vertices
    stretch = np.einsum("abi,abiq->abq", offset, unrestrained[:, None] - unrestrained)
    assert np.abs(stretch).max(initial=0.0) < 1e-12


def test_a_solution_does_not_slide(rolling):
    system, left = rolling
    load = traction_column(
        system, np.flatnonzero(FACE == 1), np.tile([0.0, 0.0, 1.0], (np.sum(FACE == 1), 6, 1))
    )
    x = solve(factorise(system, 0.3), load.at(0.3))[:, 0]
    free = system.unknowns.free_vertices
    moved = x[: 3 * free.size].reshape(-1, 3)
    slid = np.einsum("vi,viq->q", moved, unrestrained_motions(system.surface)[free])
    assert slid.shape == (left,)
    assert np.abs(slid).max(initial=0.0) < 1e-10 * np.abs(moved).sum()


def test_what_is_eliminated_leaves_a_solution_of_every_equation(rolling):
    """The equations that were left out, those of points inside the support, hold as well."""
    system, _ = rolling
    material = Material(2.5, 0.3)
    right = boundary_data(system, linear_field(GENERAL, material), material)
    x = solve(factorise(system, 0.3), right)
    left = system_matrix(system, 0.3) @ x - right
    # Balances of force that no support answers are not equations of the object.
    assert np.abs(left[:-3]).max() < 1e-10 * np.abs(right).max()


def test_the_slope_of_the_solution(rolling):
    """What the reduced model rests on: (K + d K') (x + d x') = b to first order."""
    system, _ = rolling
    right = boundary_data(system, linear_field(GENERAL, Material(2.5, 0.3)), Material(2.5, 0.3))
    factorised = factorise(system, 0.3)
    x = solve(factorised, right)
    slope = solve(factorised, -system_slope(system).apply(x))
    step = 1e-4
    higher, lower = (solve(factorise(system, 0.3 + d), right) for d in (step, -step))
    # The central difference leaves the third derivative times 1e-8 / 6.
    np.testing.assert_allclose(
        (higher - lower) / (2 * step), slope, atol=1e-6 * np.abs(slope).max()
    )


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.499])
def test_a_block_that_stands_on_rollers_under_its_weight(nu):
    """On a bed without friction the stress is -weight (1 - z) along z alone, exactly."""
    material, weight = Material(40.0, nu), 7.0
    young = 2 * material.shear * (1 + nu)
    held = np.flatnonzero(FACE == 4)
    surface = make_surface(MESH, held, directions=np.tile(Z, (held.size, 1, 1)))
    system = boundary_system(surface, quadrature=FINE)
    body = body_force_columns(system, np.array([0.0, 0.0, -weight]), quadrature=FINE)
    x, y, z = (MESH.vertices - [0.5, 0.5, 0.0]).T
    down = -(z - 0.5 * z**2) + 0.5 * nu * (x**2 + y**2)
    exact = weight / young * np.column_stack([nu * (1 - z) * x, nu * (1 - z) * y, down])
    bed = support_columns(system, material.shear * exact[:, :, None])
    parts = solve(factorise(system, nu), np.hstack([body.right.at(nu), bed.at(nu)]))
    factor, count = dilation_factor(nu), 3 * system.unknowns.free_vertices.size
    found = (parts[:count] @ [1.0, factor, 1.0]).reshape(-1, 3) / material.shear
    found += factor * body.particular / material.shear
    bottom = system.unknowns.held_vertices
    found[bottom, 2] = exact[bottom, 2]
    unrestrained = unrestrained_motions(surface).reshape(exact.size, 3)
    away = (found - exact).ravel()
    away -= unrestrained @ np.linalg.lstsq(unrestrained, away, rcond=None)[0]
    # The displacement is quadratic and so are the elements: as for the glued block.
    assert np.abs(away).max() < 3e-7 * np.abs(exact).max()
