"""Contacts of tools under which the object moves sideways and turns.

A tool moves along a straight line. The object under it does not: a block that is pressed beside its
middle leans, a tool on its flank pushes it over. So the place that the tool touches moves along the
surface, by a millimetre where the object moves by four, and that of a ball most, since it touches
where the surface faces it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from palpate.bem import BoundarySurface, PressureDisc, disc_displacement, disc_potentials
from palpate.geometry import (
    CREASE_ANGLE,
    TriangleMesh,
    closest_points,
    interpolation_matrix,
    unit_normals,
)
from palpate.probe import LocalSurface, local_surface
from palpate.records import SLIDES, SPHERE, Contact, Probing, Session, Tool
from palpate.shapes import Points, Vector3, Vertices

# Distances, in reaches of the contact, of the points about it at which the object's motion is
# taken, how many there are on each circle, and how many are enough for a plane.
_CIRCLES, _ON_CIRCLE, _ENOUGH = (1.5, 2.0, 2.5), 12, 6
# Share of a change of place that is taken at once: the object moves less sideways under a contact
# that has followed it, so a whole step goes too far, by a quarter on a block.
STEP = 0.75
# Farther than this many reaches the linear model does not follow a contact.
_FARTHEST = 1.0


def displaced_contacts(
    session: Session,
    surface: BoundarySurface,
    moved: Sequence[Vertices],
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> Session:
    """A session with the contacts of its tools nearer to where these press in the end.

    Parameters
    ----------
    session : Session                       k probings, their tools with contact radii
    surface : BoundarySurface               of the session's mesh
    moved : sequence of k (v, 3) float [m]  displacement of its vertices under each tool
    shear_modulus : float [Pa]              > 0
    poisson_ratio : float [-]               -1 < nu < 0.5

    Returns
    -------
    Session                                 `STEP` of the way; contacts without a tool stay as they
                                            are
    """
    probings = []
    for probing, displacement in zip(session.probings, moved, strict=True):
        contact, tool = probing.contact, probing.contact.tool
        if tool is not None:
            start = contact.start
            local = local_surface(session.mesh, start, tool.radius)
            places, whole = _around(session.mesh, contact, local, surface, displacement)
            shift = np.zeros(3)
            if len(places) >= _ENOUGH:
                own = _under_tool(probing, local, places, shear_modulus, poisson_ratio)
                shift = _shift(probing, tool, local, _plane(contact, local, places, whole - own))
            place = contact.point + STEP * (start + shift - contact.point)
            point = closest_points(session.mesh, place[None]).position[0]
            probing = replace(probing, contact=replace(contact, point=point, first_point=start))
        probings.append(probing)
    return replace(session, probings=tuple(probings))


def _shift(
    probing: Probing, tool: Tool, local: LocalSurface, plane: Float[np.ndarray, "3 3"]
) -> Vector3:
    """Shift of a contact along the surface [m], from the displacement of the whole object there and
    its derivatives along two tangents.

    With u the displacement along the surface, s that of the tool, g the slope that the surface
    takes and k its curvature, a ball of radius R touches at y where (y + u - s) / R + k y = g. For
    tools of other shapes R is taken as 0, and to one that sticks the surface does not move.
    """
    tangents, shift = local.tangents, np.zeros(2)
    if tool.friction == SLIDES:
        travel = np.zeros(3) if probing.tip_displacement is None else probing.tip_displacement
        shift = tangents @ (travel - plane[0])
    if tool.shape == SPHERE:
        shift += tool.radius * (plane[1:] @ local.normal)
        shift /= 1.0 + tool.radius * max(local.curvature, 0.0)
    length, farthest = float(np.linalg.norm(shift)), _FARTHEST * probing.contact.reach
    return shift @ tangents * min(1.0, farthest / max(length, np.finfo(float).tiny))


def _plane(
    contact: Contact, local: LocalSurface, places: Points, displacement: Points
) -> Float[np.ndarray, "3 3"]:
    """Displacement [m] at a contact and its derivatives along two tangents, of the whole object:
    from a displacement without that under the tool's pressure, which has neither at the centre."""
    offset = (places - contact.point) @ local.tangents.T
    # A curved surface lies lower away from the contact.
    terms = np.column_stack([np.ones(len(offset)), offset, (offset**2).sum(axis=1)])
    return np.linalg.lstsq(terms, displacement, rcond=None)[0][:3]


def _under_tool(
    probing: Probing,
    local: LocalSurface,
    places: Points,
    shear_modulus: float,
    poisson_ratio: float,
) -> Points:
    """Displacement of a half space under the force along its normal, (p, 3) [m]."""
    contact = probing.contact
    pressing = float(local.normal @ probing.force) * local.normal
    disc = PressureDisc(contact.point, contact.reach, contact.pressure)
    constant, slope = disc_displacement(
        disc, disc_potentials(contact.pressure), local.normal, places
    )
    return (constant + poisson_ratio * slope) @ pressing / shear_modulus


def _around(
    mesh: TriangleMesh,
    contact: Contact,
    local: LocalSurface,
    surface: BoundarySurface,
    displacement: Vertices,
) -> tuple[Points, Points]:
    """Points about a contact on the same face of the object, and their displacement [m]."""
    angle = 2.0 * np.pi * np.arange(_ON_CIRCLE) / _ON_CIRCLE
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = np.concatenate([reach * circle @ local.tangents for reach in _CIRCLES])
    near = closest_points(mesh, contact.point + contact.reach * offset)
    level = unit_normals(mesh)[near.triangle] @ local.normal > np.cos(CREASE_ANGLE)
    rows = np.flatnonzero(level)
    at_points = interpolation_matrix(
        surface.displacement, near.triangle[rows], near.barycentric[rows]
    )
    return near.position[rows], at_points @ displacement
