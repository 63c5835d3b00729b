"""Perturbed contacts, for the errors of a contact's position and radius; and the error of the mesh
about a contact."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import (
    BoundarySystem,
    IndentationCorrection,
    LoadCells,
    PressureDisc,
    RightHand,
    SurfaceLoad,
    correction_columns,
    joined,
    load_right_hand,
)
from palpate.errors import InputError
from palpate.estimation import NuisanceParameter
from palpate.geometry import TriangleMesh, closest_points
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import RIGID, Contact, Probing, Session
from palpate.shapes import Vector3

# Begins the name of the error of a contact's radius.
RADIUS_ERROR = "contact radius of"
# Cosine above which a tangent is named by an axis.
_ALONG_AXIS = 0.95
# Cells for loads of perturbed contacts and outward tractions: fewer points than for contacts.
PERTURBATION_CELLS = LoadCells(degree=3, rim_points=3, polar_points=6, coarsest=0, finest=0)
# Relative error of the half space's dip that is added to the mesh about a contact, on bodies that
# are no half space: root mean square over 32 contacts of twelve bodies, compared with tetrahedra
# (benchmarks/coverage_of_bodies.py prints them).
DIP_ERROR = 0.35
# Positions of perturbed contacts, in standard deviations along two tangents, for first and second
# derivatives. The distance sqrt(3), that of Gauss-Hermite nodes, minimises the error of a cubic for
# normally distributed errors.
_PLACES = np.sqrt(3.0) * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0], [1.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class ContactPerturbation:
    """A perturbed contact of a probing, or a perturbed dip or outward traction about it.

    Attributes
    ----------
    probing : int                   index of the probing
    patch_index : int               index of its patch in the model
    steps : parameter -> float      size of the perturbation, in standard deviations
    patch : ContactPatch or None    the perturbed contact; None: the nominal contact, with the half
                                    space's dip changed by `DIP_ERROR`, or the outward traction
    force : (3,) float [N]          of the probing
    outward : float [-]             relative change of the outward traction
    """

    probing: int
    patch_index: int
    steps: Mapping[NuisanceParameter, float]
    patch: ContactPatch | None
    force: Vector3
    outward: float = 0.0

    @property
    def is_dip(self) -> bool:
        """True for a perturbed dip, False for a perturbed contact."""
        return self.patch is None and self.outward == 0.0


def contact_perturbations(
    session: Session, patch_index: Int[np.ndarray, " k"]
) -> tuple[ContactPerturbation, ...]:
    """Perturbed contacts of a session's probings.

    Parameters
    ----------
    session : Session
    patch_index : (k,) int          index of each probing's patch in the model

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
                perturbed = replace(patch, contact=contact)
                perturbations.append(
                    ContactPerturbation(k, int(patch_index[k]), steps, perturbed, probing.force)
                )
    return tuple(perturbations)


def dip_perturbations(
    session: Session,
    patch_index: Int[np.ndarray, " k"],
    dips: Sequence[IndentationCorrection | None],
) -> tuple[ContactPerturbation, ...]:
    """Perturbed dips: errors of the displacement about contacts that the mesh does not resolve.

    Parameters
    ----------
    session : Session
    patch_index : (k,) int          index of each probing's patch in the model
    dips : sequence of IndentationCorrection or None     of the patches

    Returns
    -------
    tuple of ContactPerturbation    one for each probing with such a contact, whatever the priors of
                                    the session
    """
    return tuple(
        ContactPerturbation(
            k, int(patch_index[k]), {_dip_parameter(probing.name): 1.0}, None, probing.force
        )
        for k, probing in enumerate(session.probings)
        if patch_index[k] >= 0 and adds(dips[patch_index[k]])
    )


def _dip_parameter(name: str) -> NuisanceParameter:
    return NuisanceParameter(
        f"mesh about the contact of {name} (in dips of a half space)",
        DIP_ERROR,
        of="mesh",
        is_model_error=True,
    )


def adds(dip: IndentationCorrection | None) -> bool:
    """Whether a dip adds to the displacement that the mesh resolves under a load."""
    return dip is not None and dip.midside_nodes.size > 0


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


def perturbation_columns(
    system: BoundarySystem,
    perturbations: Sequence[ContactPerturbation],
    shapes: Sequence[IndentationCorrection | None],
    nominal: Sequence[RightHand],
) -> list[RightHand]:
    """Columns of perturbed contacts minus the nominal ones, under the forces of their probings.

    Parameters
    ----------
    system : BoundarySystem
    perturbations : sequence of ContactPerturbation     those without a patch are skipped
    shapes : sequence                       `indentation_corrections` of the others; may hold None
    nominal : sequence of RightHand         of every perturbation's nominal contact

    Returns
    -------
    list of RightHand                       none, or one with a column for each perturbation that
                                            has a patch

    Raises
    ------
    InputError                              a perturbed contact covers no part of the free surface
    """
    moved = [each for each in zip(perturbations, nominal, strict=True) if each[0].patch is not None]
    if not moved:
        return []
    loads = [surface_load(contact.patch) for contact, _ in moved if contact.patch is not None]
    forces = np.array([contact.force for contact, _ in moved])
    perturbed = load_right_hand(system, loads, shapes, forces=forces, cells=PERTURBATION_CELLS)
    unperturbed = joined([columns.under(contact.force) for contact, columns in moved])
    return [RightHand(perturbed.terms - unperturbed.terms)]


def dip_columns(
    perturbations: Sequence[ContactPerturbation], dipped: Sequence[RightHand]
) -> list[RightHand]:
    """Columns of perturbed dips: `DIP_ERROR` of each, under the force of its probing.

    Parameters
    ----------
    perturbations : sequence of ContactPerturbation
    dipped : sequence of RightHand          contribution of each patch's dip to its three columns

    Returns
    -------
    list of RightHand                       one column for each perturbation that is a dip
    """
    return [
        dipped[dip.patch_index].under(DIP_ERROR * dip.force) for dip in perturbations if dip.is_dip
    ]


def dipped_columns(
    system: BoundarySystem, dips: Sequence[IndentationCorrection | None], bare: Sequence[RightHand]
) -> list[RightHand]:
    """Contribution of each patch's dip to its columns; all integrals are computed in one pass.

    Parameters
    ----------
    system : BoundarySystem
    dips : sequence                         `indentation_corrections` of every patch
    bare : sequence of RightHand            columns of every patch without its dip

    Returns
    -------
    list of RightHand                       zero where the mesh resolves the contact
    """
    contributions = [RightHand(np.zeros_like(columns.terms)) for columns in bare]
    unresolved = {k: dip for k, dip in enumerate(dips) if dip is not None and adds(dip)}
    if unresolved:
        terms = correction_columns(system, list(unresolved.values())).terms
        for k, own in zip(unresolved, np.split(terms, len(unresolved), axis=2), strict=True):
            contributions[k] = RightHand(own)
    return contributions


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
                f"contact point of {probing.name} toward {name}", point_std, "m", "contact points"
            )
            for name in names
        ]
        for steps, place in zip(_PLACES.tolist(), places[1:], strict=True):
            moved_contact = replace(contact, point=contact.point + place - places[0])
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


def named_tangents(
    mesh: TriangleMesh, patch: ContactPatch
) -> tuple[Float[np.ndarray, "2 3"], list[str]]:
    """Two tangents of the surface under a patch, aligned with axes if possible, and their names.

    Parameters
    ----------
    mesh : TriangleMesh
    patch : ContactPatch

    Returns
    -------
    (2, 3) float [-]                        at right angles to each other
    list of 2 str                           "+x", "-y", or the vector
    """
    corner = mesh.vertices[mesh.triangles[patch.triangles]]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    first = np.eye(3)[int(np.abs(normal).argmin())]
    first = first - (first @ normal) * normal
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    second *= np.sign(second[int(np.abs(second).argmax())])
    return np.stack([first, second]), [_direction_name(tangent) for tangent in (first, second)]


def _direction_name(direction: Float[np.ndarray, "3"]) -> str:
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) > _ALONG_AXIS:
        return "+-"[int(direction[axis] < 0)] + "xyz"[axis]
    return "(" + ", ".join(f"{x:g}" for x in np.round(direction, 2) + 0.0) + ")"
