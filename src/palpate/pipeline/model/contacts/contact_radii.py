"""Sessions with the contact radii that follow from their tools and given elastic constants."""

from dataclasses import replace

import numpy as np

from palpate.errors import InputError
from palpate.probe import contact_circle, convex_contact, local_surface
from palpate.records import MESH, Contact, Probing, Session
from palpate.shapes import Vector3

# A change of place counts this many times less than one of the radius, both over the radius: by
# default it is known four times less well on a contact of 2.5 mm, twice on one of 5 mm.
_POINT_SHARE = 4.0


def has_tools(session: Session) -> bool:
    """Whether a contact's radius follows from its tool."""
    return any(probing.contact.tool is not None for probing in session.probings)


def with_contact_radii(session: Session, *, shear_modulus: float, poisson_ratio: float) -> Session:
    """A session with contact radius and pressure profile computed for each tool.

    Parameters
    ----------
    session : Session
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu < 0.5

    Returns
    -------
    Session                         contacts without a tool stay as they are

    Raises
    ------
    InputError                      a tool that pulls, or that is buried
    NotConvergedError               contact of a mesh-shaped tool is not found (`convex_contact`)
    """

    def with_radius(probing: Probing) -> Probing:
        contact = probing.contact
        try:
            settled = settled_contact(
                session,
                contact,
                probing.force,
                shear_modulus=shear_modulus,
                poisson_ratio=poisson_ratio,
            )
        except InputError as error:
            raise InputError(f"probing '{probing.name}': {error}") from error
        return replace(probing, contact=settled)

    return replace(session, probings=tuple(with_radius(probing) for probing in session.probings))


def settled_contact(
    session: Session,
    contact: Contact,
    force: Vector3,
    *,
    shear_modulus: float,
    poisson_ratio: float,
) -> Contact:
    """A contact with the radius and the pressure that follow from its tool.

    Parameters
    ----------
    session : Session               of the object
    contact : Contact               one without a tool stays as it is
    force : (3,) float [N]          of the tool on the object
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    Contact

    Raises
    ------
    InputError                      a tool that pulls, is buried, or whose mesh touches far from
                                    its origin
    NotConvergedError               no equilibrium under a mesh
    """
    tool = contact.tool
    if tool is None:
        return contact
    local = local_surface(session.mesh, contact.point, tool.radius)
    pressed = -float(local.normal @ force)
    constants = {"shear_modulus": shear_modulus, "poisson_ratio": poisson_ratio}
    if tool.shape == MESH:
        found = convex_contact(tool, local, pressed, **constants)
        return replace(contact, radius=found.radius, pressure_map=found.pressure_map)
    circle = contact_circle(tool, local.curvature, pressed, **constants)
    return replace(contact, radius=circle.radius, profile=circle.profile, outward=circle.outward)


def largest_change(before: Session, after: Session) -> float:
    """Largest change of a contact between two versions of a session: of its radius, over it, of its
    point, over `_POINT_SHARE` of the radius, or of its outward traction [-]."""
    changes = [0.0]
    for earlier, later in zip(before.probings, after.probings, strict=True):
        old, new = earlier.contact, later.contact
        if old.radius is not None and new.radius is not None:
            changes += [abs(old.radius / new.radius - 1.0), abs(old.outward - new.outward)]
            shift = float(np.linalg.norm(new.point - old.point))
            changes.append(shift / (_POINT_SHARE * new.radius))
    return max(changes)
