"""All loads of a session's object, as columns of right-hand sides.

Every column is a combination of tractions that are integrated once each: the pressure under a tool,
the outward part of its traction, what a mesh misses of the dip about it, and the same of contacts
beside their place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from jaxtyping import Float, Int

from palpate.bem import (
    BodyForce,
    BoundarySurface,
    BoundarySystem,
    IndentationCorrection,
    LoadCells,
    RightHand,
    SurfaceLoad,
    body_force_columns,
    correction_columns,
    face_columns,
    indentation_corrections,
    load_right_hand,
    missed_indentation,
    pressure_column,
    support_columns,
)
from palpate.geometry import unit_normals
from palpate.pipeline.model.contact_loads import (
    ContactPerturbation,
    contact_perturbations,
    dip_perturbations,
    outward_perturbations,
    outward_pushes,
    surface_load,
)
from palpate.probe import ContactPatch, find_contact_patch
from palpate.records import RIGID, Contact, Session
from palpate.shapes import Vector3

ContactKey = tuple[object, ...]
# Column -> force in it [N].
_Forces = dict[int, Vector3]
# Cells of perturbed contacts and outward tractions: fewer points than for contacts.
_FEWER = LoadCells(degree=3, rim_points=3, polar_points=6, coarsest=0, finest=0)
# Singular value of forces over the largest, below which it is rounding error.
_NO_FORCE = 1e-12
# Tractions, and dips, that are integrated at a time: their integrals take a megabyte each on 800
# vertices, and a session has a dozen for each push.
_TOGETHER = 64
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Traction:
    """A traction on the surface, with its resultant force in some columns of a table.

    Attributes
    ----------
    load : SurfaceLoad
    is_uniform : bool               over its triangles: integrated as nodal values are
    columns : (m,) int
    force : (3, m) float [N]        resultant in each of these columns
    dip : IndentationCorrection or None    what the mesh misses of the displacement about it
    dip_force : (3, m) float [N]    the force whose dip is in each column
    """

    load: SurfaceLoad
    is_uniform: bool
    columns: Int[np.ndarray, " m"]
    force: Float[np.ndarray, "3 m"]
    dip: IndentationCorrection | None
    dip_force: Float[np.ndarray, "3 m"]

    def dips(self) -> list[tuple[IndentationCorrection, Float[np.ndarray, " m"]]]:
        """Dips under as few single forces as the columns need, each with its factor in every
        column."""
        if self.dip is None:
            return []
        axis, size, share = np.linalg.svd(self.dip_force, full_matrices=False)
        rank = int((size > _NO_FORCE * size[0]).sum())
        return [(self.dip.under(axis[:, k]), size[k] * share[k]) for k in range(rank)]


@dataclass(frozen=True, slots=True, eq=False)
class LoadTable:
    """All loads of a session's object. Its columns are, in this order: three for each contact under
    a force, of one newton along x, y and z; one for each pressure, of one pascal; two for the
    weight, if any; one for each motion of a support; one for each perturbation, under the force of
    its probing.

    Attributes
    ----------
    patches : dict of ContactPatch        distinct contacts under a force, by `contact_key`
    pressed : dict of ContactPatch        distinct contacts under a pressure, likewise
    patch_of : (k,) int                   index of the patch under the tool of each probing; -1: it
                                          pulls a support
    weight : (3,) float [N/m^3] or None
    shapes : (v, 3, q) float              displacements prescribed by motions of supports
    perturbations : tuple of ContactPerturbation    of all probings
    tractions : tuple of Traction         on the patches, and on perturbed ones
    """

    patches: dict[ContactKey, ContactPatch]
    pressed: dict[ContactKey, ContactPatch]
    patch_of: Int[np.ndarray, " k"]
    weight: Float[np.ndarray, "3"] | None
    shapes: Float[np.ndarray, "v 3 q"]
    perturbations: tuple[ContactPerturbation, ...]
    tractions: tuple[Traction, ...]

    def force_columns(self, contact: Contact) -> Int[np.ndarray, "3"]:
        """Columns of a contact under a force."""
        return 3 * list(self.patches).index(contact_key(contact)) + np.arange(3)

    def pressure_columns(self, contact: Contact) -> Int[np.ndarray, "1"]:
        """Column of a contact under a pressure."""
        return np.array([3 * len(self.patches) + list(self.pressed).index(contact_key(contact))])

    @property
    def weight_columns(self) -> Int[np.ndarray, " w"]:
        """Columns of the weight: two, or none."""
        return np.arange(*self._ends[2:4])

    @property
    def motion_columns(self) -> Int[np.ndarray, " q"]:
        """Columns of the motions of supports."""
        return np.arange(*self._ends[3:5])

    @property
    def perturbation_columns(self) -> Int[np.ndarray, " p"]:
        """Columns of the perturbations."""
        return np.arange(*self._ends[4:])

    @property
    def _ends(self) -> Int[np.ndarray, "6"]:
        """Where the columns of each kind begin, and where the last ones end."""
        weight, motions = 0 if self.weight is None else 2, self.shapes.shape[2]
        counts = (3 * len(self.patches), len(self.pressed), weight, motions)
        return np.cumsum([0, *counts, len(self.perturbations)])

    def missed_indentation(
        self,
        surface: BoundarySurface,
        columns: Int[np.ndarray, " c"],
        triangle: Int[np.ndarray, " n"],
        barycentric: Float[np.ndarray, "n 3"],
    ) -> Float[np.ndarray, "2 q c"]:
        """Part of the dips about contacts that is missed between vertices (`bem`), in some columns.

        Parameters
        ----------
        surface : BoundarySurface
        columns : (c,) int
        triangle : (n,) int
        barycentric : (n, 3) float [-]

        Returns
        -------
        (2, 3 n, c) float [m Pa]      displacement times shear modulus, constant and slope in
                                      Poisson's ratio
        """
        missed, wanted = np.zeros((2, 3 * len(triangle), len(columns))), set(columns.tolist())
        for traction in self.tractions:
            # Of many pushes, few tractions are in any columns.
            if traction.dip is None or wanted.isdisjoint(traction.columns.tolist()):
                continue
            _, here, chosen = np.intersect1d(columns, traction.columns, return_indices=True)
            dip = missed_indentation(surface, traction.dip.dip, triangle, barycentric)
            missed[:, :, here] += (dip @ traction.dip_force[:, chosen]).reshape(2, -1, chosen.size)
        return missed

    def integrate(self, system: BoundarySystem) -> tuple[RightHand, BodyForce | None]:
        """All columns for a system on the surface of this table.

        Parameters
        ----------
        system : BoundarySystem       with any collocation points

        Returns
        -------
        RightHand
        BodyForce or None             None: there is no weight
        """
        terms = np.zeros((3, 3 * system.n_points + 3, self._ends[-1]))
        for traction in self.tractions:
            if traction.is_uniform:
                unit = face_columns(system, traction.load.triangles).terms
                terms[:, :, traction.columns] += unit @ traction.force
        for part in _slices([traction for traction in self.tractions if not traction.is_uniform]):
            units = load_right_hand(system, [traction.load for traction in part]).terms
            for traction, unit in zip(part, np.split(units, len(part), axis=2), strict=True):
                terms[:, :, traction.columns] += unit @ traction.force
        dips = [(traction.columns, *dip) for traction in self.tractions for dip in traction.dips()]
        for batch in _slices(dips):
            corrections = correction_columns(system, [dip for _, dip, _ in batch]).terms
            for k, (columns, _, factor) in enumerate(batch):
                terms[:, :, columns] += corrections[:, :, k, None] * factor
        for patch in self.pressed.values():
            column = self.pressure_columns(patch.contact)
            terms[:, :, column] = pressure_column(system, patch.triangles).terms
        body = None
        if self.weight is not None:
            body = body_force_columns(system, self.weight)
            terms[:, :, self.weight_columns] = body.right.terms
        terms[:, :, self.motion_columns] = support_columns(system, self.shapes).terms
        return RightHand(terms), body


def make_load_table(
    session: Session,
    surface: BoundarySurface,
    shapes: Float[np.ndarray, "v 3 q"],
    *,
    perturbed: bool,
) -> LoadTable:
    """The loads of a session's probings, with the errors that their contacts may have.

    Parameters
    ----------
    session : Session
    surface : BoundarySurface       of its object
    shapes : (v, 3, q) float        displacements prescribed by motions of supports
    perturbed : bool                False: without errors of contacts and of the mesh about them

    Returns
    -------
    LoadTable

    Raises
    ------
    InputError                      a bad contact
    """
    patches, pressed = _distinct_patches(session)
    order = list(patches)
    keys = [contact_key(probing.contact) for probing in session.probings]
    patch_of = np.array([order.index(key) if key in patches else -1 for key in keys])
    weight = None
    if session.added_gravity is not None and session.density is not None:
        weight = session.density * session.added_gravity
    loads = [surface_load(patch) for patch in patches.values()]
    corrections = indentation_corrections(surface, loads)
    perturbations: tuple[ContactPerturbation, ...] = ()
    if perturbed:
        perturbations = (
            *contact_perturbations(session),
            *outward_perturbations(session, patch_of),
            *dip_perturbations(session, patch_of, corrections),
        )
    table = LoadTable(patches, pressed, patch_of, weight, shapes, perturbations, ())
    tractions = [
        _nominal(session, table, patch, load, correction)
        for patch, load, correction in zip(patches.values(), loads, corrections, strict=True)
    ]
    further = [*_outward(session, table), *_perturbed(session, table)]
    tractions += [
        _traction(replace(load, cells=_FEWER), dip, force)
        for (load, force), dip in zip(
            further, indentation_corrections(surface, [load for load, _ in further]), strict=True
        )
    ]
    return replace(table, tractions=tuple(tractions))


def _slices(items: Sequence[T]) -> Iterator[Sequence[T]]:
    """Consecutive slices of a few items."""
    for begin in range(0, len(items), _TOGETHER):
        yield items[begin : begin + _TOGETHER]


def _nominal(
    session: Session,
    table: LoadTable,
    patch: ContactPatch,
    load: SurfaceLoad,
    dip: IndentationCorrection | None,
) -> Traction:
    """The traction on a patch: of one newton along each axis; less where a perturbed contact takes
    its place; more of its dip where that is perturbed."""
    force = _units(table, patch)
    dip_force = dict(force)
    for column, perturbation, pushed in _own(session, table, patch):
        force[column] = -pushed if perturbation.patch is not None else np.zeros(3)
        dip_force[column] = force[column] + perturbation.dip * pushed
    traction = _traction(load, dip, force, is_uniform=patch.contact.triangles is not None)
    return replace(traction, dip_force=np.stack([*dip_force.values()], axis=1))


def _outward(session: Session, table: LoadTable) -> Iterator[tuple[SurfaceLoad, _Forces]]:
    """The outward parts of tractions, in proportion to the normal component of the force."""
    normals = unit_normals(session.mesh)
    for patch in table.patches.values():
        normal = normals[patch.triangle]
        every = _units(table, patch)
        for column, perturbation, pushed in _own(session, table, patch):
            if perturbation.outward:
                every[column] = perturbation.outward * pushed
        for load, share in outward_pushes(patch, normal, -normal):
            yield load, {column: -normal @ force * share for column, force in every.items()}


def _perturbed(session: Session, table: LoadTable) -> Iterator[tuple[SurfaceLoad, _Forces]]:
    """Contacts beside their place, or of another radius, under the forces of their probings."""
    for column, perturbation in zip(table.perturbation_columns, table.perturbations, strict=True):
        if perturbation.patch is not None:
            force = session.probings[perturbation.probing].force
            yield surface_load(perturbation.patch), {column: force}


def _units(table: LoadTable, patch: ContactPatch) -> _Forces:
    """One newton along each axis, in the columns of a patch."""
    return dict(zip(table.force_columns(patch.contact).tolist(), np.eye(3), strict=True))


def _own(
    session: Session, table: LoadTable, patch: ContactPatch
) -> Iterator[tuple[int, ContactPerturbation, Vector3]]:
    """Column, perturbation and force of each perturbation of the contact on a patch."""
    every = list(table.patches.values())
    for column, perturbation in zip(
        table.perturbation_columns.tolist(), table.perturbations, strict=True
    ):
        if every[table.patch_of[perturbation.probing]] is patch:
            yield column, perturbation, session.probings[perturbation.probing].force


def _traction(
    load: SurfaceLoad,
    dip: IndentationCorrection | None,
    forces: _Forces,
    *,
    is_uniform: bool = False,
) -> Traction:
    columns, force = np.array([*forces], dtype=np.int64), np.stack([*forces.values()], axis=1)
    return Traction(load, is_uniform, columns, force, dip, force)


def _distinct_patches(
    session: Session,
) -> tuple[dict[ContactKey, ContactPatch], dict[ContactKey, ContactPatch]]:
    """Distinct contacts under a force, and distinct contacts under a pressure."""
    patches: dict[ContactKey, ContactPatch] = {}
    pressed: dict[ContactKey, ContactPatch] = {}
    for probing in session.probings:
        contacts = [(patches, probing.contact)] if probing.contact.profile != RIGID else []
        contacts += [
            (patches if load.pressure is None else pressed, load.contact) for load in probing.loads
        ]
        for group, contact in contacts:
            if contact_key(contact) not in group:
                group[contact_key(contact)] = find_contact_patch(
                    session.mesh, contact, session.held_triangles, name=probing.name
                )
    return patches, pressed


def contact_key(contact: Contact) -> ContactKey:
    """Key that is equal for contacts with the same patch."""
    triangles = () if contact.triangles is None else tuple(contact.triangles.tolist())
    traction = contact.traction
    shape = () if traction is None else (traction.pressure.tobytes(), traction.outward.tobytes())
    return (*contact.point.tolist(), contact.radius, contact.profile, triangles, *shape)
