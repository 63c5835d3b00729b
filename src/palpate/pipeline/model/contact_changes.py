"""Contacts that differ a little from what a session says: beside their point, wider or narrower."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

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
    nominal : int                   which of the model's patches it has
    parameter : NuisanceParameter
    patch : ContactPatch            the contact changed by one standard deviation
    force : (3,) float [N]          of the probing
    """

    probing: int
    nominal: int
    parameter: NuisanceParameter
    patch: ContactPatch
    force: Vector3


def contact_changes(session: Session, nominal: Int[np.ndarray, " k"]) -> tuple[ContactChange, ...]:
    """How the contacts of a session's probings may differ.

    Parameters
    ----------
    session : Session
    nominal : (k,) int              which of the model's patches each probing has

    Returns
    -------
    tuple of ContactChange          up to three a probing: place along two tangents, and radius;
                                    none where a contact has no radius or is a part of the surface
    """
    found = []
    for k, probing in enumerate(session.probings):
        if probing.contact.profile != RIGID and probing.contact.radius is not None:
            patch = _wide_patch(session, probing, probing.contact.radius)
            for parameter, contact in _changed(session, probing, patch):
                changed = replace(patch, contact=contact)
                found.append(ContactChange(k, int(nominal[k]), parameter, changed, probing.force))
    return tuple(found)


def _wide_patch(session: Session, probing: Probing, radius: float) -> ContactPatch:
    """Triangles that the contact reaches, changed or not; where that takes in the support, those
    that it reaches itself."""
    contact, priors = probing.contact, session.errors
    wider = radius * (1.0 + _radius_std(session, contact)) + priors.contact_std(probing.name)
    surface = session.mesh, session.held_triangles
    try:
        return find_contact_patch(
            surface[0], replace(contact, radius=wider), surface[1], name=probing.name
        )
    except InputError:
        return find_contact_patch(surface[0], contact, surface[1], name=probing.name)


def _changed(
    session: Session, probing: Probing, patch: ContactPatch
) -> Iterator[tuple[NuisanceParameter, Contact]]:
    """Parameters of a contact with the contact one standard deviation on."""
    contact, priors = probing.contact, session.errors
    point_std = priors.contact_std(probing.name)
    if point_std > 0.0:
        tangents, names = _tangents(session, patch)
        moved = contact.point + point_std * tangents
        # Along the surface, as far from it as the stated point is.
        places = closest_points(session.mesh, np.vstack([contact.point, moved])).position
        for name, place in zip(names, places[1:], strict=True):
            parameter = NuisanceParameter(
                f"contact point of {probing.name} toward {name}", point_std, "m"
            )
            yield parameter, replace(contact, point=contact.point + place - places[0])
    radius_std = _radius_std(session, contact)
    if radius_std > 0.0 and contact.radius is not None:
        parameter = NuisanceParameter(f"contact radius of {probing.name}", radius_std)
        wider = contact.radius * (1.0 + radius_std)
        yield parameter, replace(contact, radius=wider)


def _radius_std(session: Session, contact: Contact) -> float:
    """Prior of a contact's radius, over itself."""
    priors = session.errors
    return priors.contact_radius if contact.tool is None else priors.touched_radius


def _tangents(session: Session, patch: ContactPatch) -> tuple[Float[np.ndarray, "2 3"], list[str]]:
    """Two tangents of the surface under a patch, as near to the axes as may be, and their names."""
    corner = session.mesh.vertices[session.mesh.triangles[patch.triangles]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    first = np.eye(3)[int(np.abs(normal).argmin())]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    second *= np.sign(second[int(np.abs(second).argmax())])
    return np.stack([first, second]), [_direction_name(one) for one in (first, second)]


def _direction_name(direction: Float[np.ndarray, "3"]) -> str:
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > _ALONG_AXIS:
        return "+-"[int(direction[axis] < 0)] + "xyz"[axis]
    return "(" + ", ".join(f"{x:.2f}" for x in direction) + ")"
