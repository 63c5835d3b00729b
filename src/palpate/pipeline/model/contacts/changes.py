"""Contacts that differ a little from what a session says: beside their point, wider or narrower.
And what the mesh about them may be off by."""

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

# A tangent this near to an axis is called by its name.
_ALONG_AXIS = 0.95
# Cells of a load whose derivative is wanted: its rim is divided once more, not three times.
CHANGE_CELLS = LoadCells(degree=3, coarsest=2, finest_rim=3, finest=3)
# Of what the half space's dip adds to the mesh about a contact, this much is wrong on a body that
# is none: root mean square of the 32 contacts of twelve bodies against tetrahedra
# (benchmarks/coverage_of_bodies.py prints them).
DIP_SHARE = 0.35
# Where else a contact is tried, in standard deviations along two tangents: what first and second
# derivatives take. Of all distances the root of three, where Gauss-Hermite nodes lie, leaves least
# of a cubic, over errors that are normally distributed.
_PLACES = np.sqrt(3.0) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class ContactChange:
    """A contact of a probing, or a mesh about it, that differs from what is taken.

    Attributes
    ----------
    probing : int                   its number
    nominal : int                   which of the model's patches it has
    steps : parameter -> float      what it differs in, in standard deviations
    patch : ContactPatch or None    the changed contact; None: the contact as it is, the half
                                    space's dip changed by `DIP_SHARE`
    force : (3,) float [N]          of the probing
    """

    probing: int
    nominal: int
    steps: Mapping[NuisanceParameter, float]
    patch: ContactPatch | None
    force: Vector3


def contact_changes(session: Session, nominal: Int[np.ndarray, " k"]) -> tuple[ContactChange, ...]:
    """How the contacts of a session's probings may differ.

    Parameters
    ----------
    session : Session
    nominal : (k,) int              which of the model's patches each probing has

    Returns
    -------
    tuple of ContactChange          up to six a probing: place along two tangents, as many as its
                                    first and second derivatives take, and radius; none where a
                                    contact has no radius or is a part of the surface
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
    """How the displacement about contacts may differ from that of the mesh.

    Parameters
    ----------
    session : Session
    nominal : (k,) int              which of the model's patches each probing has
    dips : sequence of ContactShape or None     of the patches

    Returns
    -------
    tuple of ContactChange          one a probing whose contact the mesh does not resolve, however
                                    exact the laboratory is
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
    """Whether the mesh under a load misses some of its dip."""
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
    """A column for each changed contact less the nominal one, under the force of its probing.

    Parameters
    ----------
    system : BoundarySystem
    changes : sequence of ContactChange     those of dips are passed over
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
    """A column for each change of a dip: `DIP_SHARE` of it, under the force of its probing.

    Parameters
    ----------
    changes : sequence of ContactChange
    dipped : sequence of RightHand          what the dip of each patch adds to its three columns
    """
    return [
        dipped[one.nominal].under(DIP_SHARE * one.force) for one in changes if one.patch is None
    ]


def dipped_columns(
    system: BoundarySystem, dips: Sequence[ContactShape | None], bare: Sequence[RightHand]
) -> list[RightHand]:
    """What the dip of each patch adds to its columns; the integrals of all are one pass.

    Parameters
    ----------
    system : BoundarySystem
    dips : sequence                         `load_shapes` of every patch
    bare : sequence of RightHand            columns of every patch without its dip

    Returns
    -------
    list of RightHand                       zero where the mesh misses nothing
    """
    found = [RightHand(np.zeros_like(columns.terms)) for columns in bare]
    known = {k: dip for k, dip in enumerate(dips) if dip is not None and adds(dip)}
    if known:
        every = shape_columns(system, list(known.values())).terms
        for k, own in zip(known, np.split(every, len(known), axis=2), strict=True):
            found[k] = RightHand(own)
    return found


def _wide_patch(session: Session, probing: Probing, radius: float) -> ContactPatch:
    """Triangles that the contact reaches, changed or not; where that takes in the support, those
    that it reaches itself."""
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
    """Contacts beside the stated one, each with what it differs in."""
    contact, priors = probing.contact, session.errors
    point_std = priors.contact_std(probing.name)
    if point_std > 0.0:
        tangents, names = _tangents(session, patch)
        moved = contact.point + point_std * _PLACES @ tangents
        # Along the surface, as far from it as the stated point is.
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
    return "(" + ", ".join(f"{x:g}" for x in np.round(direction, 2) + 0.0) + ")"
