"""Every two things are paired once, and what is far is as far as it was asked to be."""

import numpy as np
import pytest

from palpate.bem.compressed.clusters import (
    charge_sphere,
    cluster_pairs,
    cluster_tree,
    interpolative_decomposition,
    inverse_distances,
    points_on_sphere,
)

ADMISSIBILITY = (1.5, 2.0)


@pytest.fixture(scope="module")
def trees():
    rng = np.random.default_rng(3)
    points, items = rng.random((700, 3)), rng.random((900, 3))
    item_radius = 0.02 * rng.random(900)
    first = cluster_tree(points, np.zeros(700), 32)
    return points, items, item_radius, first, cluster_tree(items, item_radius, 20)


def test_leaves_hold_everything_once_and_no_more_than_asked(trees):
    *_, first, second = trees
    for tree, count, most in ((first, 700, 32), (second, 900, 20)):
        members = [tree.members(leaf) for leaf in tree.leaves]
        assert np.array_equal(np.sort(np.concatenate(members)), np.arange(count))
        assert max(len(leaf) for leaf in members) <= most


def test_children_share_what_their_parent_holds(trees):
    tree = trees[3]
    for cluster, children in enumerate(tree.children):
        if children[0] >= 0:
            below = np.concatenate([tree.members(int(child)) for child in children])
            assert np.array_equal(below, tree.members(cluster))


def test_spheres_hold_their_things(trees):
    _, items, item_radius, _, tree = trees
    for cluster in range(len(tree.start)):
        members = tree.members(cluster)
        outside = (
            np.linalg.norm(items[members] - tree.centre[cluster], axis=1) + item_radius[members]
        )
        # The radius is the largest of these numbers itself.
        assert outside.max() <= tree.radius[cluster]


def test_every_pair_is_far_or_near_exactly_once(trees):
    *_, first, second = trees
    far_pairs, near_pairs = cluster_pairs(first, second, ADMISSIBILITY, np.zeros(len(second.start)))
    count = np.zeros((700, 900), dtype=int)
    for cluster in range(len(first.start)):
        for other in np.concatenate([far_pairs[cluster], near_pairs[cluster]]):
            count[np.ix_(first.members(cluster), second.members(int(other)))] += 1
    assert (count == 1).all()
    assert sum(len(x) for x in far_pairs) > 0


def test_what_is_far_lies_outside_the_widened_spheres(trees):
    points, items, item_radius, first, second = trees
    gap = np.full(len(second.start), 0.4)
    far_pairs, _ = cluster_pairs(first, second, ADMISSIBILITY, gap)
    for cluster, far in enumerate(far_pairs):
        for other in far:
            members, its = first.members(cluster), second.members(int(other))
            from_first = (
                np.linalg.norm(items[its] - first.centre[cluster], axis=1) - item_radius[its]
            )
            from_second = np.linalg.norm(points[members] - second.centre[other], axis=1)
            # Rounding of a sum of lengths of one.
            assert from_first.min() >= ADMISSIBILITY[0] * first.radius[cluster] - 1e-12
            assert from_second.min() >= ADMISSIBILITY[1] * second.radius[other] - 1e-12
            assert from_second.min() >= second.radius[other] + 0.4 - 1e-12


def test_few_things_are_one_leaf_that_is_near_itself():
    tree = cluster_tree(np.random.default_rng(0).random((10, 3)), np.zeros(10), 32)
    far_pairs, near_pairs = cluster_pairs(tree, tree, ADMISSIBILITY, np.zeros(1))
    assert [x.tolist() for x in near_pairs] == [[0]]
    assert [x.tolist() for x in far_pairs] == [[]]


def test_inverse_distances():
    rng = np.random.default_rng(0)
    a, b = rng.random((4, 3)), 2.0 + rng.random((5, 3))
    wanted = 1.0 / np.linalg.norm(a[:, None] - b[None], axis=2)
    # A square root and a division, each rounded once, in fast arithmetic.
    assert np.abs(inverse_distances(a, b) / wanted - 1.0).max() < 1e-14


def test_points_on_a_sphere_are_spread_evenly():
    points = points_on_sphere(500)
    assert np.abs(np.linalg.norm(points, axis=1) - 1.0).max() < 1e-15 * 10
    # Moments of even points: zero, and a third of the unit matrix, but for one over their number.
    assert np.abs(points.mean(axis=0)).max() < 1 / 500
    assert np.abs(points.T @ points / 500 - np.eye(3) / 3).max() < 1 / 500


@pytest.mark.parametrize(("count", "most"), [(100, 1e-4), (200, 2e-7)])
def test_charges_stand_for_all_sources_inside(count, most):
    sphere = charge_sphere(count, 2.5)
    rng = np.random.default_rng(1)
    inside = rng.normal(size=(60, 3))
    inside *= (0.8 * rng.random(60) / np.linalg.norm(inside, axis=1))[:, None]
    strength = rng.random(60)
    charges = (strength @ inverse_distances(inside, sphere.check)) @ sphere.check_to_charge
    outside = 2.5 * points_on_sphere(91)
    outside[::2] *= 3.0
    wanted = strength @ inverse_distances(inside, outside)
    potential = charges @ inverse_distances(sphere.charge, outside)
    # Harmonics that k charges do not tell apart, of a degree of about the root of k, have fallen
    # with (0.8 / 2.5)^degree.
    assert np.abs(potential / wanted - 1.0).max() < most


def test_skeleton_points_interpolate_the_others():
    rng = np.random.default_rng(2)
    cluster = np.column_stack([rng.random((80, 2)), np.zeros(80)])
    around = np.array([0.5, 0.5, 0.0]) + 2.5 * points_on_sphere(300)
    values = inverse_distances(cluster, around)
    for tolerance in (1e-3, 1e-6):
        chosen, weights = interpolative_decomposition(values, tolerance)
        assert len(chosen) < 80
        left = np.abs(values - weights @ values[chosen])
        # The tolerance is of the diagonal of R; what it leaves out adds up over the points.
        assert left.max() < 10 * tolerance * np.abs(values).max()
        assert np.array_equal(weights[chosen], np.eye(len(chosen)))
