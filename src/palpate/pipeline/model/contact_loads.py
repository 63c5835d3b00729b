"""Loads of a tool's contact: its pressure, the outward part of its traction, and both of a contact
beside its place or of another radius; and the error of the mesh about it.

The outward (radial) part of the traction has no resultant, but it widens the dent: neglecting it
makes nu of a half ball 0.004 too large under a ball that slides, 0.012 under one that sticks. How
large it is, `probe.tool_contact` says. It is minus the gradient of a potential Q(r), so it is the
derivative of Q, applied as a traction along each of two tangents, with respect to a shift along
that tangent. Under a mesh it is averaged over all directions. Where a tool sticks, and under a
sphere that touches a large circle, its integral is right, if not quite its distribution.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from palpate.arrays import tangents_of
from palpate.bem import IndentationCorrection, PressureDisc, SurfaceLoad
from palpate.errors import InputError
from palpate.estimation import PLACES, NuisanceParameter
from palpate.geometry import closest_points
from palpate.probe import ContactPatch, find_contact_patch, named_tangents
from palpate.records import RIGID, SPREAD, Contact, Pressure, Probing, Session
from palpate.shapes import Vector3
from palpate.solids import Solid, pressure_load

# Begins the name of the error of a contact's radius.
RADIUS_ERROR = "contact radius of"
# Relative error of the half space's dip that is added to the mesh about a contact, on bodies that
# are no half space: root mean square over 32 contacts of twelve bodies, compared with tetrahedra.
DIP_ERROR = 0.35
# Positions of perturbed contacts, in standard deviations along two tangents, for first and second
# derivatives. The distance sqrt(3), that of Gauss-Hermite nodes, minimises the error of a cubic for
# normally distributed errors.
_PLACES = np.sqrt(3.0) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])
# Begins the name of the error of the outward traction under a tool.
OUTWARD_ERROR = "outward traction in"
# Step of the central difference over the contact radius; the error is of second order in it.
_SHIFT = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class ContactPerturbation:
    """An error of a probing's contact, of its outward traction, or of the mesh about it.

    Attributes
    ----------
    probing : int                   index of the probing
    steps : parameter -> float      size of the perturbation, in standard deviations
    patch : ContactPatch or None    the perturbed contact; None: the nominal one
    outward : float [-]             relative change of the outward traction
    dip : float [-]                 relative change of the half space's dip
    """

    probing: int
    steps: Mapping[NuisanceParameter, float]
    patch: ContactPatch | None = None
    outward: float = 0.0
    dip: float = 0.0


def contact_perturbations(session: Session) -> tuple[ContactPerturbation, ...]:
    """Perturbed contacts of a session's probings.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of ContactPerturbation    up to six for each probing: five positions for the first and
                                    second derivatives along two tangents, and a radius; none where
                                    a contact has no radius or is a part of the surface
    """
    perturbations = []
    for k, probing in enumerate(session.probings):
        if probing.contact.profile != RIGID and probing.contact.radius is not None:
            patch = _covering_patch(session, probing, probing.contact.radius)
            for steps, contact in _perturbed(session, probing, patch):
                perturbations.append(ContactPerturbation(k, steps, replace(patch, contact=contact)))
    return tuple(perturbations)


def dip_perturbations(
    session: Session,
    patch_of: Int[np.ndarray, " k"],
    corrections: Sequence[IndentationCorrection | None],
) -> tuple[ContactPerturbation, ...]:
    """Perturbed dips: errors of the displacement about contacts that the mesh does not resolve.

    Parameters
    ----------
    session : Session
    patch_of : (k,) int             index of each probing's patch in the model
    corrections : sequence of IndentationCorrection or None     of the patches

    Returns
    -------
    tuple of ContactPerturbation    one for each probing with such a contact, whatever the priors of
                                    the session
    """
    return tuple(
        ContactPerturbation(k, {_dip_parameter(probing.name): 1.0}, dip=DIP_ERROR)
        for k, probing in enumerate(session.probings)
        if patch_of[k] >= 0 and corrections[patch_of[k]] is not None
    )


def surface_load(patch: ContactPatch) -> SurfaceLoad:
    """A contact patch as a load of the boundary element model.

    Parameters
    ----------
    patch : ContactPatch

    Returns
    -------
    SurfaceLoad
    """
    disc, contact = None, patch.contact
    if contact.radius is not None:
        disc = PressureDisc(contact.point, contact.reach, contact.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def has_outward_traction(contact: Contact) -> bool:
    """Whether a contact's traction has an outward part."""
    return _potential(contact) is not None


def outward_pushes(
    patch: ContactPatch, normal: Vector3, force: Vector3
) -> list[tuple[SurfaceLoad, Vector3]]:
    """Loads that together are the outward traction, with the force of each.

    Parameters
    ----------
    patch : ContactPatch
    normal : (3,) float [-]         outward unit normal of the surface under the tool
    force : (3,) float [N]          of the tool on the object

    Returns
    -------
    list of (SurfaceLoad, (3,) float [N])   empty where the traction has no outward part
    """
    contact, normal_force = patch.contact, float(-normal @ force)
    potential = _potential(contact)
    if potential is None:
        return []
    return [
        (_potential_load(patch, centre, potential), normal_force * share)
        for centre, share in _shifts(contact, normal)
    ]


def outward_perturbations(
    session: Session, patch_of: Int[np.ndarray, " k"]
) -> tuple[ContactPerturbation, ...]:
    """Perturbed outward tractions: as well known as the circle under a tool.

    Parameters
    ----------
    session : Session
    patch_of : (k,) int             index of each probing's patch in the model

    Returns
    -------
    tuple of ContactPerturbation    one for each probing whose contact `has_outward_traction`
    """
    std = session.errors.touched_radius
    return tuple(
        ContactPerturbation(
            k,
            {NuisanceParameter(f"{OUTWARD_ERROR} {probing.name}", std, of="contact radii"): 1.0},
            outward=std,
        )
        for k, probing in enumerate(session.probings)
        if std > 0.0 and patch_of[k] >= 0 and has_outward_traction(probing.contact)
    )


def outward_load(solid: Solid, contact: Contact, force: Vector3) -> Float[np.ndarray, "n 3"]:
    """The outward traction as forces on the nodes of finite elements.

    Parameters
    ----------
    solid : Solid
    contact : Contact
    force : (3,) float [N]          of the tool on the object

    Returns
    -------
    (n, 3) float [N]                sums to zero; all zero where there is no outward traction
    """
    normal = -force / np.linalg.norm(force)
    total, potential = np.zeros_like(solid.nodes), _potential(contact)
    if potential is None:
        return total
    for centre, share in _shifts(contact, normal):
        spread = pressure_load(solid, centre, contact.reach, potential)
        total += spread[:, None] * (share * np.linalg.norm(force))
    return total


def _dip_parameter(name: str) -> NuisanceParameter:
    return NuisanceParameter(
        f"mesh about the contact of {name} (in dips of a half space)",
        DIP_ERROR,
        of="mesh",
        is_model_error=True,
    )


def _covering_patch(session: Session, probing: Probing, radius: float) -> ContactPatch:
    """Patch with all triangles that the nominal or a perturbed contact reaches; if these include
    held ones, only those that the nominal contact reaches."""
    contact, priors = probing.contact, session.errors
    farthest = np.linalg.norm(_PLACES, axis=1).max() * priors.contact_std(probing.name)
    wider = radius * (1.0 + _radius_std(session, contact)) + float(farthest)
    surface = session.mesh, session.held_triangles
    try:
        return find_contact_patch(
            surface[0], replace(contact, radius=wider), surface[1], name=probing.name
        )
    except InputError:
        return find_contact_patch(surface[0], contact, surface[1], name=probing.name)


def _perturbed(
    session: Session, probing: Probing, patch: ContactPatch
) -> Iterator[tuple[dict[NuisanceParameter, float], Contact]]:
    """Perturbed contacts, each with its steps in standard deviations."""
    contact, priors = probing.contact, session.errors
    point_std = priors.contact_std(probing.name)
    if point_std > 0.0:
        tangents, names = named_tangents(session.mesh, patch)
        moved = contact.point + point_std * _PLACES @ tangents
        # Along the surface, at the same distance from it as the stated point.
        places = closest_points(session.mesh, np.vstack([contact.point, moved])).position
        parameters = [
            NuisanceParameter(
                f"contact point of {probing.name} toward {name}", point_std, "m", PLACES
            )
            for name in names
        ]
        for steps, position in zip(_PLACES.tolist(), places[1:], strict=True):
            moved_contact = replace(contact, point=contact.point + position - places[0])
            yield dict(zip(parameters, steps, strict=True)), moved_contact
    radius_std = _radius_std(session, contact)
    if radius_std > 0.0 and contact.radius is not None:
        parameter = NuisanceParameter(
            f"{RADIUS_ERROR} {probing.name}", radius_std, of="contact radii"
        )
        wider = contact.radius * (1.0 + radius_std)
        yield {parameter: 1.0}, replace(contact, radius=wider)


def _radius_std(session: Session, contact: Contact) -> float:
    """Prior standard deviation of a contact's radius, relative to it."""
    priors = session.errors
    return priors.contact_radius if contact.tool is None else priors.touched_radius


def _potential(contact: Contact) -> Pressure | None:
    """Q of a contact at a distance in units of its reach, up to a factor; None if it has none."""
    if contact.traction is None or not contact.traction.outward.any():
        return None
    table = contact.traction.potential
    return lambda at: np.interp(at, SPREAD, table)


def _shifts(contact: Contact, normal: Vector3) -> list[tuple[Vector3, Vector3]]:
    """Shifted centres of Q, and the total force of Q about each for one newton of pressure."""
    tangents = tangents_of(normal)
    step = _SHIFT * contact.reach
    # The integral of Q is half that of the outward traction times the distance from the centre.
    lever = contact.traction.lever if contact.traction is not None else 0.0
    size = 0.5 * contact.reach * lever / (2.0 * step)
    signed = [side * tangent for tangent in tangents for side in (1.0, -1.0)]
    return [(contact.point + step * shift, size * shift) for shift in signed]


def _potential_load(patch: ContactPatch, centre: Vector3, potential: Pressure) -> SurfaceLoad:
    """Q as a load about a given centre."""
    radius = patch.contact.reach

    def density(triangle: np.ndarray, barycentric: np.ndarray, position: np.ndarray) -> np.ndarray:
        return potential(np.linalg.norm(position - centre, axis=1) / radius)

    return SurfaceLoad(patch.triangles, density, PressureDisc(centre, radius, potential))
