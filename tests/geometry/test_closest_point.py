"""Closest points against closed forms, a brute-force minimum, and the laws of a projection."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from surfaces import box, sphere

from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    closest_points,
    distinct_points,
    ray_intersection,
    triangle_distances,
)


def _brute_force(mesh, point, steps=200):
    """Smallest distance to a dense grid of points on every triangle: an upper bound."""
    t = np.linspace(0.0, 1.0, steps + 1)
    b, c = (grid.ravel() for grid in np.meshgrid(t, t))
    keep = b + c <= 1.0 + 1e-12
    weights = np.stack([1.0 - b - c, b, c], axis=1)[keep]
    cloud = np.einsum("wv,eva->ewa", weights, mesh.vertices[mesh.triangles]).reshape(-1, 3)
    return np.linalg.norm(cloud - point, axis=1).min()


def test_points_around_a_box_have_the_closed_form():
    mesh = box(size=(1.0, 2.0, 3.0), cells=4)
    points = np.random.default_rng(0).uniform(-1.0, 4.0, size=(500, 3))
    size = np.array([1.0, 2.0, 3.0])
    outside = np.maximum(np.maximum(-points, points - size), 0.0)
    inside = np.minimum(points, size - points).min(axis=1)
    expected = np.where(inside > 0.0, inside, np.linalg.norm(outside, axis=1))
    # Coordinates of size 4 leave roundings of 1e-15; 1e-13 is a hundred of them.
    np.testing.assert_allclose(closest_points(mesh, points).distance, expected, atol=1e-13)


@pytest.mark.slow
def test_distance_is_the_brute_force_minimum():
    mesh = sphere(1, radius=0.04)
    points = np.random.default_rng(1).normal(scale=0.04, size=(40, 3))
    closest = closest_points(mesh, points)
    for point, distance in zip(points, closest.distance, strict=True):
        bound = _brute_force(mesh, point)
        # The nearest grid point is at most one spacing (edge / 200) from the closest point.
        assert distance <= bound + 1e-15
        assert distance >= bound - 0.04 / 200


def test_one_large_triangle_among_small_ones_is_found():
    fine = box(size=(0.1, 0.1, 0.1), cells=6)
    large = np.array([[-5.0, -5.0, 0.3], [5.0, -5.0, 0.3], [0.0, 9.0, 0.3]])
    mesh = TriangleMesh(
        np.concatenate([fine.vertices, large]),
        np.concatenate([fine.triangles, [len(fine.vertices) + np.arange(3)]]),
    )
    points = np.array([[2.0, -4.0, 0.5], [0.05, 0.05, 0.29], [0.05, 0.05, 0.12]])
    closest = closest_points(mesh, points)
    np.testing.assert_allclose(closest.distance, [0.2, 0.01, 0.02], atol=1e-14)
    assert closest.triangle[:2].tolist() == [len(fine.triangles)] * 2
    assert closest.triangle[2] < len(fine.triangles)


def test_vertices_are_their_own_closest_points_exactly():
    mesh = sphere(2)
    closest = closest_points(mesh, mesh.vertices)
    # |v| = 1: the weights may carry one rounding.
    assert closest.distance.max() < 1e-15
    assert np.abs(closest.barycentric.max(axis=1) - 1.0).max() < 1e-15


@given(seed=st.integers(0, 10_000), shift=st.floats(-1.0, 1.0), scale=st.floats(1e-3, 1e3))
@settings(max_examples=30, deadline=None)
def test_projection_obeys_its_laws(seed, shift, scale):
    """Weights are convex, projecting twice changes nothing, and size and place do not matter."""
    rng = np.random.default_rng(seed)
    mesh, points = sphere(1), rng.normal(size=(20, 3))
    closest = closest_points(mesh, points)
    assert closest.barycentric.min() >= 0.0
    np.testing.assert_allclose(closest.barycentric.sum(axis=1), 1.0, atol=1e-14)
    assert closest_points(mesh, closest.position).distance.max() < 1e-14
    moved = TriangleMesh(scale * (mesh.vertices + shift), mesh.triangles)
    again = closest_points(moved, scale * (points + shift))
    np.testing.assert_allclose(again.distance, scale * closest.distance, atol=1e-13 * scale)


def test_triangle_distances_agree_with_the_closest_point():
    mesh, point = sphere(2), np.array([0.3, -0.9, 0.8])
    distances = triangle_distances(mesh, point)
    closest = closest_points(mesh, point[None])
    assert distances.min() == pytest.approx(closest.distance[0], abs=1e-15)
    assert distances[closest.triangle[0]] == distances.min()


def test_points_of_several_sets_are_told_apart_by_place():
    mesh = sphere(2)
    rng = np.random.default_rng(4)
    points = rng.normal(size=(30, 3))
    sets = [closest_points(mesh, points[rng.integers(0, 30, count)]) for count in (25, 1, 40)]
    every, numbers = distinct_points(sets)
    assert len(np.unique(every.position, axis=0)) == len(every.position) <= 30
    for single, number in zip(sets, numbers, strict=True):
        for name in ("triangle", "barycentric", "position", "distance"):
            assert np.array_equal(getattr(every, name)[number], getattr(single, name))


def test_no_points_give_no_answer():
    closest = closest_points(box(), np.zeros((0, 3)))
    assert closest.position.shape == (0, 3)


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(InputError, match="points has 1 entries that are not finite"):
        closest_points(box(), np.array([[0.0, np.nan, 0.0]]))


def test_rays_meet_the_cube_where_they_enter_its_slabs():
    mesh = box(size=(0.04, 0.04, 0.04), cells=2)
    draws = np.random.default_rng(3)
    met = 0
    for _ in range(40):
        start = 0.02 + 0.1 * np.sign(draws.normal(size=3)) * draws.uniform(0.5, 1.0, 3)
        way = 0.02 + 0.02 * draws.normal(size=3) - start
        # Between 0 and 40 mm along x, y and z at once, from the latest entry to the first exit.
        times = np.sort((np.array([[0.0], [0.04]]) - start) / way, axis=0)
        enters, leaves = times[0].max(), times[1].min()
        hit = ray_intersection(mesh, start, way)
        assert (hit is not None) == (enters < leaves)
        if hit is not None:
            met += 1
            np.testing.assert_allclose(hit, start + enters * way, atol=1e-12)
    assert 10 < met < 40
