"""Quadratic elements that know how a surface dips under a tool.

Close to a contact the displacement is a smooth field plus the dip of a half space under the same
pressure. Fitted midpoints catch the smooth part; the dip is known. So the midpoints near a load get
what the fit of the dip misses, which goes to the right-hand side. No unknown is added, and the dip
is linear in Poisson's ratio like the system.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.arrays import lengths
from palpate.bem.integrals import TRACTION, BoundarySurface, Quadrature, assemble, traction_parts
from palpate.bem.loads.half_space import PressureDisc, disc_displacement
from palpate.bem.loads.right_hand import RightHand
from palpate.bem.loads.surface_load import SurfaceLoad, loaded_triangles
from palpate.bem.system import BoundarySystem
from palpate.geometry import (
    QuadraticNodes,
    TriangleMesh,
    closest_points,
    cut_distance,
    element_points,
)

# A midpoint may differ from its fit within this many edges of the patch.
_REACH_EDGES = 2.5
# Triangles whose normal is turned further from that of the patch are not part of its half space;
# those in between are in part, so that a contact that moves on a little dips a little otherwise.
_TURNED = (0.6, 0.8)
# Share of the largest dip below which what the fit misses is left out.
_NEGLIGIBLE = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class ContactShape:
    """What the fitted midpoints near a load miss of the dip under it.

    Attributes
    ----------
    midpoints : (p,) int              rows of `QuadraticNodes.weights` where more than 2e-3 of the
                                      dip is missed; none where the mesh is fine enough
    missing : (2, p, 3, c) float      displacement times shear modulus, constant and slope in nu;
                                      [.., i, j]: component i under force j: one newton along each
                                      of three axes [1/m], or one force [N/m]
    """

    midpoints: Int[np.ndarray, " p"]
    missing: Float[np.ndarray, "2 p 3 c"]

    def under(self, force: Float[np.ndarray, "3"]) -> "ContactShape":
        """The same under one force [N]."""
        return ContactShape(self.midpoints, (self.missing @ force)[..., None])


def load_shapes(
    surface: BoundarySurface, loads: Sequence[SurfaceLoad]
) -> list[ContactShape | None]:
    """How the elements around some loads dip, where that is known.

    Parameters
    ----------
    surface : BoundarySurface
    loads : sequence of k SurfaceLoad

    Returns
    -------
    list of k ContactShape or None    None for a load that is no round patch, for linear elements,
                                      and where the patch is not smooth ground: on flat facets, or
                                      across an edge of the object
    """
    edge, found = _edge_lengths(surface.mesh), list[ContactShape | None]()
    for load in loads:
        disc = load.disc if surface.follows_dips else None
        if disc is None or _crosses_edge(surface, load, disc):
            found.append(None)
        else:
            normal = _normal_at(surface, load.triangles, disc.centre)
            found.append(_contact_shape(surface, edge, disc, normal))
    return found


def _normal_at(
    surface: BoundarySurface, triangles: Int[np.ndarray, " k"], point: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Outward unit normal of the curved elements at the place nearest to a point: it turns as the
    point moves on, where those of flat triangles jump."""
    near = TriangleMesh(surface.mesh.vertices, surface.mesh.triangles[triangles])
    place = closest_points(near, point[None])
    element = surface.element_nodes[triangles[place.triangle]]
    normal = element_points(element, place.barycentric)[0, 0, 3:]
    return np.asarray(normal / np.linalg.norm(normal))


def _crosses_edge(surface: BoundarySurface, load: SurfaceLoad, disc: PressureDisc) -> bool:
    """Whether an edge of the object or the rim of its support runs through a load."""
    loaded = loaded_triangles(surface, load)
    return cut_distance(surface.mesh, surface.sides, loaded, disc.centre) < disc.radius


def _edge_lengths(mesh: TriangleMesh) -> Float[np.ndarray, "m 3"]:
    """Length of the edges of every triangle [m], in the order of its midpoints."""
    corner = mesh.vertices[mesh.triangles]
    return lengths(corner - np.roll(corner, -1, axis=1))


def _contact_shape(
    surface: BoundarySurface,
    edge: Float[np.ndarray, "m 3"],
    disc: PressureDisc,
    normal: Float[np.ndarray, "3"],
) -> ContactShape:
    """The dip of a half space of this outward normal against its own fit, at the midpoints around
    the load; `edge`: `_edge_lengths`."""
    mesh, nodes = surface.mesh, surface.displacement
    middle = surface.element_nodes[:, 3:]
    within = lengths(middle - disc.centre) < disc.radius + _REACH_EDGES * edge
    # A midpoint is within reach of the load in both of its triangles, or in none.
    near = np.flatnonzero(within.any(axis=1))
    low, high = _TURNED
    a, b, c = mesh.vertices[mesh.triangles[near]].transpose(1, 0, 2)
    area = np.cross(b - a, c - a)
    level = np.clip((area @ normal / lengths(area) - low) / (high - low), 0.0, 1.0)
    edge_level = np.ones(nodes.weights.shape[0])
    row = nodes.element[near, 3:] - nodes.n_nodes
    np.minimum.at(edge_level, row, np.where(surface.held[near], 0.0, level)[:, None])
    chosen = within[near] & (edge_level[row] > 0.0) & ~surface.sides.cut[surface.sides.edge[near]]
    midpoints, first = np.unique(row[chosen], return_index=True)
    position = middle[near][chosen][first]
    weights = csr_array(nodes.weights[midpoints])
    vertices = np.unique(weights.indices)
    at_vertices = disc_displacement(disc, normal, mesh.vertices[vertices])
    fitted = np.einsum("pv,svij->spij", weights[:, vertices].toarray(), at_vertices)
    dip = disc_displacement(disc, normal, position)
    missing = edge_level[midpoints, None, None] * (dip - fitted)
    counts = np.abs(missing).max(axis=(0, 2, 3)) > _NEGLIGIBLE * np.abs(dip).max(initial=0.0)
    return ContactShape(midpoints[counts], missing[:, counts])


def shape_columns(
    system: BoundarySystem,
    shapes: Sequence[ContactShape],
    *,
    quadrature: Quadrature = Quadrature(),
) -> RightHand:
    """Right-hand sides of what the midpoints miss, to be added to those of the loads themselves.

    Parameters
    ----------
    system : BoundarySystem
    shapes : sequence of k ContactShape under as many forces each
    quadrature : Quadrature

    Returns
    -------
    RightHand                         a column for each force of each shape, quadratic in Poisson's
                                      ratio
    """
    surface, forces = system.surface, shapes[0].missing.shape[3]
    nodes, triangles = _shape_nodes(surface.displacement, shapes)
    blocks = assemble(
        surface, system.collocation, nodes, TRACTION, triangles=triangles, quadrature=quadrature
    )
    n_blocks, _, n_fields, lanes = blocks.values.shape
    # Both parts of the kernel: component i of the row from component j of the dip and a field.
    kernel = np.stack(traction_parts(np.eye(n_fields))).reshape(6, 3 * n_fields)
    parts = kernel @ blocks.values.reshape(-1, 3 * n_fields, lanes)
    parts = parts.reshape(n_blocks, len(shapes), 2, forces, 2, 3, lanes)
    parts = parts.transpose(4, 2, 5, 0, 6, 1, 3).reshape(2, 2, 3, n_blocks * lanes, -1)
    scaled, constant = parts[:, :, :, : blocks.n_rows].reshape(2, 2, 3 * blocks.n_rows, -1)
    constant, slope = scaled + constant, -2 * scaled
    terms = np.zeros((3, 3 * blocks.n_rows + 3, forces * len(shapes)))
    terms[:, :-3] = -constant[0], -(constant[1] + slope[0]), -slope[1]
    return RightHand(terms)


def _shape_nodes(
    nodes: QuadraticNodes, shapes: Sequence[ContactShape]
) -> tuple[QuadraticNodes, Int[np.ndarray, " t"]]:
    """Some nodes a shape, one for each entry of its `missing` at a midpoint, whose shape functions
    carry these entries (constant and slope, then forces, then components); and the triangles on
    which they do."""
    entries = shapes[0].missing[:, 0].size
    used = np.unique(np.concatenate([shape.midpoints for shape in shapes]))
    number = np.full(nodes.weights.shape[0], -1)
    number[used] = np.arange(used.size)
    parts = []
    for k, shape in enumerate(shapes):
        values = shape.missing.transpose(1, 0, 3, 2).reshape(-1, entries)
        row = np.repeat(number[shape.midpoints], entries)
        column = np.tile(entries * k + np.arange(entries), shape.midpoints.size)
        parts.append((row, column, values.ravel()))
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    # One more row of zeros, for corners and for midpoints that miss nothing.
    count = entries * len(shapes)
    weights = csr_array((value, (row, column)), shape=(used.size + 1, count))
    local = number[nodes.element[:, 3:] - nodes.n_nodes]
    triangles = np.flatnonzero((local >= 0).any(axis=1))
    element = np.full((triangles.size, 6), count + used.size)
    element[:, 3:] = count + np.where(local[triangles] >= 0, local[triangles], used.size)
    return QuadraticNodes(element, count, weights), triangles
