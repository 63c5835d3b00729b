"""Right-hand sides against the matrix and against each other."""

from dataclasses import replace

import numpy as np
import pytest
from elastic_bodies import Material, bump_load, cube_with_faces, held_part
from surfaces import sphere

from palpate.bem import (
    RightHand,
    SurfaceLoad,
    body_force_columns,
    dilation_factor,
    factorise,
    load_right_hand,
    make_surface,
    solve,
    support_columns,
)
from palpate.bem.integrals.surface import Quadrature, integral_weights, triangle_rule
from palpate.bem.loads.right_hand import joined, load_columns, total_traction, traction_column
from palpate.bem.system.matrix import system_matrix
from palpate.geometry.midside_nodes import element_points

FINE = Quadrature(tolerance=1e-8)


@pytest.fixture(scope="module")
def ball():
    mesh = sphere(2)
    return held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)


def columns(system, seed=0):
    rng = np.random.default_rng(seed)
    return [RightHand(rng.normal(size=(3, 4, k))) for k in (1, 2)]


def test_at_is_the_polynomial(ball):
    a, _ = columns(ball)
    nu = 0.37
    np.testing.assert_allclose(
        a.at(nu), a.terms[0] + nu * a.terms[1] + nu**2 * a.terms[2], rtol=1e-14
    )


def test_joined_keeps_the_order(ball):
    a, b = columns(ball)
    both = joined([a, b])
    assert np.array_equal(both.at(0.2), np.concatenate([a.at(0.2), b.at(0.2)], axis=1))


def test_load_columns_are_kelvins_tensor():
    fields = np.random.default_rng(2).normal(size=(5, 2, 6))
    nu = 0.3
    xx, yy, zz, yz, zx, xy = fields[:, 1].T
    tensor = np.stack([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    expected = 0.5 * ((3 - 4 * nu) * (xx + yy + zz) * np.eye(3)[:, :, None] + tensor)
    balance = np.diag([1.0, 2.0, 3.0])
    right = load_columns(fields, balance).at(nu)[:, 3:]
    np.testing.assert_allclose(right[:15].reshape(3, 5, 3).transpose(0, 2, 1), expected, rtol=1e-13)
    assert np.array_equal(right[15:], balance)


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.5])
def test_a_moved_support_is_what_the_matrix_would_take_away(ball, nu):
    # Seen from a support elsewhere the same vertices are free: their columns times the motion,
    # other sign.
    surface = ball.surface
    motion = np.random.default_rng(3).normal(size=surface.mesh.vertices.shape)
    held = ball.unknowns.held_vertices
    right = support_columns(ball, motion[:, :, None]).at(nu)[:, 0]
    free = replace(ball.unknowns, free_vertices=held)
    matrix = system_matrix(replace(ball, unknowns=free), nu)
    np.testing.assert_allclose(
        right, -matrix[:, : 3 * held.size] @ motion[held].ravel(), rtol=0, atol=1e-12
    )


def test_a_traction_over_triangles_is_that_load(ball):
    """A uniform traction by elements and the same as a load of its own: two ways to integrate, one
    answer."""
    surface = ball.surface
    triangles = np.flatnonzero(~surface.held)[5:9]
    load = SurfaceLoad(triangles, lambda triangle, barycentric, position: np.ones(triangle.size))
    direction = np.array([0.3, -0.5, 0.8])
    from_load = load_right_hand(ball, [load]).at(0.3) @ direction
    uniform = np.broadcast_to(direction, (triangles.size, 6, 3)).copy()
    area = element_area(surface.element_nodes[triangles])
    from_elements = traction_column(ball, triangles, uniform).at(0.3)[:, 0] / area
    # The load's cells are a quarter of an element with a rule of degree 5; its own points see it
    # through 3 panels.
    error = np.abs(from_load - from_elements).max() / np.abs(from_elements).max()
    assert error < 2e-4


def element_area(nodes):
    barycentric, weight = triangle_rule(11)
    normal = element_points(nodes, barycentric)[..., 3:]
    return (np.linalg.norm(normal, axis=2) @ weight).sum()


def test_total_of_a_quadratic_traction():
    mesh, face = cube_with_faces(2)
    surface = make_surface(mesh, np.flatnonzero(face == 4))
    triangles = np.flatnonzero(face == 5)
    x, y, _ = surface.element_nodes[triangles].transpose(2, 0, 1)
    traction = np.stack([x * x, x * y, 1 + y], axis=2)
    # Exact for quadratics on flat ground.
    np.testing.assert_allclose(
        total_traction(surface.element_nodes[triangles], traction),
        [1 / 3, 1 / 4, 3 / 2],
        rtol=1e-13,
    )


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.499])
def test_the_last_rows_balance_the_load(ball, nu):
    mesh = ball.surface.mesh
    load = bump_load(mesh, np.array([0.0, 0.0, 1.0]), 0.6)
    x = solve(factorise(ball, nu), load_right_hand(ball, [load]).at(nu))
    weights = integral_weights(ball.surface, np.flatnonzero(ball.surface.held))
    traction = x[3 * ball.unknowns.free_vertices.size : -3].reshape(-1, 3, 3) / ball.traction_length
    reaction = np.einsum("s,sij->ij", weights[ball.unknowns.held_sides], traction)
    # An equation of the system: round-off times its condition.
    np.testing.assert_allclose(reaction, -np.eye(3), atol=1e-9)
    # The price: slack in the integral equations, far below the displacement.
    assert np.abs(x[-3:]).max() < 5e-3 * np.abs(x[:-3]).max()


def test_a_traction_at_shifted_points_too():
    mesh, face = cube_with_faces(2)
    system = held_part(mesh, np.isin(face, [0, 4]))
    triangles = np.flatnonzero(~system.surface.held)
    # A uniform normal pressure on the free part of a closed surface and its opposite cancel.
    uniform = np.broadcast_to([1.0, 2.0, 3.0], (triangles.size, 6, 3)).copy()
    there, back = (traction_column(system, triangles, sign * uniform).terms for sign in (1, -1))
    assert np.array_equal(there, -back)


@pytest.fixture(scope="module")
def block():
    mesh, face = cube_with_faces(3)
    return held_part(mesh, face == 4, quadrature=FINE)


def standing_block(x, weight, material):
    """A block on a bed that gives way just so: stress -weight (1 - z) along z alone."""
    nu, young = material.poisson, 2 * material.shear * (1 + material.poisson)
    side = nu * (1 - x[:, 2:]) * x[:, :2]
    down = -(x[:, 2] - 0.5 * x[:, 2] ** 2) + 0.5 * nu * (x[:, 0] ** 2 + x[:, 1] ** 2)
    return weight / young * np.column_stack([side, down])


@pytest.mark.parametrize("nu", [0.0, 0.3, 0.499])
def test_a_block_that_stands_under_its_weight(block, nu):
    material = Material(40.0, nu)
    weight = 7.0
    body = body_force_columns(block, np.array([0.0, 0.0, -weight]), quadrature=FINE)
    exact = standing_block(block.surface.mesh.vertices, weight, material)
    bed = support_columns(block, material.shear * exact[:, :, None])
    x = solve(factorise(block, nu), np.hstack([body.right.at(nu), bed.at(nu)]))
    factor = dilation_factor(nu)
    count = 3 * block.unknowns.free_vertices.size
    free = (x[:count, 0] + factor * x[:count, 1] + x[:count, 2]).reshape(-1, 3)
    free += factor * body.particular[block.unknowns.free_vertices]
    # The displacement is quadratic and so are the elements: the tolerance of the integrals is what
    # is left.
    error = np.abs(free / material.shear - exact[block.unknowns.free_vertices]).max()
    assert error < 3e-7 * np.abs(exact).max()
    traction = x[count:-3] @ [1.0, factor, 1.0] / block.traction_length
    # The bed carries the weight evenly (the particular pressure vanishes at its level).
    np.testing.assert_allclose(traction.reshape(-1, 3)[:, 2], weight, rtol=2e-5)


def test_a_glued_block_hands_its_weight_to_the_support(block):
    force = np.array([1.0, -2.0, -7.0])
    nu = 0.3
    body = body_force_columns(block, force)
    x = solve(factorise(block, nu), body.right.at(nu)) @ [1.0, dilation_factor(nu)]
    weights = integral_weights(block.surface, np.flatnonzero(block.surface.held))
    traction = x[3 * block.unknowns.free_vertices.size : -3].reshape(-1, 3) / block.traction_length
    reaction = weights[block.unknowns.held_sides] @ traction
    # Particular traction -(b.y) n over the flat support: zero in sum, for y counts from its middle.
    # Volume 1.
    np.testing.assert_allclose(reaction, -force, rtol=1e-6, atol=1e-6)


def test_an_incompressible_particular_solution_is_pressure_alone(block):
    assert dilation_factor(0.5) == 0
    np.testing.assert_allclose(dilation_factor(0.2), 0.6 / 2.4)


def test_twice_the_force_is_twice_the_columns(block):
    force = np.array([1.0, -2.0, -7.0])
    single, two = (body_force_columns(block, scale * force) for scale in (1.0, 2.0))
    np.testing.assert_allclose(two.right.at(0.3), 2 * single.right.at(0.3), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(two.particular, 2 * single.particular, rtol=1e-13)


def test_particular_displacement_balances_the_force(block):
    # Hooke and equilibrium by second differences: (lambda + 2 G) grad div u = -b for this curl-free
    # field.
    force = np.array([1.0, -2.0, -7.0])
    particular = body_force_columns(block, force).particular
    vertices = block.surface.mesh.vertices
    origin = vertices[block.unknowns.held_vertices].mean(axis=0)
    y = vertices - origin
    np.testing.assert_allclose(
        particular, 0.5 * (y**2).sum(axis=1)[:, None] * force - (y @ force)[:, None] * y, atol=1e-12
    )
