"""Perturbed contacts, for the errors of a contact's position and radius; and the error of the mesh
about a contact."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import (
    BoundarySystem,
    ContactShape,
    LoadCells,
    PressureDisc,
    RightHand,
    SurfaceLoad,
    joined,
    load_right_hand,
    shape_columns,
)
from palpate.errors import InputError
from palpate.estimation import NuisanceParameter
from palpate.geometry import closest_points
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import RIGID, Contact, Probing, Session
from palpate.shapes import Vector3

# Cosine above which a tangent is named by an axis.
_ALONG_AXIS = 0.95
# Cells for loads of perturbed contacts: the rim is subdivided once more, not three times.
CHANGE_CELLS = LoadCells(degree=3, coarsest=2, finest_rim=3, finest=3)
# Relative error of the half space's dip that is added to the mesh about a contact, on bodies that
# are no half space: root mean square over 32 contacts of twelve bodies, compared with tetrahedra
# (benchmarks/coverage_of_bodies.py prints them).
DIP_SHARE = 0.35
# Positions of perturbed contacts, in standard deviations along two tangents, for first and second
# derivatives. The distance sqrt(3), that of Gauss-Hermite nodes, minimises the error of a cubic for
# normally distributed errors.
_PLACES = np.sqrt(3.0) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class ContactChange:
    """A perturbed contact of a probing, or a perturbed dip about it.

    Attributes
    ----------
    probing : int                   index of the probing
    nominal : int                   index of its patch in the model
    steps : parameter -> float      size of the perturbation, in standard deviations
    patch : ContactPatch or None    the perturbed contact; None: the nominal contact, with the half
                                    space's dip changed by `DIP_SHARE`
    force : (3,) float [N]          of the probing
    """

    probing: int
    nominal: int
    steps: Mapping[NuisanceParameter, float]
    patch: ContactPatch | None
    force: Vector3


def contact_changes(session: Session, nominal: Int[np.ndarray, " k"]) -> tuple[ContactChange, ...]:
    """Perturbed contacts of a session's probings.

    Parameters
    ----------
    session : Session
    nominal : (k,) int              index of each probing's patch in the model

    Returns
    -------
    tuple of ContactChange          up to six for each probing: five positions for the first and
                                    second derivatives along two tangents, and a radius; none where
                                    a contact has no radius or is a part of the surface
    """
    found = []
    for k, probing in enumerate(session.probings):
        if probing.contact.profile != RIGID and probing.contact.radius is not None:
            patch = _wide_patch(session, probing, probing.contact.radius)
            for steps, contact in _changed(session, probing, patch):
                changed = replace(patch, contact=contact)
                found.append(ContactChange(k, int(nominal[k]), steps, changed, probing.force))
    return tuple(found)


def dip_changes(
    session: Session, nominal: Int[np.ndarray, " k"], dips: Sequence[ContactShape | None]
) -> tuple[ContactChange, ...]:
    """Perturbed dips: errors of the displacement about contacts that the mesh does not resolve.

    Parameters
    ----------
    session : Session
    nominal : (k,) int              index of each probing's patch in the model
    dips : sequence of ContactShape or None     of the patches

    Returns
    -------
    tuple of ContactChange          one for each probing with such a contact, whatever the priors of
                                    the session
    """
    return tuple(
        ContactChange(k, int(nominal[k]), {_dip_parameter(probing.name): 1.0}, None, probing.force)
        for k, probing in enumerate(session.probings)
        if nominal[k] >= 0 and adds(dips[nominal[k]])
    )


def _dip_parameter(name: str) -> NuisanceParameter:
    return NuisanceParameter(
        f"mesh about the contact of {name} (in dips of a half space)", DIP_SHARE, of="mesh"
    )


def adds(dip: ContactShape | None) -> bool:
    """Whether a dip adds to the displacement that the mesh resolves under a load."""
    return dip is not None and dip.midpoints.size > 0


def surface_load(patch: ContactPatch) -> SurfaceLoad:
    """A contact patch as a load of the boundary element model.

    Parameters
    ----------
    patch : ContactPatch

    Returns
    -------
    SurfaceLoad
    """
    disc = None
    if patch.contact.radius is not None:
        disc = PressureDisc(patch.contact.point, patch.contact.radius, patch.pressure)
    return SurfaceLoad(patch.triangles, patch.density, disc)


def change_columns(
    system: BoundarySystem,
    changes: Sequence[ContactChange],
    shapes: Sequence[ContactShape | None],
    nominal: Sequence[RightHand],
) -> list[RightHand]:
    """Columns of perturbed contacts minus the nominal ones, under the forces of their probings.

    Parameters
    ----------
    system : BoundarySystem
    changes : sequence of ContactChange     those of dips are skipped
    shapes : sequence                       `load_shapes` of the others
    nominal : sequence of RightHand         of every change's nominal contact
    """
    moved = [(one, nominal[k]) for k, one in enumerate(changes) if one.patch is not None]
    if not moved:
        return []
    loads = [surface_load(one.patch) for one, _ in moved if one.patch is not None]
    forces = np.array([one.force for one, _ in moved])
    after = load_right_hand(system, loads, shapes, forces=forces, cells=CHANGE_CELLS)
    before = joined([columns.under(one.force) for one, columns in moved])
    return [RightHand(after.terms - before.terms)]


def dip_columns(changes: Sequence[ContactChange], dipped: Sequence[RightHand]) -> list[RightHand]:
    """Columns of perturbed dips: `DIP_SHARE` of each, under the force of its probing.

    Parameters
    ----------
    changes : sequence of ContactChange
    dipped : sequence of RightHand          contribution of each patch's dip to its three columns
    """
    return [
        dipped[one.nominal].under(DIP_SHARE * one.force) for one in changes if one.patch is None
    ]


def dipped_columns(
    system: BoundarySystem, dips: Sequence[ContactShape | None], bare: Sequence[RightHand]
) -> list[RightHand]:
    """Contribution of each patch's dip to its columns; all integrals are computed in one pass.

    Parameters
    ----------
    system : BoundarySystem
    dips : sequence                         `load_shapes` of every patch
    bare : sequence of RightHand            columns of every patch without its dip

    Returns
    -------
    list of RightHand                       zero where the mesh resolves the contact
    """
    found = [RightHand(np.zeros_like(columns.terms)) for columns in bare]
    known = {k: dip for k, dip in enumerate(dips) if dip is not None and adds(dip)}
    if known:
        every = shape_columns(system, list(known.values())).terms
        for k, own in zip(known, np.split(every, len(known), axis=2), strict=True):
            found[k] = RightHand(own)
    return found


def _wide_patch(session: Session, probing: Probing, radius: float) -> ContactPatch:
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


def _changed(
    session: Session, probing: Probing, patch: ContactPatch
) -> Iterator[tuple[dict[NuisanceParameter, float], Contact]]:
    """Perturbed contacts, each with its steps in standard deviations."""
    contact, priors = probing.contact, session.errors
    point_std = priors.contact_std(probing.name)
    if point_std > 0.0:
        tangents, names = _tangents(session, patch)
        moved = contact.point + point_std * _PLACES @ tangents
        # Along the surface, at the same distance from it as the stated point.
        places = closest_points(session.mesh, np.vstack([contact.point, moved])).position
        toward = [
            NuisanceParameter(
                f"contact point of {probing.name} toward {name}", point_std, "m", "contact points"
            )
            for name in names
        ]
        for steps, place in zip(_PLACES.tolist(), places[1:], strict=True):
            there = replace(contact, point=contact.point + place - places[0])
            yield dict(zip(toward, steps, strict=True)), there
    radius_std = _radius_std(session, contact)
    if radius_std > 0.0 and contact.radius is not None:
        parameter = NuisanceParameter(
            f"contact radius of {probing.name}", radius_std, of="contact radii"
        )
        wider = contact.radius * (1.0 + radius_std)
        yield {parameter: 1.0}, replace(contact, radius=wider)


def _radius_std(session: Session, contact: Contact) -> float:
    """Prior standard deviation of a contact's radius, relative to it."""
    priors = session.errors
    return priors.contact_radius if contact.tool is None else priors.touched_radius


def _tangents(session: Session, patch: ContactPatch) -> tuple[Float[np.ndarray, "2 3"], list[str]]:
    """Two tangents of the surface under a patch, aligned with axes if possible, and their names."""
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
    return "(" + ", ".join(f"{x:g}" for x in np.round(direction, 2) + 0.0) + ")"
