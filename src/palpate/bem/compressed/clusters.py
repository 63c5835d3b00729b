"""Trees of clusters of points or triangles, and their far and near pairs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from palpate.bem.integrals.kelvin import LANES


@dataclass(frozen=True, slots=True, eq=False)
class ClusterTree:
    """Binary tree of clusters of items in space, parents before their children.

    Attributes
    ----------
    order : (n,) int              the items, those of a cluster one after the other
    start, stop : (c,) int        where each cluster begins and ends in `order`
    children : (c, 2) int         -1 for a leaf
    centre : (c, 3) float [m]
    radius : (c,) float [m]       of a sphere about the centre that contains all items of a cluster
    """

    order: Int[np.ndarray, " n"]
    start: Int[np.ndarray, " c"]
    stop: Int[np.ndarray, " c"]
    children: Int[np.ndarray, "c 2"]
    centre: Float[np.ndarray, "c 3"]
    radius: Float[np.ndarray, " c"]

    @property
    def leaves(self) -> Int[np.ndarray, " l"]:
        """Clusters without children, (l,) int."""
        return np.flatnonzero(self.children[:, 0] < 0)

    def members(self, cluster: int | np.integer) -> Int[np.ndarray, " k"]:
        """The items of a cluster, (k,) int."""
        return self.order[self.start[cluster] : self.stop[cluster]]


def cluster_tree(
    position: Float[np.ndarray, "n 3"], item_radius: Float[np.ndarray, " n"], leaf_size: int
) -> ClusterTree:
    """Bisect items across their longest extent until every part is small.

    Parameters
    ----------
    position : (n, 3) float [m]   position of each item
    item_radius : (n,) float [m]  radius of a sphere about its position that contains each item
    leaf_size : int               largest number of items in a leaf; a part is cut at a multiple of
                                  `LANES` where it is large enough

    Returns
    -------
    ClusterTree
    """
    order = np.arange(len(position))
    bounds, children = [(0, len(position))], []
    centre, radius = [], []
    # The list grows within the loop: children are appended to all clusters found before.
    for start, stop in bounds:
        own = order[start:stop]
        low, high = position[own].min(axis=0), position[own].max(axis=0)
        centre.append(0.5 * (low + high))
        distance = np.linalg.norm(position[own] - centre[-1], axis=1)
        radius.append(float((distance + item_radius[own]).max()))
        if stop - start <= leaf_size:
            children.append((-1, -1))
            continue
        along = position[own, int(np.argmax(high - low))]
        order[start:stop] = own[np.argsort(along, kind="stable")]
        half = (stop - start) // 2
        middle = start + max(half // LANES, 1) * LANES if half > LANES else start + half
        children.append((len(bounds), len(bounds) + 1))
        bounds += [(start, middle), (middle, stop)]
    begin, end = np.array(bounds).T
    return ClusterTree(order, begin, end, np.array(children), np.array(centre), np.array(radius))


@dataclass(frozen=True, slots=True, eq=False)
class ClusterPairs:
    """Far pairs of clusters of two trees, and near pairs of their leaves.

    Attributes
    ----------
    far : list of (k,) int        for each cluster of the first tree, the clusters of the second
                                  that are far from it, each pair at the highest possible level
    near : list of (k,) int       for each leaf of the first tree, the near leaves of the second;
                                  empty for other clusters
    """

    far: list[Int[np.ndarray, " _"]]
    near: list[Int[np.ndarray, " _"]]


def far_clusters(tree: ClusterTree, far: list[Int[np.ndarray, " _"]]) -> Bool[np.ndarray, " c"]:
    """Clusters that belong to a far pair, by themselves or as parts of larger ones.

    Parameters
    ----------
    tree : ClusterTree
    far : list of (k,) int        its clusters that are far from each cluster of another tree

    Returns
    -------
    (c,) bool
    """
    is_far = np.zeros(len(tree.start), dtype=bool)
    is_far[np.concatenate([np.zeros(0, dtype=np.int64), *far])] = True
    for one, children in enumerate(tree.children):
        if is_far[one] and children[0] >= 0:
            is_far[children] = True
    return is_far


def cluster_pairs(
    first: ClusterTree,
    second: ClusterTree,
    admissibility: tuple[float, float],
    gap: Float[np.ndarray, " c"],
) -> ClusterPairs:
    """Pair the clusters of two trees so that every pair of items is covered exactly once.

    Parameters
    ----------
    first, second : ClusterTree
    admissibility : (float, float)    least distance of a far partner from a cluster's centre, in
                                  radii of the cluster, for the first tree and for the second
    gap : (c,) float [m]          least distance of a far partner from the sphere of each cluster of
                                  the second tree

    Returns
    -------
    ClusterPairs
    """
    far: list[list[int]] = [[] for _ in first.start]
    near: list[list[int]] = [[] for _ in first.start]
    pending = np.zeros((1, 2), dtype=np.int64)
    while pending.size:
        a, b = pending.T
        distance = np.linalg.norm(first.centre[a] - second.centre[b], axis=1)
        radius_a, radius_b = first.radius[a], second.radius[b]
        admissible = distance - radius_b >= admissibility[0] * radius_a
        admissible &= distance - radius_a >= np.maximum(
            admissibility[1] * radius_b, radius_b + gap[b]
        )
        is_leaf_a, is_leaf_b = first.children[a, 0] < 0, second.children[b, 0] < 0
        near_leaves = ~admissible & is_leaf_a & is_leaf_b
        for pairs, chosen in ((far, admissible), (near, near_leaves)):
            for i, j in pending[chosen]:
                pairs[i].append(int(j))
        open_pairs = ~admissible & ~near_leaves
        # The larger of the two clusters is divided.
        divide_a = open_pairs & ~is_leaf_a & (is_leaf_b | (radius_a >= radius_b))
        divide_b = open_pairs & ~divide_a
        pending = np.concatenate(
            [np.stack([first.children[a[divide_a], k], b[divide_a]], axis=1) for k in (0, 1)]
            + [np.stack([a[divide_b], second.children[b[divide_b], k]], axis=1) for k in (0, 1)]
        )
    return ClusterPairs(
        [np.array(sorted(x), dtype=np.int64) for x in far],
        [np.array(sorted(x), dtype=np.int64) for x in near],
    )
