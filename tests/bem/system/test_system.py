"""The solved system against exact linear fields on a cube, and its own algebra."""

import numpy as np
import pytest
from elastic_bodies import Material, cube_with_faces, held_part, linear_field, solve_known
from surfaces import box, joined

from palpate.bem import factorise, make_surface
from palpate.bem.integrals.surface import Quadrature
from palpate.bem.system.matrix import matrix_and_slope, system_matrix
from palpate.bem.system.system import (
    boundary_system,
    find_unknowns,
    place_collocation,
    restricted_nodes,
)
from palpate.errors import SingularSystemError
from palpate.geometry import closest_points

CELLS = 3
NORMALS = np.repeat(np.eye(3), 2, axis=0) * np.array([-1, 1, -1, 1, -1, 1])[:, None]
SUPPORTS = {"one": [4], "two opposite": [4, 5], "two adjacent": [0, 4], "three": [0, 2, 4]}
SHEAR = np.array([[0, 0.5, 0.2], [0.5, 0, 0.1], [0.2, 0.1, 0]])
TURNED = np.array([[0.1, 0.4, -0.2], [-0.3, 0.2, 0.5], [0.6, 0.0, -0.1]])
FACE = (CELLS + 1) ** 2
ALL = 6 * CELLS**2 + 2
EDGE = CELLS + 1


@pytest.fixture(scope="module", params=SUPPORTS)
def held_cube(request):
    mesh, face = cube_with_faces(CELLS)
    chosen = np.isin(face, SUPPORTS[request.param])
    return held_part(mesh, chosen, quadrature=Quadrature(tolerance=1e-9)), face


def gradient_of(kind, nu):
    return {"tension": np.diag([-nu, -nu, 1.0]), "shear": SHEAR, "general": TURNED}[kind]


@pytest.mark.parametrize("kind", ["tension", "shear", "general"])
@pytest.mark.parametrize("nu", [0.0, 0.25, 0.45, 0.499])
def test_linear_fields_on_a_cube(held_cube, kind, nu):
    system, face = held_cube
    material = Material(2.5, nu)
    field = linear_field(gradient_of(kind, nu), material)
    displacement, traction = solve_known(
        system, field, material, quadrature=Quadrature(tolerance=1e-9)
    )
    vertices = system.surface.mesh.vertices
    exact = field.displacement(vertices)
    # The elements hold a linear field exactly and the quadrature outdoes its 1e-9: round-off is
    # left, times the pressure that belongs to the field (lame is 500 G at nu 0.499). The issue asks
    # for 1e-6.
    assert np.abs(displacement - exact).max() < 1e-11 * np.abs(exact).max()
    side_face = np.zeros(system.surface.traction.n_nodes, dtype=np.int64)
    side_face[system.surface.sides.corner.ravel()] = np.repeat(face, 3)
    sigma = field.stress(np.zeros((1, 3)))[0]
    expected = (NORMALS @ sigma)[side_face[system.unknowns.held_sides]]
    # Tractions differentiate displacements over an element: an order is lost. Edges and corners
    # count too; the issue asks for 1e-4.
    assert np.abs(traction - expected).max() < 1e-10 * np.abs(sigma).max()


@pytest.fixture(scope="module")
def cube_system():
    mesh, face = cube_with_faces(2)
    return held_part(mesh, np.isin(face, [0, 4]))


def test_default_quadrature_passes_the_patch_test(cube_system):
    material = Material(1.0, 0.3)
    field = linear_field(TURNED, material)
    displacement, _ = solve_known(cube_system, field, material)
    exact = field.displacement(cube_system.surface.mesh.vertices)
    # The default tolerance is 1e-6 in each integral.
    assert np.abs(displacement - exact).max() < 1e-6 * np.abs(exact).max()


def test_slope_is_the_difference_of_matrices(cube_system):
    x = np.random.default_rng(0).normal(size=(cube_system.size, 2))
    difference = system_matrix(cube_system, 1.3) - system_matrix(cube_system, 0.3)
    # Round-off of sums of 100 entries of order one.
    np.testing.assert_allclose(
        matrix_and_slope(cube_system, 0.3)[1].apply(x), difference @ x, rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("precision", [np.float64, np.float32])
def test_the_matrix_with_its_slope_is_that_by_itself(cube_system, precision):
    matrix, slope = matrix_and_slope(cube_system, 0.3, precision=precision)
    assert np.array_equal(matrix, system_matrix(cube_system, 0.3, precision=precision))
    assert {getattr(slope, name).dtype.type for name in ("skew", "flux", "trace")} == {precision}


def test_matrix_is_linear_in_poisson_ratio(cube_system):
    low, middle, high = (system_matrix(cube_system, nu) for nu in (0.0, 0.25, 0.5))
    np.testing.assert_allclose(middle, 0.5 * (low + high), rtol=0, atol=1e-13)


def test_the_matrix_is_square_and_as_large_as_its_unknowns(cube_system):
    matrix = system_matrix(cube_system, 0.3)
    assert matrix.shape == (cube_system.size, cube_system.size)
    assert factorise(cube_system, 0.3).reciprocal_condition > 1e-7


def test_an_object_that_is_not_held_is_singular():
    loose = joined(box(cells=1), box(cells=1, origin=(3.0, 0.0, 0.0)))
    system = boundary_system(make_surface(loose, np.arange(2)))
    with pytest.raises(SingularSystemError, match=r"is singular \(.*palpate check"):
        factorise(system, 0.3)


def test_size_scales_nothing_but_lengths():
    mesh, face = cube_with_faces(1)
    field_of = [
        held_part(type(mesh)(scale * mesh.vertices, mesh.triangles), face == 4)
        for scale in (1, 1e-3)
    ]
    large, small = (system_matrix(system, 0.3) for system in field_of)
    # The traction kernel has no unit, and the unknown traction comes times the object's length.
    np.testing.assert_allclose(large, small, rtol=0, atol=1e-12)


def test_restricted_parts_keep_what_they_name():
    mesh, face = cube_with_faces(2)
    surface = make_surface(mesh, np.flatnonzero(face == 4))
    unknowns = find_unknowns(surface)
    held = np.flatnonzero(surface.held)
    index = np.full(surface.traction.n_nodes, -1)
    index[unknowns.held_sides] = np.arange(unknowns.held_sides.size)
    nodes = restricted_nodes(surface.traction, held, index)
    x = np.random.default_rng(0).normal(size=surface.traction.n_nodes)
    whole = np.concatenate([x, surface.traction.weights @ x])[surface.traction.element[held]]
    part = x[unknowns.held_sides]
    assert np.array_equal(np.concatenate([part, nodes.weights @ part])[nodes.element], whole)


def bounded(faces):
    mesh, face = cube_with_faces(CELLS)
    surface = make_surface(mesh, np.flatnonzero(np.isin(face, faces)))
    unknowns = find_unknowns(surface)
    return surface, unknowns, place_collocation(surface, unknowns)


@pytest.mark.parametrize(
    ("faces", "held_vertices", "held_sides"),
    [
        ([4], FACE, FACE),
        ([4, 5], 2 * FACE, 2 * FACE),
        ([0, 4], 2 * FACE - EDGE, 2 * FACE),
        ([0, 2, 4], 3 * FACE - 3 * EDGE + 1, 3 * FACE),
    ],
)
def test_counts_on_a_cube(faces, held_vertices, held_sides):
    _, unknowns, collocation = bounded(faces)
    assert unknowns.held_vertices.size == held_vertices
    assert unknowns.free_vertices.size == ALL - held_vertices
    assert unknowns.held_sides.size == held_sides
    assert collocation.point.shape[0] == unknowns.free_vertices.size + held_sides


def test_every_vertex_with_one_held_side_or_none_has_its_own_equation():
    surface, unknowns, collocation = bounded([0, 4])
    shared = np.flatnonzero((surface.mesh.vertices[:, [0, 2]] == 0).all(axis=1))
    at_vertices = collocation.vertex[collocation.vertex >= 0]
    assert np.array_equal(np.sort(np.concatenate([at_vertices, shared])), np.arange(ALL))
    assert np.array_equal(collocation.point[: at_vertices.size], surface.mesh.vertices[at_vertices])
    assert unknowns.held_sides.size == np.unique(unknowns.held_sides).size


def test_shifted_points_lie_in_held_faces_near_their_vertex():
    surface, _, collocation = bounded([0, 2, 4])
    inside = collocation.vertex < 0
    assert surface.held[collocation.triangle[inside]].all()
    closest = closest_points(surface.mesh, collocation.point[inside])
    # On the surface up to round-off, and off every edge so that the polar coordinates work.
    assert closest.distance.max() < 1e-15
    assert np.array_equal(closest.triangle, collocation.triangle[inside])
    np.testing.assert_allclose(closest.barycentric, collocation.barycentric[inside], atol=1e-12)
    # One point for each of the three faces at the common corner.
    corner = np.linalg.norm(collocation.point[inside], axis=1) < 0.25 * np.sqrt(2) / CELLS
    assert corner.sum() == 3


def test_rim_vertices_have_one_unknown_side():
    surface, unknowns, _ = bounded([4])
    vertex = surface.sides.vertex[unknowns.held_sides]
    assert np.array_equal(np.sort(vertex), unknowns.held_vertices)


def test_flat_facets_have_flat_midpoints():
    mesh, face = cube_with_faces(2)
    surface = make_surface(mesh, np.flatnonzero(face == 4), smooth=False)
    corner = mesh.vertices[mesh.triangles]
    middle = 0.5 * (corner + np.roll(corner, -1, axis=1))
    np.testing.assert_allclose(surface.element_nodes[:, 3:], middle, atol=1e-15)
