"""Patches of neighbouring triangles: what their integrals add up in stays in the processor's cache.

Most nodes of a triangle are midside nodes, whose integrals are distributed to ten nodes each. A
patch has few, so that they are distributed while the cache still holds them.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from palpate.geometry import QuadraticNodes, morton_order

# Triangles of a patch: 150 nodes and midside nodes, 350 kB for LANES points and nine fields.
_PATCH_SIZE = 64


class Patches(NamedTuple):
    """Triangles in patches, and how the integrals of a patch's own nodes add to those of the nodes.

    Attributes
    ----------
    order : (m,) int          the triangles, patch by patch
    number : (m, 6) int       their nodes in the numbering of the patch
    triangles : (p + 1,) int  where each patch starts in `order`
    size : (p,) int           nodes and midside nodes of each patch
    sums : (p + 1,) int       where each patch starts in `node`
    node : (s,) int           node that a weighted sum of a patch's integrals is added to
    terms : (s + 1,) int      where each sum starts in `own` and `weight`
    own : (w,) int            term of a sum: node in the numbering of the patch
    weight : (w,) float       its weight
    """

    order: np.ndarray
    number: np.ndarray
    triangles: np.ndarray
    size: np.ndarray
    sums: np.ndarray
    node: np.ndarray
    terms: np.ndarray
    own: np.ndarray
    weight: np.ndarray


def make_patches(centre: Float[np.ndarray, "m 3"], nodes: QuadraticNodes) -> Patches:
    """Divide triangles into patches along a Morton curve.

    Parameters
    ----------
    centre : (m, 3) float [m]     of each triangle
    nodes : QuadraticNodes        on the same triangles

    Returns
    -------
    Patches
    """
    count = len(centre)
    order = morton_order(centre) if count else np.arange(0)
    triangles = np.append(np.arange(0, count, _PATCH_SIZE), count)
    patch = np.arange(count) // _PATCH_SIZE
    # Rows of the identity, then those of the midside nodes: scipy takes its time to stack them.
    own_nodes, midside = np.arange(nodes.n_nodes), nodes.weights
    weights = csr_array(
        (
            np.append(np.ones(own_nodes.size), midside.data),
            np.append(own_nodes, midside.indices),
            np.append(own_nodes, midside.indptr + own_nodes.size),
        ),
        shape=(own_nodes.size + midside.shape[0], own_nodes.size),
    )
    pairs, number = np.unique(
        patch[:, None] * weights.shape[0] + nodes.element[order], return_inverse=True
    )
    patch_of_own, used = np.divmod(pairs, weights.shape[0])
    first = np.searchsorted(patch_of_own, np.arange(triangles.size))
    terms = weights[used].tocoo()
    pairs = patch_of_own[terms.row] * nodes.n_nodes + terms.col
    by_sum = np.argsort(pairs, kind="stable")
    pairs, start, terms_of_sum = np.unique(pairs[by_sum], return_index=True, return_counts=True)
    patch_of_sum, node = np.divmod(pairs, nodes.n_nodes)
    row = terms.row[by_sum]
    # The kernel takes three terms at a time: the last of a sum may have no weight.
    padded = np.append(0, np.cumsum(-(-terms_of_sum // 3) * 3))
    place = np.arange(row.size) + np.repeat(padded[:-1] - start, terms_of_sum)
    own, weight = np.zeros(padded[-1], dtype=np.int64), np.zeros(padded[-1])
    own[place] = row - first[patch_of_own[row]]
    weight[place] = terms.data[by_sum]
    return Patches(
        order=order,
        number=number.reshape(-1, 6) - first[patch][:, None],
        triangles=triangles,
        size=np.diff(first),
        sums=np.searchsorted(patch_of_sum, np.arange(triangles.size)),
        node=node,
        terms=padded,
        own=own,
        weight=weight,
    )
