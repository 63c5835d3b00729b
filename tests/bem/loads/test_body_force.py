"""Gravity without a volume mesh."""

import numpy as np
import pytest
from elastic_bodies import Material, cube_with_faces, held_part

from palpate.bem import (
    Quadrature,
    body_force_columns,
    dilation_factor,
    factorise,
    solve,
    support_columns,
)
from palpate.bem.integrals.surface import integral_weights

FINE = Quadrature(tolerance=1e-8)


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
    one, two = (body_force_columns(block, scale * force) for scale in (1.0, 2.0))
    np.testing.assert_allclose(two.right.at(0.3), 2 * one.right.at(0.3), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(two.particular, 2 * one.particular, rtol=1e-13)


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
