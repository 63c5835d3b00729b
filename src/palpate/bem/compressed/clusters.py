"""Trees of clusters of points or triangles, and equivalent charges in place of all sources in one.

Outside a sphere, sources inside it have the same potential as charges on it. Charges that match
this potential at check points on a wider sphere match it everywhere beyond. Charges and check
points are the same for all clusters up to position and size, so one pseudo-inverse serves all.
From the values at skeleton points of a cluster those at all its others are interpolated.

Source
------
Ying, Biros and Zorin, J. Comput. Phys. 196 (2004): equivalent charges; Cheng, Gimbutas, Martinsson
and Rokhlin, SIAM J. Sci. Comput. 26 (2005): interpolative decomposition.
"""

from dataclasses import dataclass

import numba
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import qr, solve_triangular

from palpate.bem.integrals.kelvin import LANES

# Check points per charge.
_CHECK_POINTS_PER_CHARGE = 1.6
# Cutoff of the pseudo-inverse, relative to the largest singular value.
_CUTOFF = 1e-12


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
        members = order[start:stop]
        low, high = position[members].min(axis=0), position[members].max(axis=0)
        centre.append(0.5 * (low + high))
        distance = np.linalg.norm(position[members] - centre[-1], axis=1)
        radius.append(float((distance + item_radius[members]).max()))
        if stop - start <= leaf_size:
            children.append((-1, -1))
            continue
        along = position[members, int(np.argmax(high - low))]
        order[start:stop] = members[np.argsort(along, kind="stable")]
        half = (stop - start) // 2
        middle = start + max(half // LANES, 1) * LANES if half > LANES else start + half
        children.append((len(bounds), len(bounds) + 1))
        bounds += [(start, middle), (middle, stop)]
    begin, end = np.array(bounds).T
    return ClusterTree(order, begin, end, np.array(children), np.array(centre), np.array(radius))


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
    for cluster, children in enumerate(tree.children):
        if is_far[cluster] and children[0] >= 0:
            is_far[children] = True
    return is_far


def cluster_pairs(
    first: ClusterTree,
    second: ClusterTree,
    admissibility: tuple[float, float],
    gap: Float[np.ndarray, " c"],
) -> tuple[list[Int[np.ndarray, " _"]], list[Int[np.ndarray, " _"]]]:
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
    list of (k,) int              for each cluster of the first tree, the clusters of the second
                                  that are far from it, each pair at the highest possible level
    list of (k,) int              for each leaf of the first tree, the near leaves of the second;
                                  empty for other clusters
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
    return (
        [np.array(sorted(x), dtype=np.int64) for x in far],
        [np.array(sorted(x), dtype=np.int64) for x in near],
    )


@dataclass(frozen=True, slots=True, eq=False)
class ChargeSphere:
    """Equivalent charges for sources in the unit sphere.

    Attributes
    ----------
    charge : (k, 3) float         positions of the charges, on the unit sphere
    check : (p, 3) float          check points on a wider sphere, at which potentials are matched
    check_to_charge : (p, k) float    charges from the potentials there: values @ check_to_charge
    """

    charge: Float[np.ndarray, "k 3"]
    check: Float[np.ndarray, "p 3"]
    check_to_charge: Float[np.ndarray, "p k"]


def charge_sphere(count: int, check_radius: float) -> ChargeSphere:
    """Charges on the unit sphere, matched on a wider one.

    Parameters
    ----------
    count : int                   number of charges
    check_radius : float          > 1, radius of the wider sphere

    Returns
    -------
    ChargeSphere
    """
    charge = points_on_sphere(count)
    check = check_radius * points_on_sphere(int(_CHECK_POINTS_PER_CHARGE * count))
    check_to_charge = np.linalg.pinv(inverse_distances(check, charge), rcond=_CUTOFF).T
    return ChargeSphere(charge, check, np.ascontiguousarray(check_to_charge))


def points_on_sphere(count: int) -> Float[np.ndarray, "n 3"]:
    """Points that are spread evenly over the unit sphere (Fibonacci's lattice).

    Parameters
    ----------
    count : int

    Returns
    -------
    (count, 3) float [-]            unit vectors
    """
    step = np.arange(count) + 0.5
    polar, turn = np.arccos(1.0 - 2.0 * step / count), np.pi * (1.0 + np.sqrt(5.0)) * step
    return np.stack(
        [np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1
    )


def inverse_distances(
    first: Float[np.ndarray, "n 3"], second: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "n m"]:
    """Reciprocal distance of every pair of points, (n, m) [1/m].

    Parameters
    ----------
    first, second : (_, 3) float [m]    without common points
    """
    out = np.empty((len(first), len(second)))
    fill_inverse_distances(first, np.ascontiguousarray(second.T), out)
    return out


@numba.njit(nogil=True, fastmath=True, error_model="numpy", cache=True)
def fill_inverse_distances(first, second, out):
    """`inverse_distances` written into an array.

    Parameters
    ----------
    first : (n, 3) float
    second : (3, m) float
    out : (n, m) float            overwritten
    """
    x, y, z = second[0], second[1], second[2]
    unity = out.dtype.type(1.0)
    for i in range(first.shape[0]):
        a, b, c = first[i, 0], first[i, 1], first[i, 2]
        row = out[i]
        for j in range(x.size):
            square = (x[j] - a) ** 2 + (y[j] - b) ** 2 + (z[j] - c) ** 2
            row[j] = unity / np.sqrt(square)


def interpolative_decomposition(
    values: Float[np.ndarray, "m p"], tolerance: float
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, "m k"]]:
    """Interpolative decomposition: the few rows of a matrix from which all others are interpolated.

    Parameters
    ----------
    values : (m, p) float         value of p functions at each of m points
    tolerance : float             smallest pivot that is kept, relative to the largest

    Returns
    -------
    (k,) int                      the chosen rows
    (m, k) float                  weights: values = weights @ values[rows], approximately
    """
    upper, pivot = qr(values.T, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(upper))
    rank = max(1, int((size > tolerance * size[0]).sum()))
    rest = solve_triangular(upper[:rank, :rank], upper[:rank, rank:], check_finite=False)
    weights = np.empty((len(values), rank))
    weights[pivot[:rank]] = np.eye(rank)
    weights[pivot[rank:]] = rest.T
    return pivot[:rank], weights
