"""Six-node triangles: midside values, refined surfaces, shape functions."""

import numpy as np
import pytest
from surfaces import box, sphere

from palpate.errors import InputError
from palpate.geometry import (
    ELEMENT_NODES,
    TriangleMesh,
    displacement_nodes,
    element_points,
    element_spheres,
    enclosed_volume,
    interpolation_matrix,
    linear_nodes,
    quadratic_shapes,
    quartered,
    refined_surface,
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
    position = middles(mesh, nodes)
    used = np.isfinite(position[:, 0])
    np.testing.assert_allclose((nodes.weights @ value)[used], quadratic(position[used]), atol=1e-11)


@pytest.mark.parametrize("level", [2, 3, 4])
def test_the_step_to_two_rings_is_as_large_as_the_error_of_one(level):
    """Edges of half the length at each level, from two of them a radian on."""
    mesh = sphere(level)
    sides = split_sides(mesh, no_region(mesh))
    near, wide = (displacement_nodes(mesh, sides, rings=rings) for rings in (1, 2))
    position = middles(mesh, near)
    position /= np.linalg.norm(position, axis=1)[:, None]
    first, second = (nodes.weights @ np.sin(2 * mesh.vertices[:, 0]) for nodes in (near, wide))
    error = np.linalg.norm(first - np.sin(2 * position[:, 0]))
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
    values = (nodes.weights @ at_sides)[nodes.element[:, 3:] - nodes.n_nodes]
    np.testing.assert_allclose(values, np.repeat(face[:, None], 3, axis=1), atol=1e-12)


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
    values = (nodes.weights @ value)[nodes.element[:, 3:] - nodes.n_nodes]
    np.testing.assert_allclose(values, expected, atol=1e-15)


def test_interpolation_is_exact_for_quadratics_between_the_nodes():
    mesh = uneven_box()
    nodes = displacement_nodes(mesh, split_sides(mesh, no_region(mesh)))
    rng = np.random.default_rng(1)
    triangle = rng.integers(0, mesh.triangles.shape[0], 50)
    barycentric = rng.dirichlet([1, 1, 1], 50)
    matrix = interpolation_matrix(nodes, triangle, barycentric)
    position = np.einsum("nk,nki->ni", barycentric, mesh.vertices[mesh.triangles[triangle]])
    np.testing.assert_allclose(matrix @ quadratic(mesh.vertices), quadratic(position), atol=1e-11)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-13)


def test_the_coarsest_box_falls_back_to_straight_lines():
    # Two triangles a face cannot fix a quadratic: the diagonal's midpoint is the mean of its ends.
    mesh = box(cells=1)
    sides = split_sides(mesh, no_region(mesh))
    nodes = displacement_nodes(mesh, sides)
    np.testing.assert_allclose(nodes.weights @ mesh.vertices, middles(mesh, nodes), atol=1e-12)


def _off_sphere(vertices: np.ndarray) -> float:
    return float(np.abs(np.linalg.norm(vertices, axis=1) - 1.0).max())


def test_a_ball_comes_close_to_its_sphere() -> None:
    """Quadratic elements are third order in position, so far nearer than the flat facets."""
    mesh = sphere(3)
    flat = 1.0 - np.linalg.norm(mesh.vertices[mesh.triangles].mean(axis=1), axis=1).min()
    fine, _ = refined_surface(mesh, pieces=4)
    assert _off_sphere(fine) < 0.05 * flat


def test_flat_parts_of_finer_triangles_shrink_with_the_square_of_the_pieces() -> None:
    """What is left between the corners of the parts is their own sagitta: 1 / pieces^2."""
    mesh = sphere(2)
    gaps = []
    for pieces in (2, 4):
        vertices, triangles = refined_surface(mesh, pieces=pieces)
        middle = vertices[triangles].mean(axis=1)
        on = np.linalg.norm(vertices[triangles], axis=2).mean(axis=1)
        gaps.append(float((on - np.linalg.norm(middle, axis=1)).max()))
    assert gaps[0] / gaps[1] == pytest.approx(4.0, rel=0.1)


def test_a_box_stays_a_box() -> None:
    mesh = box((1.0, 2.0, 3.0), 2)
    vertices, triangles = refined_surface(mesh, pieces=3)
    inside = (vertices > mesh.vertices.min(axis=0) - 1e-12).all()
    assert inside
    assert (vertices < mesh.vertices.max(axis=0) + 1e-12).all()
    assert len(triangles) == 9 * len(mesh.triangles)
    # Corners are not merged, so the volume is summed over triangles; rounding only.
    assert enclosed_volume(TriangleMesh(vertices, triangles)) == pytest.approx(6.0, rel=1e-12)


def test_one_piece_is_the_mesh_itself() -> None:
    mesh = sphere(1)
    vertices, triangles = refined_surface(mesh, pieces=1)
    assert np.allclose(vertices[triangles], mesh.vertices[mesh.triangles], atol=1e-15)


def test_no_pieces_are_refused() -> None:
    with pytest.raises(InputError, match="pieces is 0"):
        refined_surface(sphere(1), pieces=0)


def some_places(count=6):
    b = np.random.default_rng(0).random((count, 3))
    return b / b.sum(axis=1)[:, None]


def test_shapes_are_one_at_their_own_node_only():
    np.testing.assert_allclose(quadratic_shapes(ELEMENT_NODES), np.eye(6), atol=1e-15)
    np.testing.assert_allclose(quadratic_shapes(some_places()).sum(axis=0), 1, rtol=1e-14)


def test_positions_and_normals_are_those_of_the_shapes():
    places, nodes = some_places(), np.random.default_rng(3).normal(size=(1, 6, 3))

    def position(there):
        return quadratic_shapes(there).T @ nodes[0]

    points = element_points(nodes, places)[0]
    np.testing.assert_allclose(points[:, :3], position(places), atol=1e-14)
    # A central difference of a quadratic has no error but round-off, 1e-16 / step.
    along = []
    for step in ([-1, 1, 0], [-1, 0, 1]):
        move = 1e-3 * np.array(step)
        along.append((position(places + move) - position(places - move)) / 2e-3)
    np.testing.assert_allclose(points[:, 3:], np.cross(*along), atol=1e-11)


def test_element_points_follow_a_parabolic_cap():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0.2, 0.9, 0]])
    flat = ELEMENT_NODES @ corners
    nodes = flat + np.outer(0.3 * flat[:, 0] ** 2 - 0.1 * flat[:, 0] * flat[:, 1], [0, 0, 1])
    places = some_places()
    x, y, z, nx, ny, nz = element_points(nodes[None], places)[0].T
    np.testing.assert_allclose(z, 0.3 * x**2 - 0.1 * x * y, atol=1e-15)
    # Normal of z = f(x, y) is (-f_x, -f_y, 1); its z part is the area of the projection, twice
    # 0.45.
    np.testing.assert_allclose(nz, 0.9, rtol=1e-14)
    np.testing.assert_allclose(nx / nz, -(0.6 * x - 0.1 * y), atol=1e-14)
    np.testing.assert_allclose(ny / nz, 0.1 * x, atol=1e-14)


def test_spheres_hold_their_elements():
    nodes = np.random.default_rng(1).normal(size=(4, 6, 3))
    centre, radius = element_spheres(nodes)
    distance = np.linalg.norm(nodes - centre[:, None], axis=2)
    assert (distance <= radius[:, None] * (1 + 1e-15)).all()
    np.testing.assert_allclose(centre, nodes[:, :3].mean(axis=1))


def test_points_of_their_own_are_those_of_each_triangle():
    rng = np.random.default_rng(2)
    nodes, places = rng.normal(size=(3, 6, 3)), rng.dirichlet([1, 1, 1], size=(3, 4))
    points = element_points(nodes, places)
    for k in range(3):
        alone = element_points(nodes[k : k + 1], places[k])[0]
        np.testing.assert_allclose(points[k], alone, rtol=1e-13, atol=1e-14)


def test_quarters_fill_their_cell_and_are_alike():
    cell = np.array([[[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.2, 0.2, 0.6]]])
    triangle, corners = quartered(np.array([5]), cell)
    assert triangle.tolist() == [5] * 4
    # A quarter of the area each, with the same orientation, and the same centroid together.
    np.testing.assert_allclose(np.linalg.det(corners), np.linalg.det(cell)[0] / 4, rtol=1e-13)
    np.testing.assert_allclose(corners.mean(axis=(0, 1)), cell.mean(axis=(0, 1)), rtol=1e-13)
    assert (corners.reshape(-1, 3) @ np.linalg.inv(cell[0]) > -1e-14).all()
