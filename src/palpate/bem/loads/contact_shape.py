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

from palpate.bem.integrals import TRACTION, BoundarySurface, Quadrature, assemble, traction_parts
from palpate.bem.loads.half_space import PressureDisc, disc_displacement
from palpate.bem.loads.right_hand import RightHand
from palpate.bem.system import BoundarySystem
from palpate.geometry import QuadraticNodes, unit_normals

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


def contact_shape(
    surface: BoundarySurface, disc: PressureDisc, normal: Float[np.ndarray, "3"]
) -> ContactShape:
    """Compare the dip under a load with its own fit, at the midpoints around the load.

    Parameters
    ----------
    surface : BoundarySurface
    disc : PressureDisc
    normal : (3,) float [-]           outward unit normal of the half space that dips

    Returns
    -------
    ContactShape
    """
    mesh, nodes = surface.mesh, surface.displacement
    middle = surface.element_nodes[:, 3:]
    edge = mesh.vertices[mesh.triangles] - np.roll(mesh.vertices[mesh.triangles], -1, axis=1)
    distance = np.linalg.norm(middle - disc.centre, axis=2)
    reach = disc.radius + _REACH_EDGES * np.linalg.norm(edge, axis=2)
    low, high = _TURNED
    level = np.clip((unit_normals(mesh) @ normal - low) / (high - low), 0.0, 1.0)
    edge_level = np.ones(nodes.weights.shape[0])
    row = nodes.element[:, 3:] - nodes.n_nodes
    np.minimum.at(edge_level, row, np.where(surface.held, 0.0, level)[:, None])
    chosen = (distance < reach) & (edge_level[row] > 0.0) & ~surface.sides.cut[surface.sides.edge]
    midpoints, first = np.unique(row[chosen], return_index=True)
    position = middle[chosen][first]
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
    n_rows = blocks.n_rows
    fields = blocks.values.transpose(2, 0, 3, 1)
    fields = fields.reshape(TRACTION.count, -1, len(shapes), 2, 3, forces)
    # Component j of the dip by its force c, constant and slope p; force and component i of the row.
    scaled, constant = (
        np.einsum("ijrspjc->pirsc", part).reshape(2, 3 * n_rows, -1)
        for part in traction_parts(fields[:, :n_rows])
    )
    constant, slope = scaled + constant, -2 * scaled
    terms = np.zeros((3, 3 * n_rows + 3, forces * len(shapes)))
    terms[:, :-3] = -constant[0], -(constant[1] + slope[0]), -slope[1]
    return RightHand(terms)


def _shape_nodes(
    nodes: QuadraticNodes, shapes: Sequence[ContactShape]
) -> tuple[QuadraticNodes, Int[np.ndarray, " t"]]:
    """Some nodes a shape, one for each entry of its `missing` at a midpoint, whose shape functions
    carry these entries; and the triangles on which they do."""
    entries = shapes[0].missing[:, 0].size
    used = np.unique(np.concatenate([shape.midpoints for shape in shapes]))
    number = np.full(nodes.weights.shape[0], -1)
    number[used] = np.arange(used.size)
    parts = []
    for k, shape in enumerate(shapes):
        values = shape.missing.transpose(1, 0, 2, 3).reshape(-1, entries)
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
