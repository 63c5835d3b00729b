"""Six-node triangles: shape functions, points and cells against exact values and derivatives."""

import numpy as np

from palpate.geometry import (
    ELEMENT_NODES,
    element_points,
    element_spheres,
    quadratic_shapes,
    quartered,
)


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

    found = element_points(nodes, places)[0]
    np.testing.assert_allclose(found[:, :3], position(places), atol=1e-14)
    # A central difference of a quadratic has no error but round-off, 1e-16 / step.
    along = []
    for step in ([-1, 1, 0], [-1, 0, 1]):
        move = 1e-3 * np.array(step)
        along.append((position(places + move) - position(places - move)) / 2e-3)
    np.testing.assert_allclose(found[:, 3:], np.cross(*along), atol=1e-11)


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
    found = element_points(nodes, places)
    for k in range(3):
        alone = element_points(nodes[k : k + 1], places[k])[0]
        np.testing.assert_allclose(found[k], alone, rtol=1e-13, atol=1e-14)


def test_quarters_fill_their_cell_and_are_alike():
    cell = np.array([[[0.7, 0.2, 0.1], [0.1, 0.8, 0.1], [0.2, 0.2, 0.6]]])
    triangle, corners = quartered(np.array([5]), cell)
    assert triangle.tolist() == [5] * 4
    # A quarter of the area each, with the same orientation, and the same centroid together.
    np.testing.assert_allclose(np.linalg.det(corners), np.linalg.det(cell)[0] / 4, rtol=1e-13)
    np.testing.assert_allclose(corners.mean(axis=(0, 1)), cell.mean(axis=(0, 1)), rtol=1e-13)
    assert (corners.reshape(-1, 3) @ np.linalg.inv(cell[0]) > -1e-14).all()
