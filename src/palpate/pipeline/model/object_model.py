"""Boundary element model of a session's object, with its loads, weight and moving supports."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import (
    BodyForce,
    BoundarySystem,
    CentredSystem,
    IndentationCorrection,
    PointEquations,
    RightHand,
    Springs,
    SurfaceSettings,
    body_force_columns,
    check_memory,
    face_columns,
    held_system,
    indentation_corrections,
    joined,
    load_right_hand,
    make_surface,
    point_equations,
    pressure_column,
    support_columns,
)
from palpate.pipeline.model.compliant_supports import (
    compliant_supports,
    session_springs,
)
from palpate.pipeline.model.contacts import (
    ContactPerturbation,
    contact_perturbations,
    dip_columns,
    dip_perturbations,
    dipped_columns,
    has_outward_traction,
    outward_columns,
    outward_perturbations,
    perturbation_columns,
    surface_load,
)
from palpate.pipeline.model.moving_supports import (
    MovingSupport,
    held_directions,
    moving_supports,
    require_balance,
    sliding_motion,
    support_shapes,
)
from palpate.probe import ContactPatch, find_contact_patch
from palpate.progress import Progress, silent
from palpate.records import GIVEN, RIGID, Contact, Session

ContactKey = tuple[object, ...]


@dataclass(frozen=True, slots=True, eq=False)
class ContactPoints:
    """Integral equations for the displacement of the contact points.

    Attributes
    ----------
    equations : PointEquations            for every patch
    right : RightHand                     the same columns as for the system
    """

    equations: PointEquations
    right: RightHand


@dataclass(frozen=True, slots=True, eq=False)
class ObjectModel:
    """Boundary element model of a session's object with the loads of its probings.

    Attributes
    ----------
    session : Session
    system : BoundarySystem
    patches : dict of ContactPatch        distinct contacts under a force, by `contact_key`
    pressed : dict of ContactPatch        distinct contacts under a pressure, likewise
    supports : tuple of MovingSupport     moving ones; last the object itself, where it slides
    slides : bool                         whether the object slides along rollers
    shapes : (v, 3, q) float              displacements prescribed by their motions
                                          (`support_shapes`)
    right : RightHand                     three columns for each patch, one for each pressure, two
                                          for gravity, if any, q for the supports, then the
                                          perturbations
    perturbations : tuple of ContactPerturbation    perturbed contacts and dips of all probings
    springs : Springs or None             under compliant supports
    body : BodyForce or None
    tips : ContactPoints or None          None where no tip was measured
    centred : CentredSystem or None       the system, factorised for several models of it to share
    """

    session: Session
    system: BoundarySystem
    patches: dict[ContactKey, ContactPatch]
    pressed: dict[ContactKey, ContactPatch]
    supports: tuple[MovingSupport, ...]
    slides: bool
    shapes: Float[np.ndarray, "v 3 q"]
    right: RightHand
    body: BodyForce | None
    tips: ContactPoints | None
    perturbations: tuple[ContactPerturbation, ...] = ()
    springs: Springs | None = None
    centred: CentredSystem | None = None

    @property
    def gives_motions(self) -> bool:
        """Whether probings give the motion of a support."""
        return any(support.motion == GIVEN for support in self.supports)

    @property
    def patch_of(self) -> Int[np.ndarray, " k"]:
        """Index of the patch under the tool of each probing; -1: it pulls a support."""
        return _patch_numbers(self.session, self.patches)

    def pulled_translations(self, probing: int) -> tuple[int, ...]:
        """Indices of the translations of the support that a probing pulls; empty: it pulls none."""
        pulled = self.pulled_support(probing)
        return () if pulled is None else tuple(6 * pulled + i for i in range(3))

    def pulled_support(self, probing: int) -> int | None:
        """Index in `supports` of the one that a probing pulls; None: it pulls none."""
        contact = self.session.probings[probing].contact
        if contact.profile != RIGID or contact.triangles is None:
            return None
        same = [np.array_equal(support.triangles, contact.triangles) for support in self.supports]
        return same.index(True)


def make_object_model(
    session: Session,
    *,
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    perturbed: bool = True,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> ObjectModel:
    """Compute all integrals for a session's object, its loads, its weight and its supports.

    Parameters
    ----------
    session : Session
    surface : SurfaceSettings
    cache : Path or None              folder in which what is computed of the body is kept for
                                      reuse
    perturbed : bool                  False: without perturbed contacts, and without the error of
                                      the mesh about contacts
    like : ObjectModel or None        of the same mesh on the same supports with other contacts: its
                                      integrals and factors are reused
    progress : callable               called with the progress of the integrals, which may take
                                      minutes

    Returns
    -------
    ObjectModel

    Raises
    ------
    InputError                        the model does not fit into memory, a bad contact, or a force
                                      along a motion that no support holds
    """
    rollers = any(support.directions is not None for support in session.supports)
    compliant = bool(compliant_supports(session))
    check_memory(
        len(session.mesh.vertices), len(session.probings), rollers=rollers, dense=compliant
    )
    sliding = sliding_motion(session)
    require_balance(session, sliding)
    supports = (*moving_supports(session), *filter(None, [sliding]))
    shapes = support_shapes(session, supports)
    patches, pressed = _distinct_patches(session)
    boundary = make_surface(
        session.mesh, session.held_triangles, directions=held_directions(session), settings=surface
    )
    if like is not None:
        system = like.system
    else:
        system = held_system(boundary, dense=compliant, cache=cache, progress=progress)
    weight = None
    if session.gravity is not None and session.density is not None:
        weight = session.density * session.gravity
    dips = indentation_corrections(boundary, [surface_load(patch) for patch in patches.values()])
    numbers = _patch_numbers(session, patches)
    perturbations: tuple[ContactPerturbation, ...] = ()
    if perturbed:
        perturbations = (
            *contact_perturbations(session, numbers),
            *outward_perturbations(session, numbers),
            *dip_perturbations(session, numbers, dips),
        )
    moved = [contact.patch for contact in perturbations if contact.patch is not None]
    moved_dips = indentation_corrections(boundary, [surface_load(patch) for patch in moved])
    pressures = tuple(pressed.values())
    loads = tuple(patches.values()), dips, pressures, weight, shapes, perturbations, moved_dips
    right, body = _right_hand(system, *loads)
    tips = None
    if any(probing.tip_displacement is not None for probing in session.probings):
        equations = point_equations(
            system,
            np.array([patch.triangle for patch in patches.values()]),
            np.array([patch.barycentric for patch in patches.values()]),
        )
        tips = ContactPoints(equations, _right_hand(equations.system, *loads)[0])
    return ObjectModel(
        session, system, patches, pressed, supports, sliding is not None, shapes, right, body, tips,
        perturbations, session_springs(session, system), None if like is None else like.centred,
    )  # fmt: skip


def _right_hand(
    system: BoundarySystem,
    patches: Sequence[ContactPatch],
    dips: Sequence[IndentationCorrection | None],
    pressed: Sequence[ContactPatch],
    weight: Float[np.ndarray, "3"] | None,
    shapes: Float[np.ndarray, "v 3 q"],
    perturbations: Sequence[ContactPerturbation],
    moved_dips: Sequence[IndentationCorrection | None],
) -> tuple[RightHand, BodyForce | None]:
    """Columns of all loads, of the weight [N/m^3], if any, of the motions of supports, and of
    perturbed contacts."""
    parts = [
        load_right_hand(system, [surface_load(patch)])
        if patch.contact.triangles is None
        else face_columns(system, patch.triangles)
        for patch in patches
    ]
    dipped = dipped_columns(system, dips, parts)
    parts = [bare + dip for bare, dip in zip(parts, dipped, strict=True)]
    parts += [pressure_column(system, patch.triangles) for patch in pressed]
    body = None if weight is None else body_force_columns(system, weight)
    if body is not None:
        parts.append(body.right)
    parts.append(support_columns(system, shapes))
    nominal = [parts[each.patch_index] for each in perturbations]
    outward = {
        k: outward_columns(system, patch)
        for k, patch in enumerate(patches)
        if has_outward_traction(patch.contact)
    }
    for k, columns in outward.items():
        parts[k] = parts[k] + columns
    parts += perturbation_columns(system, perturbations, moved_dips, nominal)
    parts += [
        outward[each.patch_index].under(each.outward * each.force)
        for each in perturbations
        if each.outward
    ]
    parts += dip_columns(perturbations, dipped)
    return joined(parts), body


def _distinct_patches(
    session: Session,
) -> tuple[dict[ContactKey, ContactPatch], dict[ContactKey, ContactPatch]]:
    """Distinct contacts under a force, and distinct contacts under a pressure."""
    patches: dict[ContactKey, ContactPatch] = {}
    pressed: dict[ContactKey, ContactPatch] = {}
    for probing in session.probings:
        wanted = [(patches, probing.contact)] if probing.contact.profile != RIGID else []
        wanted += [
            (patches if load.pressure is None else pressed, load.contact) for load in probing.loads
        ]
        for group, contact in wanted:
            if contact_key(contact) not in group:
                group[contact_key(contact)] = find_contact_patch(
                    session.mesh, contact, session.held_triangles, name=probing.name
                )
    return patches, pressed


def _patch_numbers(
    session: Session, patches: dict[ContactKey, ContactPatch]
) -> Int[np.ndarray, " k"]:
    """Index of the patch under the tool of each probing; -1: it pulls a support."""
    order = list(patches)
    keys = [contact_key(probing.contact) for probing in session.probings]
    return np.array([order.index(key) if key in patches else -1 for key in keys])


def contact_key(contact: Contact) -> ContactKey:
    """Key that is equal for contacts with the same patch."""
    triangles = () if contact.triangles is None else tuple(contact.triangles.tolist())
    shape = None if contact.pressure_map is None else contact.pressure_map.pressure.tobytes()
    size = contact.radius, contact.profile, contact.outward
    return (*contact.point.tolist(), *size, triangles, shape)
