"""The far field of the integral equations: harmonic functions of clusters of triangles, evaluated
at clusters of collocation points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from palpate.bem.compressed.charges import (
    ChargeSphere,
    fill_inverse_distances,
    interpolative_decomposition,
    inverse_distances,
)
from palpate.bem.compressed.clusters import ClusterTree
from palpate.bem.compressed.moments import KernelWeights, LeafMoments
from palpate.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class Receivers:
    """Clusters of points, each with a skeleton: the few points from which all others interpolate.

    Attributes
    ----------
    tree : ClusterTree            of the points
    skeleton : list of (k, 3) float [m]   skeleton points of each cluster
    interpolation : list of (m, k) float  weights that interpolate from these to the points of a
                                          leaf, or to the skeleton points of both children
    """

    tree: ClusterTree
    skeleton: list[Float[np.ndarray, "_ 3"]]
    interpolation: list[Float[np.ndarray, "_ _"]]


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
    skeleton = [np.zeros((0, 3))] * count
    interpolation = [np.zeros((0, 0))] * count
    for one in range(count - 1, -1, -1):
        children = tree.children[one]
        if children[0] < 0:
            candidates = points[tree.members(one)]
        else:
            candidates = np.concatenate([skeleton[child] for child in children])
        around = tree.centre[one] + tree.radius[one] * proxies
        chosen, weights = interpolative_decomposition(
            inverse_distances(candidates, around), tolerance
        )
        skeleton[one], interpolation[one] = candidates[chosen], weights.astype(np.float32)
    return Receivers(tree, skeleton, interpolation)


@dataclass(frozen=True, slots=True, eq=False)
class FarField:
    """Products of the far field with vectors.

    Attributes
    ----------
    sources : ClusterTree                 of the triangles
    moments : dict of LeafMoments         of its leaves that belong to a far pair
    child_to_parent : dict of (k, 2 k) float    of its larger clusters that do: their charges from
                                          those of their children
    receivers : Receivers
    far : list of (k,) int                clusters of triangles that are far from each cluster of
                                          points
    sphere : ChargeSphere
    offset : (r, 3) float [m]             of every point from the centre of its leaf
    """

    sources: ClusterTree
    moments: dict[int, LeafMoments]
    child_to_parent: dict[int, Float[np.ndarray, "k h"]]
    receivers: Receivers
    far: list[Int[np.ndarray, " _"]]
    sphere: ChargeSphere
    offset: Float[np.ndarray, "r 3"]

    def apply(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "r 3 c"]:
        """Far-field part of the equations at every collocation point.

        Parameters
        ----------
        weights : KernelWeights           of the parts of the equations
        displacement : (v, 3, c) float [m]    of all vertices
        traction : (h, 3, c) float        of all held sides, scaled as `weights` requires

        Returns
        -------
        (r, 3, c) float
        """
        if not self.moments:
            return np.zeros((len(self.offset), 3, displacement.shape[2]), dtype=displacement.dtype)
        charges = self._cluster_charges(weights, displacement, traction)
        values = [np.zeros((0, 4, 0))] * len(self.far)
        in_threads(self._receive, len(self.far), charges, values)
        return self._interpolated(values, displacement.shape[2])

    def _cluster_charges(
        self,
        weights: KernelWeights,
        displacement: Float[np.ndarray, "v 3 c"],
        traction: Float[np.ndarray, "h 3 c"],
    ) -> Float[np.ndarray, "s k 4 c"]:
        """Charges of all clusters of triangles, from the leaves up."""
        tree, sphere = self.sources, self.sphere
        shape = len(tree.start), len(sphere.charge), 4, displacement.shape[2]
        charges = np.zeros(shape, dtype=displacement.dtype)
        leaves = np.array(sorted(self.moments))

        def leaf_charges(begin: int, end: int) -> None:
            for leaf in leaves[begin:end]:
                charges[leaf] = self.moments[int(leaf)].charges(weights, displacement, traction)

        in_threads(leaf_charges, leaves.size)
        parents = np.array(sorted(self.child_to_parent), dtype=np.int64)
        # Clusters of one level do not depend on each other; the deepest level is first.
        for level in _levels(tree)[::-1]:
            own = level[np.isin(level, parents)]
            in_threads(
                lambda begin, end, own=own: self._merge_children(own[begin:end], charges), own.size
            )
        return charges

    def _merge_children(
        self, parents: Int[np.ndarray, " p"], charges: Float[np.ndarray, "s k 4 c"]
    ) -> None:
        """Charges of some clusters from those of their children."""
        tree = self.sources
        for one in parents:
            parts = tree.children[one]
            shifted = [recentred(charges[k], tree.centre[one] - tree.centre[k]) for k in parts]
            halves = np.concatenate(shifted).reshape(-1, 4 * charges.shape[3])
            charges[one] = (self.child_to_parent[int(one)] @ halves).reshape(charges.shape[1:])

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
            far, skeleton = self.far[one], own.skeleton[one]
            columns = charges.shape[3]
            values[one] = np.zeros((len(skeleton), 4, columns), dtype=charges.dtype)
            if not far.size:
                continue
            # Relative to the centre: in single precision, absolute positions would lose digits.
            shift = own.tree.centre[one] - tree.centre[far]
            charge_positions = tree.radius[far, None, None] * sphere.charge - shift[:, None]
            charge_positions = np.ascontiguousarray(
                charge_positions.reshape(-1, 3).T, dtype=np.float32
            )
            skeleton = (skeleton - own.tree.centre[one]).astype(np.float32)
            # Indexing has copied it: it may be changed in place.
            shifted = charges[far]
            shifted[:, :, :3] += shift[:, None, :, None].astype(shifted.dtype) * shifted[:, :, 3:]
            kernel = np.empty((len(skeleton), charge_positions.shape[1]), dtype=np.float32)
            fill_inverse_distances(skeleton, charge_positions, kernel)
            products = kernel @ shifted.reshape(kernel.shape[1], -1)
            values[one] = products.reshape(values[one].shape)

    def _interpolated(
        self, values: list[Float[np.ndarray, "_ 4 _"]], columns: int
    ) -> Float[np.ndarray, "r 3 c"]:
        """Values at all points, interpolated from the largest clusters down."""
        tree, interpolation = self.receivers.tree, self.receivers.interpolation
        out = np.empty((len(self.offset), 3, columns), dtype=values[0].dtype)
        for one, children in enumerate(tree.children):
            weights = interpolation[one]
            interpolated = (weights @ values[one].reshape(weights.shape[1], -1)).reshape(
                -1, 4, columns
            )
            values[one] = np.zeros((0, 4, 0))
            if children[0] < 0:
                points = tree.members(one)
                out[points] = (
                    interpolated[:, :3] + self.offset[points][:, :, None] * interpolated[:, 3:]
                )
                continue
            first = 0
            for child in children:
                last = first + interpolation[child].shape[1]
                shift = tree.centre[child] - tree.centre[one]
                values[child] = values[child] + recentred(interpolated[first:last], shift)
                first = last
        return out


def recentred(
    functions: Float[np.ndarray, "... 4 c"], shift: Float[np.ndarray, "... 3"]
) -> Float[np.ndarray, "... 4 c"]:
    """F and psi of the same field, F + (y - c) psi, about another centre.

    Parameters
    ----------
    functions : (..., 4, c) float     three components of F, then psi [that of F / m]
    shift : (..., 3) float [m]        from the old centre to the new one

    Returns
    -------
    (..., 4, c) float                 in the units of `functions`
    """
    out = functions.copy()
    out[..., :3, :] += shift[..., :, None].astype(out.dtype) * functions[..., 3:, :]
    return out


def make_child_to_parent(
    tree: ClusterTree, parents: Int[np.ndarray, " p"], sphere: ChargeSphere
) -> dict[int, Float[np.ndarray, "k h"]]:
    """Matrices that give the charges of clusters from those of their children.

    Parameters
    ----------
    tree : ClusterTree
    parents : (p,) int            clusters that have children
    sphere : ChargeSphere

    Returns
    -------
    dict of int to (k, h) float32 [-]    parent -> matrix from the h charges of both its children to
                                      its own k charges
    """
    child_to_parent: dict[int, np.ndarray] = {}

    def match(begin: int, end: int) -> None:
        for one in parents[begin:end]:
            check = tree.centre[one] + tree.radius[one] * sphere.check
            halves = tree.children[one]
            positions = [tree.centre[k] + tree.radius[k] * sphere.charge for k in halves]
            potentials = inverse_distances(check, np.concatenate(positions))
            child_to_parent[int(one)] = (
                tree.radius[one] * sphere.check_to_charge.T @ potentials
            ).astype(np.float32)

    in_threads(match, parents.size)
    return child_to_parent


def _levels(tree: ClusterTree) -> list[Int[np.ndarray, " _"]]:
    """Clusters by their depth in the tree."""
    levels = [np.zeros(1, dtype=np.int64)]
    while True:
        next_level = tree.children[levels[-1]].ravel()
        next_level = next_level[next_level >= 0]
        if not next_level.size:
            return levels
        levels.append(next_level)
