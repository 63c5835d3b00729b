"""Material-independent matrices of a boundary element model: collocation points by nodes.

The rows come in blocks of LANES collocation points that lie close together, so that the loops over
a block vectorise and one quadrature rule suits all of its points. A block is computed by one
thread, which adds its triangles in order, patch by patch: the result does not depend on the number
of threads. A patch holds neighbouring triangles. Most of their nodes are midside nodes, whose
integrals are distributed to ten nodes each: few enough that the processor's cache still holds them.

The integrals of all points together are larger than the matrix that they serve, and take a second:
who needs few numbers of each computes one block after the other (`KernelIntegrals`).
"""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.integrals.element_integrals import MOST_KEPT, integrate_blocks
from palpate.bem.integrals.kelvin import LANES
from palpate.bem.integrals.surface import BoundarySurface, Quadrature, triangle_rule, unit_gauss
from palpate.geometry import (
    QuadraticNodes,
    element_points,
    element_spheres,
    interpolation_matrix,
    morton_order,
    quadratic_shapes,
)
from palpate.threads import in_threads

# Triangles of a patch: 150 nodes and midside nodes, 350 kB for LANES points and nine fields.
_PATCH_SIZE = 64


@dataclass(frozen=True, slots=True, eq=False)
class Collocation:
    """Points at which the boundary integral equation is written.

    Attributes
    ----------
    point : (r, 3) float [m]
    vertex : (r,) int             vertex at which the point lies, -1 where inside a triangle
    triangle : (r,) int           triangle in which the point lies, -1 where at a vertex
    barycentric : (r, 3) float    position in that triangle, zero where at a vertex
    """

    point: Float[np.ndarray, "r 3"]
    vertex: Int[np.ndarray, " r"]
    triangle: Int[np.ndarray, " r"]
    barycentric: Float[np.ndarray, "r 3"]


@dataclass(frozen=True, slots=True, eq=False)
class FieldBlocks:
    """Integrals of kernel fields times nodal shape functions.

    Attributes
    ----------
    values : (blocks, n_nodes, fields, LANES) float     the fields in the order of
                                                        `kelvin.TRACTION`, or `DISPLACEMENT`
    rows : (blocks, LANES) int                          collocation point of each lane; the last
                                                        block is padded with its last point
    n_rows : int                                        number of collocation points
    """

    values: Float[np.ndarray, "blocks nodes fields lanes"]
    rows: Int[np.ndarray, "blocks lanes"]
    n_rows: int

    def by_row(self, node: int) -> Float[np.ndarray, "r fields"]:
        """The integrals that belong to one node.

        Parameters
        ----------
        node : int

        Returns
        -------
        (r, fields) float           one row per collocation point, in the order of the blocks
        """
        fields = self.values[:, node].transpose(0, 2, 1)
        return fields.reshape(-1, fields.shape[2])[: self.n_rows]


class Rules(NamedTuple):
    """Concatenated quadrature rules.

    Attributes
    ----------
    points : (q, 4) float     barycentric coordinates and weight
    shapes : (6, q) float     shape functions there
    start : (k + 1,) int      where each of the k rules starts
    ratios : (k,) float       distance over radius above which each may be used
    polar : (p, 3) float      `polar_rule`
    """

    points: np.ndarray
    shapes: np.ndarray
    start: np.ndarray
    ratios: np.ndarray
    polar: np.ndarray


class _Patches(NamedTuple):
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


class _Elements(NamedTuple):
    """Triangles, patch by patch, with the quadrature points of the smaller rules (`_sources`)."""

    triangle: np.ndarray
    vertices: np.ndarray
    nodes: np.ndarray
    sources: np.ndarray
    centre: np.ndarray
    radius: np.ndarray


class _Points(NamedTuple):
    """Collocation points in the layout of the kernels: by lane, then one by one."""

    lanes: np.ndarray
    rows: np.ndarray
    point: np.ndarray
    vertex: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class KernelIntegrals:
    """Integrals of a kernel's fields times nodal shape functions, computed when they are asked for.

    Attributes
    ----------
    n_nodes : int
    n_fields : int
    points, elements, rules, patches      inputs of the compiled kernel
    """

    n_nodes: int
    n_fields: int
    points: _Points
    elements: _Elements
    rules: Rules
    patches: _Patches

    def block(self, number: int) -> Float[np.ndarray, "nodes fields lanes"]:
        """The integrals of one block of collocation points.

        Parameters
        ----------
        number : int              see `point_blocks`

        Returns
        -------
        (n_nodes, n_fields, LANES) float
        """
        chosen = slice(number, number + 1)
        points = self.points._replace(
            lanes=self.points.lanes[chosen], rows=self.points.rows[chosen]
        )
        return self._computed(points)[0]

    def all_blocks(self) -> FieldBlocks:
        """The integrals of all blocks, computed in threads."""
        return FieldBlocks(
            self._computed(self.points), self.points.rows, self.points.point.shape[0]
        )

    def _computed(self, points: _Points) -> Float[np.ndarray, "blocks nodes fields lanes"]:
        count = points.rows.shape[0]
        values = np.empty((count, self.n_nodes * self.n_fields * LANES))
        prepared = points, self.elements, self.rules, self.patches
        in_threads(integrate_blocks, count, self.n_fields, *prepared, values)
        return values.reshape(count, self.n_nodes, self.n_fields, LANES)


def kernel_integrals(
    surface: BoundarySurface,
    collocation: Collocation,
    nodes: QuadraticNodes,
    n_fields: int,
    *,
    triangles: Int[np.ndarray, " m"] | None = None,
    quadrature: Quadrature = Quadrature(),
) -> KernelIntegrals:
    """Prepare the integrals of a kernel's fields times shape functions over triangles of a surface.

    Near-singular and singular integrals are included.

    Parameters
    ----------
    surface : BoundarySurface
    collocation : Collocation
    nodes : QuadraticNodes                of the field that the kernel multiplies, on the same m
                                          triangles
    n_fields : int                        of the kernel: `TRACTION` or `DISPLACEMENT`
    triangles : (m,) int or None          the triangles to integrate over; None: all
    quadrature : Quadrature

    Returns
    -------
    KernelIntegrals                       for the traction kernel without the value at the
                                          collocation point on the triangles that contain it;
                                          `add_rigid_body_sum` completes it
    """
    if triangles is None:
        triangles = np.arange(len(surface.held))
    rules = all_rules(quadrature)
    patches = make_patches(element_spheres(surface.element_nodes[triangles])[0], nodes)
    triangles = triangles[patches.order]
    element_nodes = surface.element_nodes[triangles]
    elements = _Elements(
        triangles, surface.mesh.triangles[triangles], element_nodes,
        _sources(element_nodes, rules), *element_spheres(element_nodes),
    )  # fmt: skip
    points = _points_in_blocks(collocation)
    return KernelIntegrals(nodes.n_nodes, n_fields, points, elements, rules, patches)


def add_rigid_body_sum(
    values: Float[np.ndarray, "v fields lanes"],
    points: Int[np.ndarray, " lanes"],
    collocation: Collocation,
    nodes: QuadraticNodes,
) -> None:
    """Complete the traction kernel by the rigid-body sum: each field by itself gives zero for a
    rigid translation. Free term and Cauchy principal value are then included.

    Parameters
    ----------
    values : (v, fields, LANES) float     of one block, changed in place
    points : (LANES,) int                 collocation points of the block
    collocation : Collocation
    nodes : QuadraticNodes                of the displacement

    Source
    ------
    Lang and Pai (2001), eq. 4: C, for A and B separately
    """
    total = values.sum(axis=0)
    vertex = collocation.vertex[points]
    (lane,) = np.nonzero(vertex >= 0)
    values[vertex[lane], :, lane] -= total[:, lane].T
    for i in np.flatnonzero(vertex < 0):
        row = points[i, None]
        interpolation = interpolation_matrix(
            nodes, collocation.triangle[row], collocation.barycentric[row]
        )
        values[interpolation.indices, :, i] -= interpolation.data[:, None] * total[:, i]


def all_rules(quadrature: Quadrature) -> Rules:
    """The rules of a quadrature in the layout of the kernels.

    Parameters
    ----------
    quadrature : Quadrature

    Returns
    -------
    Rules
    """
    rules = [triangle_rule(degree) for degree in quadrature.degrees]
    points = np.concatenate([np.column_stack(rule) for rule in rules])
    shapes = np.ascontiguousarray(quadratic_shapes(points[:, :3]))
    start = np.cumsum([0] + [weight.size for _, weight in rules])
    return Rules(points, shapes, start, quadrature.ratios(), polar_rule(quadrature))


def polar_rule(quadrature: Quadrature) -> Float[np.ndarray, "p 3"]:
    """Quadrature points of the singular integrals.

    Parameters
    ----------
    quadrature : Quadrature

    Returns
    -------
    (p, 3) float [-]          radius and angle from 0 to 1, weight times radius
    """
    (s, w_s), (t, w_t) = (unit_gauss(n) for n in quadrature.polar_points)
    s_grid, t_grid = np.meshgrid(s, t, indexing="ij")
    return np.stack([s_grid.ravel(), t_grid.ravel(), np.outer(w_s * s, w_t).ravel()], axis=1)


def lanes_of(point: Float[np.ndarray, "r 3"], rows: Int[np.ndarray, "b lanes"]) -> np.ndarray:
    """Coordinates of the points of each block, coordinate-major, (b, 3 LANES) float [m]."""
    return point[rows].transpose(0, 2, 1).reshape(rows.shape[0], 3 * LANES).copy()


def point_blocks(point: Float[np.ndarray, "r 3"]) -> Int[np.ndarray, "b lanes"]:
    """Points grouped along a Morton curve, padded with the last one.

    Parameters
    ----------
    point : (r, 3) float [m]

    Returns
    -------
    (b, LANES) int            points of each block
    """
    order = morton_order(point)
    return np.concatenate([order, np.repeat(order[-1:], -order.size % LANES)]).reshape(-1, LANES)


def make_patches(centre: Float[np.ndarray, "m 3"], nodes: QuadraticNodes) -> _Patches:
    """Divide triangles into patches along a Morton curve.

    Parameters
    ----------
    centre : (m, 3) float [m]     of each triangle
    nodes : QuadraticNodes        on the same triangles

    Returns
    -------
    _Patches
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
    slot = np.arange(row.size) + np.repeat(padded[:-1] - start, terms_of_sum)
    local, weight = np.zeros(padded[-1], dtype=np.int64), np.zeros(padded[-1])
    local[slot] = row - first[patch_of_own[row]]
    weight[slot] = terms.data[by_sum]
    return _Patches(
        order=order,
        number=number.reshape(-1, 6) - first[patch][:, None],
        triangles=triangles,
        size=np.diff(first),
        sums=np.searchsorted(patch_of_sum, np.arange(triangles.size)),
        node=node,
        terms=padded,
        own=local,
        weight=weight,
    )


def _points_in_blocks(collocation: Collocation) -> _Points:
    rows = point_blocks(collocation.point)
    return _Points(
        lanes_of(collocation.point, rows), rows, np.array(collocation.point), collocation.vertex,
        collocation.triangle, collocation.barycentric,
    )  # fmt: skip


def _sources(element_nodes: Float[np.ndarray, "m 6 3"], rules: Rules) -> np.ndarray:
    """Quadrature points and normals times weight of the rules of at most `MOST_KEPT` points,
    (q m, 6): by rule, then by triangle."""
    parts = [np.empty((0, 6))]
    for first, last in itertools.pairwise(rules.start):
        if last - first <= MOST_KEPT:
            part = element_points(element_nodes, rules.points[first:last, :3])
            part[:, :, 3:] *= rules.points[first:last, 3:]
            parts.append(part.reshape(-1, 6))
    return np.concatenate(parts)
