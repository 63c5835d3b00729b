"""The outward (radial) part of the traction under a tool.

It has no resultant, but it widens the dent: neglecting it makes nu of a half ball 0.004 too large
under a ball that slides, 0.012 under one that sticks. How large it is, `probe.contact_circle` says.
It is minus the gradient of a potential Q(r), so it is the derivative of Q, applied as a traction
along each of two tangents, with respect to a shift along that tangent. Under a mesh it is averaged
over all directions. Where a tool sticks, and under a sphere that touches a large circle, its
integral is right, if not quite its distribution.
"""

import numpy as np
from jaxtyping import Float, Int
from scipy.integrate import cumulative_trapezoid

from palpate.arrays import tangents_of
from palpate.bem import PressureDisc, SurfaceLoad
from palpate.estimation import NuisanceParameter
from palpate.pipeline.model.contacts.perturbations import ContactPerturbation
from palpate.probe import ContactPatch
from palpate.records import Contact, Pressure, Session
from palpate.shapes import Vector3
from palpate.solids import Solid, pressure_load

# Begins the name of the error of the outward traction under a tool.
OUTWARD_ERROR = "outward traction in"
# Distances at which a potential is tabulated.
_SAMPLES = 64
# Step of the central difference over the contact radius; the error is of second order in it.
_SHIFT = 0.05


def _of_hertz(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Q at a distance s in contact radii, up to a factor, for an outward traction p r."""
    return np.clip(1.0 - s**2, 0.0, None) ** 1.5


def _of_cone(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """That of a traction p where p is arcosh(1 / s)."""
    s = np.clip(s, 1e-9, 1.0)
    return np.arccos(s) - s * np.arccosh(1.0 / s)


def _of_flat(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """That of a traction p r under a flat face."""
    return np.sqrt(np.clip(1.0 - s**2, 0.0, None))


# By the contact's profile.
_POTENTIALS = {"hertz": _of_hertz, "cone": _of_cone, "flat": _of_flat}


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
    contact, pressed = patch.contact, float(-normal @ force)
    potential = _potential(contact)
    if potential is None:
        return []
    return [
        (_potential_load(patch, centre, potential), pressed * share)
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


def _potential(contact: Contact) -> Pressure | None:
    """Q of a contact at a distance in units of its reach, up to a factor; None if it has none."""
    pressures = contact.pressure_map
    if pressures is None:
        return _POTENTIALS[contact.profile] if contact.outward else None
    s = np.linspace(0.0, 1.0, _SAMPLES)
    table = cumulative_trapezoid(pressures.mean_outward(s[::-1]), s, initial=0.0)[::-1]
    if not table.any():
        return None
    return lambda at: np.interp(at, s, table)


def _shifts(contact: Contact, normal: Vector3) -> list[tuple[Vector3, Vector3]]:
    """Shifted centres of Q, and the total force of Q about each for one newton of pressure."""
    tangents = tangents_of(normal)
    step = _SHIFT * contact.reach
    size = _integral(contact) / (2.0 * step)
    signed = [side * tangent for tangent in tangents for side in (1.0, -1.0)]
    return [(contact.point + step * shift, size * shift) for shift in signed]


def _integral(contact: Contact) -> float:
    """Integral of Q over the contact, for one newton [m]: half that of the outward traction times
    the distance from the centre."""
    pressures = contact.pressure_map
    if pressures is None:
        return 0.5 * contact.outward * contact.reach
    s = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    outward, pressure = pressures.mean_outward(s), pressures.mean(s)
    return float(0.5 * contact.reach * (outward @ s**2) / (pressure @ s))


def _potential_load(patch: ContactPatch, centre: Vector3, potential: Pressure) -> SurfaceLoad:
    """Q as a load about a given centre."""
    radius = patch.contact.reach

    def density(triangle: np.ndarray, barycentric: np.ndarray, position: np.ndarray) -> np.ndarray:
        return potential(np.linalg.norm(position - centre, axis=1) / radius)

    return SurfaceLoad(patch.triangles, density, PressureDisc(centre, radius, potential))
