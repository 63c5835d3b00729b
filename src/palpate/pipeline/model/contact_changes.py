"""Contacts that differ a little from what a session says: beside their point, wider or narrower."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.estimation import NuisanceParameter
from palpate.geometry import closest_points
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import RIGID, Contact, Probing, Session
from palpate.shapes import Vector3

# A tangent this near to an axis is called by its name.
_ALONG_AXIS = 0.95


@dataclass(frozen=True, slots=True, eq=False)
class ContactChange:
    """One way in which a probing's contact may differ from what its session says.

    Attributes
    ----------
    probing : int                   its number
    parameter : NuisanceParameter
    higher, lower : ContactPatch    the contact changed by one standard deviation either way, or by
                                    none where it cannot lie there
    share : float                   of the difference of the two, for one standard deviation
    force : (3,) float [N]          of the probing
    """

    probing: int
    parameter: NuisanceParameter
    higher: ContactPatch
    lower: ContactPatch
    share: float
    force: Vector3


def contact_changes(session: Session) -> tuple[ContactChange, ...]:
    """How the contacts of a session's probings may differ.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of ContactChange          up to three a probing: place along two tangents, and radius;
                                    none where a contact has no radius or is a part of the surface
    """
    found = []
    for k, probing in enumerate(session.probings):
        if probing.contact.profile == RIGID or probing.contact.radius is None:
            continue
        middle = find_contact_patch(
            session.mesh, probing.contact, session.held_triangles, name=probing.name
        )
        for parameter, *contacts in _changed(session, probing, middle):
            patches = [_patch(session, probing, contact) for contact in contacts]
            known = sum(patch is not None for patch in patches)
            if known:
                higher, lower = (patch or middle for patch in patches)
                change = ContactChange(k, parameter, higher, lower, 1.0 / known, probing.force)
                found.append(change)
    return tuple(found)


def _changed(
    session: Session, probing: Probing, patch: ContactPatch
) -> Iterator[tuple[NuisanceParameter, Contact, Contact]]:
    """Parameters of a contact with the contacts one standard deviation either way."""
    contact, priors = probing.contact, session.errors
    if priors.contact_point > 0.0:
        for tangent, name in _tangents(session, patch):
            parameter = NuisanceParameter(
                f"contact point of {probing.name} toward {name}", priors.contact_point, "m"
            )
            shift = priors.contact_point * tangent
            yield parameter, _moved(session, contact, shift), _moved(session, contact, -shift)
    if priors.contact_radius > 0.0 and contact.radius is not None:
        parameter = NuisanceParameter(f"contact radius of {probing.name}", priors.contact_radius)
        wider, narrower = (
            replace(contact, radius=contact.radius * (1.0 + sign * priors.contact_radius))
            for sign in (1.0, -1.0)
        )
        yield parameter, wider, narrower


def _tangents(session: Session, patch: ContactPatch) -> list[tuple[Float[np.ndarray, "3"], str]]:
    """Two tangents of the surface under a patch, as near to the axes as may be, and their names."""
    corner = session.mesh.vertices[session.mesh.triangles[patch.triangles]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    first = np.eye(3)[int(np.abs(normal).argmin())]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    second *= np.sign(second[int(np.abs(second).argmax())])
    return [(tangent, _direction_name(tangent)) for tangent in (first, second)]


def _direction_name(direction: Float[np.ndarray, "3"]) -> str:
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > _ALONG_AXIS:
        return "+-"[int(direction[axis] < 0)] + "xyz"[axis]
    return "(" + ", ".join(f"{x:.2f}" for x in direction) + ")"


def _moved(session: Session, contact: Contact, shift: Float[np.ndarray, "3"]) -> Contact:
    """The contact moved along the surface."""
    here, there = closest_points(
        session.mesh, np.stack([contact.point, contact.point + shift])
    ).position
    return replace(contact, point=contact.point + there - here)


def _patch(session: Session, probing: Probing, contact: Contact) -> ContactPatch | None:
    """Triangles under a contact; None where a tool cannot press there."""
    try:
        return find_contact_patch(session.mesh, contact, session.held_triangles, name=probing.name)
    except InputError:
        return None
