"""Every two things are paired once, and what is far is as far as it was asked to be."""

import numpy as np
import pytest

from palpate.bem.compressed.clusters import cluster_pairs, cluster_tree

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
        assert max(len(own) for own in members) <= most


def test_children_share_what_their_parent_holds(trees):
    tree = trees[3]
    for one, children in enumerate(tree.children):
        if children[0] >= 0:
            below = np.concatenate([tree.members(int(child)) for child in children])
            assert np.array_equal(below, tree.members(one))


def test_spheres_hold_their_things(trees):
    _, items, item_radius, _, tree = trees
    for one in range(len(tree.start)):
        own = tree.members(one)
        outside = np.linalg.norm(items[own] - tree.centre[one], axis=1) + item_radius[own]
        # The radius is the largest of these numbers itself.
        assert outside.max() <= tree.radius[one]


def test_every_pair_is_far_or_near_exactly_once(trees):
    *_, first, second = trees
    pairs = cluster_pairs(first, second, ADMISSIBILITY, np.zeros(len(second.start)))
    count = np.zeros((700, 900), dtype=int)
    for one in range(len(first.start)):
        for other in np.concatenate([pairs.far[one], pairs.near[one]]):
            count[np.ix_(first.members(one), second.members(int(other)))] += 1
    assert (count == 1).all()
    assert sum(len(x) for x in pairs.far) > 0


def test_what_is_far_lies_outside_the_widened_spheres(trees):
    points, items, item_radius, first, second = trees
    gap = np.full(len(second.start), 0.4)
    pairs = cluster_pairs(first, second, ADMISSIBILITY, gap)
    for one, far in enumerate(pairs.far):
        for other in far:
            own, its = first.members(one), second.members(int(other))
            from_first = np.linalg.norm(items[its] - first.centre[one], axis=1) - item_radius[its]
            from_second = np.linalg.norm(points[own] - second.centre[other], axis=1)
            # Rounding of a sum of lengths of one.
            assert from_first.min() >= ADMISSIBILITY[0] * first.radius[one] - 1e-12
            assert from_second.min() >= ADMISSIBILITY[1] * second.radius[other] - 1e-12
            assert from_second.min() >= second.radius[other] + 0.4 - 1e-12


def test_few_things_are_one_leaf_that_is_near_itself():
    tree = cluster_tree(np.random.default_rng(0).random((10, 3)), np.zeros(10), 32)
    pairs = cluster_pairs(tree, tree, ADMISSIBILITY, np.zeros(1))
    assert [x.tolist() for x in pairs.near] == [[0]]
    assert [x.tolist() for x in pairs.far] == [[]]
