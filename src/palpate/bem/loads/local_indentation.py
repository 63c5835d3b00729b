"""Right-hand sides of loads, with the local indentation under them.

Close to a contact the displacement is a smooth field plus the indentation of a half space under the
same pressure. Fitted midside nodes capture the smooth part; the indentation is known. The midside
nodes near a load are therefore corrected by the indentation minus its own fit, which is a term of
the right-hand side (`IndentationCorrection`). No unknown is added, and like the system the term is
linear in Poisson's ratio. Where the displacement is asked between the vertices, what these miss of
the indentation there is added to what is interpolated from them (`missed_indentation`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.arrays import components_of, lengths
from palpate.bem.integrals.assembly import kernel_integrals
from palpate.bem.integrals.kelvin import TRACTION, traction_parts
from palpate.bem.integrals.surface import BoundarySurface, Quadrature
from palpate.bem.loads.half_space import (
    DiscPotentials,
    PressureDisc,
    Profile,
    disc_displacement,
    disc_potentials,
)
from palpate.bem.loads.right_hand import RightHand, load_columns
from palpate.bem.loads.surface_load import SurfaceLoad, find_foot, integrate_loads
from palpate.bem.system.system import BoundarySystem
from palpate.geometry import (
    QuadraticNodes,
    TriangleMesh,
    cut_distance,
    quadratic_shapes,
    unit_normals,
)

# Midside nodes within this many edge lengths of the patch may be corrected.
_REACH_EDGES = 2.5
# Cosine between the normals of a triangle and of the patch: below the first the triangle does not
# belong to the half space, above the second it does fully. The transition between the two makes the
# correction continuous in the position of the contact.
_NORMAL_COSINES = (0.6, 0.8)
# Corrections below this fraction of the largest indentation are dropped.
_NEGLIGIBLE = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class Dip:
    """Indentation of a half space under a load, where that lies on a surface.

    Attributes
    ----------
    disc : PressureDisc             about its place on the curved surface
    potentials : DiscPotentials     of its profile
    normal : (3,) float [-]         outward, there
    share : (m,) float [-]          0 to 1, in which each triangle belongs to the half space; 0
                                    where it is held or far from the load
    """

    disc: PressureDisc
    potentials: DiscPotentials
    normal: Float[np.ndarray, "3"]
    share: Float[np.ndarray, " m"]

    def at(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "2 n 3 3"]:
        """Displacement of points times the shear modulus (`disc_displacement`)."""
        return disc_displacement(self.disc, self.potentials, self.normal, points)


@dataclass(frozen=True, slots=True, eq=False)
class IndentationCorrection:
    """Indentation near a load minus its fit, at midside nodes.

    Attributes
    ----------
    midside_nodes : (p,) int              rows of `QuadraticNodes.weights` whose correction exceeds
                                      2e-3 of the largest indentation; none on a fine mesh
    correction : (2, p, 3, c) float   displacement times shear modulus, constant and slope in nu;
                                      [.., i, j]: component i under force j: one newton along each
                                      of three axes [1/m], or one given force [N/m]
    dip : Dip                         of the load
    """

    midside_nodes: Int[np.ndarray, " p"]
    correction: Float[np.ndarray, "2 p 3 c"]
    dip: Dip

    def under(self, force: Float[np.ndarray, "3"]) -> "IndentationCorrection":
        """The correction under one given force, (3,) [N]."""
        return replace(self, correction=(self.correction @ force)[..., None])


def load_right_hand(
    system: BoundarySystem,
    loads: Sequence[SurfaceLoad],
    corrections: Sequence[IndentationCorrection | None] | None = None,
) -> RightHand:
    """Right-hand sides of surface loads, for one newton along each axis.

    Parameters
    ----------
    system : BoundarySystem
    loads : sequence of k SurfaceLoad
    corrections : sequence of k IndentationCorrection or None    for the local indentation around
                                      each load (`indentation_corrections`)

    Returns
    -------
    RightHand                         three columns per load

    Raises
    ------
    InputError                        a load covers no part of the free surface
    """
    fields = integrate_loads(system.surface, loads, system.collocation, system.rows)
    right = load_columns(fields, -np.eye(3) / system.traction_length)
    known = {
        k: correction for k, correction in enumerate(corrections or ()) if correction is not None
    }
    if known:
        columns = components_of(np.array([*known]))
        right.terms[:, :, columns] += correction_columns(system, [*known.values()]).terms
    return right


def indentation_corrections(
    surface: BoundarySurface, loads: Sequence[SurfaceLoad]
) -> list[IndentationCorrection | None]:
    """Corrections of midside nodes for the local indentation under loads.

    Parameters
    ----------
    surface : BoundarySurface
    loads : sequence of k SurfaceLoad

    Returns
    -------
    list of k IndentationCorrection or None    None for a load that is not a round patch, for linear
                                      or flat elements, where an edge of the object or the rim of
                                      the support crosses the patch, and where the mesh misses
                                      next to nothing
    """
    edge, corrections = _edge_lengths(surface.mesh), list[IndentationCorrection | None]()
    potentials: dict[Profile, DiscPotentials] = {}
    for load in loads:
        dip = _dip(surface, load, edge, potentials)
        corrections.append(None if dip is None else _indentation_correction(surface, edge, dip))
    return corrections


def missed_indentation(
    surface: BoundarySurface,
    dip: Dip,
    triangle: Int[np.ndarray, " n"],
    barycentric: Float[np.ndarray, "n 3"],
) -> Float[np.ndarray, "2 n 3 3"]:
    """Indentation of a load at points of the surface minus what is interpolated of it from the
    vertices.

    Parameters
    ----------
    surface : BoundarySurface
    dip : Dip                         of the load
    triangle : (n,) int
    barycentric : (n, 3) float [-]

    Returns
    -------
    (2, n, 3, 3) float [1/m]          displacement times shear modulus, constant and slope in nu;
                                      [.., i, j]: component i under a newton along j. Zero far from
                                      the load and at vertices
    """
    missed, share = np.zeros((2, len(triangle), 3, 3)), dip.share[triangle]
    near = np.flatnonzero(share)
    if not near.size:
        return missed
    shapes, nodes = quadratic_shapes(barycentric[near]), surface.element_nodes[triangle[near]]
    position = np.einsum("kn,nki->ni", shapes, nodes)
    element = surface.displacement.element[triangle[near]]
    used, local = np.unique(element, return_inverse=True)
    at_nodes = _fitted(surface, dip, used)[:, local.reshape(element.shape)]
    exact, fitted = dip.at(position), np.einsum("kn,snkij->snij", shapes, at_nodes)
    missed[:, near] = share[near, None, None] * (exact - fitted)
    return missed


def _fitted(
    surface: BoundarySurface, dip: Dip, nodes: Int[np.ndarray, " k"]
) -> Float[np.ndarray, "2 k 3 3"]:
    """A dip at vertices, and at midside nodes what is fitted to that at the vertices; nodes in the
    order of `QuadraticNodes.element`."""
    count = surface.displacement.n_nodes
    weights = csr_array(surface.displacement.weights[nodes[nodes >= count] - count])
    vertices = np.union1d(weights.indices, nodes[nodes < count])
    at_vertices = dip.at(surface.mesh.vertices[vertices])
    at_nodes = np.empty((2, len(nodes), 3, 3))
    at_nodes[:, nodes < count] = at_vertices[:, np.searchsorted(vertices, nodes[nodes < count])]
    at_nodes[:, nodes >= count] = np.einsum(
        "pv,svij->spij", weights[:, vertices].toarray(), at_vertices
    )
    return at_nodes


def _dip(
    surface: BoundarySurface,
    load: SurfaceLoad,
    edge: Float[np.ndarray, "m 3"],
    potentials: dict[Profile, DiscPotentials],
) -> Dip | None:
    """The dip of a load, with potentials that are known or added there; None where it cannot be
    corrected. `edge`: `_edge_lengths`."""
    disc = load.disc
    if disc is None or not surface.corrects_indentation:
        return None
    flat, curved, normal = find_foot(surface, load.triangles, disc.centre)
    # An edge of the object or the rim of its support may run through the patch.
    if cut_distance(surface.mesh, surface.sides, load.triangles, flat) < disc.radius:
        return None
    if disc.profile not in potentials:
        potentials[disc.profile] = disc_potentials(disc.profile)
    mesh = surface.mesh
    away = lengths(mesh.vertices[mesh.triangles] - curved).min(axis=1)
    near = (away < disc.radius + _REACH_EDGES * edge.max(axis=1)) & ~surface.held
    share = np.where(near, _taper(mesh, normal, np.arange(len(near))), 0.0)
    return Dip(replace(disc, centre=curved), potentials[disc.profile], normal, share)


def _taper(
    mesh: TriangleMesh, normal: Float[np.ndarray, "3"], triangles: Int[np.ndarray, " t"]
) -> Float[np.ndarray, " t"]:
    """Share, 0 to 1, in which triangles belong to the half space of an outward normal."""
    low, high = _NORMAL_COSINES
    return np.clip((unit_normals(mesh)[triangles] @ normal - low) / (high - low), 0.0, 1.0)


def _edge_lengths(mesh: TriangleMesh) -> Float[np.ndarray, "m 3"]:
    """Length of the edges of every triangle [m], in the order of its midside nodes."""
    corner = mesh.vertices[mesh.triangles]
    return lengths(corner - np.roll(corner, -1, axis=1))


def _indentation_correction(
    surface: BoundarySurface, edge: Float[np.ndarray, "m 3"], dip: Dip
) -> IndentationCorrection | None:
    """A dip minus its fit, at the midside nodes around the load, if that is much; `edge`:
    `_edge_lengths`."""
    mesh, nodes, disc = surface.mesh, surface.displacement, dip.disc
    midside = surface.element_nodes[:, 3:]
    within = lengths(midside - disc.centre) < disc.radius + _REACH_EDGES * edge
    # A midside node is within reach of the load in both of its triangles, or in neither.
    near = np.flatnonzero(within.any(axis=1))
    taper = np.where(surface.held[near], 0.0, _taper(mesh, dip.normal, near))
    edge_taper = np.ones(nodes.weights.shape[0])
    row = nodes.element[near, 3:] - nodes.n_nodes
    np.minimum.at(edge_taper, row, taper[:, None])
    corrected = (
        within[near] & (edge_taper[row] > 0.0) & ~surface.sides.cut[surface.sides.edge[near]]
    )
    midside_nodes, first = np.unique(row[corrected], return_index=True)
    position = midside[near][corrected][first]
    fitted = _fitted(surface, dip, nodes.n_nodes + midside_nodes)
    indentation = dip.at(position)
    correction = edge_taper[midside_nodes, None, None] * (indentation - fitted)
    largest = np.abs(indentation).max(initial=0.0)
    significant = np.abs(correction).max(axis=(0, 2, 3)) > _NEGLIGIBLE * largest
    if not significant.any():
        return None
    return IndentationCorrection(midside_nodes[significant], correction[:, significant], dip)


def correction_columns(
    system: BoundarySystem,
    corrections: Sequence[IndentationCorrection],
    *,
    quadrature: Quadrature = Quadrature(),
) -> RightHand:
    """Right-hand sides of corrected midside nodes, to be added to those of the loads themselves.

    Parameters
    ----------
    system : BoundarySystem
    corrections : sequence of k IndentationCorrection    with the same number of forces
    quadrature : Quadrature

    Returns
    -------
    RightHand                         one column for each force of each correction
    """
    surface, forces = system.surface, corrections[0].correction.shape[3]
    nodes, triangles = _correction_nodes(surface.displacement, corrections)
    blocks = kernel_integrals(
        surface, system.collocation, nodes, TRACTION, triangles=triangles, quadrature=quadrature
    ).all_blocks()
    n_blocks, _, n_fields, lanes = blocks.values.shape
    # Both parts of the kernel: component i of a row from component j of the correction and a field.
    kernel = np.stack(traction_parts(np.eye(n_fields))).reshape(6, 3 * n_fields)
    parts = kernel @ blocks.values.reshape(-1, 3 * n_fields, lanes)
    parts = parts.reshape(n_blocks, len(corrections), 2, forces, 2, 3, lanes)
    parts = parts.transpose(4, 2, 5, 0, 6, 1, 3).reshape(2, 2, 3, n_blocks * lanes, -1)
    scaled, constant = parts[:, :, :, : blocks.n_rows].reshape(2, 2, 3 * blocks.n_rows, -1)
    constant, slope = scaled + constant, -2 * scaled
    terms = np.zeros((3, 3 * blocks.n_rows + 3, forces * len(corrections)))
    terms[:, :-3] = -constant[0], -(constant[1] + slope[0]), -slope[1]
    return RightHand(terms)


def _correction_nodes(
    nodes: QuadraticNodes, corrections: Sequence[IndentationCorrection]
) -> tuple[QuadraticNodes, Int[np.ndarray, " t"]]:
    """Auxiliary nodes, one for each entry of every `correction` at a midside node, whose shape
    functions are scaled by these entries (constant and slope, then forces, then components); and
    the triangles on which they are not zero."""
    entries = corrections[0].correction[:, 0].size
    used = np.unique(np.concatenate([correction.midside_nodes for correction in corrections]))
    number = np.full(nodes.weights.shape[0], -1)
    number[used] = np.arange(used.size)
    parts = []
    for k, correction in enumerate(corrections):
        values = correction.correction.transpose(1, 0, 3, 2).reshape(-1, entries)
        row = np.repeat(number[correction.midside_nodes], entries)
        column = np.tile(entries * k + np.arange(entries), correction.midside_nodes.size)
        parts.append((row, column, values.ravel()))
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    # One more row of zeros, for corners and for midside nodes that are not corrected.
    count = entries * len(corrections)
    weights = csr_array((value, (row, column)), shape=(used.size + 1, count))
    local = number[nodes.element[:, 3:] - nodes.n_nodes]
    triangles = np.flatnonzero((local >= 0).any(axis=1))
    element = np.full((triangles.size, 6), count + used.size)
    element[:, 3:] = count + np.where(local[triangles] >= 0, local[triangles], used.size)
    return QuadraticNodes(element, count, weights), triangles
