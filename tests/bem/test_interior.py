"""Displacement and stress inside: exact fields, equilibrium over a cut, Hooke's law."""

import numpy as np
import pytest
from elastic_bodies import (
    Material,
    bump_load,
    cube_with_faces,
    element_traction,
    held_part,
    linear_field,
    point_source,
)
from surfaces import sphere

from palpate.bem import PressureDisc, SurfaceLoad, make_elastic_map, make_surface
from palpate.bem.interior import VALUES, interior_state, interior_values, sum_forces
from palpate.errors import InputError

GRADIENT = np.array([[0.1, 0.4, -0.2], [-0.3, 0.2, 0.5], [0.6, 0.0, -0.1]])
SOURCE, FORCE = np.array([0.4, -0.5, 1.7]), np.array([1.0, 2.0, -1.5])
TOP = np.array([0.5, 0.5, 1.0])


def known(surface, field):
    everywhere = np.arange(surface.held.size)
    return (
        surface.element_nodes,
        field.displacement(surface.element_nodes),
        element_traction(surface, everywhere, field),
    )


def values(surface, field, material, points):
    return interior_values(
        *known(surface, field), points, shear_modulus=material.shear, poisson_ratio=material.poisson
    )


@pytest.fixture(scope="module")
def cube():
    mesh, face = cube_with_faces(3)
    return held_part(mesh, face == 4)


@pytest.mark.parametrize("nu", [-0.4, 0.0, 0.3, 0.499])
def test_a_linear_field_inside_a_cube(cube, nu):
    material = Material(2.5, nu)
    field = linear_field(GRADIENT, material)
    points = 0.03 + 0.94 * np.random.default_rng(0).random((40, 3))
    inside_values = values(cube.surface, field, material, points)
    # The elements hold the field; the integrals are good to 1e-8 and better, the stress loses a
    # length over distance.
    np.testing.assert_allclose(inside_values.displacement, field.displacement(points), atol=1e-9)
    size = np.abs(field.stress(points)).max()
    np.testing.assert_allclose(inside_values.stress, field.stress(points), atol=1e-7 * size)


@pytest.mark.parametrize("depth", [0.015, 0.05, 0.2])
def test_close_to_a_face_edge_or_vertex(cube, depth):
    material = Material(1.0, 0.3)
    field = linear_field(GRADIENT, material)
    # Above a triangle's middle, above an edge of two triangles, above a vertex, in a corner of the
    # cube.
    places = np.array([[0.4, 0.55, 0], [0.5, 0.5, 0], [1 / 3, 1 / 3, 0], [0, 0, 0.0]])
    points = places + depth * np.array([[0, 0, 1], [0, 0, 1], [0, 0, 1], [1, 1, 1]])
    inside_values = values(cube.surface, field, material, points)
    np.testing.assert_allclose(inside_values.displacement, field.displacement(points), atol=1e-9)
    np.testing.assert_allclose(inside_values.stress, field.stress(points), atol=1e-7)


def test_curved_fields_converge():
    material = Material(1.0, 0.3)
    field = point_source(SOURCE, FORCE, material)
    points = 0.7 * np.random.default_rng(1).uniform(-1, 1, (30, 3)) / np.sqrt(3)
    errors = []
    for level in (1, 2, 3):
        mesh = sphere(level)
        low = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].mean(axis=1) < -0.6)
        inside_values = values(make_surface(mesh, low), field, material, points)
        errors.append(np.abs(inside_values.stress - field.stress(points)).max())
    order = -np.polyfit((1, 2, 3), np.log2(errors), 1)[0]
    assert order > 2.5
    assert errors[-1] < 1e-2 * np.abs(field.stress(points)).max()


def test_forces_alone_are_kelvins_solution():
    material = Material(2.0, 0.2)
    field = point_source(SOURCE, FORCE, material)
    points = np.random.default_rng(2).normal(size=(6, 3))
    out = np.zeros((6, VALUES))
    sum_forces(0, 6, points, SOURCE[None], FORCE[None], 2.0, 0.2, out)
    out /= 8 * np.pi * (1 - 0.2)
    np.testing.assert_allclose(out[:, :3], field.displacement(points), rtol=1e-12)
    stress = out[:, 3:12].reshape(-1, 3, 3)
    np.testing.assert_allclose(stress, field.stress(points), rtol=1e-11, atol=1e-14)


@pytest.fixture(scope="module")
def pressed():
    mesh, face = cube_with_faces(5)
    elastic_map = make_elastic_map(
        held_part(mesh, face == 4), shear_modulus=3.0, poisson_ratio=0.35
    )
    return elastic_map, bump_load(mesh, TOP, 0.35), np.array([0.2, -0.1, -1.0])


@pytest.mark.parametrize("height", [0.3, 0.7])
def test_a_cut_through_the_cube_carries_the_load(pressed, height):
    x, w = np.polynomial.legendre.leggauss(14)
    x, w = 0.5 * (x + 1), 0.5 * w
    a, b = (grid.ravel() for grid in np.meshgrid(x, x, indexing="ij"))
    # Gauss points begin 0.7 % from the faces, too close: the outermost ring is moved in a little.
    a, b = (np.clip(t, 0.012, 0.988) for t in (a, b))
    points = np.stack([a, b, np.full(a.size, height)], axis=1)
    state = interior_state(*pressed, points)
    carried = np.einsum("n,ni->i", np.outer(w, w).ravel(), state.stress[:, 2])
    # The part above is in balance: what the load pushes goes through the cut. Fields of 5 x 5
    # elements a face.
    np.testing.assert_allclose(carried, pressed[2], atol=0.01)


def test_stress_is_hookes_of_the_displacement(pressed):
    elastic_map, load, force = pressed
    points = np.array([[0.5, 0.5, 0.9], [0.2, 0.3, 0.5], [0.8, 0.45, 0.1]])
    step = 1e-4
    moves = step * np.concatenate([np.eye(3), -np.eye(3)])
    around = (points[:, None] + moves).reshape(-1, 3)
    u = interior_state(elastic_map, load, force, around).displacement.reshape(3, 6, 3)
    gradient = (u[:, :3] - u[:, 3:]).transpose(0, 2, 1) / (2 * step)
    expected = Material(3.0, 0.35).stress(gradient)
    stress = interior_state(elastic_map, load, force, points).stress
    # Difference of 1e-4: its square times the third derivative, and the integrals' round-off over
    # the step.
    np.testing.assert_allclose(stress, expected, atol=1e-5 * np.abs(expected).max())
    np.testing.assert_allclose(stress, stress.transpose(0, 2, 1), atol=1e-12)


@pytest.mark.parametrize("depth", [0.006, 0.02, 0.06, 0.1])
def test_under_the_patch_the_pressure_spreads_as_in_a_half_space(depth):
    mesh, face = cube_with_faces(8)
    elastic_map = make_elastic_map(
        held_part(mesh, face == 4), shear_modulus=3.0, poisson_ratio=0.35
    )
    bump = bump_load(mesh, TOP, 0.35)
    disc = PressureDisc(TOP, 0.35, lambda s: np.clip(1 - s**2, 0, None) ** 2)
    load = SurfaceLoad(bump.triangles, bump.density, disc)
    points = TOP - np.array([[0.0, 0.0, depth]])
    stress = interior_state(elastic_map, load, np.array([0.0, 0.0, -1.0]), points).stress[0]
    # Boussinesq: a point force gives 3 z^3 / (2 pi R^5) below it, whatever the material.
    s, w = np.polynomial.legendre.leggauss(200)
    r, w = 0.175 * (s + 1), 0.175 * w
    pressure = 3 / (np.pi * 0.35**2) * (1 - (r / 0.35) ** 2) ** 2
    expected = -(w * r * pressure * 3 * depth**3 / (r**2 + depth**2) ** 2.5).sum()
    # The cube is no half space and its faces have 8 x 8 squares: 1 % each.
    np.testing.assert_allclose(stress[2, 2], expected, rtol=0.02)


def test_just_under_the_surface_the_displacement_is_its_own(pressed):
    elastic_map, load, force = pressed
    mesh = elastic_map.system.surface.mesh
    vertex = int(np.argmin(np.linalg.norm(mesh.vertices - [0.8, 0.6, 1.0], axis=1)))
    (state,) = elastic_map.respond([load], force[None])
    inside = mesh.vertices[[vertex]] - [[0.0, 0.0, 0.012]]
    displacement = interior_state(elastic_map, load, force, inside).displacement[0]
    # 1.2 % of the cube deeper: strain of order one times that.
    scale = np.abs(state.displacement).max()
    np.testing.assert_allclose(displacement, state.displacement[vertex], atol=0.02 * scale)


@pytest.mark.parametrize(
    ("point", "words"),
    [
        ([0.5, 0.5, 0.001], "within 5% of a triangle's radius of the surface"),
        ([0.0, 0.0, 0.0], "within 5% of a triangle's radius of the surface"),
        ([0.5, 0.5, -0.2], "outside the object"),
        ([300.0, 500.0, 200.0], "outside the object .* in metres"),
        ([np.nan, 0.5, 0.5], "outside the object"),
    ],
)
def test_points_that_have_no_inside_are_refused(cube, point, words):
    material = Material(1.0, 0.3)
    points = np.array([[0.5, 0.5, 0.5], point])
    with pytest.raises(InputError, match=f"1 of 2 points are {words}"):
        values(cube.surface, linear_field(GRADIENT, material), material, points)
