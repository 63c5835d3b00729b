"""The displacement of a point of the surface from its own integral equation."""

import numpy as np
import pytest
from elastic_bodies import (
    Material,
    bump_load,
    cube_with_faces,
    element_traction,
    held_part,
    linear_field,
)
from surfaces import sphere

from palpate.bem import factorise, load_right_hand, point_equations, solve, support_columns
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.loads.right_hand import traction_column
from palpate.geometry import interpolation_matrix
from palpate.geometry.midside_nodes import quadratic_shapes

NU = 0.3
FINE = Quadrature(tolerance=1e-9)


@pytest.fixture(scope="module")
def ball():
    mesh = sphere(3)
    return held_part(mesh, mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.5)


@pytest.fixture(scope="module")
def pressed(ball):
    load = bump_load(ball.surface.mesh, np.array([0.0, 0.0, 1.0]), 0.5)
    x = solve(factorise(ball, NU), load_right_hand(ball, [load]).at(NU))
    return load, x


def displacement_at(system, load, x, triangle, barycentric):
    equations = point_equations(system, triangle, barycentric)
    right = equations.by_point(load_right_hand(equations.system, [load]).at(NU))
    left = (equations.matrix[0] + NU * equations.matrix[1]) @ x - right
    return np.linalg.solve(equations.own[0] + NU * equations.own[1], left)


def test_at_a_vertex_it_is_the_vertex(ball, pressed):
    load, x = pressed
    triangles = np.flatnonzero(ball.surface.mesh.triangles[:, 0] == ball.unknowns.free_vertices[40])
    triangle = triangles[:1]
    found = displacement_at(ball, load, x, triangle, np.array([[1.0, 0.0, 0.0]]))[0]
    expected = x[120:123]
    # The same equation as in the system, by a block of its own: the integrals' tolerance.
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_between_vertices_it_agrees_with_the_elements_far_from_the_load(ball, pressed):
    load, x = pressed
    mesh = ball.surface.mesh
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    around = np.flatnonzero((np.abs(middle[:, 2]) < 0.15) & ~ball.surface.held)[:12]
    barycentric = np.tile([0.5, 0.2, 0.3], (around.size, 1))
    found = displacement_at(ball, load, x, around, barycentric)
    nodal = np.zeros((mesh.vertices.shape[0], 3, 3))
    count = 3 * ball.unknowns.free_vertices.size
    nodal[ball.unknowns.free_vertices] = x[:count].reshape(-1, 3, 3)
    matrix = interpolation_matrix(ball.surface.displacement, around, barycentric)
    expected = (matrix @ nodal.reshape(-1, 9)).reshape(-1, 3, 3)
    # Both approximate the same smooth field, on 258 vertices to some thousandths.
    assert np.abs(found - expected).max() < 5e-3 * np.abs(expected).max()


def test_it_runs_smoothly_across_the_patch(ball, pressed):
    """Along a line over the patch the displacement has no bumps at the edges of elements."""
    load, x = pressed
    mesh = ball.surface.mesh
    triangle = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] > 0.999).any(axis=1))[0]
    corner = int(np.argmax(mesh.vertices[mesh.triangles[triangle], 2]))
    t = np.linspace(0.05, 0.9, 9)
    barycentric = np.empty((t.size, 3))
    barycentric[:, corner] = 1 - t
    barycentric[:, (corner + 1) % 3] = barycentric[:, (corner + 2) % 3] = 0.5 * t
    found = displacement_at(ball, load, x, np.full(t.size, triangle), barycentric)
    down = found[:, 2, 2]
    fit = np.polyval(np.polyfit(t, down, 4), t)
    # Smooth within one element, and falling from the middle outward.
    assert np.abs(down - fit).max() < 2e-3 * np.abs(down).max()
    assert (np.diff(down) < 0).all()


@pytest.mark.parametrize("barycentric", [[0.2, 0.3, 0.5], [0.98, 0.01, 0.01], [0.5, 0.5, 0.0]])
def test_a_linear_field_is_exact_at_every_point(barycentric):
    mesh, face = cube_with_faces(2)
    system = held_part(mesh, face == 4, quadrature=FINE)
    material = Material(1.0, NU)
    field = linear_field(np.array([[0.1, 0.4, -0.2], [-0.3, 0.2, 0.5], [0.6, 0.0, -0.1]]), material)
    free = np.flatnonzero(~system.surface.held)
    traction = element_traction(system.surface, free, field)
    exact = field.displacement(mesh.vertices)

    def right_of(some):
        pushed = traction_column(some, free, traction, quadrature=FINE).at(NU)
        return pushed + support_columns(some, exact[:, :, None]).at(NU)

    x = solve(factorise(system, NU), right_of(system))
    triangle, place = free[[3, 20]], np.tile(barycentric, (2, 1))
    equations = point_equations(system, triangle, place, quadrature=FINE)
    left = (equations.matrix[0] + NU * equations.matrix[1]) @ x
    left = left - equations.by_point(right_of(equations.system))
    found = np.linalg.solve(equations.own[0] + NU * equations.own[1], left)[:, :, 0]
    points = equations.system.collocation.point
    # The singular integrals keep 4 x 12 points; the rest is 1e-9.
    np.testing.assert_allclose(found, field.displacement(points), atol=1e-6)
    asked = np.einsum("ap,pai->pi", quadratic_shapes(place), system.surface.element_nodes[triangle])
    # A point on an edge is moved off it by 2 % of its triangle, no other is.
    moved = np.linalg.norm(points - asked, axis=1).max()
    assert moved < 0.03 * 0.71
    assert (moved < 1e-12) == (min(barycentric) > 0.02)
