"""Quadratic elements that know how a surface dips under a tool.

Close to a contact the displacement is a smooth field plus the dip of a half space under the same
pressure. Fitted midpoints catch the smooth part; the dip is known. So the midpoints near a load get
what the fit of the dip misses, which goes to the right-hand side. No unknown is added, and the dip
is linear in Poisson's ratio like the system.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.assembly import assemble
from palpate.bem.half_space import PressureDisc, disc_displacement
from palpate.bem.kelvin import TRACTION_FIELDS
from palpate.bem.quadrature import Quadrature
from palpate.bem.right_hand import RightHand
from palpate.bem.surface import BoundarySurface
from palpate.bem.system import PAIRS, BoundarySystem, restrict_collocation
from palpate.geometry import QuadraticNodes, unit_normals

REACH = 2.5
SMALLEST_COSINE = 0.7
SKEW = np.array([[[0, 0, 0], [0, 0, 1], [0, -1, 0]], [[0, 0, -1], [0, 0, 0], [1, 0, 0]],
                 [[0, 1, 0], [-1, 0, 0], [0, 0, 0]]])  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class ContactShape:
    """What the fitted midpoints near a load miss of the dip under it.

    Attributes
    ----------
    midpoints : (p,) int              rows of `QuadraticNodes.weights`
    missing : (2, p, 3, 3) float      displacement times shear modulus per newton, constant and
                                      slope in nu [1/m]; [.., i, j]: component i, force along j
    """

    midpoints: Int[np.ndarray, " p"]
    missing: Float[np.ndarray, "2 p 3 3"]


def contact_shape(surface: BoundarySurface, disc: PressureDisc, triangle: int) -> ContactShape:
    """Compare the dip under a load with its own fit, at the midpoints around the load.

    Parameters
    ----------
    surface : BoundarySurface
    disc : PressureDisc
    triangle : int                    triangle at its centre, for the normal

    Returns
    -------
    ContactShape
    """
    mesh, nodes = surface.mesh, surface.displacement
    normals = unit_normals(mesh)
    normal = normals[triangle]
    middle = surface.element_nodes[:, 3:]
    edge = mesh.vertices[mesh.triangles] - np.roll(mesh.vertices[mesh.triangles], -1, axis=1)
    distance = np.linalg.norm(middle - disc.centre, axis=2)
    reach = disc.radius + REACH * np.linalg.norm(edge, axis=2)
    level = ~surface.held & (normals @ normal > SMALLEST_COSINE)
    edge_level = np.ones(nodes.weights.shape[0], dtype=bool)
    row = nodes.element[:, 3:] - nodes.n_nodes
    edge_level[row[~level].ravel()] = False
    chosen = (distance < reach) & edge_level[row] & ~surface.sides.cut[surface.sides.edge]
    midpoints, first = np.unique(row[chosen], return_index=True)
    position = middle[chosen][first]
    weights = csr_array(nodes.weights[midpoints])
    vertices = np.unique(weights.indices)
    at_vertices = disc_displacement(disc, normal, mesh.vertices[vertices])
    fitted = np.einsum("pv,svij->spij", weights[:, vertices].toarray(), at_vertices)
    return ContactShape(midpoints, disc_displacement(disc, normal, position) - fitted)


def shape_columns(
    system: BoundarySystem, shape: ContactShape, *, quadrature: Quadrature = Quadrature()
) -> RightHand:
    """Right-hand sides of what the midpoints miss, to be added to those of the load itself.

    Parameters
    ----------
    system : BoundarySystem
    shape : ContactShape
    quadrature : Quadrature

    Returns
    -------
    RightHand                         three columns, quadratic in Poisson's ratio
    """
    surface = system.surface
    nodes = surface.displacement
    number = np.full(nodes.weights.shape[0], -1)
    number[shape.midpoints] = np.arange(shape.midpoints.size)
    local = number[nodes.element[:, 3:] - nodes.n_nodes]
    triangles = np.flatnonzero((local >= 0).any(axis=1))
    # 18 nodes, one for each entry of `missing`, whose shape functions carry these entries; one more
    # row of zeros.
    values = np.concatenate(
        [shape.missing.transpose(1, 0, 2, 3).reshape(-1, 18), np.zeros((1, 18))]
    )
    element = np.full((triangles.size, 6), 18 + shape.midpoints.size)
    found = local[triangles]
    element[:, 3:] = np.where(found >= 0, 18 + found, element[:, 3:])
    chosen = np.zeros(surface.held.size, dtype=bool)
    chosen[triangles] = True
    blocks = assemble(
        restrict_collocation(system.collocation, chosen), surface.mesh.triangles[triangles],
        surface.element_nodes[triangles], QuadraticNodes(element, 18, csr_array(values)),
        n_fields=TRACTION_FIELDS, quadrature=quadrature,
    )  # fmt: skip
    fields = blocks.values.transpose(0, 3, 1, 2).reshape(-1, 2, 3, 3, 9)[: blocks.n_rows]
    flux = fields[..., 3:6].sum(axis=-1) / 3
    part_a = np.einsum("rsjck,ijk->isrc", fields[..., :3], SKEW) - flux.transpose(2, 1, 0, 3)
    part_b = -np.einsum("rsjcij->isrc", fields[..., 3 + np.array(PAIRS)])
    zero, one = part_a + part_b, -2 * part_a
    constant, slope = -zero[:, 0], -(zero[:, 1] + one[:, 0])
    parts = (constant, slope, -one[:, 1])
    return RightHand(*(np.concatenate([p.reshape(-1, 3), np.zeros((3, 3))]) for p in parts))
