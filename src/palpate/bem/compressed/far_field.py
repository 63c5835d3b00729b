"""The far field of the integral equations: harmonic functions of clusters of triangles, evaluated
at clusters of collocation points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.compressed.charges import (
    ChargeSphere,
    fill_inverse_distances,
    inverse_distances,
    telling_points,
)
from palpate.bem.compressed.clusters import ClusterTree
from palpate.bem.compressed.moments import LeafMoments, Mix
from palpate.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class Receivers:
    """Clusters of points, each with a skeleton: the few points from which all others interpolate.

    Attributes
    ----------
    tree : ClusterTree            of the points
    telling : list of (k, 3) float [m]    skeleton points of each cluster
    spread : list of (m, k) float         weights that interpolate from these to the points of a
                                          leaf, or to the skeleton points of both children
    """

    tree: ClusterTree
    telling: list[Float[np.ndarray, "_ 3"]]
    spread: list[Float[np.ndarray, "_ _"]]


def make_receivers(
    tree: ClusterTree,
    points: Float[np.ndarray, "r 3"],
    proxies: Float[np.ndarray, "p 3"],
    tolerance: float,
) -> Receivers:
    """Choose the skeleton points of every cluster, from the leaves up.

    Parameters
    ----------
    tree : ClusterTree
    points : (r, 3) float [m]
    proxies : (p, 3) float        positions of proxy charges around the unit sphere, which stand for
                                  all far sources
    tolerance : float             relative error of interpolated values

    Returns
    -------
    Receivers
    """
    count = len(tree.start)
    telling = [np.zeros((0, 3))] * count
    spread = [np.zeros((0, 0))] * count
    for one in range(count - 1, -1, -1):
        children = tree.children[one]
        if children[0] < 0:
            candidates = points[tree.members(one)]
        else:
            candidates = np.concatenate([telling[child] for child in children])
        around = tree.centre[one] + tree.radius[one] * proxies
        chosen, weights = telling_points(inverse_distances(candidates, around), tolerance)
        telling[one], spread[one] = candidates[chosen], weights.astype(np.float32)
    return Receivers(tree, telling, spread)


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Products of the far field with vectors.

    Attributes
    ----------
    sources : ClusterTree                 of the triangles
    moments : dict of LeafMoments         of its leaves that belong to a far pair
    lifts : dict of (k, 2 k) float        of its larger clusters that do: their charges from those
                                          of their children
    receivers : Receivers
    far : list of (k,) int                clusters of triangles that are far from each cluster of
                                          points
    sphere : ChargeSphere
    offset : (r, 3) float [m]             of every point from the centre of its leaf
    """

    sources: ClusterTree
    moments: dict[int, LeafMoments]
    lifts: dict[int, Float[np.ndarray, "k h"]]
    receivers: Receivers
    far: list[Int[np.ndarray, " _"]]
    sphere: ChargeSphere
    offset: Float[np.ndarray, "r 3"]

    def apply(
        self, mix: Mix, moved: Float[np.ndarray, "v 3 c"], pressed: Float[np.ndarray, "h 3 c"]
    ) -> Float[np.ndarray, "r 3 c"]:
        """Far-field part of the equations at every collocation point.

        Parameters
        ----------
        mix : Mix                         weights of their parts
        moved : (v, 3, c) float [m]       displacement of all vertices
        pressed : (h, 3, c) float         traction of all held sides, scaled as `mix` requires

        Returns
        -------
        (r, 3, c) float
        """
        if not self.moments:
            return np.zeros((len(self.offset), 3, moved.shape[2]), dtype=moved.dtype)
        charges = self._gathered(mix, moved, pressed)
        values = [np.zeros((0, 4, 0))] * len(self.far)
        in_threads(self._receive, len(self.far), charges, values)
        return self._spread(values, moved.shape[2])

    def _gathered(
        self, mix: Mix, moved: Float[np.ndarray, "v 3 c"], pressed: Float[np.ndarray, "h 3 c"]
    ) -> Float[np.ndarray, "s k 4 c"]:
        """Charges of all clusters of triangles, from the leaves up."""
        tree, sphere = self.sources, self.sphere
        shape = len(tree.start), len(sphere.charge), 4, moved.shape[2]
        charges = np.zeros(shape, dtype=moved.dtype)
        leaves = np.array(sorted(self.moments))

        def start(begin: int, end: int) -> None:
            for leaf in leaves[begin:end]:
                charges[leaf] = self.moments[int(leaf)].charges(mix, moved, pressed)

        in_threads(start, leaves.size)
        parents = np.array(sorted(self.lifts), dtype=np.int64)
        # Clusters of one level do not depend on each other; the deepest level is first.
        for level in _levels(tree)[::-1]:
            own = level[np.isin(level, parents)]
            in_threads(lambda begin, end, own=own: self._lift(own[begin:end], charges), own.size)
        return charges

    def _lift(self, parents: Int[np.ndarray, " p"], charges: Float[np.ndarray, "s k 4 c"]) -> None:
        """Charges of some clusters from those of their children."""
        tree = self.sources
        for one in parents:
            parts = tree.children[one]
            shifted = [recentred(charges[k], tree.centre[one] - tree.centre[k]) for k in parts]
            halves = np.concatenate(shifted).reshape(-1, 4 * charges.shape[3])
            charges[one] = (self.lifts[int(one)] @ halves).reshape(charges.shape[1:])

    def _receive(
        self,
        begin: int,
        end: int,
        charges: Float[np.ndarray, "s k 4 c"],
        values: list[Float[np.ndarray, "_ 4 _"]],
    ) -> None:
        """Values at the skeleton points of some clusters, due to the sources far from each."""
        tree, sphere, own = self.sources, self.sphere, self.receivers
        for one in range(begin, end):
            seen, points = self.far[one], own.telling[one]
            columns = charges.shape[3]
            values[one] = np.zeros((len(points), 4, columns), dtype=charges.dtype)
            if not seen.size:
                continue
            # Relative to the centre: in single precision, absolute positions would lose digits.
            shift = own.tree.centre[one] - tree.centre[seen]
            place = tree.radius[seen, None, None] * sphere.charge - shift[:, None]
            place = np.ascontiguousarray(place.reshape(-1, 3).T, dtype=np.float32)
            points = (points - own.tree.centre[one]).astype(np.float32)
            # Indexing has copied it: it may be changed in place.
            shifted = charges[seen]
            shifted[:, :, :3] += shift[:, None, :, None].astype(shifted.dtype) * shifted[:, :, 3:]
            kernel = np.empty((len(points), place.shape[1]), dtype=np.float32)
            fill_inverse_distances(points, place, kernel)
            found = kernel @ shifted.reshape(kernel.shape[1], -1)
            values[one] = found.reshape(values[one].shape)

    def _spread(
        self, values: list[Float[np.ndarray, "_ 4 _"]], columns: int
    ) -> Float[np.ndarray, "r 3 c"]:
        """Values at all points, interpolated from the largest clusters down."""
        tree, spread = self.receivers.tree, self.receivers.spread
        out = np.empty((len(self.offset), 3, columns), dtype=values[0].dtype)
        for one, children in enumerate(tree.children):
            weights = spread[one]
            told = (weights @ values[one].reshape(weights.shape[1], -1)).reshape(-1, 4, columns)
            values[one] = np.zeros((0, 4, 0))
            if children[0] < 0:
                points = tree.members(one)
                out[points] = told[:, :3] + self.offset[points][:, :, None] * told[:, 3:]
                continue
            first = 0
            for child in children:
                last = first + spread[child].shape[1]
                shift = tree.centre[child] - tree.centre[one]
                values[child] = values[child] + recentred(told[first:last], shift)
                first = last
        return out


def recentred(
    functions: Float[np.ndarray, "... 4 c"], shift: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 4 c"]:
    """F and psi of the same field, F + (y - c) psi, about another centre.

    Parameters
    ----------
    functions : (..., 4, c) float
    shift : (..., 3) float [m]        from the old centre to the new one
    """
    out = functions.copy()
    out[..., :3, :] += shift[..., :, None].astype(out.dtype) * functions[..., 3:, :]
    return out


def make_lifts(
    tree: ClusterTree, parents: Int[np.ndarray, " p"], sphere: ChargeSphere
) -> dict[int, Float[np.ndarray, "k h"]]:
    """Matrices that give the charges of clusters from those of their children.

    Parameters
    ----------
    tree : ClusterTree
    parents : (p,) int            clusters that have children
    sphere : ChargeSphere
    """
    lifts: dict[int, np.ndarray] = {}

    def fill(begin: int, end: int) -> None:
        for one in parents[begin:end]:
            check = tree.centre[one] + tree.radius[one] * sphere.check
            halves = tree.children[one]
            place = [tree.centre[k] + tree.radius[k] * sphere.charge for k in halves]
            seen = inverse_distances(check, np.concatenate(place))
            lifts[int(one)] = (tree.radius[one] * sphere.matched.T @ seen).astype(np.float32)

    in_threads(fill, parents.size)
    return lifts


def _levels(tree: ClusterTree) -> list[Int[np.ndarray, " _"]]:
    """Clusters by their depth in the tree."""
    levels = [np.zeros(1, dtype=np.int64)]
    while True:
        below = tree.children[levels[-1]].ravel()
        below = below[below >= 0]
        if not below.size:
            return levels
        levels.append(below)
