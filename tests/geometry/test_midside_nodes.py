"""Fitted midpoints: exact for quadratics, third order on a sphere, blind across creases."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.geometry import (
    TriangleMesh,
    displacement_nodes,
    interpolation_matrix,
    linear_nodes,
    side_nodes,
    split_sides,
)


def no_region(mesh):
    return np.zeros(mesh.triangles.shape[0], dtype=np.int64)


def uneven_box(cells=5):
    """A box whose inner vertices are shifted at random within their faces."""
    mesh = box(cells=cells)
    vertices = mesh.vertices.copy()
    shift = np.random.default_rng(0).uniform(-0.25, 0.25, vertices.shape) / cells
    # Vertices of an edge move along it, corners stay.
    free = ~(np.isclose(vertices, 0) | np.isclose(vertices, 1))
    return TriangleMesh(vertices + shift * free, mesh.triangles)


def middles(mesh, nodes):
    """Straight midpoint of the edge behind every row of weights."""
    corner = mesh.vertices[mesh.triangles]
    straight = 0.5 * (corner + np.roll(corner, -1, axis=1))
    out = np.full((nodes.weights.shape[0], 3), np.nan)
    out[(nodes.element[:, 3:] - nodes.n_nodes).ravel()] = straight.reshape(-1, 3)
    return out


def quadratic(x):
    return 1 + x @ [0.3, -0.7, 0.2] + np.einsum("ni,ij,nj->n", x, QUADRATIC, x)


QUADRATIC = np.array([[0.5, 0.1, -0.3], [0.0, -0.4, 0.2], [0.6, 0.0, 0.9]])


@pytest.mark.parametrize("rings", [1, 2])
@pytest.mark.parametrize("continuous", [True, False])
def test_quadratics_are_exact_on_every_flat_face(continuous, rings):
    mesh = uneven_box()
    sides = split_sides(mesh, no_region(mesh))
    make = displacement_nodes if continuous else side_nodes
    nodes = make(mesh, sides, rings=rings)
    value = quadratic(mesh.vertices)
    if not continuous:
        value = value[sides.vertex]
    # A function of three coordinates is a quadratic on each face; edges are straight, corners bound
    # their curves.
    place = middles(mesh, nodes)
    used = np.isfinite(place[:, 0])
    np.testing.assert_allclose((nodes.weights @ value)[used], quadratic(place[used]), atol=1e-11)


@pytest.mark.parametrize("level", [2, 3, 4])
def test_the_step_to_two_rings_is_as_large_as_the_error_of_one(level):
    """Edges of half the length at each level, from two of them a radian on."""
    mesh = sphere(level)
    sides = split_sides(mesh, no_region(mesh))
    near, wide = (displacement_nodes(mesh, sides, rings=rings) for rings in (1, 2))
    place = middles(mesh, near)
    place /= np.linalg.norm(place, axis=1)[:, None]
    first, second = (nodes.weights @ np.sin(2 * mesh.vertices[:, 0]) for nodes in (near, wide))
    error = np.linalg.norm(first - np.sin(2 * place[:, 0]))
    # 0.97, 1.37 and 1.21.
    assert 0.5 < error / np.linalg.norm(second - first) < 2.0


def test_weights_sum_to_one():
    mesh = sphere(2)
    nodes = displacement_nodes(mesh, split_sides(mesh, no_region(mesh)))
    np.testing.assert_allclose(nodes.weights.sum(axis=1), 1, atol=1e-12)
    # Small weights: no midpoint runs away from the vertices around it.
    assert np.abs(nodes.weights).sum(axis=1).max() <= 4


def test_midpoints_of_a_sphere_approach_it():
    worst, size = [], []
    for level in (2, 3, 4):
        mesh = sphere(level)
        nodes = displacement_nodes(mesh, split_sides(mesh, no_region(mesh)))
        radius = np.linalg.norm(nodes.weights @ mesh.vertices, axis=1)
        worst.append(np.sqrt(np.mean((radius - 1) ** 2)))
        size.append(2.0**-level)
    order = np.polyfit(np.log(size), np.log(worst), 1)[0]
    # A quadratic over the tangent plane misses the fourth power of the distance on a sphere.
    assert order > 3.3
    # 1.8e-5 at 1026 vertices, where chords would be 1e-3 off.
    assert worst[-1] < 2.5e-5


def test_no_weight_reaches_across_a_crease():
    mesh = uneven_box(3)
    sides = split_sides(mesh, no_region(mesh))
    nodes = side_nodes(mesh, sides)
    # Sides of a face know their own face only: a field that is the face's number stays so.
    normal = np.cross(
        mesh.vertices[mesh.triangles[:, 1]] - mesh.vertices[mesh.triangles[:, 0]],
        mesh.vertices[mesh.triangles[:, 2]] - mesh.vertices[mesh.triangles[:, 0]],
    )
    face = np.round(normal / np.linalg.norm(normal, axis=1)[:, None] @ [1.0, 2.0, 3.0])
    at_sides = np.empty(sides.vertex.size)
    at_sides[sides.corner.ravel()] = np.repeat(face, 3)
    found = (nodes.weights @ at_sides)[nodes.element[:, 3:] - nodes.n_nodes]
    np.testing.assert_allclose(found, np.repeat(face[:, None], 3, axis=1), atol=1e-12)


def test_a_displacement_on_a_crease_is_one_from_both_sides():
    mesh = box(cells=3)
    sides = split_sides(mesh, no_region(mesh))
    nodes = displacement_nodes(mesh, sides)
    assert nodes.weights.shape == (sides.cut.size, mesh.vertices.shape[0])
    middle = nodes.element[:, 3:].ravel()
    assert np.array_equal(middle[sides.twin.ravel()], middle)


def test_linear_nodes_are_means():
    mesh = sphere(1)
    nodes = linear_nodes(displacement_nodes(mesh, split_sides(mesh, no_region(mesh))))
    value = np.random.default_rng(0).normal(size=mesh.vertices.shape[0])
    corner = value[mesh.triangles]
    expected = 0.5 * (corner + np.roll(corner, -1, axis=1))
    found = (nodes.weights @ value)[nodes.element[:, 3:] - nodes.n_nodes]
    np.testing.assert_allclose(found, expected, atol=1e-15)


def test_interpolation_is_exact_for_quadratics_between_the_nodes():
    mesh = uneven_box()
    nodes = displacement_nodes(mesh, split_sides(mesh, no_region(mesh)))
    rng = np.random.default_rng(1)
    triangle = rng.integers(0, mesh.triangles.shape[0], 50)
    barycentric = rng.dirichlet([1, 1, 1], 50)
    matrix = interpolation_matrix(nodes, triangle, barycentric)
    place = np.einsum("nk,nki->ni", barycentric, mesh.vertices[mesh.triangles[triangle]])
    np.testing.assert_allclose(matrix @ quadratic(mesh.vertices), quadratic(place), atol=1e-11)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-13)


def test_the_coarsest_box_falls_back_to_straight_lines():
    # Two triangles a face cannot fix a quadratic: the diagonal's midpoint is the mean of its ends.
    mesh = box(cells=1)
    sides = split_sides(mesh, no_region(mesh))
    nodes = displacement_nodes(mesh, sides)
    np.testing.assert_allclose(nodes.weights @ mesh.vertices, middles(mesh, nodes), atol=1e-12)
